"""Errors of coefficients: over the Cramér-Rao bound, over those stated, and where forces are neglected.

precision: runs of the paper's experiment (w = 9.91 rad/s, from 0.3 rad at rest, 25 s at 100 Hz, white noise
of 1e-4 rad unless the title says otherwise). Two runs: that of 25 s, and one of 15 s at 50 Hz from 0.6 rad in
noise of 3e-4 rad, whose bound is that of both together.
classical: 12 s of the forces that a method looks for, and the paper's run, which has forces beside them.
pushed: twenty periods at w = 8.87 rad/s in noise of 0.2 mrad, pushed until they have wandered at the end by
so many noise levels. Methods are direct, trajectory, averaging (of motions at 60 samples a period, where it
is used), and each without a random force (-off): with these in the file too, a second table has the errors
where nothing pushes over those without.
"""

from argparse import Namespace
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from time import process_time

import numpy as np
import xarray as xr
from helpers import (
    EIGHT_MORE,
    FIVE,
    NOISE,
    OWN_MODELS,
    SIX,
    Run,
    W,
    library_of_formulas,
    names,
    paper_run,
    rms,
)

import sysid_trib as st
from benchmarks import peers
from benchmarks.study import common
from sysid_trib.errors import SysidTribError
from sysid_trib.forces import ForceLibrary
from sysid_trib.methods import Averaging, Direct, FrequencyShift, Trajectory
from sysid_trib.results.random_force import random_force_of
from sysid_trib.validation import cramer_rao_bound, run_agreement

STRONG = SIX | {"lambda": 1e-3}
PAPER, FINE, FITTED = (paper_run(),), (paper_run(sampling_rate=1000.0),), (paper_run(FIVE),)
DRY, STOP = (paper_run(STRONG, duration=14.0),), (paper_run(STRONG),)
PAIR = (*FITTED, replace(paper_run(FIVE, duration=15.0, sampling_rate=50.0), start=0.6))
NOISES = (NOISE, 3e-4)
GOLAY = peers.inner_savitzky_golay
# Title, runs, method, seeds at most, bar of the worst RMS error over the bound; `Decided` as commands do it.
STUDIES = [
    ("Direct", PAPER, Direct(W), 400, 1.2),
    ("Direct, lambda = 1e-3, 14 s", DRY, Direct(W), 400, 1.5),
    ("Direct, 1 kHz", FINE, Direct(W), 100, 1.2),
    ("Direct, frequency fitted", FITTED, Direct(), 400, 1.2),
    ("Direct, unrefined", PAPER, Direct(W, refine=False), 400, None),
    ("Direct, unrefined, lambda = 1e-3, 14 s", DRY, Direct(W, refine=False), 400, None),
    ("Direct, strong form", PAPER, Direct(W, form="strong"), 50, None),
    ("Trajectory", PAPER, Trajectory(W), 400, 1.12),
    ("Trajectory, lambda = 1e-3, stop inside", STOP, Trajectory(W), 400, 1.12),
    ("Averaging", FITTED, Averaging(), 200, None),
    ("Decided: direct", FITTED, Direct(), 200, 1.05),
    ("Decided: direct, lambda = 1e-3, 14 s", DRY, Direct(W), 200, 1.05),
    ("Decided: averaging", FITTED, Averaging(), 200, None),
    ("Averaging, lambda = 1e-3, 14 s, w given", DRY, Averaging(reference_frequency=W), 100, None),
    ("Averaging, uncorrected", FITTED, Averaging(correct=False), 200, None),
    ("Averaging, the paper's rule", FITTED, Averaging(frequency="last", correct=False), 200, None),
    ("Two runs: direct", PAIR, Direct(W), 100, None),
    ("Two runs: trajectory", PAIR, Trajectory(W), 100, None),
    ("Two runs: averaging", PAIR, Averaging(reference_frequency=W), 100, None),
    ("pysindy.SINDy, finite differences", PAPER, peers.sindy, 50, None),
    ("pysindy.SINDy, Savitzky-Golay", PAPER, partial(peers.sindy, derivatives=GOLAY), 50, None),
    ("pysindy.WeakPDELibrary", PAPER, peers.weak_sindy, 20, None),
    ("pysindy.SINDy, finite differences, 1 kHz", FINE, peers.sindy, 20, None),
    (
        *("pysindy.SINDy, Savitzky-Golay, 1 kHz", FINE),
        *(partial(peers.sindy, derivatives=partial(GOLAY, window=0.18)), 20, None),
    ),
    ("pysindy.WeakPDELibrary, 1 kHz", FINE, peers.weak_sindy, 10, None),
]


