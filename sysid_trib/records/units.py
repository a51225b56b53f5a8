"""Units as laboratories write them: which quantity a signal is, and its factor to the unit that is used."""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

STANDARD_GRAVITY = 9.80665
# How laboratories call columns, spell units, and write that a value is missing.
LAB_WORDS = tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))


def _by_spelling(kind: str) -> dict[str, str]:
    """The name that results use of each spelling of a kind of unit."""
    return {spelling: name for name, spellings in LAB_WORDS[kind].items() for spelling in spellings}


_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": 86400.0}
TIME_UNITS = {spelling: _SECONDS[name] for spelling, name in _by_spelling("seconds").items()}
ANGLE_UNITS, POSITION_UNITS = _by_spelling("angles"), _by_spelling("positions")
_TURN = 2.0 * np.pi
_PER_TURN = {"rev": 1.0, "deg": 360.0, "gon": 400.0, "arcmin": 21600.0, "arcsec": 1296000.0}
RADIANS = {"rad": 1.0, "mrad": 1e-3, "µrad": 1e-6}
RADIANS |= {name: _TURN / count for name, count in _PER_TURN.items()}
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9, "in": 0.0254}
# How often a signal is to be integrated to become an angle or a displacement.
INTEGRATIONS = {"angle": 0, "displacement": 0, "rate": 1, "acceleration": 2}
# What an accelerometer on a pendulum feels is no derivative of its angle.
ACCELEROMETER = "accelerometer"
SIGNALS = (*INTEGRATIONS, ACCELEROMETER)
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
        By its usual name; one that is not known as the file has it.
    quantity : {"angle", "displacement", "rate", "acceleration"}
        What is measured in it.
    position : str
        Unit of the angle (rad) or displacement that it is, or becomes when it is integrated over s.
    factor : float
        To `position`, `position`/s or `position`/s^2.
    known : bool
        Whether the unit is one of those listed here; another one is that of a displacement.
    """

    text: str
    quantity: str
    position: str
    factor: float
    known: bool = True


def signal_unit(text: str) -> SignalUnit | None:
    """The unit that a text means; None of an empty one.

    Parameters
    ----------
    text : str
        Such as `°/s`, `m s^-2`, `Grad`, `px`, `g`, in any usual spelling.
    """
    plain = plain_unit(text)
    if plain in ("", "1", "none", "-"):
        return None
    if plain in ("g", "g0", "gn", "mg"):
        thousandth = 1e-3 if plain == "mg" else 1.0
        return SignalUnit("mg" if plain == "mg" else "g", "acceleration", "m", thousandth * STANDARD_GRAVITY)
    if plain == "rpm":
        return SignalUnit(plain, "rate", "rad", _TURN / 60.0)
    plain = "deg/s" if plain == "dps" else plain
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


def is_known_unit(text: str) -> bool:
    """True if a text means a unit of a signal that is listed here."""
    unit = signal_unit(text)
    return unit is not None and unit.known


def plain_unit(text: str) -> str:
    """A unit in lower case, with `/s` and `/s^2` for every way to write "per second"."""
    # Patterns take the square of the time for blanks in a row.
    plain = re.sub(r" since .*", "", " ".join(text.lower().split()).replace("μ", "µ"))
    plain = plain.replace("**", "^").translate(_SUPERSCRIPTS)
    plain = re.sub(r"-\^|\^[({]?-|(?<=s)-(?=[12]$)", "^-", plain)
    plain = re.sub(r"\^[({]?(-?)([12])[)}]?", r"^\1\2", plain)
    plain = re.sub(r"\s*(?:/|\bper\b|_per_)\s*(?:sec(?:ond)?s?|s)\b", "/s", plain)
    plain = re.sub(r"/s\s*/s$|/\s*\(?s\s*[*·.]\s*s\)?$", "/s^2", plain)
    plain = re.sub(
        r"^(.+?)[\s_*·.]+s(?:ec)?\s*\^-([12])$|^(m?rad|deg|°|[cmuµ]?m)s\^-([12])$", _per_second, plain
    )
    plain = re.sub(r"^(m?rad|deg|°|[cmuµ]?m)[\s_]s$", r"\1/s", plain)
    return plain.strip().removesuffix("^1")


def _per_second(match: "re.Match[str]") -> str:
    base, power = (text for text in match.groups() if text is not None)
    return f"{base}/s" + ("^2" if power == "2" else "")
