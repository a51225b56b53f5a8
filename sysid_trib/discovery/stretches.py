"""Which parts of records a search is fitted to and which it predicts: of long driven ones a few stretches."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from sysid_trib.errors import DecayError
from sysid_trib.likelihood.run_rows import decimated
from sysid_trib.records.inputs import inputs_of
from sysid_trib.records.smoothing import swing_frequency
from sysid_trib.validation.holdout import first_held_out, stretches, up_to_held_out


class RecordPart(NamedTuple):
    """A part of a run.

    `record` : its samples. `run` : number of its run, from 0. `origin` : time (s) from which the `t` of
    formulas counts. `before` : samples before it and its first, of which forces remember; None at the begin
    of a record.
    """

    record: xr.Dataset
    run: int
    origin: float
    before: xr.Dataset | None = None


class SearchParts(NamedTuple):
    """Runs with as many samples as a search needs, what models are fitted to, and what they predict."""

    runs: list[xr.Dataset]
    learnt: list[RecordPart]
    later: list[RecordPart]

    @property
    def in_stretches(self) -> bool:
        """True if models are fitted to stretches of the runs."""
        return len(self.learnt) > len(self.runs)

    @property
    def sentence(self) -> str:
        """What of long records the models are fitted to; empty where that is all of them."""
        ends = [part.record.time.values[[0, -1]] for part in self.learnt]
        spans = ", ".join(f"{first:.4g} to {last:.4g} s" for first, last in ends)
        said = f"A long driven record: models are fitted to stretches ({spans}), each with its own noise."
        return said if self.in_stretches else ""


def search_parts(runs: Sequence[xr.Dataset], unseen: Sequence[xr.Dataset], per_period: int) -> SearchParts:
    """Parts of the runs and of what is held out; a driven record is as dense as its inputs ask for."""
    kept, records = (
        [run if inputs_of(run) else decimated(run, per_period) for run in those] for those in (runs, unseen)
    )
    later = _held_out_records(records, kept) if records else _last_thirds(kept)
    return SearchParts(kept, _parts_to_learn(kept, whole=bool(records)), later)


def _parts_to_learn(runs: Sequence[xr.Dataset], *, whole: bool) -> list[RecordPart]:
    """What models are fitted to: the runs, or the first two thirds of each."""
    parts = []
    for at, run in enumerate(runs):
        time = run.time.values.astype(float)
        end = len(time) if whole else first_held_out(time)
        parts += [
            RecordPart(part, at, float(time[0]), _before(run, part) if part.sizes["time"] < end else None)
            for part in _stretches(run, slice(0, end))
        ]
    return parts


def _last_thirds(runs: Sequence[xr.Dataset]) -> list[RecordPart]:
    """What models predict where no record is held out."""
    parts = []
    for at, run in enumerate(runs):
        time = run.time.values.astype(float)
        first = first_held_out(time)
        for part in _stretches(run, slice(first, len(time))):
            is_whole = part.sizes["time"] == len(time) - first
            before = up_to_held_out(run) if is_whole else _before(run, part)
            parts.append(RecordPart(part, at, float(time[0]), before))
    return parts


def _before(run: xr.Dataset, part: xr.Dataset) -> xr.Dataset | None:
    """As much of a run before a stretch of it, and its first sample; None at the begin of the run."""
    begin, count = int(np.searchsorted(run.time.values, part.time.values[0])), part.sizes["time"]
    return run.isel(time=slice(max(0, begin - count), begin + 1)) if begin else None


def _held_out_records(records: Sequence[xr.Dataset], runs: Sequence[xr.Dataset]) -> list[RecordPart]:
    """What models predict where records are held out; the noise of each is that of a run."""
    return [
        RecordPart(part, min(at, len(runs) - 1), _origin(record, runs))
        for at, record in enumerate(records)
        for part in _stretches(record, slice(0, record.sizes["time"]))
    ]


def _stretches(run: xr.Dataset, within: slice) -> Iterator[xr.Dataset]:
    """The part of a run, or of one that is driven and long the beginning, the middle and the end of it."""
    part = run.isel(time=within)
    if not inputs_of(run):
        yield part
        return
    try:
        # A decay shows every amplitude once, a driven record the same ones again and again: the time that a
        # candidate takes grows with the periods, and after so many in each of three stretches names do not
        # change.
        duration = 2.0 * np.pi / swing_frequency(run) * 60
    except DecayError:
        # Where nothing swings there are no periods to be counted.
        yield part
        return
    time = part.time.values
    if time[-1] - time[0] > 4.0 * duration:
        # Where a record begins it is not known what forces remember: a few periods tell.
        part = part.sel(time=slice(time[0] + 0.1 * duration, None))
    yield from stretches(part, duration, 3.0 * duration)


def _origin(part: xr.Dataset, runs: Sequence[xr.Dataset]) -> float:
    """Time from which `t` counts: the first sample of the record that the part is from, else its first."""
    name = part.attrs.get("record_checksum")
    same = [run for run in runs if name and run.attrs.get("record_checksum") == name]
    return float((same or [part])[0].time.values[0])
