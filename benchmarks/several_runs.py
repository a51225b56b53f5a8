"""Two runs of one experiment identified together: RMS error over the Cramér-Rao bound of both, agreement.

python benchmarks/several_runs.py [--seeds N]

Runs of the paper's five forces, w = 9.91 rad/s given: 25 s at 100 Hz from 0.3 rad with white noise of
1e-4 rad, and 15 s at 50 Hz from 0.6 rad with 3e-4 rad; the seeds are 0, 1, 2, ...
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rich.console import Console
from rich.table import Table
from scipy.stats import kstest

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
from helpers import FIVE, Run, W, paper_run, rms, values  # noqa: E402

from sysid_trib import cramer_rao_bound, identify, run_agreement  # noqa: E402
from sysid_trib.methods import Averaging, Direct, Trajectory  # noqa: E402

LONG = paper_run(FIVE)
RUNS = (LONG, replace(paper_run(FIVE, duration=15.0, sampling_rate=50.0), start=0.6))
NOISES = (1e-4, 3e-4)
LIBRARY = LONG.model.library.select(FIVE)


def bound(runs: Sequence[Run], noises: Sequence[float]) -> np.ndarray:
    """Smallest standard errors of the forces from all runs, whose starts are their own."""
    each = [
        cramer_rao_bound(run.model, run.time, run.start, 0.0, noise).covariance.values
        for run, noise in zip(runs, noises, strict=True)
    ]
    # Coefficients differ by orders of magnitude: scaled, the matrices are well conditioned.
    size = np.sqrt(np.diag(each[0]))
    information = sum(np.linalg.inv(covariance / np.outer(size, size)) for covariance in each)
    return size * np.sqrt(np.diag(np.linalg.inv(information)))


def decays(seed: int) -> list[xr.Dataset]:
    """Both runs, with noise of their own."""
    return [run.decay(2 * seed + at, NOISES[at]) for at, run in enumerate(RUNS)]


def row(method: Any, seeds: int) -> list[str]:
    """RMS error of each force over the bound, and how many 95 % intervals cover."""
    results = [identify(decays(seed), LIBRARY, method) for seed in range(seeds)]
    errors = np.array([values(result, FIVE) - list(FIVE.values()) for result in results])
    stated = np.array([result.standard_error.sel(force=list(FIVE)).values for result in results])
    covered = 100.0 * np.mean(np.abs(errors) < 1.96 * stated, axis=0)
    ratios = rms(errors) / bound(RUNS, NOISES)
    return [
        type(method).__name__,
        *(f"{r:.2f}" for r in ratios),
        f"{covered.min():.0f} to {covered.max():.0f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    seeds = parser.parse_args().seeds
    table = Table("", *FIVE, "95 % intervals cover (%)", title=f"RMS error / bound of both, {seeds} seeds")
    for name, at in (("bound of the first alone", 0), ("bound of the second alone", 1)):
        ratio = bound(RUNS[at : at + 1], NOISES[at : at + 1]) / bound(RUNS, NOISES)
        table.add_row(name, *(f"{r:.2f}" for r in ratio), "")
    for method in (Direct(W), Trajectory(W), Averaging(reference_frequency=W)):
        table.add_row(*row(method, seeds))
    Console(width=120).print(table)
    chances = [
        run_agreement(runs, identify(runs, LIBRARY, Direct(W))).total_p_value.item()
        for runs in map(decays, range(seeds))
    ]
    share, uniform = 100.0 * np.mean(np.less(chances, 0.05)), kstest(chances, "uniform").pvalue
    print(
        f"Do the runs agree: p below 0.05 in {share:.0f} %; uniform by Kolmogorov and Smirnov: {uniform:.2g}."
    )


if __name__ == "__main__":
    main()
