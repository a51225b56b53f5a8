"""Which columns of a table are times and signal, where names, units and the swing make that certain."""

import re
from dataclasses import dataclass

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError, SysidTribError, UsageError, did_you_mean
from sysid_trib.records.as_angle import are_axes, in_phase, is_magnitude
from sysid_trib.records.cleaning import unwrapped, unwrapped_anywhere
from sysid_trib.records.clock import MOST_SET_BACK, read_clock
from sysid_trib.records.equilibrium import Swing
from sysid_trib.records.free_decay import swing_within
from sysid_trib.records.headers import (
    cells,
    counts_rows,
    is_time,
    names_quantity,
    runs_side_by_side,
    split_header,
    time_of,
    unit_of_column,
)
from sysid_trib.records.numbers import is_clock_time, is_numeric, numbers, without_sentinels
from sysid_trib.records.tables import FileTable
from sysid_trib.records.units import INTEGRATIONS, TIME_UNITS, SignalUnit

LISTED = 12
FEWEST_NUMBERS = 3
DERIVATIVE_TOLERANCE = 0.2


@dataclass(frozen=True)
class Chosen:
    """The columns of one run.

    Attributes
    ----------
    time : str or None
        Name of the time column; None if there is none, or a sampling rate stands for it.
    signal : str
        Name of the signal's column.
    sentence : str
        Why it is this one; nothing where there is no other.
    """

    time: str | None
    signal: str
    sentence: str = ""


@dataclass(frozen=True)
class _Candidate:
    """A column that could be the signal: its header, numbers, and how it swings."""

    name: str
    base: str
    unit: SignalUnit | None
    values: Array
    swing: Swing | None
    reason: str = ""

    @property
    def amplitude(self) -> float:
        return 0.5 * float(np.ptp(np.nanpercentile(self.values, [0.5, 99.5])))

    @property
    def period(self) -> float:
        return self.swing.oscillation.period if self.swing else np.inf

    @property
    def quantity(self) -> str:
        return self.unit.quantity if self.unit and self.unit.known else names_quantity(self.base)

    @property
    def integrations(self) -> int:
        return INTEGRATIONS.get(self.quantity, 0)


def choose_columns(
    table: FileTable,
    source: str,
    *,
    time: str | int | None,
    angle: str | int | None,
    signal: str | None,
    rate: float | None,
) -> list[Chosen]:
    """The columns of each run in a table: as given, or where one alone can be meant.

    Parameters
    ----------
    table : FileTable
        What the file holds.
    source : str
        Name of the file, for messages.
    time, angle : str or int, optional
        Name or number (from 0) of the columns of time and signal.
    signal : str, optional
        The quantity that is wanted.
    rate : float, Hz, optional
        Sampling rate, where one is given or stated.

    Raises
    ------
    UsageError
        There is no such column, or several could be the signal: they are listed.
    RecordError
        There is no column for a signal, or no clock.
    """
    times = _time_columns(table)
    given_time = None if time is None else find_column(table, time, source)
    if angle is not None:
        name = find_column(table, angle, source)
        return [Chosen(given_time or time_of_column(name, table), name)]
    if given_time is not None:
        times = [given_time]
    names = [
        name
        for name, values in table.columns.items()
        if name not in times and not _is_empty(values) and is_numeric(values)
    ]
    if not names:
        raise RecordError(f"{source}: there is no column for the angle beside the time.")
    if rate is None and not times:
        # Without a clock it cannot be seen which column swings.
        raise RecordError(no_clock(table, source))
    runs = runs_side_by_side(names, times, table)
    if runs:
        return [Chosen(*run, "runs side by side") for run in runs]
    parts = cells(names, times, table)
    if parts:
        first = parts[0][1]
        at = first.index(_choose(first, times, table, signal, source)[0]) if len(first) > 1 else 0
        return _moving_runs([(t, group[at]) for t, group in parts], table, source)
    if len(names) == 1:
        return [Chosen(time_of(names[0], times, table), names[0])]
    name, why = _choose(names, times, table, signal, source)
    return [Chosen(time_of(name, times, table), name, why)]


