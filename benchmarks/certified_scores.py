"""Programs on the certified decays: error over the Cramér-Rao bound.

python -m benchmarks certified                          ours and other programs, the records as published
python -m benchmarks certified --method direct --seeds 20       20 realisations, the published one first
python -m benchmarks certified --answers FILE.csv       the answers of any program (docs/certified.md)
"""

import argparse
import sys
import time as clock
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

import sysid_trib as st
from benchmarks.certified import DECAYS, FREQUENCY, LEVELS, Decay, noisy, record_name, seed_of
from benchmarks.peers import DECAY_PEERS, Answer
from benchmarks.study.common import shown
from sysid_trib.forces import ForceLibrary
from sysid_trib.methods.options import Method

# Times that a peer, which takes w as known, is asked where w is unknown.
TURNS = 4
# Programs that take an hour or more, run only if --method names them.
SLOW = {"scipy shooting, from SINDy"}
# Distance of the seeds of further realisations; the first has those of the published records.
FRESH = 1000
# A value farther from the truth than this, relative to it, is counted as a failure.
Values = dict[str, tuple[float, float]]
Program = Callable[[Decay, np.ndarray], Values]


@dataclass(frozen=True)
class Realisation:
    """A record: a decay with one realisation of its noise."""

    decay: Decay
    noise: float
    angle: np.ndarray

    @property
    def name(self) -> str:
        return record_name(self.decay, self.noise)


def realisations(only: str, seeds: int) -> Iterator[list[Realisation]]:
    """Yield the published records, then further realisations of them, as many as there are seeds."""
    chosen = [decay for decay in DECAYS if only in decay.name]
    motions = {
        decay.name: st.simulate(decay.model, decay.time, decay.angle, decay.rate).angle.values
        for decay in chosen
    }
    for fresh in range(seeds or 1):
        yield [
            Realisation(
                decay, noise, noisy(decay, motions[decay.name], noise, seed_of(decay, noise) + FRESH * fresh)
            )
            for decay in chosen
            for noise in LEVELS
        ]


def ours(kind: type[Method], **options: Any) -> Program:
    """Return the program of a method of this package, with options of it."""

    def answer(decay: Decay, angle: np.ndarray) -> Values:
        record = xr.Dataset({"angle": ("time", angle, {"units": "rad"})}, {"time": decay.time})
        held = {"reference_frequency": decay.w} if decay.w_is_given else {}
        model = decay.model
        shapes = {"shapes": dict(decay.shapes)} if decay.shapes else {}
        result = st.identify(record, model.library, kind(**held, **shapes, **options))
        found = zip(
            result.force.values.tolist(),
            result.coefficient.values.tolist(),
            result.standard_error.values.tolist(),
            strict=True,
        )
        values = {symbol: (value, error) for symbol, value, error in found}
        if not decay.w_is_given:
            values[FREQUENCY] = (
                result.reference_frequency.item(),
                result.reference_frequency_standard_error.item(),
            )
        return values

    return answer


def peer(program: Callable[[ForceLibrary, float, np.ndarray, np.ndarray], Answer]) -> Program:
    """Return a program that takes w as known.

    Where w is unknown it identifies a linear spring too, is asked again with the frequency that follows, and
    begins with that of the crossings of zero.
    """

    def answer(decay: Decay, angle: np.ndarray) -> Values:
        library, symbols = decay.model.library, list(decay.coefficients)
        # With known shapes the formulas have numbers in their place.
        library = st.library(**{s: _formula(library, s, decay) for s in symbols})
        if decay.w_is_given:
            values, errors = program(library, decay.w, decay.time, angle)
            return dict(zip(symbols, zip(values.tolist(), errors.tolist(), strict=True), strict=True))
        w = _frequency_of_crossings(decay.time, angle)
        spring = library + st.library(alpha="x")
        for _ in range(TURNS):
            values, errors = program(spring, w, decay.time, angle)
            w *= float(np.sqrt(1.0 + values[-1]))
        found = dict(zip(symbols, zip(values[:-1].tolist(), errors[:-1].tolist(), strict=True), strict=True))
        return found | {FREQUENCY: (w, 0.5 * w * float(errors[-1]))}

    return answer


def _formula(library: ForceLibrary, symbol: str, decay: Decay) -> str:
    formula = library.select([symbol]).forces[0].formula.text
    for name, value in decay.shapes.items():
        shaped, _, shape = name.partition(".")
        formula = formula.replace(f"/{shape}", f"/{value!r}") if shaped == symbol else formula
    return formula


