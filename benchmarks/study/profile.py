"""How often profile intervals of 95 % hold the truth, beside those of 1.96 standard errors of the same fit.

Presliding length, Stribeck speed, and dry friction near zero that is bounded at zero, with a stop at the end.
"""

import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
import xarray as xr
from helpers import decay

import sysid_trib as st
from benchmarks.study.common import gone_on, shown
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
    record = decay(clock, angle, [seed, 11], noise / quieter)
    method = st.methods.Trajectory(fit_shapes=tuple(shapes), random_force="off", constraints=constraints)
    return record, st.identify(record, library, method)


def intervals(name: str, seed: int) -> list[float]:
    """Truth, the fit's value and standard error, both ends by the profile, processor time (s)."""
    coefficients, shapes, *_ = CASES[name]
    begin = time.process_time()
    record, fit = fitted_record(name, seed)
    row = st.validation.profile(record, fit, [name]).isel(parameter=0)
    stated = fit.sel(shape_parameter=name) if shapes else fit.sel(force=name)
    words = ("shape", "shape_standard_error") if shapes else ("coefficient", "standard_error")
    numbers = [stated[word].item() for word in words] + [row.low.item(), row.high.item()]
    return [(coefficients | shapes)[name], *numbers, time.process_time() - begin]


def main(asked: Namespace) -> None:
    rows = []
    for name in (name for name in CASES if asked.only in name):
        one = partial(intervals, name)
        found = np.array([row["numbers"] for row in gone_on(asked.out, asked.seeds, each(one), case=name)])
        truth, value, error, low, high, spent = found[np.isfinite(found[:, 0])].T
        below, above = (100.0 * np.mean(side) for side in (high < truth, low > truth))
        by_error = 100.0 * np.mean(np.abs(value - truth) <= 1.96 * error)
        shares = (f"{share:.1f}" for share in (100.0 - below - above, below, above, by_error))
        counts = (name, str(len(found)), str(len(found) - len(truth)))
        rows.append([*counts, *shares, f"{np.mean(spent):.2f}"])
    heads = ("case", "seeds", "failed", "profile (%)", "below", "above", "1.96 errors (%)", "s of one")
    shown("intervals of 95 % that hold", heads, rows)


def each(one: Callable[[int], list[float]]) -> Callable[[list[int]], Iterator[dict]]:
    """What the file says of each seed; where it fails no number."""

    def make(seeds: list[int]) -> Iterator[dict]:
        for seed in seeds:
            try:
                yield {"numbers": one(seed)}
            except st.errors.SysidTribError as error:
                print(f"seed {seed}: {error}", flush=True)
                yield {"numbers": [np.nan] * 6}

    return make
