"""Choice of the columns of time and signal, where names, units and the swing make it certain."""

import re
from contextlib import suppress
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple, TypeAlias

import numpy as np
import pandas as pd

from sysid_trib.arrays import Array
from sysid_trib.errors import ChoiceError, RecordError, SysidTribError, UsageError
from sysid_trib.records import clock, drives, equilibrium, free_decay, modes, units as lab
from sysid_trib.records.column import Column
from sysid_trib.records.no_decay import LIKE_BEATS, Cause, NoDecay
from sysid_trib.records.reading import Reading
from sysid_trib.records.tables import LISTED, FileTable
from sysid_trib.records.unwrapping import unwrapped


class ChosenColumns(NamedTuple):
    """Columns of a run.

    Attributes
    ----------
    time : Column or None
        Its times, if there are any.
    signal : Column
    reason : str
        Reason for the choice of this signal; empty if there is no other column.
    copies : tuple of str
        Names of columns with the same numbers.
    """

    time: Column | None
    signal: Column
    reason: str
    copies: tuple[str, ...] = ()


# Advice where no column is a free decay: several modes oscillate together, the motion may be driven, or there
# are too few samples.
ONE_MODE = (
    "separate one mode, from all sensors together (--mode 1, or one_mode in Python), or record only one mode."
)
MAYBE_DRIVEN = (
    "is it driven? Then name signal and drive (--angle COLUMN --input COLUMN); otherwise switch "
    "the drive off, and record the free decay."
)
RECORD_LONGER = "record longer."


class TriedColumn(NamedTuple):
    """Swing of a column, or the reason why it has none, if that is known."""

    swing: equilibrium.Swing | None = None
    reason: NoDecay | None = None

    @property
    def why(self) -> str:
        """Text of the reason; empty if nothing is known."""
        return self.reason.text if self.reason else ""


# Columns that could be the signal.
Swings: TypeAlias = dict[Column, TriedColumn]


def choose_columns(table: FileTable, how: Reading, driving: list[Column]) -> list[ChosenColumns]:
    """Return the columns of each run in a table: as given, or the only plausible ones.

    Parameters
    ----------
    table : FileTable
        Contents of the file.
    how : Reading
        Columns, quantity and sampling rate, where they are given.
    driving : list of Column
        Inputs: they are no signal.

    Raises
    ------
    UsageError
        There is no such column, or several could be the signal: they are listed.
    RecordError
        There is no column for a signal, or no clock.
    """
    table = replace(table, columns=tuple(column for column in table.columns if column not in driving))
    given = None if how.time is None else table.find(how.time)
    if how.angle is not None:
        signal = table.find(how.angle)
        _refuse_levels([signal])
        return [ChosenColumns(given or own_time(table, signal), signal, "")]
    times = [given] if given else table.times
    numeric = [c for c in table.columns if c not in times and not c.is_empty and c.is_numeric]
    signals = [c for c in numeric if not c.is_level]
    acting: list[Column] = []
    driven = bool(driving)
    if not driven:
        signals, acting = _without_drives(signals, times, table)
    if not signals:
        _refuse_levels(numeric)
        _refuse_texts([column for column in table.columns if column not in times], table.source)
        raise RecordError(f"{table.source}: there is no column for the angle, only the time.")
    _refuse_long_format(table, times)
    if not (how.sampling_rate or table.rate or times):
        # Without a clock it cannot be seen which column swings.
        raise RecordError(table.no_clock)
    runs = _runs(table, signals, times)
    if not runs:
        distinct = _distinct(signals)
        try:
            chosen = _chosen(table, distinct, times, how)
        except (RecordError, UsageError):
            if not (driven or acting):
                raise
            chosen = _chosen_of_driven(table, distinct, times, acting)
        return [chosen._replace(copies=_copies_of(chosen.signal, signals))]
    first = runs[0][1]
    at = first.index(_chosen(table, first, times, how).signal) if len(first) > 1 else 0
    pairs = [(time, group[at]) for time, group in runs]
    # Runs without a decay are left out, and named, if others have one.
    swings = [signal for time, signal in pairs if _swings(signal, time)] or signals
    still = ", ".join(signal.name for _, signal in pairs if signal not in swings)
    why = f"runs side by side, {still} left out: no decay" if still else "runs side by side"
    return [ChosenColumns(time, signal, why) for time, signal in pairs if signal in swings]


