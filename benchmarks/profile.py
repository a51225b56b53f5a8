"""How often profile intervals of 95 % hold the truth, beside those of 1.96 standard errors of the same fit.

usage: python benchmarks/profile.py [--seeds 400] [--only WORD] [--out FILE]     with FILE resumable

Presliding length, Stribeck speed, and dry friction near zero that is bounded at zero, with a stop at the end.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
import xarray as xr

import sysid_trib as st
from sysid_trib.forces import ForceLibrary

W, RATE = 9.9, 50.0
CONTACT, CANDIDATES = st.load_library(), st.load_library("candidate_effects")
# Of each case: coefficients, shapes, release (rad), duration (s), noise (rad), constraints.
CASES = {
    "dahl.s": ({"zeta": 0.005, "dahl": 6e-4}, {"dahl.s": 0.03}, 0.3, 12.0, 3e-3, {}),
    "stribeck.s": ({"zeta": 0.005, "stribeck": 3e-3}, {"stribeck.s": 0.05}, 0.3, 12.0, 2e-3, {}),
    "lambda": ({"zeta": 0.02, "lambda": 5e-5}, {}, 0.1, 40.0, 6e-3, {"lambda": (0.0, None)}),
}


def fitted_record(name: str, seed: int, quieter: float = 1.0) -> tuple[xr.Dataset, xr.Dataset]:
    """A record of a case, its noise over a number, and its fit."""
    coefficients, shapes, release, duration, noise, constraints = CASES[name]
    forces = (*CONTACT, *CANDIDATES.select([s for s in coefficients if s in CANDIDATES.symbols]))
    library = ForceLibrary("of the case", forces).select(list(coefficients))
    model, clock = st.Model(library, coefficients, W, shapes), np.arange(0.0, duration, 1.0 / RATE)
    angle = st.simulate(model, clock, release).angle.values
    angle = angle + noise / quieter * np.random.default_rng([seed, 11]).standard_normal(len(clock))
    decay = xr.Dataset({"angle": ("time", angle, {"units": "rad"})}, {"time": clock})
    method = st.methods.Trajectory(fit_shapes=tuple(shapes), random_force="off", constraints=constraints)
    return decay, st.identify(decay, library, method)


def intervals(name: str, seed: int) -> list[float]:
    """Truth, the fit's value and standard error, both ends by the profile, processor time (s)."""
    coefficients, shapes, *_ = CASES[name]
    begin = time.process_time()
    decay, fit = fitted_record(name, seed)
    row = st.validation.profile(decay, fit, [name]).isel(parameter=0)
    stated = fit.sel(shape_parameter=name) if shapes else fit.sel(force=name)
    words = ("shape", "shape_standard_error") if shapes else ("coefficient", "standard_error")
    numbers = [stated[word].item() for word in words] + [row.low.item(), row.high.item()]
    return [(coefficients | shapes)[name], *numbers, time.process_time() - begin]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=400)
    parser.add_argument("--only", default="", help="part of a case's name")
    parser.add_argument("--out", type=Path, default=None, help="a line of JSON a record; those in it stand")
    asked = parser.parse_args()
    there = asked.out.read_text().splitlines() if asked.out and asked.out.exists() else []
    rows = {(name, seed): numbers for name, seed, numbers in map(json.loads, there)}
    names = [name for name in CASES if asked.only in name]
    for seed in range(asked.seeds):
        for name in names:
            if (name, seed) in rows:
                continue
            try:
                rows[name, seed] = intervals(name, seed)
            except st.errors.SysidTribError as error:
                print(f"{name}, seed {seed}: {error}", flush=True)
                rows[name, seed] = [np.nan] * 6
            if asked.out:
                asked.out.open("a").write(json.dumps([name, seed, rows[name, seed]]) + "\n")
    print("case         seeds  failed  profile %  below  above  1.96 errors %  s of one")
    for name in names:
        numbers = np.array([row for (case, _), row in rows.items() if case == name])
        truth, value, error, low, high, spent = numbers.T
        made = np.isfinite(truth)
        truth, value, error, low, high = (numbers[made] for numbers in (truth, value, error, low, high))
        below, above = (100.0 * np.mean(side) for side in (high < truth, low > truth))
        by_error = 100.0 * np.mean(np.abs(value - truth) <= 1.96 * error)
        counts = f"{len(made):7}  {np.count_nonzero(~made):6}  {100.0 - below - above:9.1f}  {below:5.1f}"
        print(f"{name:11}{counts}  {above:5.1f}  {by_error:13.1f}  {np.nanmean(spent):8.2f}")


if __name__ == "__main__":
    main()