def bound_of(runs: Sequence[Run], noises: Sequence[float], free: bool = False) -> np.ndarray:
    """Smallest standard errors of the forces from all runs, whose starts are their own."""
    each = [
        cramer_rao_bound(run.model, run.time, run.start, 0.0, noise, free=free).covariance.values
        for run, noise in zip(runs, noises, strict=True)
    ]
    # Coefficients differ by orders of magnitude: scaled, the matrices are well conditioned.
    size = np.sqrt(np.diag(each[0]))
    information = sum(np.linalg.inv(covariance / np.outer(size, size)) for covariance in each)
    return size * np.sqrt(np.diag(np.linalg.inv(information)))


def records_of(runs: Sequence[Run], seed: int):
    """The run with noise, or both of a pair."""
    if len(runs) == 1:
        return runs[0].decay(seed)
    return [run.decay(2 * seed + at, NOISES[at]) for at, run in enumerate(runs)]


def estimated(identify: Callable[[], xr.Dataset], truth: dict[str, float], w: float | None = None) -> dict:
    """Errors of the coefficients, and of w if it is given, those stated, the time."""
    result, seconds = common.timed(identify, process_time)
    truth = {symbol: value for symbol, value in truth.items() if symbol in result.force.values}
    found, force = result.sel(force=list(truth)), random_force_of(result)
    errors, stated = [*(found.coefficient.values - [*truth.values()])], [*found.standard_error.values]
    if w is not None:
        errors.append(result.reference_frequency.item() - w)
        stated.append(result.reference_frequency_standard_error.item())
    row = {"errors": errors, "standard_errors": stated, "p_value": force.p_value if force else 1.0}
    return row | {"names": [*truth], "seconds": seconds}


def by_peer(peer, library: ForceLibrary, record: xr.Dataset) -> xr.Dataset:
    """Coefficients by a peer; what it breaks with is a refusal."""
    try:
        values, errors = peer(library, W, record.time.values, record.angle.values)
    except Exception as problem:
        raise SysidTribError(f"{type(problem).__name__}: {problem}"[:60]) from problem
    data = {"coefficient": ("force", values), "standard_error": ("force", errors)}
    return xr.Dataset(data, {"force": [*library.symbols]})


def identified(method, runs: Sequence[Run], whole: bool, seed: int) -> dict:
    """A row of a run, or of a pair of runs, by one method; a peer states no errors."""
    records, model = records_of(runs, seed), runs[0].model
    truth, library = model.coefficients, model.library
    if callable(method):
        return estimated(lambda: by_peer(method, library, records), truth)
    if len(runs) > 1:
        library = library.select(truth)
    identify = partial(st.identify, method=method) if whole else method.identify
    return estimated(lambda: identify(records, library), truth)


def of_study(asked: Namespace, title: str, runs: Sequence[Run], method, most: int, bar: float | None):
    """RMS error over the bound, share of 95 % intervals that cover, time."""
    whole, truth = title.startswith("Decided") or len(runs) > 1, runs[0].model.coefficients
    found = common.over_seeds(asked, partial(identified, method, runs, whole), seeds=most, case=title)
    errors, stated, spent = common.columns(found, "errors", "standard_errors", "seconds")
    bound = bound_of(runs, NOISES[: len(runs)], free="alpha" not in truth and len(runs) == 1)
    ratio, cover = dict(zip(truth, rms(errors) / bound, strict=True)), common.covered(errors, stated)
    worst = max(ratio.values())
    verdict = "" if bar is None else f"{'yes' if worst <= bar else 'NO'} ({bar:g})"
    cells = [f"{ratio[symbol]:.3g}" if symbol in ratio else "" for symbol in SIX]
    inside = "" if np.isnan(stated).any() else f"{cover.min():.1f} to {cover.max():.1f}"
    return [title, str(len(found)), *cells, inside, verdict, f"{1e3 * np.median(spent):.0f}"]


def selection(seeds: int) -> str:
    """Report how often a significance level keeps exactly the five true forces out of fourteen."""
    forces = (*PAPER[0].model.library, *library_of_formulas(**EIGHT_MORE))
    offered, method = ForceLibrary("fourteen", forces), Direct(W, significance=0.01)
    results = [method.identify(records_of(PAPER, seed), offered) for seed in range(seeds)]
    kept = [names(offered.symbols, result.active.values) for result in results]
    hits = np.mean([symbols == set(FIVE) for symbols in kept])
    missed = np.mean([bool(set(FIVE) - symbols) for symbols in kept])
    return f"{100 * hits:.1f} %, a true one missed in {100 * missed:.1f} % (bar 90 %)"