def _distinct(signals: list[Column]) -> list[Column]:
    """Return the columns without copies: of columns with equal numbers, keep the one with the best name."""
    ranked = sorted(signals, key=lambda c: (c.quantity != "angle", not c.unit_text))
    kept: list[Column] = []
    for column in ranked:
        if not any(_are_copies(column, other) for other in kept):
            kept.append(column)
    return [column for column in signals if column in kept]


def _copies_of(signal: Column, signals: list[Column]) -> tuple[str, ...]:
    """Return the names of other columns with the same numbers as a signal."""
    return tuple(other.name for other in signals if other is not signal and _are_copies(other, signal))


def _are_copies(first: Column, other: Column) -> bool:
    """Return true if two columns of numbers, which move, are the same."""
    if not (first.is_plain and other.is_plain) or first.cells.size != other.cells.size:
        return False
    same = np.array_equal(first.cells.astype(float), other.cells.astype(float), equal_nan=True)
    return bool(same and first.amplitude > 0.0)


def _refuse_levels(columns: list[Column]) -> None:
    """Raise an error for columns of levels in dB, which contain no oscillation."""
    level = next((column for column in columns if column.is_level), None)
    if level is not None:
        raise RecordError(
            f"{level.source}: column {level.name} is a level in dB, the logarithm of an amplitude: it shows "
            "how fast a motion fades, but contains no oscillation; record the signal "
            "itself, such as the sound "
            "pressure or the acceleration."
        )


def _refuse_texts(columns: list[Column], source: str) -> None:
    """Raise an error for columns of texts where numbers were expected."""
    texts = [c for c in columns if not c.is_plain and not c.is_dated and c.cells.size]
    if not texts:
        return
    shown = ", ".join(f"{c.name} (such as {str(c.cells[0])[:20]!r})" for c in texts[:LISTED])
    raise RecordError(
        f"{source}: there is no column of numbers for the signal, only texts: {shown}; write the signal as "
        "decimal numbers."
    )


def _refuse_long_format(table: FileTable, times: list[Column]) -> None:
    """Raise an error for a table whose rows are values of several sensors in turn, named in a column."""
    for labels in table.columns:
        if labels.is_plain or labels.is_dated or labels.cells.dtype.kind not in "OUS" or not times:
            continue
        rows = pd.DataFrame({"of": pd.Series(labels.cells).astype(str)})
        named = rows["of"].unique()
        # A column with more different texts contains remarks.
        if not 2 <= named.size <= LISTED or times[0].cells.size != len(rows):
            continue
        rows["time"] = times[0].cells
        # Each sensor is read once at each time.
        of_several = rows["time"].duplicated(keep=False).mean() > 0.5
        in_turn = rows["of"].ne(rows["of"].shift()).mean() > 0.5
        if of_several and in_turn and not rows.duplicated().any():
            raise RecordError(
                f"{table.source}: its rows are values of several sensors in turn (column {labels.name}: "
                f"{', '.join(named)}); write one column per sensor and one row per time (a pivot table), or "
                "keep the rows of one sensor."
            )


def own_time(table: FileTable, signal: Column) -> Column | None:
    """Return the time column that belongs to a column; None if there is none."""
    return _time_of(table, signal, [time for time in table.times if time is not signal])