def _moving_runs(runs: list[tuple[str, str]], table: FileTable, source: str) -> list[Chosen]:
    """Runs side by side, without those that hold no decay where others do; they are named."""
    candidates = {name: _candidate(table, name, time, source) for time, name in runs}
    still = [name for name, candidate in candidates.items() if candidate is None or candidate.swing is None]
    still = [] if len(still) == len(runs) else still
    said = f"runs side by side, {', '.join(still)} left out: no decay" if still else "runs side by side"
    return [Chosen(time, name, said) for time, name in runs if name not in still]


def _choose(
    names: list[str], times: list[str], table: FileTable, signal: str | None, source: str
) -> tuple[str, str]:
    """The column that alone can be meant, and why."""
    # Columns that are looked at.
    made = (_candidate(table, name, time_of(name, times, table), source) for name in names[:40])
    candidates = [candidate for candidate in made if candidate is not None]
    if not candidates:
        # Each of them holds a text: the refusal says where.
        return names[0], ""
    chosen, why = _certain(candidates, signal, source)
    return chosen.name, why


def _time_columns(table: FileTable) -> list[str]:
    """Names of the columns of time: by their headers, else the first one that rises throughout."""
    names = [name for name, values in table.columns.items() if not _is_empty(values)]
    units = {name: table.units.get(name, "") or split_header(name)[1] for name in names}
    named = [
        name
        for name in names
        if is_time(split_header(name)[0], units[name]) or is_clock_time(table.columns[name])
    ]
    # `Time_id[0]`, `t run 2`, `host time (s)`: names that begin or end so, of columns that rise.
    named += [
        name
        for name in names
        if name not in named
        and _is_like_time(split_header(name)[0], units[name])
        and _rises(table.columns[name])
    ]
    named.sort(key=names.index)
    if named or len(names) == 1:
        return named
    first = [name for name in names if np.asarray(table.columns[name]).dtype.kind in "fiu"][:3]
    rising = [
        name for name in first if _rises(table.columns[name]) and not counts_rows(split_header(name)[0])
    ]
    if not rising and _starts_anew(table.columns[names[0]]):
        return names[:1]
    # A number of the row stands before the time.
    if (
        len(rising) > 1
        and len(names) > 2
        and np.median(np.diff(np.asarray(table.columns[rising[0]], float))) == 1
    ):
        return rising[1:2]
    return rising[:1]


def _is_like_time(base: str, unit: str) -> bool:
    if unit:
        return unit in TIME_UNITS and base.endswith(" time")
    return re.match(r"(?:time|t|zeit)\b", base) is not None


def _is_empty(values: object) -> bool:
    """True if a column holds nothing, as that of the times where a logger leaves them out."""
    column = np.asarray(values)
    return column.dtype.kind == "f" and not np.isfinite(column).any()


def _rises(values: object) -> bool:
    column = np.asarray(values)
    if column.dtype.kind not in "fiu":
        return False
    steps = np.diff(column[np.isfinite(column.astype(float))].astype(float))
    return bool(steps.size and np.all(steps >= 0) and np.any(steps > 0))


def _starts_anew(values: object) -> bool:
    """True if a column rises and starts anew where it began, for each of a few runs."""
    column = np.asarray(values)
    if column.dtype.kind not in "fiu" or not np.isfinite(column.astype(float)).all():
        return False
    steps = np.diff(column.astype(float))
    back = np.flatnonzero(steps <= 0.0) + 1
    # Of the range of times: runs below each other begin as near to each other as this.
    begins = np.abs(column[back] - column[0]) <= 0.01 * np.ptp(column.astype(float))
    return bool(0 < back.size <= MOST_SET_BACK and begins.all())


def _candidate(table: FileTable, name: str, time: str | None, source: str) -> _Candidate | None:
    """A column with its header and swing; None if it holds a text, or next to no numbers."""
    base, unit = split_header(name)[0], unit_of_column(table, name)
    swing, reason = None, ""
    try:
        values, _ = without_sentinels(numbers(table.columns[name], name, source))
    except SysidTribError:
        return None
    if np.count_nonzero(np.isfinite(values)) < FEWEST_NUMBERS:
        return None
    try:
        stamps = np.arange(values.size) if time is None else numbers(table.columns[time], time, source)
        if stamps.size != values.size:
            return _Candidate(name, base, unit, values, None)
        clock = read_clock(stamps.astype(float), 1.0, source, values)
        good = np.isfinite(values[clock.rows])
        whole, _ = unwrapped(
            values[clock.rows][good], 360.0 if np.nanmax(np.abs(values)) > 10.0 else 2.0 * np.pi
        )
        swing, reason = swing_within(clock.time[good], unwrapped_anywhere(whole)[0])
    except SysidTribError:
        pass
    return _Candidate(name, base, unit, values, swing, reason)