def shares(p_values: Sequence[float]) -> str:
    """Report how many p-values are small, and whether they are uniform."""
    small = ", ".join(f"{100 * np.mean(np.array(p_values) < p):.0f} % < {p:g}" for p in (0.01, 0.05, 0.5))
    return f"{small}; common.uniform: p = {common.uniform(p_values):.2g}"


def checked(seeds: int) -> str:
    """Distribution of the cross-check's p-value where both models are true."""
    p_values = []
    for seed in range(seeds):
        record = records_of(FITTED, 1000 + seed)
        pair = [method.identify(record, FITTED[0].model.library) for method in (Averaging(), Direct())]
        p_values.append(st.cross_check(record, *pair).comparison.p_value.item())
    return shares(p_values)


def agreed(seeds: int) -> str:
    """Distribution of the p-value of agreement of two runs of one experiment."""
    library = FITTED[0].model.library.select(FIVE)
    runs = [records_of(PAIR, seed) for seed in range(seeds)]
    return shares([run_agreement(r, st.identify(r, library, Direct(W))).total_p_value.item() for r in runs])


OTHERS: dict[str, tuple[int, Callable[[int], str]]] = {
    "selection by significance: exactly the five of fourteen": (200, selection),
    "p-value of the cross-check": (100, checked),
    "Two runs: p-value of their agreement": (100, agreed),
}


def precision(asked: Namespace) -> None:
    heads = ("run and method", "seeds", *SIX, "95 % covers (%)", "bar", "ms")
    chosen = [study for study in STUDIES if asked.only in study[0]]
    common.shown("RMS error over its Cramér-Rao bound", heads, (of_study(asked, *study) for study in chosen))
    if any(runs is PAIR for _, runs, *_ in chosen):
        alone = [bound_of(PAIR[at : at + 1], NOISES[at : at + 1]) / bound_of(PAIR, NOISES) for at in (0, 1)]
        rows = [[f"{at + 1}", *(f"{ratio:.2f}" for ratio in each)] for at, each in enumerate(alone)]
        common.shown("bounds of one of two runs over that of both", ("run", *FIVE), rows)
    others = [
        (title, min(most, asked.seeds), of) for title, (most, of) in OTHERS.items() if asked.only in title
    ]
    common.shown(
        "", ("statistic", "seeds", "found"), ([title, str(count), of(count)] for title, count, of in others)
    )


CLASSICAL = {kind.__name__: (kind(), own) for kind, own in OWN_MODELS.items()}
CLASSICAL |= {
    "FrequencyShift": (FrequencyShift(), FIVE),
    "Averaging": (Averaging(), FIVE),
    "Averaging, analytic signal": (Averaging(curve="analytic-signal"), FIVE),
    "Direct": (Direct(), FIVE),
}


def classical(asked: Namespace) -> None:
    """Own model: RMS error over the one stated; paper's run: bias where forces are neglected."""
    table = []
    for title, (method, own) in CLASSICAL.items():
        if asked.only not in title:
            continue
        found = []
        for run in (paper_run(own, duration=12.0), paper_run(SIX)):
            one = partial(identified, method, (run,), False)
            found.append(common.over_seeds(asked, one, case=f"{title}, {run.time[-1]:.0f} s"))
        own_errors, stated, spent = common.columns(found[0], "errors", "standard_errors", "seconds")
        off, errors = common.columns(found[1], "errors", "standard_errors")
        pull, bias, error = rms(own_errors / stated), np.mean(off, axis=0), rms(errors)
        for at, symbol in enumerate(found[0][0]["names"]):
            true, start = SIX[symbol], ["", ""] if at else [title, f"{1e3 * np.median(spent):.0f}"]
            cells = f"{true:.3g}", f"{true + bias[at]:.4g}", f"{100.0 * bias[at] / abs(true):+.3g} %"
            table.append([*start, symbol, f"{pull[at]:.2f}", *cells, f"{bias[at] / error[at]:+.2g}"])
    heads = ("method", "ms", "force", "own model: RMS error / its standard error", "paper's run: truth")
    heads += ("mean found", "bias", "bias / its standard error")
    common.shown(f"Classical methods, {asked.seeds} seeds", heads, table)


CASES = [
    common.Pushed(wander, friction, per_period, start)
    for per_period in (20, 200)
    for wander in (1, 5, 20)
    for friction, start in ((0.0, 0.3), (1e-3, 0.3), (1e-3, 0.06))
]
CASES += [common.Pushed(0, noise=noise) for noise in ("white", "AR(0.8)", "rounded")]
FOR_AVERAGING = [common.Pushed(0), common.Pushed(5), common.Pushed(20)]
AVERAGING = {
    f"averaging{given}{off}": Averaging(reference_frequency=w, random_force=option)
    for given, w in (("", None), (", w given", common.W))
    for off, option in (("", "estimated"), ("-off", "off"))
}
# Cases with the same kicks and noise would err alike, and a pooled figure rest on few of them.
SEEDS_OF_A_CASE = 10_000


