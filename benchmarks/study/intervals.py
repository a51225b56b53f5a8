"""Coverage of 95 % intervals and bands.

profile: profile intervals beside 1.96 standard errors of the same fit: presliding length, Stribeck speed, and
dry friction near zero that is bounded at zero, with a stop at the end.
curve_bands: simultaneous bands of an identified model, beside pointwise ones: the paper's five forces, 10 s
at 100 Hz, in weak and in strong noise, and dry friction that stops the motion. Bands know the error of the
noise alone: two cases more show what they miss, a random force that the fit takes for none, and a force that
the model lacks.
"""

import time
from argparse import Namespace
from functools import partial

import numpy as np
import pandas as pd
import xarray as xr
from helpers import FIVE, decay

import sysid_trib as st
from benchmarks.study.common import columns, over_seeds, shown
from sysid_trib.forces import ForceLibrary
from sysid_trib.questions.averaged_motion import averaged_rates, predict_envelope

W, RATE = 9.9, 50.0
CONTACT, CANDIDATES = st.load_library(), st.load_library("candidate_effects")
# Of each case: coefficients, shapes, release (rad), duration (s), noise (rad), constraints.
PARAMETERS = {
    "dahl.s": ({"zeta": 0.005, "dahl": 6e-4}, {"dahl.s": 0.03}, 0.3, 12.0, 3e-3, {}),
    "stribeck.s": ({"zeta": 0.005, "stribeck": 3e-3}, {"stribeck.s": 0.05}, 0.3, 12.0, 2e-3, {}),
    "lambda": ({"zeta": 0.02, "lambda": 5e-5}, {}, 0.1, 40.0, 6e-3, {"lambda": (0.0, None)}),
}


def fitted_record(name: str, seed: int) -> tuple[xr.Dataset, xr.Dataset]:
    """A record of a case, and its fit."""
    coefficients, shapes, release, duration, noise, constraints = PARAMETERS[name]
    forces = (*CONTACT, *CANDIDATES.select([s for s in coefficients if s in CANDIDATES.symbols]))
    library = ForceLibrary("of the case", forces).select(list(coefficients))
    model, clock = st.Model(library, coefficients, W, shapes), np.arange(0.0, duration, 1.0 / RATE)
    angle = st.simulate(model, clock, release).angle.values
    record = decay(clock, angle, [seed, 11], noise)
    method = st.methods.Trajectory(fit_shapes=tuple(shapes), random_force="off", constraints=constraints)
    return record, st.identify(record, library, method)


def interval(name: str, seed: int) -> dict:
    """Truth, the fit's value and standard error, both ends by the profile, processor time (s)."""
    coefficients, shapes, *_ = PARAMETERS[name]
    begin = time.process_time()
    record, fit = fitted_record(name, seed)
    row = st.validation.profile(record, fit, [name]).isel(parameter=0)
    stated = fit.sel(shape_parameter=name) if shapes else fit.sel(force=name)
    words = ("shape", "shape_standard_error") if shapes else ("coefficient", "standard_error")
    numbers = [stated[word].item() for word in words] + [row.low.item(), row.high.item()]
    return {"numbers": [(coefficients | shapes)[name], *numbers, time.process_time() - begin]}


def profile(asked: Namespace) -> None:
    rows = []
    for name in (name for name in PARAMETERS if asked.only in name):
        every = over_seeds(asked, partial(interval, name), case=name)
        (numbers,) = columns((row for row in every if "failed" not in row), "numbers")
        truth, value, error, low, high, spent = numbers.T
        below, above = (100.0 * np.mean(side) for side in (high < truth, low > truth))
        by_error = 100.0 * np.mean(np.abs(value - truth) <= 1.96 * error)
        shares = (f"{share:.1f}" for share in (100.0 - below - above, below, above, by_error))
        rows.append([name, str(len(every)), str(len(every) - len(truth)), *shares, f"{np.mean(spent):.2f}"])
    heads = ("case", "seeds", "failed", "profile (%)", "below", "above", "1.96 errors (%)", "s of one")
    shown("intervals of 95 % that hold", heads, rows)


PAPER_W, RELEASE, CLOCK = 9.91, 0.3, np.arange(0.0, 10.0, 0.01)
# Of each case: coefficients, noise (rad), forces that the fit lacks, density of a random force.
CURVES = {
    "five forces, weak noise": (FIVE, 1e-4, (), 0.0),
    "five forces, strong noise": (FIVE, 3e-3, (), 0.0),
    "dry friction, stop": ({"lambda": 8e-3, "zeta": 0.005}, 1e-3, (), 0.0),
    "random force, taken for none": (FIVE, 1e-4, (), 1e-6),
    "quadratic damping lacks": (FIVE, 1e-4, ("delta",), 0.0),
}


def true_curves(model: st.Model, bands: xr.Dataset) -> dict[str, np.ndarray]:
    """The true curves, but the motion, where the bands are."""
    change, frequency = averaged_rates(model)(bands.amplitude.values)
    return {
        "envelope": predict_envelope(model, bands.envelope_time.values, RELEASE).amplitude.values,
        "frequency": frequency,
        "damping_ratio": -change / (bands.amplitude.values * frequency),
    }


def covers(case: str, seed: int) -> dict[str, tuple[bool, float]]:
    """Return for each curve whether it is inside, and the part within 1.96 errors (pointwise bands)."""
    coefficients, noise, lacking, density = CURVES[case]
    model = st.Model(CONTACT.select(list(coefficients)), coefficients, PAPER_W)
    motion = st.simulate(model, CLOCK, RELEASE, random_force=density, seed=seed).angle.values
    record = decay(CLOCK, motion, [seed, 5], noise)
    offered = model.library.select([symbol for symbol in coefficients if symbol not in lacking])
    fit = st.identify(record, offered, st.methods.Trajectory(random_force="off"))
    bands, held = st.validation.curve_bands(record, fit), {}
    for name, true in ({"angle": motion} | true_curves(model, bands)).items():
        apart = np.abs(bands[name].values - true)
        whole = np.all(apart <= bands[f"{name}_high"].values - bands[name].values + 1e-12)
        held[name] = bool(whole), float(np.mean(apart <= 1.96 * bands[f"{name}_standard_error"].values))
    return held


def curve_bands(asked: Namespace) -> None:
    rows = []
    for case in (case for case in CURVES if asked.only in case):
        every = over_seeds(asked, partial(covers, case), case=case)
        found = pd.DataFrame([row for row in every if "failed" not in row])
        for name, pairs in found.drop(columns=["case", "seed"]).items():
            whole, part = 100.0 * np.mean([*pairs], axis=0)
            rows.append([case, str(len(found)), str(name), f"{whole:.1f}", f"{part:.1f}"])
    heads = ("case", "records", "curve", "wholly inside (%)", "parts within pointwise bands (%)")
    shown("simultaneous bands of 95 %", heads, rows)
