"""How often intervals of what varies between runs hold, on simulated round-robins.

python benchmarks/round_robins.py [--round-robins N] [--identified N]

Eight laboratories with three runs each. A coefficient has a spread between laboratories and one between
their runs, none to three stated errors in size; errors differ by a factor of e. Of these the intervals
of `between_runs` (spread, effect of the load, values of the runs) and of ISO 5725 are counted. With
--identified also of round-robins of six simulated records each, whose lambda scatters by 5 % and whose zeta
goes with a load: each record is identified by `Direct` from its samples.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table
from scipy.stats import t as student

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]

import sysid_trib as st  # noqa: E402

LABORATORIES, RUNS = 8, 3
SLOPE, SPREADS = 0.5, (0.0, 0.5, 1.0, 3.0)
W, NOISE, PERIODS, PER_PERIOD = 8.87, 4e-5, 20, 60
TRUTH = {"lambda": 1e-3, "zeta": 1e-3, "delta": 2e-3}
# Between runs, of lambda; and of zeta per unit of the load.
SCATTER, PER_LOAD = 5e-5, 1e-3
RIGS, LOADS = 6, np.repeat([0.0, 0.5, 1.0], 2)


def of_values(spread: float, count: int) -> list[str]:
    """Round-robins of numbers, by the spread between runs of one laboratory in stated errors."""
    random = np.random.default_rng([LABORATORIES, int(10 * spread)])
    laboratory = np.repeat(np.arange(LABORATORIES), RUNS)
    runs = len(laboratory)
    names = ("between_run", "load", "shrunken", "repeatability", "between_laboratory", "reproducibility")
    hold = {name: [] for name in names}
    for _ in range(count):
        errors, load = np.exp(random.uniform(-0.5, 0.5, runs)), random.uniform(0.0, 4.0, runs)
        true = 3.0 + SLOPE * load + spread * random.standard_normal(runs)
        runs_of = _dataset(true + errors * random.standard_normal(runs), errors)
        fit = st.campaigns.between_runs(runs_of, {"load": load}).squeeze()
        hold["between_run"].append(fit.between_run_lower <= spread <= fit.between_run_upper)
        slope = fit.sel(term="load")
        reach = student.ppf(0.975, runs - 2) * slope.effect_standard_error
        hold["load"].append(abs(slope.effect - SLOPE) <= reach)
        off = np.abs(fit.shrunken - true) <= 1.96 * fit.shrunken_standard_error
        hold["shrunken"].append(float(off.mean()))
        between = np.hypot(0.5, spread)
        values = between * random.standard_normal(LABORATORIES)[laboratory] + random.standard_normal(runs)
        iso = st.campaigns.between_runs(
            _dataset(values, np.full(runs, 0.1)), {"place": laboratory}, laboratories="place"
        ).squeeze()
        for name, truth in zip(names[3:], (1.0, between, np.hypot(1.0, between)), strict=True):
            hold[name].append(iso[f"{name}_lower"] <= truth <= iso[f"{name}_upper"])
    return [f"{spread:g}", *(f"{100.0 * np.mean(hold[name]):.1f}" for name in names)]


def _dataset(values: np.ndarray, errors: np.ndarray) -> xr.Dataset:
    dims = ("run", "quantity")
    variables = {"value": (dims, values[:, None]), "standard_error": (dims, errors[:, None])}
    return xr.Dataset(variables, {"quantity": ["lambda"]})


def of_records(count: int) -> list[str]:
    """Round-robins of records: spread of lambda, effect on zeta, verdicts of both and of delta."""
    library = st.load_library("contact_forces").select(TRUTH)
    direct = st.methods.Direct(random_force="estimated")
    time = np.arange(PERIODS * PER_PERIOD) * 2.0 * np.pi / W / PER_PERIOD
    counted = np.zeros(5)
    for at in range(count):
        random = np.random.default_rng([at, 7])
        results = []
        for load in LOADS:
            own = {
                "lambda": TRUTH["lambda"] + SCATTER * random.standard_normal(),
                "zeta": TRUTH["zeta"] + PER_LOAD * load,
                "delta": TRUTH["delta"],
            }
            angle = st.simulate(st.Model(library, own, W), time, 0.3).angle
            noisy = angle + NOISE * random.standard_normal(len(time))
            results.append(st.identify(xr.Dataset({"angle": noisy}), library, direct))
        fit = st.campaigns.between_runs(results, {"load": LOADS})
        friction, viscous = fit.sel(quantity="lambda"), fit.sel(quantity="zeta")
        reach = student.ppf(0.975, RIGS - 2) * viscous.effect_standard_error.sel(term="load")
        counted += [
            friction.between_run_lower <= SCATTER <= friction.between_run_upper,
            abs(viscous.effect.sel(term="load") - PER_LOAD) <= reach,
            friction.verdict == "scatters",
            viscous.verdict == "varies with load",
            fit.verdict.sel(quantity="delta") == "common",
        ]
    return [str(count), *(f"{100.0 * share:.1f}" for share in counted / count)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--round-robins", type=int, default=2000)
    parser.add_argument("--identified", type=int, default=0)
    options = parser.parse_args()
    heads = ["spread / stated error", "between runs", "load", "runs, shrunken"]
    heads += ["repeatability", "between laboratories", "reproducibility"]
    table = Table(*heads, title=f"{options.round_robins} round-robins each: intervals of 95 % that hold (%)")
    for spread in SPREADS:
        table.add_row(*of_values(spread, options.round_robins))
    Console(width=120).print(table)
    if options.identified:
        heads = ["round-robins", "spread of lambda holds (%)", "effect on zeta holds (%)"]
        heads += ["lambda scatters (%)", "zeta varies with load (%)", "delta common (%)"]
        table = Table(*heads, title=f"{RIGS} records each, identified")
        table.add_row(*of_records(options.identified))
        Console(width=120).print(table)


if __name__ == "__main__":
    main()
