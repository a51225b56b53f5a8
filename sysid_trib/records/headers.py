"""Headers of columns: a name and a unit."""

import re
import unicodedata

from sysid_trib.records.units import ANGLE_UNITS, POSITION_UNITS, TIME_UNITS, plain_unit, signal_unit

# Names without accents, in lower case.
TIME_NAMES = {
    *("time", "t", "times", "timestamp", "time stamp", "seconds", "elapsed", "elapsed time", "zeit", "temps"),
    *(
        "tempo",
        "tiempo",
        "uhrzeit",
        "date time",
        "datetime",
        "clock",
        "czas",
        "millis",
        "micros",
        "tijd",
        "tid",
    ),
    *("hora", "heure", "ts", "x value", "sekunden", "время", "时间", "時間"),
}
# Columns that count rows: no clock has a step of 1 by itself.
COUNTER_NAMES = {
    *(
        "frame",
        "frames",
        "frame number",
        "frame no",
        "frame no.",
        "index",
        "sample",
        "samples",
        "sample number",
    ),
    *("n", "no", "no.", "nr", "nr.", "number", "row", "image", "bild", "id", "unnamed: 0", "#", "#0"),
}
ANGLE_NAMES = {
    *("angle", "theta", "phi", "θ", "φ", "ϕ", "ϑ", "roll", "angular position", "rotation", "winkel", "ang"),
    *("angular displacement", "auslenkwinkel", "angulo", "roll angle", "swing angle", "angolo", "hoek"),
    *("угол", "角度", "vinkel", "kat", "alpha", "beta", "α", "β", "drehwinkel"),
}
RATE_NAMES = {
    *("rate", "angular rate", "angular velocity", "omega", "ω", "gyro", "gyroscope", "theta dot", "thetadot"),
    *(
        "velocity",
        "speed",
        "wx",
        "wy",
        "wz",
        "winkelgeschwindigkeit",
        "geschwindigkeit",
        "v",
        "vx",
        "vy",
        "gx",
        "gy",
        "gz",
    ),
}
POSITION_NAMES = {
    *("x", "y", "z", "displacement", "position", "deflection", "elongation", "pos", "weg", "auslenkung"),
    *("distance", "height", "laser", "u", "voltage", "signal", "potential", "pot", "potentiometer", "adc"),
    *("counts", "count", "encoder", "ticks", "raw", "probe", "channel", "ch"),
}
ACCELERATION_NAMES = {
    *("acceleration", "accel", "acc", "linear acceleration", "accelerometer", "beschleunigung", "a"),
    *("ax", "ay", "az"),
}
QUANTITY_NAMES = {
    "angle": ANGLE_NAMES,
    "rate": RATE_NAMES,
    "displacement": POSITION_NAMES,
    "acceleration": ACCELERATION_NAMES,
}
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
        if match is not None and _is_unit(match[2]):
            return match[1], plain_unit(match[2])
    # `Volt`, `deg`: a unit is all the name there is.
    return text, plain_unit(text) if plain_unit(text) in _NAMING_UNITS else ""


def _is_unit(text: str) -> bool:
    unit = signal_unit(text)
    return plain_unit(text) in _KNOWN or (unit is not None and unit.known)


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
        for quantity, names in QUANTITY_NAMES.items():
            if text in names:
                return quantity
    # `p1 x`: a coordinate of anything.
    return "displacement" if re.search(r"\w [xyz]$", base) else ""


def is_time(base: str, unit: str) -> bool:
    """Whether a header is that of a time column."""
    base = _without_accents(base)
    plain = re.sub(r"\s*\d+$", "", base)
    return plain in TIME_NAMES or base in TIME_NAMES or (unit in TIME_UNITS and base.startswith("time"))


def counts_rows(base: str) -> bool:
    """Whether a header is that of a number of the row, such as `frame`."""
    return base in COUNTER_NAMES


def _without_accents(text: str) -> str:
    """Letters without their accents: `angulo` for `ángulo`."""
    parted = unicodedata.normalize("NFD", text)
    return "".join(letter for letter in parted if not unicodedata.combining(letter))


def as_written(name: str, unit: str) -> str:
    """The unit of a header with the capitals that the header has: `mT`, where `split_header` says `mt`."""
    at = name.lower().rfind(unit)
    return name[at : at + len(unit)] if unit and at >= 0 else unit