def _certain(candidates: list[_Candidate], signal: str | None, source: str) -> tuple[_Candidate, str]:
    """The one column that can be meant, and why."""
    moving = [c for c in candidates if c.amplitude > 0.0] or candidates
    moving = [c for c in moving if not is_magnitude(c.values)] or moving
    pool = [c for c in moving if c.swing is not None] or moving
    if signal is not None:
        pool = [c for c in pool if c.quantity == signal] or pool
    # A position is worth more than its rate, and that than its acceleration: what need not be integrated.
    order = min(c.integrations for c in pool)
    pool = [c for c in pool if c.integrations == order]
    named = [c for c in pool if c.quantity == "angle" and names_quantity(c.base) == "angle"]
    others = f"of {len(candidates)} columns" if len(candidates) > 1 else ""
    if len(pool) == 1:
        _ask_of_larger(pool[0], moving, source)
        return pool[0], f"the one {others} that swings as a decay" if others and pool[0].swing else ""
    if len(named) == 1:
        return named[0], f"named as an angle, {others}"
    axes = _without_smaller_axes(named or pool)
    if len(axes) == 1:
        return axes[0], "the largest of the axes of one sensor, which swing together as one motion"
    pool = _without_copies(axes)
    if len(pool) == 1:
        return pool[0], f"of the columns that swing alike, {others}"
    units = {c.unit.text if c.unit else "" for c in pool}
    largest, second = sorted(pool, key=lambda c: c.amplitude)[:-3:-1]
    # Of columns in one unit, one is the signal if it swings so many times as far as any other.
    if len(units) == 1 and largest.amplitude > 5.0 * second.amplitude:
        return largest, f"it swings {largest.amplitude / second.amplitude:.2g} times as far as any other"
    if not any(c.swing for c in pool):
        raise RecordError(_no_decay(named or pool, source))
    raise UsageError(
        f"{source}: {_listed(pool)} could each be the signal; name one, such as "
        f'--angle "{(largest if len(units) == 1 else pool[0]).name}" (angle= in Python).'
    )


def _ask_of_larger(swinging: _Candidate, moving: list[_Candidate], source: str) -> None:
    """Ask which one is the signal where a column of the same kind that is no clean decay is far larger."""
    for other in moving:
        unit = other.unit and swinging.unit and other.unit.text == swinging.unit.text
        alike = unit or are_axes(other.base, swinging.base)
        # What is so many times as large as the column that swings is no noise of it, and is asked about.
        if alike and other.swing is None and other.amplitude > 50.0 * swinging.amplitude:
            raise UsageError(
                f"{source}: {other.name} moves {other.amplitude / swinging.amplitude:.2g} times as far as "
                f"{swinging.name}, but is no free decay ({other.reason}): cut that out, or name the column, "
                f'--angle "{swinging.name}" (angle= in Python).'
            )


def _no_decay(pool: list[_Candidate], source: str) -> str:
    """Why none of several columns is a decay."""
    reasons = "; ".join(f"{column.name}: {column.reason}" for column in pool[:LISTED] if column.reason)
    return (
        f"{source}: none of {len(pool)} columns swings as a free decay{f' ({reasons})' * bool(reasons)}; "
        + (
            "record one mode alone."
            if "two modes beat" in reasons and "driven" not in reasons
            else "is it driven? A free decay is needed: switch the drive off, and record what follows."
        )
    )


def _without_smaller_axes(pool: list[_Candidate]) -> list[_Candidate]:
    """Without axes of one sensor that move in phase with a larger one: all see the same motion."""
    largest = max(pool, key=lambda c: c.amplitude)
    return [
        c
        for c in pool
        if c is largest or not (are_axes(c.base, largest.base) and in_phase(c.values, largest.values))
    ]


