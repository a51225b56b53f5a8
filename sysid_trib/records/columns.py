"""Which columns of a table hold time and angle, in which units, and their numbers."""

import re
from datetime import datetime

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.tables import FileTable

TIME_NAMES = {"time", "t", "times", "timestamp", "seconds", "elapsed", "elapsed time", "zeit", "temps"}
ANGLE_NAMES = {"angle", "theta", "phi", "θ", "φ", "ϕ", "roll", "angular position", "rotation", "winkel"}
RATE_NAMES = {"rate", "angular rate", "angular velocity", "omega", "ω", "gyro", "theta dot", "thetadot"}
_DEGREE = float(np.pi / 180.0)
TIME_UNITS = {
    **dict.fromkeys(("s", "sec", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "µs", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("ns", "nanosecond", "nanoseconds"), 1e-9),
    **dict.fromkeys(("min", "minute", "minutes"), 60.0),
}
ANGLE_UNITS = {
    **dict.fromkeys(("rad", "radian", "radians"), 1.0),
    **dict.fromkeys(("mrad", "milliradian", "milliradians"), 1e-3),
    **dict.fromkeys(("deg", "degree", "degrees", "°", "dps"), _DEGREE),
}
LENGTH_UNITS = {"m": 1.0, "metre": 1.0, "meter": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6}
# By option: factor to SI of each unit, the unit where none is stated, and those that errors name.
UNITS = {
    "units": (ANGLE_UNITS | LENGTH_UNITS, "rad", "rad, deg, mrad, m or mm"),
    "time_units": (TIME_UNITS, "s", "s, ms, us or min"),
}
_RATE = re.compile(
    r"(?:^|[\s\[({_/])(dps|(?:m?rad(?:ians?)?|deg(?:rees?)?|°|[cmuµ]?m)"
    r"(?:\s*[/*·]\s*|[\s_]+|[\s_]*per[\s_]*)s(?:ec|econds?)?(?:\^?-1|⁻¹)?)\s*[\])}]?$"
)


def choose_columns(
    table: FileTable,
    source: str,
    *,
    time: str | int | None,
    angle: str | int | None,
    signal: str,
    timeless: bool,
) -> tuple[str | None, str]:
    """Names of the time and the angle column: given, recognised, or the first and the second.

    Parameters
    ----------
    table : FileTable
        What the file holds.
    source : str
        Name of the file, for messages.
    time : str or int, optional
        Name or number of the time column.
    angle : str or int, optional
        Name or number of the angle column.
    signal : str
        `angle` or `rate`.
    timeless : bool
        Whether a sampling rate is given: the time column is then only recognised to be ignored.
    """
    names = list(table.columns)
    angle_name = None if angle is None else find_column(table, angle, source)
    time_name = None if time is None else find_column(table, time, source)
    if time_name is None:
        time_name = _usual_time(table, [name for name in names if name != angle_name], timeless)
    if angle_name is None:
        angle_name = _usual_angle([name for name in names if name != time_name], signal, source)
    return None if timeless else time_name, angle_name


def _usual_time(table: FileTable, names: list[str], timeless: bool) -> str | None:
    usual = [name for name in names if split_header(name)[0] in TIME_NAMES]
    if usual:
        return usual[0]
    if len(table.columns) == 1:
        return None
    first = np.asarray(table.columns[names[0]])
    # An angle that swings cannot rise throughout: such a column is the time that a sampling rate replaces.
    rises = first.dtype.kind in "fiu" and bool(np.all(np.diff(first.astype(float)) >= 0))
    return names[0] if rises or not timeless else None


def _usual_angle(names: list[str], signal: str, source: str) -> str:
    if not names:
        raise RecordError(f"{source}: there is no column for the {signal} beside the time.")
    usual = RATE_NAMES if signal == "rate" else ANGLE_NAMES
    named = [name for name in names if split_header(name)[0] in usual]
    exact = [name for name in named if split_header(name)[0] == signal]
    if len(named) > 1 and len(exact) != 1:
        raise UsageError(
            f"{source}: columns {' and '.join(named)} could each be the {signal}; "
            "name one, --angle NAME (angle= in Python)."
        )
    return (exact or named or names)[0]


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
    if str(wanted).isdigit() and int(wanted) < len(names):
        return names[int(wanted)]
    listed = ", ".join(f"{number}: {name}" for number, name in enumerate(names[:12])) + (
        ", ..." if len(names) > 12 else ""
    )
    raise UsageError(f"{source}: there is no single column {str(wanted)!r}; its columns are {listed}.")


def split_header(name: str) -> tuple[str, str]:
    """Base name and unit of a header such as `angle (deg)`, `Time [ms]`, `t / s` or `time_ms`.

    Both in lower case; "per second" of a rate is taken off its unit.
    """
    text = name.strip().lower().replace("μ", "µ")
    text = re.sub(r"(rad|deg|degrees|°)(/|[_ ](per[_ ])?)s(ec)?$", r"\1", text)
    match = re.fullmatch(r"(.*?)\s*[\[({]\s*([^\[\](){}]*?)\s*[\])}]", text)
    bracket = match is not None and not match[2].isdigit()
    if not bracket:
        match = re.fullmatch(r"(.+?)\s*/\s*(\S+)", text) or re.fullmatch(r"(.+)[_ ](\S+)", text)
    base, unit = (match[1], plain_unit(match[2])) if match else (text, "")
    if not bracket and unit not in (TIME_UNITS | ANGLE_UNITS | LENGTH_UNITS):
        base, unit = text, ""
    base = re.split(r"[./](?=\D)", base)[-1]
    return base.replace("_", " ").strip(), unit


def plain_unit(unit: str) -> str:
    """Unit in lower case, without "per second" and without an epoch."""
    unit = re.sub(r" since .*", "", unit.strip().lower().replace("μ", "µ"))
    return re.sub(r"\s*(?:/|_|per|\*|·|\s)\s*(?:s|sec|seconds?)(?:\^?-1|⁻¹)?$", "", unit)


def refuse_rate(table: FileTable, name: str, source: str) -> None:
    """Refuse a column in a unit per second where an angle or a position is wanted."""
    for text in (table.units.get(name, ""), name):
        match = _RATE.search(text.strip().lower().replace("μ", "µ"))
        if match:
            raise UsageError(
                f"{source}: the header of column {name} says {match[1]}: a rate; "
                "use --signal rate (signal= in Python)."
            )


def si_numbers(
    table: FileTable, name: str, source: str, *, option: str, wanted: str | None
) -> tuple[Array, str]:
    """The finite numbers of a column in SI units, and the unit that they have in the file.

    The unit is as the option says, as the file says, or the default. Dates become seconds since the first.

    Parameters
    ----------
    table : FileTable
        What the file holds.
    name : str
        Name of the column.
    source : str
        Name of the file, for messages.
    option : {"units", "time_units"}
        Name of the option that gives the unit, in Python.
    wanted : str, optional
        The unit that it gives.

    Raises
    ------
    UsageError
        The option contradicts the header.
    RecordError
        The unit is unknown. Text, a missing or an infinite value; the message says in which row (from 1,
        below the header).
    """
    known, default, offered = UNITS[option]
    flag = f"--{option.replace('_', '-')}"
    dated = np.asarray(table.columns[name]).dtype.kind == "M"
    stated = plain_unit(table.units.get(name, "")) or split_header(name)[1]
    if wanted and stated in known and not dated and not _same(stated, wanted, known):
        raise UsageError(
            f"{source}: the header of column {name} says {stated}, but {flag} says {wanted} ({option}= in "
            "Python); leave the option out or correct the header."
        )
    unit = wanted or stated
    if unit in ("", "1", "none", "-") or (not wanted and dated):
        unit = default
    if unit not in known:
        raise RecordError(
            f"{source}: the unit {unit!r} of column {name} is unknown; give {flag} ({option}= in Python): "
            f"{offered}."
        )
    return _numbers(table, name, source) * known[unit], unit


def _same(first: str, other: str, known: dict[str, float]) -> bool:
    return known[first] == known[other] and (first in LENGTH_UNITS) == (other in LENGTH_UNITS)


def _numbers(table: FileTable, name: str, source: str) -> Array:
    values = np.asarray(table.columns[name])
    if values.dtype == object and all(isinstance(value, datetime) for value in values):
        values = values.astype("datetime64[us]")
    if values.dtype.kind == "M":
        return np.asarray((values - values[0]) / np.timedelta64(1, "ns"), dtype=float) * 1e-9
    if values.dtype.kind not in "fiu":
        values = np.array([_number(value, name, row, source) for row, value in enumerate(values, 1)])
    values = values.astype(np.float64)
    bad = np.flatnonzero(~np.isfinite(values))
    if bad.size:
        text = "infinite" if np.isinf(values[bad[0]]) else "missing or not a number"
        raise RecordError(
            f"{source}: row {bad[0] + 1} of column {name} is {text} ({bad.size} such rows); "
            "cut them out, or keep the part between them."
        )
    return values


def _number(value: object, name: str, row: int, source: str) -> float:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        raise RecordError(
            f"{source}: row {row} of column {name} holds {str(value)[:30]!r}, not a number; "
            "correct it or cut it out."
        ) from None
