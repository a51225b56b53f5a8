"""Spellings of laboratories: units and their factors, names of columns, sampling rates."""

import re
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, pairwise

import numpy as np

from sysid_trib.records.unit_tables import (
    ACCELEROMETER,
    ANGLE_UNITS,
    LAB_WORDS,
    POSITION_UNITS,
    RADIANS,
    STANDARD_GRAVITY,
    by_spelling,
)

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
TIME_UNITS = {spelling: _SECONDS[name] for spelling, name in by_spelling("seconds").items()}
# Number of integrations that turn a signal into an angle or a displacement.
INTEGRATIONS = {"angle": 0, "displacement": 0, "rate": 1, "acceleration": 2}
SIGNALS = (*INTEGRATIONS, ACCELEROMETER)
POSITIONS = ("angle", "displacement")
OFFERED_UNITS = "rad, deg, mrad, m, mm, px, V, au, rad/s, deg/s, m/s^2 or g"
OFFERED_TIME_UNITS = "s, ms, us, ns, min, h or d"
OFFERED_ANGLES = ", ".join(LAB_WORDS["angles"])


_SUPERSCRIPTS = str.maketrans({"²": "^2", "¹": "^1", "⁻": "-", "\u22c5": "·", "\u2219": "·", "\u2212": "-"})


@dataclass(frozen=True)
class SignalUnit:
    """Unit of a signal.

    Attributes
    ----------
    text : str
        Usual name of the unit; an unknown one as in the file.
    quantity : {"angle", "displacement", "rate", "acceleration"}
        Measured quantity of this unit.
    position : str
        Unit of the angle (rad) or displacement that the signal is, or becomes by integration over s.
    factor : float
        Factor to `position`, `position`/s or `position`/s^2.
    known : bool
        Whether the unit is listed here; an unknown one counts as a unit of displacement.
    """

    text: str
    quantity: str
    position: str
    factor: float
    known: bool = True


def signal_unit(text: str) -> SignalUnit | None:
    """Return the unit that a text means; None for an empty text.

    Parameters
    ----------
    text : str
        Unit in any usual spelling, such as `°/s`, `m s^-2`, `Grad`, `px`, `g`.
    """
    plain = plain_unit(text)
    if plain in ("", "1", "none", "-"):
        return None
    if plain in ("g", "g0", "gn", "mg"):
        thousandth = 1e-3 if plain == "mg" else 1.0
        return SignalUnit("mg" if plain == "mg" else "g", "acceleration", "m", thousandth * STANDARD_GRAVITY)
    if plain == "rpm":
        return SignalUnit(plain, "rate", "rad", 2.0 * np.pi / 60.0)
    plain = "deg/s" if plain == "dps" else plain
    if scaled := _SCALED_UNIT.fullmatch(plain):
        return _scaled_unit(scaled, text)
    match = re.fullmatch(r"(.+?)/s(\^?2)?", plain)
    base, quantity = (match[1], "acceleration" if match[2] else "rate") if match else (plain, "")
    per = {"rate": "/s", "acceleration": "/s^2", "": ""}[quantity]
    if base in ANGLE_UNITS:
        name = ANGLE_UNITS[base]
        return SignalUnit(f"{name}{per}", quantity or "angle", "rad", RADIANS[name])
    if base in POSITION_UNITS:
        name = POSITION_UNITS[base]
        return SignalUnit(f"{name}{per}", quantity or "displacement", name, 1.0)
    return SignalUnit(text, "displacement", text.strip(), 1.0, known=False)


# `0.01 deg`, `1/100 °`, `10^-3 rad`, `x1e-6 m`: a unit with a factor.
_SCALED_UNIT = re.compile(
    r"[x*×]?\s*(?:10\^(?P<power>-?\d+)|(?P<number>\d+(?:\.\d+)?(?:e[-+]?\d+)?)(?:/(?P<divisor>\d+))?)"
    r"\s*[x*×·]?\s*(?P<unit>[^\d\s.,/^].*)"
)


def _scaled_unit(match: "re.Match[str]", text: str) -> SignalUnit | None:
    """Return a unit with a factor; the unit of a displacement is unchanged."""
    unit = signal_unit(match["unit"])
    number = float(match["number"] or 10.0 ** int(match["power"])) / float(match["divisor"] or 1.0)
    if unit is None or not unit.known or not 0.0 < number < np.inf:
        return SignalUnit(text, "displacement", text.strip(), 1.0, known=False)
    return replace(unit, text=text.strip(), factor=number * unit.factor)


