"""What a file says of its columns and of itself: names, units, sampling rate, and which belong together."""

import re
import unicodedata
from collections.abc import Sequence

import numpy as np
import pandas as pd

from sysid_trib.records.tables import FileTable
from sysid_trib.records.units import (
    ANGLE_UNITS,
    LAB_WORDS,
    POSITION_UNITS,
    TIME_UNITS,
    SignalUnit,
    is_known_unit,
    plain_unit,
    signal_unit,
)

# Behind a name without a bracket these letters are an index: `theta_d`, `h d`.
_KNOWN = (TIME_UNITS.keys() | ANGLE_UNITS.keys() | POSITION_UNITS.keys() | {"g", "dps", "%"}) - {"h", "d"}

_NAMING_UNITS = {unit for unit in ANGLE_UNITS.keys() | POSITION_UNITS.keys() if len(unit) > 1} - {
    *("in", "turn", "turns", "raw", "adc", "count", "counts", "arb")
}


def split_header(name: str) -> tuple[str, str]:
    """Name and unit of a header such as `angle (deg)`, `Time [ms]`, `t / s`, `time_ms` or `Winkel in Grad`.

    Both in lower case; the name without a group before it (`run.time`, `Run 1: Time`).
    """
    # Patterns take the square of the time for blanks in a row.
    text = re.sub(r"_?\{\w*\}|(?<=.)#\d+$", "", " ".join(name.lower().split()).replace("μ", "µ"))
    bracket = re.fullmatch(r"(.*?)\s*[\[({]\s*([^\[\](){}]*?)\s*[\])}](?:\s+run\b.*)?", text)
    if bracket is not None and not bracket[2].isdigit():
        base, unit = bracket[1], plain_unit(bracket[2])
    else:
        base, unit = _without_bracket(text)
    *groups, base = re.split(r"[./](?=\D)|:\s+", base)
    # `angular_velocity.x`
    if base in ("x", "y", "z") and groups and names_quantity(groups[-1].replace("_", " ")):
        base = f"{groups[-1]} {base}"
    return re.sub(r"^\d+\s+", "", base.replace("_", " ").strip()), unit


def _without_bracket(text: str) -> tuple[str, str]:
    per = re.fullmatch(r"(.+?)[_ ](m?rad|deg|degrees|°|[cmuµ]?m)(?:/|[_ ](?:per[_ ])?)s(?:ec)?(\^?2)?", text)
    if per is not None:
        return per[1], f"{per[2]}/s{'^2' if per[3] else ''}"
    for pattern in (r"(.+?)\s*/\s*(\S+)", r"(.+) in (\S+)", r"(.+)[_ ](\S+)"):
        match = re.fullmatch(pattern, text)
        if match is not None and (plain_unit(match[2]) in _KNOWN or is_known_unit(match[2])):
            return match[1], plain_unit(match[2])
    # `Volt`, `deg`: a unit is all the name there is.
    return text, plain_unit(text) if plain_unit(text) in _NAMING_UNITS else ""


def names_quantity(base: str) -> str:
    """The quantity that a name usually means (`angle`, `rate`, ...), or nothing.

    Parameters
    ----------
    base : str
        Of `split_header`. The axis at its end does not count: `gyroscope y`.
    """
    base = _without_accents(base)
    first = base.split(" ")[0]
    for text in (base, re.sub(r"[ _]?(?:[xyz]|\d+|left|right)$", "", base), first if len(first) > 2 else ""):
        for quantity, names in LAB_WORDS["quantities"].items():
            if text in names:
                return quantity
    # `p1 x`: a coordinate of anything.
    return "displacement" if re.search(r"\w [xyz]$", base) else ""


def is_time(base: str, unit: str) -> bool:
    """True if a header is that of a time column."""
    base = _without_accents(base)
    plain = re.sub(r"\s*\d+$", "", base)
    named = {plain, base} & set(LAB_WORDS["time"])
    return bool(named) or (unit in TIME_UNITS and base.startswith("time"))