def _without_copies(pool: list[_Candidate]) -> list[_Candidate]:
    """Without columns that repeat another one, are its rate, or swing twice as often (y of a pendulum)."""
    ranked = sorted(pool, key=lambda c: (c.quantity != "angle", c.unit is None))
    kept: list[_Candidate] = []
    for column in ranked:
        alike = any(_repeats(column, other) for other in kept)
        doubled = any(abs(other.period / column.period - 2.0) < 0.1 for other in pool)
        if not alike and not doubled and not any(_is_rate_of(column, other) for other in pool):
            kept.append(column)
    return [c for c in pool if c in kept] or pool[:1]


def _is_rate_of(column: _Candidate, other: _Candidate) -> bool:
    """True if a column is the derivative of another: a quarter of a period ahead, and w times as large."""
    if column.swing is None or other.swing is None or column is other:
        return False
    mine, its = column.swing.oscillation, other.swing.oscillation
    if mine.signal.size != its.signal.size or abs(mine.period / its.period - 1.0) > 0.05:
        return False
    w = 2.0 * np.pi / its.period
    wave = np.exp(-1j * w * its.time)
    ratio = np.sum((mine.signal - mine.signal.mean()) * wave) / np.sum(
        (its.signal - its.signal.mean()) * wave
    )
    return bool(abs(ratio / (1j * w) - 1.0) < DERIVATIVE_TOLERANCE)


def _repeats(column: _Candidate, other: _Candidate) -> bool:
    if column.values.size != other.values.size:
        return False
    good = np.isfinite(column.values) & np.isfinite(other.values)
    if not np.count_nonzero(good) or not np.ptp(column.values[good]) or not np.ptp(other.values[good]):
        return False
    # Two columns are one signal twice.
    return bool(abs(np.corrcoef(column.values[good], other.values[good])[0, 1]) > 0.9999)


def _listed(pool: list[_Candidate]) -> str:
    texts = []
    for column in pool[:LISTED]:
        low, high = np.nanpercentile(column.values, [0.0, 100.0])
        period = f", period {column.period:.4g}" if column.swing else ""
        texts.append(f"{column.name} ({low:.4g} to {high:.4g}{period})")
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def no_clock(table: FileTable, source: str) -> str:
    """Why there are no times, and what to give."""
    over = [name for name in table.columns if split_header(name)[0].startswith("freq")]
    if over:
        return (
            f"{source}: its columns are over {over[0]}, not over time: it is a response; a record is needed."
        )
    taken = next((f" but {time}, which --angle takes" for time in _time_columns(table)), "")
    return (
        f"{source}: there is no time column{taken}; give the sampling rate (--sampling-rate HZ). "
        f"Its columns are {_numbered(table)}."
    )


def _numbered(table: FileTable) -> str:
    """The columns of a file with their numbers, the time's among them."""
    names = [f"{number}: {name}" for number, name in enumerate(table.columns)]
    return ", ".join([*names[:LISTED], *["..."] * (len(names) > LISTED)])


def time_of_column(column: str, table: FileTable) -> str | None:
    """The time column that belongs to a column; None if there is none."""
    return time_of(column, [time for time in _time_columns(table) if time != column], table)


def has_column(table: FileTable, wanted: str | int | None) -> bool:
    """True if a table has a column of that name or number."""
    try:
        return wanted is not None and bool(find_column(table, wanted, ""))
    except UsageError:
        return False


def find_column(table: FileTable, wanted: str | int, source: str) -> str:
    """The column of that name, or else of that number from 0."""
    names = list(table.columns)
    if isinstance(wanted, str):
        for matches in (
            [name for name in names if name == wanted],
            [name for name in names if split_header(name)[0] == wanted.strip().lower()],
            [name for name in names if name.startswith((f"{wanted}[", f"{wanted}."))],
        ):
            if len(matches) == 1:
                return matches[0]
    if re.fullmatch(r"[0-9]{1,9}", str(wanted)) and int(wanted) < len(names):
        return names[int(wanted)]
    nearest = did_you_mean(str(wanted), [*names, *(split_header(name)[0] for name in names)])
    raise UsageError(
        f"{source}: there is no single column {str(wanted)!r}; its columns are {_numbered(table)}.{nearest}"
    )