def _frequency_of_crossings(time: np.ndarray, angle: np.ndarray) -> float:
    """Return the frequency of the later half of the zero crossings (rad/s)."""
    before = np.flatnonzero(np.diff(np.sign(angle)) != 0)
    before = before[np.abs(angle[before]) > 0.0]
    part = -angle[before] / (angle[before + 1] - angle[before])
    crossings = time[before] + part * (time[before + 1] - time[before])
    # Where the motion has stopped or the noise is large, crossings are closer than half a period.
    half = float(np.median(np.diff(crossings[: max(3, len(crossings) // 2)])))
    return np.pi / half


PROGRAMS: dict[str, Program] = {
    "ours, direct": ours(st.methods.Direct),
    # The decays have no random force; by default the method looks for one.
    "ours, direct, random force off": ours(st.methods.Direct, random_force="off"),
    "ours, trajectory": ours(st.methods.Trajectory),
    "ours, averaging": ours(st.methods.Averaging),
    **{name: peer(program) for name, program in DECAY_PEERS.items()},
}


def answers_of(program: Program, records: Iterable[Realisation]) -> tuple[pd.DataFrame, list[str]]:
    """Return the table of answers of a program, and why it failed where it did."""
    rows, failures = [], []
    for record in records:
        values: Values = {}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                values = program(record.decay, record.angle)
        # Programs of others may raise any exception.
        except Exception as error:
            failures.append(f"{record.name}: {type(error).__name__}: {str(error)[:100]}")
        scored = [name for name in record.decay.unknowns if not name.startswith("start_")]
        for name in scored:
            value, error = values.get(name, (np.nan, np.nan))
            rows.append({"name": record.name, "coefficient": name, "value": value, "error": error})
    return pd.DataFrame(rows), failures


def root_mean_square(values: pd.Series) -> float:
    """Return the RMS of the numbers; NaN if there is none."""
    return float(np.sqrt(np.mean(values.dropna() ** 2)))


def has_failed(score: pd.DataFrame) -> pd.Series:
    """Return true for each missing answer, and for one that is off by more than the truth and ten bounds."""
    off = (score.value - score.truth).abs()
    return score.value.isna() | (off > np.maximum(score.truth.abs(), 10.0 * score.bound))


def summary_row(label: str, score: pd.DataFrame, seconds: float | None = None) -> list[str]:
    """Return RMS and median of error over bound, the RMS at each noise, and records with a failure."""
    columns = ["name", "realisation"] if "realisation" in score else ["name"]
    by_record = score.assign(failed=has_failed(score)).groupby(columns).failed.any()
    error = score.error_over_bound
    cells = [label, f"{root_mean_square(error):.3g}", f"{error.abs().median():.3g}"]
    for noise in LEVELS:
        at = error[[name.endswith(f"_1e{round(np.log10(noise))}") for name, _ in error.index]]
        cells.append(f"{root_mean_square(at):.3g}")
    cells.append(f"{int(by_record.sum())} of {len(by_record)}")
    return [*cells, "" if seconds is None else f"{seconds:.0f}"]


HEADS = ("program", "RMS", "median", *(f"RMS at {noise:g}" for noise in LEVELS), "failed", "time (s)")


def certified(asked: argparse.Namespace) -> None:
    """Score the answers of a file, or programs."""
    if asked.answers is not None:
        try:
            score = st.datasets.score(asked.answers)
        except st.errors.SysidTribError as error:
            print(f"benchmarks certified: {error}", file=sys.stderr)
            sys.exit(error.exit_status)
        shown(f"Answers of {asked.answers.name}", HEADS, [summary_row(asked.answers.stem, score)], 110)
        _by_decay({asked.answers.stem: score})
        return
    scores, rows = {}, []
    for label, program in PROGRAMS.items():
        if asked.method not in label or (label in SLOW and not asked.method):
            continue
        begin, parts = clock.process_time(), []
        for records in realisations(asked.only, asked.seeds):
            table, failures = answers_of(program, records)
            parts.append(st.datasets.score(table).assign(realisation=len(parts)))
            for failure in failures:
                print(f"{label}, {failure}", flush=True)
        scores[label] = pd.concat(parts)
        rows.append(summary_row(label, scores[label], clock.process_time() - begin))
        print(", ".join(rows[-1]), flush=True)
    fresh = f"{asked.seeds} realisations of the noise" if asked.seeds else "the published records"
    shown(f"Error over the Cramér-Rao bound, {fresh}", HEADS, rows, 110)
    _by_decay(scores)


def _by_decay(scores: dict[str, pd.DataFrame]) -> None:
    """Print the RMS of error over bound of each decay."""
    rows = []
    for label, score in scores.items():
        decays = [name.partition("/")[2].rpartition("_")[0] for name, _ in score.index]
        of_decay = score.error_over_bound.groupby(decays).apply(root_mean_square)
        rows.append([label, *(f"{of_decay.get(decay.name, np.nan):.3g}" for decay in DECAYS)])
    shown("RMS by decay", ("program", *(decay.name for decay in DECAYS)), rows, 160)