def _time_of(table: FileTable, signal: Column, times: list[Column]) -> Column | None:
    """Return the time column of the same number, `Time_id[2]` of `Y_id[2][0]`; else the next before it."""
    order = table.columns
    fitting = [time for time in times if time.cells.size == signal.cells.size] or times
    # `runs[1].t` is that of `runs[1].theta`.
    group = signal.name.rpartition(".")[0]
    fitting = [time for time in fitting if group and time.name.rpartition(".")[0] == group] or fitting
    # Common part of the names after the first word.
    rest = {c: re.sub(r"^[^\W\d_]+", "", c.name.rpartition(".")[2]) for c in (signal, *fitting)}
    mates = [time for time in fitting if "[" in time.name and rest[signal].startswith(rest[time])]
    before = [time for time in fitting if order.index(time) < order.index(signal)]
    if mates or not before:
        return next(iter(mates or fitting), None)
    # Of clocks in neighbouring columns take the one with the fewest repeated values; else the next one.
    clocks = [before[-1]]
    while (at := order.index(clocks[0])) and order[at - 1] in before:
        clocks.insert(0, order[at - 1])
    return max(reversed(clocks), key=lambda clock: pd.unique(clock.cells).size)


def _runs(table: FileTable, signals: list[Column], times: list[Column]) -> list[tuple[Column, list[Column]]]:
    """Return times and signals of runs side by side: MATLAB's cells, or `t1 x1 v1 t2 x2 v2`; else nothing.

    All runs have the same number of columns. The names differ between runs only by a number or a letter.
    """
    runs = [(time, [c for c in signals if _time_of(table, c, times) is time]) for time in times]
    # Common name of the columns of all runs: `x` for `x1 (mm)`, `angle` for `Angle B [rad]`.
    bare = re.compile(r"#?\d+|(?<=[ _])[a-d](?=$| )")
    patterns = {tuple(bare.sub("", c.base) for c in (time, *group)) for time, group in runs}
    fit = all(c.cells.size == time.cells.size for time, group in runs for c in group)
    if len(runs) < 2 or len(patterns) > 1 or not fit or not runs[0][1] or _are_bodies(runs):
        return []
    return runs


# Words for runs in a line above their columns.
_RUN = re.compile(
    r"\b(?:run|trial|test|try|rep|repeat|take|messung|versuch|lauf|essai|prova|ensayo|pomiar)\b"
)


def _are_bodies(runs: list[tuple[Column, list[Column]]]) -> bool:
    """Return true if columns are several bodies in one run: groups with their own names over equal times."""
    first, *others = (time for time, _ in runs)
    grouped = all(" " in time.base and not _RUN.search(time.base) for time, _ in runs)
    named_before = grouped and all(lab.is_time(time.base.rpartition(" ")[2], "") for time, _ in runs)
    return named_before and all(np.array_equal(first.cells, time.cells) for time in others)


def _chosen(table: FileTable, signals: list[Column], times: list[Column], how: Reading) -> ChosenColumns:
    """Return the only plausible signal column, its times, and the reason."""
    own = {signal: _time_of(table, signal, times) for signal in signals}
    # Columns that are considered.
    made = {signal: _swing_of(signal, own[signal]) for signal in signals[:40] if len(signals) > 1}
    swings = {signal: swing for signal, swing in made.items() if swing is not None}
    # If each of these columns contains a text, the error states where.
    chosen, why = _certain(swings, how.quantity, table.source) if swings else (signals[0], "")
    if not lab.names_quantity(chosen.base):
        _ask_of_closed_loop(chosen, [c for c in swings if c is not chosen])
    return ChosenColumns(own[chosen], chosen, why)


def _without_drives(
    signals: list[Column], times: list[Column], table: FileTable
) -> tuple[list[Column], list[Column]]:
    """Return the columns without drives, and the drives; all columns if only the drives swing as a decay."""
    acting = [c for c in signals if drives.is_named_as_drive(c)]
    others = [c for c in signals if c not in acting]
    if not acting or not any(drives.moves(c) for c in others):
        return signals, []

    def decays(columns: list[Column]) -> bool:
        return any(_swings(c, _time_of(table, c, times)) for c in columns[:40])

    # A wanted motion is not measured, whatever it looks like.
    measured = [c for c in acting if not drives.is_wanted(c)]
    return (signals, []) if decays(measured) and not decays(others) else (others, acting)