def is_known_unit(text: str) -> bool:
    """Return true if a text means a unit of a signal that is listed here."""
    unit = signal_unit(text)
    return unit is not None and unit.known


def plain_unit(text: str) -> str:
    """Return a unit in lower case, with `/s` and `/s^2` for every spelling of "per second"."""
    # Join blanks first: the time of the patterns is quadratic in consecutive blanks.
    plain = re.sub(r" since .*", "", " ".join(text.lower().split()).replace("μ", "µ"))
    plain = plain.replace("**", "^").translate(_SUPERSCRIPTS)
    plain = re.sub(r"-\^|\^[({]?-|(?<=s)-(?=[12]$)", "^-", plain)
    plain = re.sub(r"\^[({]?(-?)([12])[)}]?", r"^\1\2", plain)
    plain = re.sub(r"\s*(?:/|\bper\b|_per_)\s*(?:sec(?:ond)?s?|s)\b", "/s", plain)
    plain = re.sub(r"/s\s*/s$|/\s*\(?s\s*[*·.]\s*s\)?$", "/s^2", plain)
    # `rad s^-1`, `m.s^-2`, `ms^-2`, `deg s`
    plain = re.sub(r"^(.+?)[\s_*·.]+s(?:ec)?\s*\^-([12])$", r"\1/s^\2", plain)
    plain = re.sub(r"^(m?rad|deg|°|[cmuµ]?m)s\^-([12])$", r"\1/s^\2", plain)
    plain = re.sub(r"^(m?rad|deg|°|[cmuµ]?m)[\s_]s$", r"\1/s", plain)
    plain = plain.strip().removesuffix("^1")
    # `sec.`, `Deg.`: an abbreviation.
    return plain[:-1] if plain.endswith(".") and len(plain) > 1 else plain


# After a name without brackets these letters are an index: `theta_d`, `h d`.
_KNOWN = (TIME_UNITS.keys() | ANGLE_UNITS.keys() | POSITION_UNITS.keys() | {"g", "dps", "%"}) - {"h", "d"}

_NAMING_UNITS = {unit for unit in ANGLE_UNITS.keys() | POSITION_UNITS.keys() if len(unit) > 1} - {
    *("in", "turn", "turns", "raw", "adc", "count", "counts", "arb")
}
# A column may be called by its unit alone; `min` may be a minimum.
_NAMING_UNITS |= {unit for unit, factor in TIME_UNITS.items() if factor < 1.0}


def split_header(name: str) -> tuple[str, str]:
    """Split a header such as `angle (deg)`, `Time [ms]`, `t / s`, `time_ms` or `Winkel in Grad`.

    Name and unit are in lower case; the name is without a group before it (`run.time`, `Run 1: Time`).
    """
    # Join blanks first: the time of the patterns is quadratic in consecutive blanks.
    text = re.sub(r"_?\{\w*\}|(?<=.)#\d+$", "", " ".join(_unit_apart(name).lower().split()).replace("μ", "µ"))
    bracket = re.fullmatch(r"(.*?)\s*[\[({]\s*([^\[\](){}]*?)\s*[\])}](?:\s+run\b.*)?", text)
    if bracket is not None and not bracket[2].isdigit():
        base = bracket[1]
        unit = plain_unit(bracket[2])
    else:
        base, unit = _without_bracket(text)
    *groups, base = re.split(r"[./](?=\D)|:\s+", base)
    # `angular_velocity.x`
    if base in ("x", "y", "z") and groups and names_quantity(groups[-1].replace("_", " ")):
        base = f"{groups[-1]} {base}"
    return re.sub(r"^\d+\s+", "", base.replace("_", " ").strip()), unit


def _unit_apart(name: str) -> str:
    """Return `time_Ms` for `timeMs`, `angle_Deg` for `angleDeg`: a unit as the last word of a name."""
    match = re.fullmatch(r"(.*[a-z])([A-Z][a-z]+)", name.strip())
    if match is None or plain_unit(match[2]) not in _NAMING_UNITS | {"sec"}:
        return name
    return f"{match[1]}_{match[2]}"


