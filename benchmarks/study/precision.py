"""How precise the identifications are on simulated runs of the paper's experiment, over the Cramér-Rao bound.

Every run is the paper's (w = 9.91 rad/s, from 0.3 rad at rest, 25 s at 100 Hz, white noise of 1e-4 rad)
unless its title says otherwise; the seeds of the noise are 0, 1, 2, ... Two runs: that of 25 s, and one of 15
s at 50 Hz from 0.6 rad in noise of 3e-4 rad, whose bound is that of both together.
"""

from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from helpers import EIGHT_MORE, FIVE, NOISE, SIX, Run, W, decay, library_of_formulas, names, paper_run, rms

import sysid_trib as st
from benchmarks import peers
from benchmarks.stopwatch import timed
from benchmarks.study.common import covered, scores, shown, uniform
from sysid_trib.forces import ForceLibrary
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.validation import cramer_rao_bound, run_agreement

STRONG = SIX | {"lambda": 1e-3}
PAPER, FINE = paper_run(), paper_run(sampling_rate=1000.0)
DRY, FITTED = paper_run(STRONG, duration=14.0), paper_run(FIVE)
STOP = paper_run(STRONG)
PAIR, NOISES = (FITTED, replace(paper_run(FIVE, duration=15.0, sampling_rate=50.0), start=0.6)), (NOISE, 3e-4)
GOLAY = peers.inner_savitzky_golay


def bound_of(runs: Sequence[Run], noises: Sequence[float] = (NOISE,), free: bool = False) -> np.ndarray:
    """Smallest standard errors of the forces from all runs, whose starts are their own."""
    each = [
        cramer_rao_bound(run.model, run.time, run.start, 0.0, noise, free=free).covariance.values
        for run, noise in zip(runs, noises, strict=True)
    ]
    # Coefficients differ by orders of magnitude: scaled, the matrices are well conditioned.
    size = np.sqrt(np.diag(each[0]))
    information = sum(np.linalg.inv(covariance / np.outer(size, size)) for covariance in each)
    return size * np.sqrt(np.diag(np.linalg.inv(information)))