def of_case(case: common.Pushed, rows: list[dict]) -> list[str]:
    """A case in the table; nan are the errors of what a method does not fit."""
    found = [row for row in rows if "failed" not in row]
    counts = [case.title, str(len(rows)), str(len(rows) - len(found))]
    if not found:
        return counts
    errors, stated, p_values, spent = common.columns(found, "errors", "standard_errors", "p_value", "seconds")
    ends = [f"{100.0 * np.mean(p_values < 0.01):.1f}", f"{np.mean(spent):.2f}"]
    if not case.wander:
        return [*counts, *[""] * 5, *ends]
    known = np.all(stated > 0.0, axis=0)
    inside, symbols = common.covered(errors, stated)[known], np.array([*case.model.coefficients, "w"])[known]
    deviation = (inside - 95.0) / np.sqrt(95.0 * 5.0 / len(found))
    worst, ratio = int(np.argmax(np.abs(deviation))), (rms(errors) / case.bound())[known]
    most = int(np.argmax(ratio))
    return [
        *(
            *counts,
            f"{np.mean(inside):.1f}",
            f"{inside[worst]:.1f} {symbols[worst]} ({deviation[worst]:+.1f})",
        ),
        *(f"{rms(errors[:, known] / stated[:, known], None):.2f}", f"{rms(ratio):.2f}"),
        *(f"{ratio[most]:.2f} {symbols[most]}", *ends),
    ]


def pooled(rows: list[dict]) -> str:
    """Coverage of all pushed records, and of those that go on and those that stop."""
    parts = []
    for title, stops in (("all", (True, False)), ("to its stop", (True,)), ("going on", (False,))):
        some = [row for row in rows if "errors" in row and ("stop" in row["case"]) in stops]
        inside = [
            np.mean(common.covered(*common.columns([row], "errors", "standard_errors")))
            for row in some
            if not row["case"].startswith("wander 0")
        ]
        if inside:
            error = np.std(inside) / np.sqrt(len(inside))
            parts.append(f"{title} {np.mean(inside):.1f} ± {error:.1f} % of {len(inside)}")
    return "covered: " + "; ".join(parts) if parts else ""


def over_off(method: str, rows: list[dict], free: list[common.Pushed]) -> list[list[str]]:
    """RMS errors over those of the same method without a random force, of records that nothing pushes."""
    table = []
    for case in free:
        some = [row for row in rows if row.get("case") == case.title and "errors" in row]
        auto, off = (
            {row["seed"]: row["errors"] for row in some if row["method"] == name}
            for name in (method, f"{method}-off")
        )
        if both := sorted(auto.keys() & off.keys()):
            ratio = rms([auto[seed] for seed in both]) / rms([off[seed] for seed in both])
            table.append([case.noise, str(len(both)), f"{rms(ratio):.3f}", f"{ratio.max():.3f}"])
    return table


def pushed(asked: Namespace) -> None:
    name = asked.method or "trajectory"
    method = {**common.METHODS, **AVERAGING}[name]
    cases = FOR_AVERAGING if name.startswith("averaging") else CASES
    rows, table = [], []
    for at, case in enumerate(cases):
        if asked.only not in case.title:
            continue
        first, model = SEEDS_OF_A_CASE * (1 + at) if case.wander else 0, case.model

        def records(seeds: list[int], case=case, first=first):
            return case.records([first + seed for seed in seeds])

        def one(decay: xr.Dataset, model=model) -> dict:
            return estimated(lambda: st.identify(decay, model.library, method), model.coefficients, common.W)

        found = common.over_seeds(asked, one, records, case=case.title, method=name)
        table.append(of_case(case, found))
        rows += found
    heads = ("wander, friction, samples a period, noise", "records", "failed", "covered (%)")
    heads += ("worst (binomial errors off)", "RMS error / stated", "/ bound", "worst / bound")
    heads += ("told at 1 % (%)", "time (s)")
    common.shown(f"{name}: coverage of 95 % intervals, errors over the Cramér-Rao bound", heads, table, 200)
    print(pooled(rows))
    heads = ("noise", "records", "RMS error / off", "worst")
    free = [case for case in cases if not case.wander]
    common.shown(f"{name}: where nothing pushes", heads, over_off(name, common.read(asked.out), free))
