"""How often simultaneous bands of an identified model hold the true curve as a whole, beside pointwise ones.

The paper's five forces, 10 s at 100 Hz, in weak and in strong noise, and dry friction that stops the motion:
motion, envelope, frequency and damping ratio (`curve_bands`), and the forced response in both sweeps. Bands
know the error of the noise alone: two cases more show what they miss, a random force that the fit takes for
none, and a force that the model lacks.
"""

from argparse import Namespace

import numpy as np
import pandas as pd
import xarray as xr
from helpers import decay

import sysid_trib as st
from benchmarks.study.common import gone_on, shown
from sysid_trib.cycles.averaged_motion import averaged_rates, predict_envelope

W, RELEASE, CLOCK, DRIVE = 9.91, 0.3, np.arange(0.0, 10.0, 0.01), 2e-3
FIVE = {"lambda": -2.3e-5, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
# Of each case: coefficients, noise (rad), forces that the fit lacks, density of a random force.
CASES = {
    "five forces, weak noise": (FIVE, 1e-4, (), 0.0),
    "five forces, strong noise": (FIVE, 3e-3, (), 0.0),
    "dry friction, stop": ({"lambda": 8e-3, "zeta": 0.005}, 1e-3, (), 0.0),
    "random force, taken for none": (FIVE, 1e-4, (), 1e-6),
    "quadratic damping lacks": (FIVE, 1e-4, ("delta",), 0.0),
}
RATIOS = np.linspace(0.93, 1.04, 81)


def model_of(coefficients: dict[str, float]) -> st.Model:
    """The model of a case."""
    return st.Model(st.load_library().select(list(coefficients)), coefficients, W)


def truth_of(model: st.Model, bands: xr.Dataset) -> dict[str, np.ndarray]:
    """The true curves, but the motion, where the bands are."""
    change, frequency = averaged_rates(model)(bands.amplitude.values)
    return {
        "envelope": predict_envelope(model, bands.envelope_time.values, RELEASE).amplitude.values,
        "frequency": frequency,
        "damping_ratio": -change / (bands.amplitude.values * frequency),
    }


def covers(case: str, seed: int, response: np.ndarray | None) -> dict[str, tuple[bool, float]]:
    """Of each curve whether it is wholly inside, and the part within 1.96 errors (of pointwise bands)."""
    coefficients, noise, lacking, density = CASES[case]
    model = model_of(coefficients)
    motion = st.simulate(model, CLOCK, RELEASE, random_force=density, seed=seed).angle.values
    record = decay(CLOCK, motion, [seed, 5], noise)
    offered = model.library.select([symbol for symbol in coefficients if symbol not in lacking])
    fit = st.identify(record, offered, st.methods.Trajectory(random_force="off"))
    bands, held = st.validation.curve_bands(record, fit), {}
    for name, true in ({"angle": motion} | truth_of(model, bands)).items():
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


def true_response() -> np.ndarray:
    """The forced response of the five forces."""
    model = model_of(FIVE)
    record = st.simulate(model, CLOCK, RELEASE)[["angle"]]
    fit = st.identify(record, model.library)["direct"].to_dataset()
    true = fit.assign(coefficient=fit.coefficient.copy(data=[*FIVE.values()]))
    return driven(true.assign(reference_frequency=W)).amplitude


def main(asked: Namespace) -> None:
    response, rows = None if asked.no_response else true_response(), []
    for case in (case for case in CASES if asked.only in case):

        def make(seeds: list[int], case=case):
            for seed in seeds:
                try:
                    yield covers(case, seed, response if case.startswith("five") else None)
                except st.errors.SysidTribError as error:
                    yield {"failed": str(error)}

        found = [row for row in gone_on(asked.out, asked.seeds, make, case=case) if "failed" not in row]
        of_curves = pd.DataFrame(found).drop(columns=["case", "seed"], errors="ignore")
        for name, pairs in of_curves.items():
            whole, part = 100.0 * np.mean([*pairs], axis=0)
            rows.append([case, str(len(found)), str(name), f"{whole:.1f}", f"{part:.1f}"])
    heads = ("case", "records", "curve", "wholly inside (%)", "parts within pointwise bands (%)")
    shown("simultaneous bands of 95 %", heads, rows)