def _without_bracket(text: str) -> tuple[str, str]:
    per = re.fullmatch(r"(.+?)[_ ](m?rad|deg|degrees|°|[cmuµ]?m)(?:/|[_ ](?:per[_ ])?)s(?:ec)?(\^?2)?", text)
    if per is not None:
        return per[1], f"{per[2]}/s{'^2' if per[3] else ''}"
    for pattern in (r"(.+?)\s*/\s*(\S+)", r"(.+) in (\S+)", r"(.+)[_ ](\S+)"):
        match = re.fullmatch(pattern, text)
        if match is not None and (plain_unit(match[2]) in _KNOWN or is_known_unit(match[2])):
            return match[1], plain_unit(match[2])
    # `Volt`, `deg`: the whole name is a unit.
    return text, plain_unit(text) if plain_unit(text) in _NAMING_UNITS else ""


# `V1`, `A0`: a channel in volts, or an analogue input, not a rate or acceleration.
_NUMBERED_CHANNEL = re.compile(r"[va][ _]?\d+")


def names_quantity(base: str) -> str:
    """Return the quantity that a name usually means (`angle`, `rate`, ...), or nothing.

    Parameters
    ----------
    base : str
        Name from `split_header`. An axis at its end is ignored: `gyroscope y`.
    """
    base = _without_accents(base)
    if _NUMBERED_CHANNEL.fullmatch(base):
        return "displacement"
    first = base.split(" ")[0]
    for text in (base, re.sub(r"[ _]?(?:[xyz]|\d+|left|right)$", "", base), first if len(first) > 2 else ""):
        for quantity, names in LAB_WORDS["quantities"].items():
            if text in names:
                return quantity
    # `p1 x`: a coordinate.
    return "displacement" if re.search(r"\w [xyz]$", base) else ""


def is_time(base: str, unit: str) -> bool:
    """Return true if a header is that of a time column."""
    base = _without_accents(base)
    named = {re.sub(r"\s*\d+$", "", base), base} & set(LAB_WORDS["time"])
    return bool(named) or (unit in TIME_UNITS and (base.startswith("time") or plain_unit(base) == unit))


def _without_accents(text: str) -> str:
    """Return letters without their accents: `angulo` for `ángulo`."""
    parted = unicodedata.normalize("NFD", text)
    return "".join(letter for letter in parted if not unicodedata.combining(letter))


_VALUE = r"(?P<value>\d[\d.]*(?:,\d+)?(?:e[+-]?\d+)?)"


def _phrases(kind: str) -> str:
    """Return a pattern of the spellings of some words, the longest first."""
    words = sorted(map(_without_accents, LAB_WORDS[kind]), key=len, reverse=True)
    return "|".join(r"[\s_-]*".join(re.escape(part) for part in word.split()) for word in words)


# `Sampling rate (kHz): 2`, `sample_rate,1000,Hz`, `Abtastrate in Hz 1000`, `sampling_rate_hz: 1000`
_STATED_UNIT = r"(?:(?:\s*in\s|\s*[/_]|\s)?\s*[\[(]?(?P<before>{0})[\])]?(?=[\W_]))?"
_PER_SECOND = r"k?hz|k?sa?/s|scans/s|(?:samples|frames)/s(?:ec)?|k?sps"
_RATES = (
    rf"(?<![^\W_])(?:{_phrases('rates')}|(?<![\w ])(?:{_phrases('bare_rates')}))"
    rf"{_STATED_UNIT.format(_PER_SECOND)}(?:\s+(?:is|was|of|ist|war|von))?\W{{0,4}}{_VALUE}"
    r"\s*(?P<after>k?hz|k?sa?/s|k?sps)?",
    # `1000 Hz sampling rate`
    rf"(?<![\w.,]){_VALUE}\s*(?P<after>k?hz)\s+sampl",
    # `30 fps`, `65 samples/s`
    rf"(?<![\w.,]){_VALUE}\s*(?:(?:k?sa|k?s)/s|k?sps|fps|"
    r"(?:samples?|frames?)\s*(?:/|per)\s*s(?:ec(?:ond)?)?\b)",
)
# `dt = 5 ms`, LabVIEW's `Delta_X`
_STEP = (
    rf"(?<![^\W_])(?:{_phrases('steps')})(?![^\W_])"
    rf"{_STATED_UNIT.format('[mµu]?s(?:ec)?')}\W{{0,4}}{_VALUE}(?:\s*(?P<after>[mµu]?s)\b)?"
)
_DURATION = rf"\b(?:duration|record(?:ing)?[ _]?length|acquisition[ _]?time)\b\W{{0,4}}{_VALUE}\s*(?:s\b|$)"
_UNIT = r"\b(?:y_unit_label|vertical units|units?)\b(?:(?<=vertical units)|\s*[:=\t])(?P<units>.+)"