@dataclass(frozen=True)
class Study:
    """Many noisy records of one run, or pairs, identified in one way; `decided` as the commands do it."""

    title: str
    runs: tuple[Run, ...]
    method: object
    seeds: int
    bar: float = np.nan
    decided: bool = False

    @property
    def truth(self) -> dict[str, float]:
        return self.runs[0].model.coefficients

    def records(self, seed: int):
        """The run with noise, or both of a pair."""
        if len(self.runs) > 1:
            return [run.decay(2 * seed + at, NOISES[at]) for at, run in enumerate(self.runs)]
        return self.runs[0].decay(seed)

    def identified(self, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """Errors of the coefficients and those stated; of a peer there are none."""
        record, library = self.records(seed), self.runs[0].model.library
        if callable(self.method):
            run = self.runs[0]
            peer = self.method(
                library.select(self.truth), run.model.reference_frequency, run.time, record.angle.values
            )
            return peer - list(self.truth.values()), np.full(len(peer), np.nan)
        whole = self.decided or len(self.runs) > 1
        asked = record, library.select(self.truth) if len(self.runs) > 1 else library
        result = st.identify(*asked, self.method) if whole else self.method.identify(*asked)
        (errors,), (stated,) = scores([result], self.truth)
        return errors, stated

    def row(self, seeds: int) -> list[str]:
        """RMS error over the bound, share of 95 % intervals that cover, time."""
        spent, found = [], []
        for seed in range(seeds):
            pair, seconds = timed(lambda seed=seed: self.identified(seed))
            found.append(pair)
            spent.append(seconds)
        errors, stated = np.array(found).swapaxes(0, 1)
        free = "alpha" not in self.truth and len(self.runs) == 1
        bound = bound_of(self.runs, NOISES[: len(self.runs)], free)
        ratio = dict(zip(self.truth, rms(errors) / bound, strict=True))
        worst, cover = max(ratio.values()), covered(errors, stated)
        verdict = "" if np.isnan(self.bar) else f"{'yes' if worst <= self.bar else 'NO'} ({self.bar:g})"
        cells = [f"{ratio[symbol]:.3g}" if symbol in ratio else "" for symbol in SIX]
        inside = "" if np.isnan(stated).any() else f"{cover.min():.1f} to {cover.max():.1f}"
        return [self.title, str(seeds), *cells, inside, verdict, f"{1e3 * np.median(spent):.0f}"]


def _study(title, run, method, seeds, bar=np.nan, decided=False) -> Study:
    return Study(title, run if isinstance(run, tuple) else (run,), method, seeds, bar, decided)


STUDIES = [
    _study("Direct", PAPER, Direct(W), 400, 1.2),
    _study("Direct, lambda = 1e-3, 14 s", DRY, Direct(W), 400, 1.5),
    _study("Direct, 1 kHz", FINE, Direct(W), 100, 1.2),
    _study("Direct, frequency fitted", FITTED, Direct(), 400, 1.2),
    _study("Direct, unrefined", PAPER, Direct(W, refine=False), 400),
    _study("Direct, unrefined, lambda = 1e-3, 14 s", DRY, Direct(W, refine=False), 400),
    _study("Direct, strong form", PAPER, Direct(W, form="strong"), 50),
    _study("Trajectory", PAPER, Trajectory(W), 400, 1.12),
    _study("Trajectory, lambda = 1e-3, stop inside", STOP, Trajectory(W), 400, 1.12),
    _study("Averaging", FITTED, Averaging(), 200),
    _study("Decided: direct", FITTED, Direct(), 200, 1.05, decided=True),
    _study("Decided: direct, lambda = 1e-3, 14 s", DRY, Direct(W), 200, 1.05, decided=True),
    _study("Decided: averaging", FITTED, Averaging(), 200, decided=True),
    _study("Averaging, lambda = 1e-3, 14 s, w given", DRY, Averaging(reference_frequency=W), 100),
    _study("Averaging, uncorrected", FITTED, Averaging(correct=False), 200),
    _study("Averaging, the paper's rule", FITTED, Averaging(frequency="last", correct=False), 200),
    _study("Two runs: direct", PAIR, Direct(W), 100),
    _study("Two runs: trajectory", PAIR, Trajectory(W), 100),
    _study("Two runs: averaging", PAIR, Averaging(reference_frequency=W), 100),
    _study("pysindy.SINDy, finite differences", PAPER, peers.sindy, 50),
    _study("pysindy.SINDy, Savitzky-Golay", PAPER, partial(peers.sindy, derivatives=GOLAY), 50),
    _study("pysindy.WeakPDELibrary", PAPER, peers.weak_sindy, 20),
    _study("pysindy.SINDy, finite differences, 1 kHz", FINE, peers.sindy, 20),
    _study(
        "pysindy.SINDy, Savitzky-Golay, 1 kHz",
        FINE,
        partial(peers.sindy, derivatives=partial(GOLAY, window=0.18)),
        20,
    ),
    _study("pysindy.WeakPDELibrary, 1 kHz", FINE, peers.weak_sindy, 10),
]


def selection(seeds: int) -> str:
    """How often significance keeps exactly the five true forces out of fourteen."""
    forces = (*PAPER.model.library, *library_of_formulas(**EIGHT_MORE))
    offered, exact, method = ForceLibrary("fourteen", forces), PAPER.angle, Direct(W, significance=0.01)
    results = [method.identify(decay(PAPER.time, exact, seed), offered) for seed in range(seeds)]
    kept = [names(offered.symbols, result.active.values) for result in results]
    hits = np.mean([symbols == set(FIVE) for symbols in kept])
    missed = np.mean([bool(set(FIVE) - symbols) for symbols in kept])
    return f"{100 * hits:.1f} %, a true one missed in {100 * missed:.1f} % (bar 90 %)"


def shares(p_values: Sequence[float]) -> str:
    """How many p-values are small, and whether they are uniform."""
    small = ", ".join(f"{100 * np.mean(np.array(p_values) < p):.0f} % < {p:g}" for p in (0.01, 0.05, 0.5))
    return f"{small}; uniform: p = {uniform(p_values):.2g}"


def checked(averaging: Averaging, seeds: int) -> str:
    """Distribution of the cross-check's p-value where both models are true."""
    p_values = []
    for seed in range(seeds):
        record = FITTED.decay(1000 + seed)
        pair = [method.identify(record, FITTED.model.library) for method in (averaging, Direct())]
        p_values.append(st.cross_check(record, *pair, seed=seed).comparison.p_value.item())
    return shares(p_values)


def agreed(seeds: int) -> str:
    """Distribution of the p-value of agreement of two runs of one experiment."""
    study, library = _study("", PAIR, Direct(W), seeds), FITTED.model.library.select(FIVE)
    runs = [study.records(seed) for seed in range(seeds)]
    return shares([run_agreement(r, st.identify(r, library, Direct(W))).total_p_value.item() for r in runs])


OTHERS: dict[str, tuple[int, Callable[[int], str]]] = {
    "selection by significance: exactly the five of fourteen": (200, selection),
    "p-value of the cross-check, averaging corrected": (100, partial(checked, Averaging())),
    "p-value of the cross-check, averaging uncorrected": (100, partial(checked, Averaging(correct=False))),
    "Two runs: p-value of their agreement": (100, agreed),
}


def main(asked: Namespace) -> None:
    heads = ("run and method", "seeds", *SIX, "95 % covers (%)", "bar", "ms")
    chosen = [study for study in STUDIES if asked.only in study.title]
    rows = (study.row(min(study.seeds, asked.seeds)) for study in chosen)
    shown("RMS error over its Cramér-Rao bound", heads, rows)
    if any(len(study.runs) > 1 for study in chosen):
        alone = [bound_of(PAIR[at : at + 1], NOISES[at : at + 1]) / bound_of(PAIR, NOISES) for at in (0, 1)]
        shown("bounds of one of two runs over that of both", ("run", *FIVE), [
            [f"{at + 1}", *(f"{ratio:.2f}" for ratio in each)] for at, each in enumerate(alone)
        ])  # fmt: skip
    others = ((title, *of) for title, of in OTHERS.items() if asked.only in title)
    counted = ((title, min(count, asked.seeds), what) for title, count, what in others)
    rows = ([title, str(count), what(count)] for title, count, what in counted)
    shown("", ("statistic", "seeds", "found"), rows)
