"""How often simultaneous bands of an identified model hold the true curve as a whole, beside pointwise ones.

usage: python benchmarks/curve_bands.py [--seeds 400]

The paper's five forces, 10 s at 100 Hz, in weak and in strong noise, and dry friction that stops the motion:
motion, envelope, frequency and damping ratio (`curve_bands`), and the forced response in both sweeps.
"""

import argparse

import numpy as np
import xarray as xr

import sysid_trib as st
from sysid_trib.cycles.envelope_prediction import Averaged, predict_envelope

W, RELEASE, CLOCK, DRIVE = 9.91, 0.3, np.arange(0.0, 10.0, 0.01), 2e-3
FIVE = {"lambda": -2.3e-5, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
CASES = {
    "five forces, weak noise": (FIVE, 1e-4),
    "five forces, strong noise": (FIVE, 3e-3),
    "dry friction, stop": ({"lambda": 8e-3, "zeta": 0.005}, 1e-3),
}
RATIOS = np.linspace(0.93, 1.04, 81)


def truth_of(model: st.Model, bands: xr.Dataset) -> dict[str, np.ndarray]:
    """The true curves where the bands are."""
    change, frequency = Averaged(model).rates(bands.amplitude.values)
    return {
        "angle": st.simulate(model, CLOCK, RELEASE).angle.values,
        "envelope": predict_envelope(model, bands.envelope_time.values, RELEASE).amplitude.values,
        "frequency": frequency,
        "damping_ratio": -change / (bands.amplitude.values * frequency),
    }


def covers(
    model: st.Model, seed: int, noise: float, response: np.ndarray | None
) -> dict[str, tuple[bool, float]]:
    """Of each curve whether it is wholly inside, and the part within 1.96 errors (of pointwise bands)."""
    angle = st.simulate(model, CLOCK, RELEASE).angle.values
    angle = angle + noise * np.random.default_rng([seed, 5]).standard_normal(len(CLOCK))
    decay = xr.Dataset({"angle": ("time", angle, {"units": "rad"})}, {"time": CLOCK})
    method = st.methods.Trajectory(random_force="off")
    fit = st.identify(decay, model.library, method)
    bands, held = st.validation.curve_bands(decay, fit), {}
    for name, true in truth_of(model, bands).items():
        apart = np.abs(bands[name].values - true)
        whole = np.all(apart <= bands[f"{name}_high"].values - bands[name].values + 1e-12)
        held[name] = bool(whole), float(np.mean(apart <= 1.96 * bands[f"{name}_standard_error"].values))
    if response is not None:
        made = driven(fit)
        ends = [(made[f"{name}_low"], made[f"{name}_high"]) for name in ("whole", "amplitude")]
        for at, sweep in enumerate(("up", "down")):
            inside = [(low <= response) & (response <= high) for low, high in ends]
            held[f"response, {sweep}"] = bool(inside[0][at].all()), float(inside[1][at].mean())
    return held


def driven(fit: xr.Dataset) -> xr.Dataset:
    """The forced response of a fit."""
    return st.validation.forced_response(fit, DRIVE, W * RATIOS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=400)
    parser.add_argument("--only", default="", help="part of a case's name")
    parser.add_argument("--no-response", action="store_true", help="leave out the forced response")
    asked = parser.parse_args()
    seeds = asked.seeds
    for case, (coefficients, noise) in CASES.items():
        model = st.Model(st.load_library().select(list(coefficients)), coefficients, W)
        response = None
        if asked.only not in case:
            continue
        if coefficients is FIVE and not asked.no_response:
            fit = st.identify(st.simulate(model, CLOCK, RELEASE)[["angle"]], model.library)[
                "direct"
            ].to_dataset()
            true = fit.assign(coefficient=fit.coefficient.copy(data=[*coefficients.values()]))
            response = driven(true.assign(reference_frequency=W)).amplitude
        rows = []
        for seed in range(seeds):
            try:
                rows.append(covers(model, seed, noise, response))
            except st.errors.SysidTribError as error:
                print(f"{case}, seed {seed}: {error}", flush=True)
        print(f"{case}: {len(rows)} records; wholly inside %, part within pointwise bands %")
        for name in rows[0]:
            whole, part = 100.0 * np.mean([row[name] for row in rows], axis=0)
            print(f"  {name:16} {whole:5.1f}  {part:5.1f}", flush=True)


if __name__ == "__main__":
    main()