def counts_rows(base: str) -> bool:
    """True if a header is that of a number of the row, such as `frame`."""
    return base in LAB_WORDS["counter"]


def _without_accents(text: str) -> str:
    """Letters without their accents: `angulo` for `ángulo`."""
    parted = unicodedata.normalize("NFD", text)
    return "".join(letter for letter in parted if not unicodedata.combining(letter))


def unit_of_column(table: FileTable, name: str) -> SignalUnit | None:
    """Unit that a file states of a column, with its name or in its header; None where it states none."""
    stated = table.units.get(name, "")
    if not stated:
        # With the capitals that the header has: `mT`, where `split_header` says `mt`.
        stated = (table.made.get(name) or split_header(name))[1]
        at = name.lower().rfind(stated)
        stated = name[at : at + len(stated)] if at >= 0 else stated
    return signal_unit(stated)


_VALUE = r"(?P<value>\d[\d.]*(?:,\d+)?(?:e[+-]?\d+)?)"
_SECOND = r"s(?:ec(?:ond)?)?\b"
_RATES = (
    # `fs = 200 Hz`, `Sampling rate (kHz): 2`
    r"\b(?:fs|f_s|fps|sampl(?:e|ing)[ _]?(?:rate|frequency)|samplerate|abtast(?:rate|frequenz)|"
    r"(?:frame|data|scan|actual|acq(?:uisition)?|daq|adc|clock|update)[ _]?rate|(?<![\w ])rate)\b"
    r"(?:\s*[\[(](?P<before>\w+)[\])])?\W{0,4}" + _VALUE + r"\s*(?P<after>k?hz)?",
    # `30 fps`, `65 samples/s`
    r"(?<![\w.,])"
    + _VALUE
    + r"\s*(?:(?:k?sa|k?s)/s|k?sps|fps|(?:samples?|frames?)\s*(?:/|per)\s*"
    + _SECOND
    + ")",
)
# `dt = 5 ms`, LabVIEW's `Delta_X`
_STEP = (
    r"\b(?:dt|ts|delta[ _]?[tx]|(?:sampl(?:e|ing)|time)[ _]?(?:interval|step|period|time)|"
    r"abtast(?:intervall|zeit))\b"
    r"(?:\s*[\[(](?P<before>\w+)[\])])?\W{0,4}" + _VALUE + r"(?:\s*(?P<after>[mµu]?s)\b)?"
)
_DURATION = (
    r"\b(?:duration|record(?:ing)?[ _]?length|acquisition[ _]?time)\b\W{0,4}" + _VALUE + r"\s*(?:s\b|$)"
)
_UNIT = (
    r"\b(?:y_unit_label|vertical units|units?)\b(?:(?<=vertical units)|\s*[:=\t])"
    r"\s*['\"]?(?P<unit>[^\s'\",;]+)"
)


def noted_rate(notes: Sequence[str]) -> float | None:
    """Sampling rate (Hz) that a file states: `fs = 200 Hz`, `30 fps`, `Sampling interval: 5 ms`."""
    for note in notes:
        for pattern in _RATES:
            match = re.search(pattern, note, re.IGNORECASE)
            if match and _value(match) > 0.0:
                return _value(match) * (1e3 if _unit_of(match, "hz").startswith("k") else 1.0)
        match = re.search(_STEP, note, re.IGNORECASE)
        if match and _value(match) > 0.0:
            return 1.0 / (_value(match) * TIME_UNITS.get(_unit_of(match, "s"), 1.0))
    return None


def _noted_duration(notes: Sequence[str]) -> float | None:
    """Duration (s) that a scalar or a comment of a file states: `duration = 30`."""
    matches = (re.search(_DURATION, note, re.IGNORECASE) for note in notes)
    return next((_value(match) for match in matches if match and _value(match) > 0.0), None)