def noted_rate(notes: Sequence[str], rows: int) -> float | None:
    """Return the sampling rate (Hz) in a note, `fs = 200 Hz`, `30 fps`, `Sampling interval: 5 ms`; or None.

    With a note that states a duration, the rate follows from the number of rows.
    """
    # `dt:` may be alone above its number.
    two_lines = [f"{key} {value}" for key, value in pairwise(notes) if not re.search(r"\d", key)]
    for note in (_without_accents(note) for note in [*notes, *two_lines]):
        for pattern in _RATES:
            if value := _value(match := re.search(pattern, note, re.IGNORECASE)):
                return value * (1e3 if _unit_of(match, "hz").startswith("k") else 1.0)
        if value := _value(match := re.search(_STEP, note, re.IGNORECASE)):
            return 1.0 / (value * TIME_UNITS.get(_unit_of(match, "s"), 1.0))
    for note in notes:
        if duration := _value(re.search(_DURATION, note, re.IGNORECASE)):
            # The duration may end at the last sample.
            return (rows - 1) / duration if (rows - 1) % duration == 0.0 else rows / duration
    return None


def bare_rate(notes: Sequence[str], rows: int) -> float | None:
    """Return the sampling rate (Hz) from a head of bare numbers, `90, 1000, 5.` above 5,000 rows; or None.

    Two of the numbers are the rate and the duration if their product is the number of rows; the larger one is
    the rate.
    """
    for note in notes:
        words = re.split(r"[,;\s]+", note.strip(" ,;\t#%"))
        if len(words) < 2 or not all(
            re.fullmatch(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?", w, re.I) for w in words
        ):
            continue
        for factor, other in combinations(map(float, words), 2):
            if min(factor, other) > 1.0 and round(factor * other) in (rows, rows - 1):
                return max(factor, other)
    return None


def _value(match: "re.Match[str] | None") -> float:
    """Return the positive number that a note states; 0 if it states none."""
    try:
        # `1,000` is a thousand.
        text = re.sub(r"^([1-9]\d{0,2}),000$", r"\g<1>000", match["value"]) if match else "0"
        return max(0.0, float(text.replace(",", ".")))
    except ValueError:
        return 0.0


def _unit_of(match: "re.Match[str] | None", usual: str) -> str:
    """Return the unit after a value, or in brackets before it."""
    units = match.groupdict() if match else {}
    return str(units.get("after") or units.get("before") or usual).lower()


def noted_unit(notes: Sequence[str], place: int | None = None, signals: int = 0) -> str:
    """Return the unit of a signal that comments or texts of a file state, `unit: rad`; empty if none does.

    Parameters
    ----------
    notes : sequence of str
    place : int, optional
        Index of the signal among the columns that are not times.
    signals : int
        Number of these columns: in a list of this many units, the unit at this index is used.
    """
    for units in _noted_units(notes):
        of_signals = [unit for unit in units if plain_unit(unit) not in TIME_UNITS]
        if of_signals:
            in_order = place is not None and len(of_signals) == signals
            return of_signals[place if in_order and place is not None else 0]
    return ""


def noted_time_unit(notes: Sequence[str]) -> str:
    """Return the unit of the times that a list of units states, `units = ms, mm`; empty if none does."""
    times = (unit for units in _noted_units(notes) for unit in map(plain_unit, units) if unit in TIME_UNITS)
    return next(times, "")


def _noted_units(notes: Sequence[str]) -> Iterator[list[str]]:
    """Yield the units that each note states."""
    for match in filter(None, (re.search(_UNIT, note, re.IGNORECASE) for note in notes)):
        cells = match["units"].strip().split("\t")
        # `Unit` may be one of several names.
        if len(cells) > 1 and not any(map(is_known_unit, cells)):
            continue
        items = (item.strip(" '\"[](){}") for item in re.split(r"[,;\t]", match["units"]))
        # `rad, as calibrated`
        yield [item if is_known_unit(item) else item.split()[0] for item in items if item]


_LEVEL = re.compile(
    r"(?<![^\W\d_])(?:db(?:[ -]?(?:[aczvumig]|fs|spl)(?![^\W_]))?(?![^\W_])|decibels?\b)", re.IGNORECASE
)


def is_level(text: str) -> bool:
    """Return true if a unit or name is that of a level, `dB`, `dB(A)`, `SPL_dB`: a log amplitude."""
    return _LEVEL.search(text) is not None or text.strip().lower() in LAB_WORDS["levels"]
