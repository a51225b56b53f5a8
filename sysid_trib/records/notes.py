"""What comments, lines above the numbers, texts and scalars of a file state: a sampling rate, a unit."""

import re
from collections.abc import Sequence

from sysid_trib.records.units import TIME_UNITS

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


def noted_duration(notes: Sequence[str]) -> float | None:
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