def _value(match: "re.Match[str]") -> float:
    try:
        return float(match["value"].replace(",", "."))
    except ValueError:
        return 0.0


def _unit_of(match: "re.Match[str]", usual: str) -> str:
    """The unit that stands behind a value, or in brackets before it."""
    units = match.groupdict()
    return str(units.get("after") or units.get("before") or usual).lower()


def noted_unit(notes: Sequence[str]) -> str:
    """Unit that comments or texts of a file state, `unit: rad`; nothing where none does."""
    matches = (re.search(_UNIT, note, re.IGNORECASE) for note in notes)
    return next((match["unit"] for match in matches if match), "")


def time_of(name: str, times: list[str], table: FileTable) -> str | None:
    """The time column of the same number, `Time_id[2]` of `Y_id[2][0]`; else the next before it."""
    order = list(table.columns)
    fitting = [t for t in times if np.size(table.columns[t]) == np.size(table.columns[name])] or times
    mates = [t for t in fitting if _are_mates(t, name)]
    before = [t for t in fitting if order.index(t) < order.index(name)]
    if mates or not before:
        return next(iter(mates or fitting), None)
    # Of clocks in neighbouring columns the one that stands still least often; else the next one.
    clocks = [before[-1]]
    while (at := order.index(clocks[0])) and order[at - 1] in before:
        clocks.insert(0, order[at - 1])
    return max(reversed(clocks), key=lambda clock: pd.unique(table.columns[clock]).size)


def _rest(name: str) -> str:
    """A name without its first word: what it shares with its mate."""
    return re.sub(r"^[^\W\d_]+", "", name.rpartition(".")[2])


def _are_mates(time: str, name: str) -> bool:
    return "[" in time and _rest(name).startswith(_rest(time))


def runs_side_by_side(names: list[str], times: list[str], table: FileTable) -> list[tuple[str, str]]:
    """Time and signal of each run where a table holds the same pair of columns several times."""
    pairs = [(time_of(name, times, table) or "", name) for name in names]
    headers = {split_header(name) for name in names}
    numbered = all(any(sign.isdigit() for sign in name) for name in names[1:])
    grouped = ":" in names[0] or "run" in names[0].lower() or all("#" in name for name in names[1:])
    several = len(pairs) > 1 and len({time for time, _ in pairs}) == len(pairs) == len(times)
    return pairs if several and len(headers) == 1 and numbered and grouped else []


def cells(names: list[str], times: list[str], table: FileTable) -> list[tuple[str, list[str]]]:
    """Times and signals of each run: MATLAB's cells, or `t1 x1 v1 t2 x2 v2`; nothing of other tables.

    Each has as many columns as the others, of the same names but for their numbers or letters, and units.
    """
    groups = [(time, [name for name in names if time_of(name, times, table) == time]) for time in times]
    patterns = {tuple(_without_number(item) for item in (time, *group)) for time, group in groups}
    fit = all(
        np.size(table.columns[name]) == np.size(table.columns[t]) for t, group in groups for name in group
    )
    return groups if len(groups) > 1 and len(patterns) == 1 and fit and groups[0][1] else []


def _without_number(name: str) -> str:
    """What the columns of all runs are called: `x` for `x1 (mm)`, `angle` for `Angle B [rad]`."""
    return re.sub(r"#?\d+|(?<=[ _])[a-d]$", "", split_header(name)[0])


def stated_rate(table: FileTable) -> float | None:
    """Sampling rate (Hz) that the notes of a file state, or that its rows have over a duration they state."""
    rate, duration = noted_rate(table.notes), _noted_duration(table.notes)
    if rate is not None or duration is None:
        return rate
    rows = max(np.size(column) for column in table.columns.values())
    # The last sample may be at the end.
    return (rows - 1) / duration if (rows - 1) % duration == 0.0 else rows / duration