def _chosen_of_driven(
    table: FileTable, signals: list[Column], times: list[Column], acting: list[Column]
) -> ChosenColumns:
    """Choose the signal of a driven record by its quantity; raise an error that asks if this is unclear."""
    pool = [c for c in signals if drives.moves(c) and not drives.is_named_as_drive(c)] or signals
    for quantity in ("angle", "displacement", "rate", "acceleration"):
        known = [c for c in pool if c.quantity == quantity]
        # A unit such as V may belong to any quantity, so the name decides: a torque is not a position.
        named = [c for c in known if c.quantity == lab.names_quantity(c.base)] or known
        if len(named) == 1:
            reason = f"the only {quantity} of {len(signals)} columns"
            return ChosenColumns(_time_of(table, named[0], times), named[0], reason)
        if len(named) > 1:
            pool = named
            break
    if len(pool) == 1:
        return ChosenColumns(_time_of(table, pool[0], times), pool[0], f"of {len(signals)} columns")
    drive = f'; column {acting[0].name} drives it: add --input "{acting[0].name}"' if acting else ""
    listed = _listed(pool, dict.fromkeys(pool, TriedColumn()))
    raise ChoiceError(
        f"{table.source}: {listed} could each be the signal; name one, "
        f'such as --angle "{pool[0].name}" (angle= in Python){drive}.',
        (column.name for column in pool),
    )


def _swings(column: Column, time: Column | None) -> bool:
    """Return true if a column swings as a free decay."""
    tried = _swing_of(column, time)
    return tried is not None and tried.swing is not None


def _swing_of(column: Column, time: Column | None) -> TriedColumn | None:
    """Return the swing of a column, or the reason for none; None for texts or fewer than three numbers."""
    try:
        values = column.values
    except SysidTribError:
        return None
    # Fewer numbers cannot show a motion.
    if np.count_nonzero(np.isfinite(values)) < 3:
        return None
    with suppress(SysidTribError):
        stamps = np.arange(values.size) if time is None else time.numbers
        if stamps.size == values.size:
            times, rows, *_ = clock.read_clock(stamps.astype(float), 1.0, column.source, values)
            good = np.isfinite(values[rows])
            turn = 360.0 if np.nanmax(np.abs(values)) > 10.0 else 2.0 * np.pi
            whole, _, _ = unwrapped(unwrapped(values[rows][good], turn)[0])
            swing = free_decay.swing_within(times[good], whole)
            return TriedColumn(reason=swing) if isinstance(swing, NoDecay) else TriedColumn(swing)
    return TriedColumn()


def _certain(swings: Swings, signal: str | None, source: str) -> tuple[Column, str]:
    """Return the only plausible signal column, and the reason."""
    moving = [c for c in swings if c.amplitude > 0.0] or [*swings]
    moving = [c for c in moving if not _is_magnitude(c.values)] or moving
    pool = [c for c in moving if swings[c].swing] or moving
    if signal is not None:
        pool = [c for c in pool if c.quantity == signal] or pool
    # A position is preferred to its rate, and that to its acceleration: they need fewer integrations.
    integrations = {c: lab.INTEGRATIONS.get(c.quantity, 0) for c in pool}
    pool = [c for c in pool if integrations[c] == min(integrations.values())]
    named = [c for c in pool if c.quantity == lab.names_quantity(c.base) == "angle"]
    others = f"of {len(swings)} columns" if len(swings) > 1 else ""
    if len(pool) == 1:
        _ask_of_larger(pool[0], moving, swings)
        return pool[0], f"the only one {others} that swings as a decay" if others and swings[
            pool[0]
        ].swing else ""
    if len(named) == 1:
        return named[0], f"named as an angle, {others}"
    axes = _without_smaller_axes(named or pool)
    if len(axes) == 1:
        return axes[0], "the largest of the axes of one sensor, which swing together as one motion"
    pool = _without_copies(axes, swings)
    if len(pool) == 1:
        return pool[0], f"the fundamental oscillation among the {len(swings)} columns"
    largest, second = sorted(pool, key=lambda c: c.amplitude)[:-3:-1]
    one_unit = len({c.unit_text for c in pool}) == 1
    # A column is the signal if its range exceeds that of others in its unit by this factor.
    if one_unit and largest.amplitude > 5.0 * second.amplitude:
        times = f"{largest.amplitude / second.amplitude:.2g}"
        return largest, f"it swings {times} times as far as any other"
    if not any(swings[c].swing for c in pool):
        raise _no_decay_in(named or pool, swings, source)
    swing = swings[largest].swing
    several = modes.modes(swing.time, swing.signal) if swing else []
    if len(several) > 1:
        raise UsageError(
            f"{source}: {_listed(pool, swings)} could each be the signal, and several modes swing in "
            f"{largest.name}: {modes.listed(several)}; {ONE_MODE}"
        )
    raise ChoiceError(
        f"{source}: {_listed(pool, swings)} could each be the signal; name one, such as "
        f'--angle "{(largest if one_unit else pool[0]).name}" (angle= in Python).',
        (column.name for column in pool),
    )


