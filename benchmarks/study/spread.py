"""How often intervals of what varies between runs hold, on simulated round-robins.

Eight laboratories with three runs each. A coefficient has a spread between laboratories and one between their
runs, none to three stated errors in size; errors differ by a factor of e. Of these the intervals of
`between_runs` (spread, effect of the load, values of the runs) and of ISO 5725 are counted. With --identified
also of round-robins of six simulated records each, whose lambda scatters by 5 % and whose zeta goes with a
load: each record is identified by `Direct` from its samples.
"""

from argparse import Namespace

import numpy as np
import xarray as xr
from scipy.stats import t as student
from test_between_runs import runs_of

import sysid_trib as st
from benchmarks.study.common import W, shown, time_of

LABORATORIES, RUNS = 8, 3
SLOPE, SPREADS = 0.5, (0.0, 0.5, 1.0, 3.0)
NOISE, TRUTH = 4e-5, {"lambda": 1e-3, "zeta": 1e-3, "delta": 2e-3}
# Between runs, of lambda; and of zeta per unit of the load.
SCATTER, PER_LOAD = 5e-5, 1e-3
LOADS = np.repeat([0.0, 0.5, 1.0], 2)
PARTS = ("between_run", "load", "shrunken", "repeatability", "between_laboratory", "reproducibility")


def holds(fit: xr.Dataset, name: str, truth: float) -> bool:
    """Whether an interval holds the truth."""
    return bool(fit[f"{name}_lower"] <= truth <= fit[f"{name}_upper"])


def near(fit: xr.Dataset, slope: float, runs: int) -> bool:
    """Whether the effect of the load is within its interval of the true one."""
    of_load = fit.sel(term="load")
    return bool(abs(of_load.effect - slope) <= student.ppf(0.975, runs - 2) * of_load.effect_standard_error)


def of_values(spread: float, count: int) -> list[str]:
    """Round-robins of numbers, by the spread between runs of one laboratory in stated errors."""
    random = np.random.default_rng([LABORATORIES, int(10 * spread)])
    laboratory = np.repeat(np.arange(LABORATORIES), RUNS)
    runs, hold = len(laboratory), []
    for _ in range(count):
        errors, load = np.exp(random.uniform(-0.5, 0.5, runs)), random.uniform(0.0, 4.0, runs)
        true = 3.0 + SLOPE * load + spread * random.standard_normal(runs)
        values = runs_of(true + errors * random.standard_normal(runs), errors)
        fit = st.campaigns.between_runs(values, {"load": load}).squeeze()
        inside = np.abs(fit.shrunken - true) <= 1.96 * fit.shrunken_standard_error
        between = np.hypot(0.5, spread)
        each = between * random.standard_normal(LABORATORIES)[laboratory] + random.standard_normal(runs)
        place = {"place": laboratory}
        iso = st.campaigns.between_runs(
            runs_of(each, np.full(runs, 0.1)), place, laboratories="place"
        ).squeeze()
        truths = zip(PARTS[3:], (1.0, between, np.hypot(1.0, between)), strict=True)
        of_iso = [holds(iso, name, truth) for name, truth in truths]
        hold.append(
            [holds(fit, "between_run", spread), near(fit, SLOPE, runs), float(inside.mean()), *of_iso]
        )
    return [f"{spread:g}", *(f"{100.0 * share:.1f}" for share in np.mean(hold, axis=0))]


def of_records(count: int) -> list[str]:
    """Round-robins of records: spread of lambda, effect on zeta, verdicts of both and of delta."""
    library, time, hold = st.load_library("contact_forces").select(TRUTH), time_of(20, 60), []
    for at in range(count):
        random, results = np.random.default_rng([at, 7]), []
        for load in LOADS:
            friction = TRUTH["lambda"] + SCATTER * random.standard_normal()
            own = TRUTH | {"lambda": friction, "zeta": TRUTH["zeta"] + PER_LOAD * load}
            angle = st.simulate(st.Model(library, own, W), time, 0.3).angle
            noisy = xr.Dataset({"angle": angle + NOISE * random.standard_normal(len(time))})
            results.append(st.identify(noisy, library, st.methods.Direct(random_force="estimated")))
        fit = st.campaigns.between_runs(results, {"load": LOADS})
        friction, viscous = fit.sel(quantity="lambda"), fit.sel(quantity="zeta")
        said = zip(TRUTH, ("scatters", "varies with load", "common"), strict=True)
        verdicts = [bool(fit.verdict.sel(quantity=name) == verdict) for name, verdict in said]
        hold.append([holds(friction, "between_run", SCATTER), near(viscous, PER_LOAD, len(LOADS)), *verdicts])
    return [str(count), *(f"{100.0 * share:.1f}" for share in np.mean(hold, axis=0))]


def main(asked: Namespace) -> None:
    title = f"{asked.seeds} round-robins each: intervals of 95 % that hold (%)"
    heads = ("between runs", "load", "runs, shrunken")
    heads += ("repeatability", "between laboratories", "reproducibility")
    rows = (of_values(spread, asked.seeds) for spread in SPREADS)
    shown(title, ("spread / stated error", *heads), rows)
    if asked.identified:
        heads = ("spread of lambda holds (%)", "effect on zeta holds (%)")
        heads += ("lambda scatters (%)", "zeta varies with load (%)", "delta common (%)")
        title = f"{len(LOADS)} records each, identified"
        shown(title, ("round-robins", *heads), [of_records(asked.identified)])
