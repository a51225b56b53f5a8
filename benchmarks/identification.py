"""How precise the identifications are on simulated runs of the paper's experiment, over the Cramér-Rao bound.

python benchmarks/identification.py [--quick] [--only WORDS]

Every run is the paper's (w = 9.91 rad/s, from 0.3 rad at rest, 25 s at 100 Hz, white noise of 1e-4 rad)
unless its title says otherwise; the seeds of the noise are 0, 1, 2, ...
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table
from scipy.stats import kstest

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "tests")]
import peers  # noqa: E402
from helpers import (  # noqa: E402
    EIGHT_MORE,
    FIVE,
    NOISE,
    SIX,
    Run,
    W,
    decay,
    library_of_formulas,
    names,
    paper_run,
    rms,
)
from stopwatch import timed  # noqa: E402

import sysid_trib as st  # noqa: E402
from sysid_trib import ForceLibrary  # noqa: E402
from sysid_trib.methods import Averaging, Direct, Trajectory  # noqa: E402
from sysid_trib.motion_fit.cramer_rao import cramer_rao_bound  # noqa: E402
from sysid_trib.validation.cross_check import cross_check  # noqa: E402

STRONG = SIX | {"lambda": 1e-3}
QUICK = 20


@dataclass(frozen=True)
class Study:
    """Many noisy records of one run, identified in one way: `identify` gives coefficients and errors."""

    title: str
    run: Run
    identify: Callable
    seeds: int
    bar: float = np.nan


def ours(method, *, decided: bool = False) -> Callable:
    """A method as it is; `decided`: as the commands have it, its noise decided and its errors total."""

    def identify(run: Run, angle: np.ndarray):
        asked = decay(run.time, angle), run.model.library
        result = st.identify(*asked, method) if decided else method.identify(*asked)
        result = result.sel(force=list(run.model.coefficients))
        return result.coefficient.values, result.standard_error.values

    return identify


def peer(function) -> Callable:
    def identify(run: Run, angle: np.ndarray):
        library = run.model.library.select(run.model.coefficients)
        values = function(library, run.model.reference_frequency, run.time, angle)
        return values, np.full(len(values), np.nan)

    return identify


PAPER, FINE = paper_run(), paper_run(sampling_rate=1000.0)
DRY, FITTED = paper_run(STRONG, duration=14.0), paper_run(FIVE)
STOP = paper_run(STRONG)
GOLAY = peers.inner_savitzky_golay
STUDIES = [
    Study("Direct", PAPER, ours(Direct(W)), 400, bar=1.2),
    Study("Direct, lambda = 1e-3, 14 s", DRY, ours(Direct(W)), 400, bar=1.5),
    Study("Direct, 1 kHz", FINE, ours(Direct(W)), 100, bar=1.2),
    Study("Direct, frequency fitted", FITTED, ours(Direct()), 400, bar=1.2),
    Study("Direct, unrefined", PAPER, ours(Direct(W, refine=False)), 400),
    Study("Direct, unrefined, lambda = 1e-3, 14 s", DRY, ours(Direct(W, refine=False)), 400),
    Study("Direct, strong form", PAPER, ours(Direct(W, form="strong")), 50),
    Study("Trajectory", PAPER, ours(Trajectory(W)), 400, bar=1.12),
    Study("Trajectory, lambda = 1e-3, stop inside", STOP, ours(Trajectory(W)), 400, bar=1.12),
    Study("Averaging", FITTED, ours(Averaging()), 200),
    Study("Decided: direct", FITTED, ours(Direct(), decided=True), 200, bar=1.05),
    Study("Decided: direct, lambda = 1e-3, 14 s", DRY, ours(Direct(W), decided=True), 200, bar=1.05),
    Study("Decided: averaging", FITTED, ours(Averaging(), decided=True), 200),
    Study("Averaging, lambda = 1e-3, 14 s, w given", DRY, ours(Averaging(reference_frequency=W)), 100),
    Study("Averaging, uncorrected", FITTED, ours(Averaging(correct=False)), 200),
    Study("Averaging, the paper's rule", FITTED, ours(Averaging(frequency="last", correct=False)), 200),
    Study("pysindy.SINDy, finite differences", PAPER, peer(peers.sindy), 50),
    Study("pysindy.SINDy, Savitzky-Golay", PAPER, peer(partial(peers.sindy, derivatives=GOLAY)), 50),
    Study("pysindy.WeakPDELibrary", PAPER, peer(peers.weak_sindy), 20),
    Study("pysindy.SINDy, finite differences, 1 kHz", FINE, peer(peers.sindy), 20),
    Study(
        "pysindy.SINDy, Savitzky-Golay, 1 kHz",
        FINE,
        peer(partial(peers.sindy, derivatives=partial(GOLAY, window=0.18))),
        20,
    ),
    Study("pysindy.WeakPDELibrary, 1 kHz", FINE, peer(peers.weak_sindy), 10),
]


def study_row(study: Study, seeds: int, tick: Callable) -> list[str]:
    """One row of the table: RMS error over the bound, share of 95 % intervals that cover, time."""
    run, truth, exact = study.run, study.run.model.coefficients, study.run.angle
    free = "alpha" not in truth
    bound = cramer_rao_bound(run.model, run.time, run.start, 0.0, NOISE, free=free).standard_error.values
    errors, reported = np.empty((2, seeds, len(truth)))
    spent = []
    for seed in range(seeds):
        angle = decay(run.time, exact, seed).angle.values
        (values, reported[seed]), seconds = timed(lambda angle=angle: study.identify(run, angle))
        spent.append(seconds)
        errors[seed] = values - list(truth.values())
        tick()
    ratio = dict(zip(truth, rms(errors) / bound, strict=True))
    covered = 100.0 * np.mean(np.abs(errors) < 1.96 * reported, axis=0)
    worst = max(ratio.values())
    verdict = "" if np.isnan(study.bar) else f"{'yes' if worst <= study.bar else 'NO'} ({study.bar:g})"
    cover = "" if np.isnan(reported).any() else f"{covered.min():.1f} to {covered.max():.1f}"
    cells = [f"{ratio[symbol]:.3g}" if symbol in ratio else "" for symbol in SIX]
    return [study.title, str(seeds), *cells, cover, verdict, f"{1e3 * np.median(spent):.0f}"]


def selection_rows(seeds: int, tick: Callable) -> list[list[str]]:
    """How often significance keeps exactly the five true forces out of fourteen."""
    offered = ForceLibrary(
        "fourteen", (*PAPER.model.library.forces, *library_of_formulas(**EIGHT_MORE).forces)
    )
    exact, method = PAPER.angle, Direct(W, significance=0.01)
    kept = []
    for seed in range(seeds):
        result = method.identify(decay(PAPER.time, exact, seed), offered)
        kept.append(names(offered.symbols, result.active.values))
        tick()
    hits = np.mean([symbols == set(FIVE) for symbols in kept])
    missed = np.mean([bool(set(FIVE) - symbols) for symbols in kept])
    title = "selection by significance: exactly the five of fourteen"
    return [[title, str(seeds), f"{100 * hits:.1f} %, a true one missed in {100 * missed:.1f} % (bar 90 %)"]]


def calibration_row(title: str, averaging: Averaging, seeds: int, tick: Callable) -> list[str]:
    """Distribution of the cross-check's p-value where both models are true."""
    exact, p_values = FITTED.angle, []
    for seed in range(seeds):
        record = decay(FITTED.time, exact, 1000 + seed)
        pair = [method.identify(record, FITTED.model.library) for method in (averaging, Direct())]
        p_values.append(cross_check(record, *pair, seed=seed).comparison.p_value.item())
        tick()
    shares = ", ".join(f"{100 * np.mean(np.array(p_values) < p):.0f} % < {p:g}" for p in (0.01, 0.05, 0.5))
    return [
        f"p-value of the cross-check, {title}",
        str(seeds),
        f"{shares}; uniform: p = {kstest(p_values, 'uniform').pvalue:.2g}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--quick", action="store_true", help=f"at most {QUICK} seeds")
    parser.add_argument("--only", default="", metavar="WORDS", help="studies whose title holds these words")
    options = parser.parse_args()
    table = Table("run and method", "seeds", *SIX, "95 % covers (%)", "bar", "ms")
    table.title = "RMS error over its Cramér-Rao bound"
    shares = Table("statistic", "seeds", "found")
    others = {
        "selection": (200, lambda n, tick: selection_rows(n, tick)[0]),
        "cross-check, corrected": (100, partial(calibration_row, "averaging corrected", Averaging())),
        "cross-check, uncorrected": (
            100,
            partial(calibration_row, "averaging uncorrected", Averaging(correct=False)),
        ),
    }
    console = Console(width=150)
    with Progress(console=Console(stderr=True), transient=True) as progress:

        def run(title: str, seeds: int, row: Callable, into: Table) -> None:
            if options.only not in title:
                return
            seeds = min(seeds, QUICK) if options.quick else seeds
            task = progress.add_task(title, total=seeds)
            into.add_row(*row(seeds, lambda: progress.advance(task)))
            progress.remove_task(task)

        for study in STUDIES:
            run(study.title, study.seeds, partial(study_row, study), table)
        for title, (seeds, row) in others.items():
            run(title, seeds, row, shares)
    for shown in (table, shares):
        if shown.row_count:
            console.print(shown)


if __name__ == "__main__":
    main()