# Correlation from which two columns are one motion, wanted and measured; how much larger a drive is.
ONE_MOTION, FAR_LARGER = 0.999, 5.0


def _ask_of_closed_loop(chosen: Column, others: list[Column]) -> None:
    """Raise an error that asks for the signal where two other columns are one motion, which this one is not.

    A wanted and a measured motion are nearly equal; what is far larger and no copy of them drives the motion.
    """
    small = [c for c in others if c.unit_text == chosen.unit_text]
    small = [c for c in small if 0.0 < FAR_LARGER * c.amplitude < chosen.amplitude]
    for first, second in combinations(small, 2):
        differ = not np.array_equal(first.values, second.values)
        copies = differ and _in_phase(first.values, second.values, ONE_MOTION)
        if not copies or _in_phase(chosen.values, second.values):
            continue
        # The measured motion is behind the wanted one.
        lag = np.nansum((second.values - first.values) * np.gradient(first.values))
        measured = second if lag < 0.0 else first
        raise UsageError(
            f"{chosen.source}: {first.name} and {second.name} are one motion, wanted and measured; "
            f"{chosen.name} swings {chosen.amplitude / second.amplitude:.2g} times as far and is no copy of "
            f'it, so that it may drive it. Name signal and drive, such as --angle "{measured.name}" '
            f'--input "{chosen.name}".'
        )


def _no_decay_in(pool: list[Column], swings: Swings, source: str) -> RecordError:
    """Return the error that no column is a free decay, with the reasons, and the advice that follows."""
    listed = [column for column in pool[:LISTED] if swings[column].reason]
    causes = {reason.cause for column in listed if (reason := swings[column].reason)}
    if causes == {Cause.FEW_SAMPLES}:
        advice = RECORD_LONGER
    elif causes & LIKE_BEATS and any(_loses_amplitude(column) for column in pool):
        advice = ONE_MODE
    else:
        advice = MAYBE_DRIVEN
    reasons = "; ".join(f"{column.name}: {swings[column].why}" for column in listed)
    said = f" ({reasons})" if reasons else ""
    return RecordError(f"{source}: none of {len(pool)} columns swings as a free decay{said}; {advice}")


def _loses_amplitude(column: Column) -> bool:
    """Return true if the last quarter of a column swings less than half as far as the first."""
    values = column.numbers[np.isfinite(column.numbers)]
    quarter = len(values) // 4
    if not quarter:
        return False
    return bool(np.std(values[-quarter:]) < 0.5 * np.std(values[:quarter]))


def _ask_of_larger(swinging: Column, moving: list[Column], swings: Swings) -> None:
    """Raise an error that asks for the signal if a column that is not a clean decay is far larger."""
    for other in moving:
        tried = swings[other]
        alike = other.unit_text == swinging.unit_text != "" or _are_axes(other.base, swinging.base)
        # A column larger than the oscillating one by this factor is not noise: ask about it.
        if alike and tried.swing is None and other.amplitude > 50.0 * swinging.amplitude:
            raise UsageError(
                f"{other.source}: {other.name} moves {other.amplitude / swinging.amplitude:.2g} times as far "
                f"as {swinging.name}, but is no free decay ({tried.why}): cut that out, or name the column, "
                f'--angle "{swinging.name}" (angle= in Python).'
            )


def _without_smaller_axes(pool: list[Column]) -> list[Column]:
    """Remove axes of one sensor that move in phase with a larger one: all see the same motion."""
    largest = max(pool, key=lambda c: c.amplitude)
    others = [c for c in pool if _are_axes(c.base, largest.base) and _in_phase(c.values, largest.values)]
    return [c for c in pool if c not in others]


def _without_copies(pool: list[Column], swings: Swings) -> list[Column]:
    """Remove columns that repeat another one, are its rate, or swing twice as often (y of a pendulum)."""
    ranked = sorted(pool, key=lambda c: (c.quantity != "angle", not c.unit_text))
    periods = {c: tried.swing.oscillation.period if tried.swing else np.inf for c, tried in swings.items()}
    kept: list[Column] = []
    for column in ranked:
        # Two columns are one signal twice.
        alike = any(_in_phase(column.values, other.values, 0.9999) for other in kept)
        doubled = any(abs(periods[other] / periods[column] - 2.0) < 0.1 for other in pool)
        is_rate = any(_is_rate_of(swings[column].swing, swings[other].swing) for other in pool)
        if not (alike or doubled or is_rate):
            kept.append(column)
    return [c for c in pool if c in kept] or pool[:1]


def _is_rate_of(swing: equilibrium.Swing | None, other: equilibrium.Swing | None) -> bool:
    """Return true if a swing is the derivative of another: a quarter period ahead, and w times as large."""
    if swing is None or other is None or swing is other:
        return False
    mine = swing.oscillation
    its = other.oscillation
    if mine.signal.size != its.signal.size or abs(mine.period / its.period - 1.0) > 0.05:
        return False
    w = 2.0 * np.pi / its.period
    wave = np.exp(-1j * w * its.time)
    rate, angle = (np.sum((part.signal - part.signal.mean()) * wave) for part in (mine, its))
    return bool(abs(rate / angle / (1j * w) - 1.0) < 0.2)


def _listed(pool: list[Column], swings: Swings) -> str:
    texts = []
    for column in pool[:LISTED]:
        low, high = np.nanpercentile(column.values, [0.0, 100.0])
        swing = swings[column].swing
        period = f", period {swing.oscillation.period:.4g}" if swing else ""
        texts.append(f"{column.name} ({low:.4g} to {high:.4g}{period})")
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


_AXIS = re.compile(r"^[xyz](?=[ _-])|(?<![^\W\d_]{2})[xyz]$|(?<=[ _-])[xyz]$|(?<=acc)[xyz]$|(?<=gyro)[xyz]$")


def _are_axes(first: str, second: str) -> bool:
    """Return true if two names differ by their axis alone: `gyroscope x` and `gyroscope y`, `ax` and `az`."""
    plain = [_AXIS.sub("", name) for name in (first, second)]
    return first != second and plain[0] == plain[1] and first not in plain and second not in plain


def _in_phase(first: Array, second: Array, least: float = 0.8) -> bool:
    """Return true if two columns are one motion, of either sign, up to noise: by their correlation."""
    if first.size != second.size:
        return False
    good = np.isfinite(first) & np.isfinite(second)
    x = first[good]
    y = second[good]
    return bool(x.size > 1 and np.ptp(x) and np.ptp(y) and abs(np.corrcoef(x, y)[0, 1]) > least)


def _is_magnitude(values: Array) -> bool:
    """Return true if a column is never negative but reaches zero to the end: a magnitude without sign."""
    good = values[np.isfinite(values)]
    if good.size < 2 or good.min() < 0.0:
        return False
    parts = [part for part in np.array_split(good, 4) if part.size]
    # Part of its range: a magnitude comes as near to zero as this in every swing.
    allowed = 0.05 * max(float(part.max()) for part in parts)
    return all(part.min() < allowed for part in parts)
