"""Tables of units: how laboratories spell them, and their sizes."""

import tomllib
from pathlib import Path

import numpy as np

STANDARD_GRAVITY = 9.80665
# Laboratory words: names of columns, spellings of units, and marks of missing values.
LAB_WORDS = tomllib.loads(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"))


def by_spelling(kind: str) -> dict[str, str]:
    """Return the name in results for each spelling of a kind of unit."""
    return {spelling: name for name, spellings in LAB_WORDS[kind].items() for spelling in spellings}


ANGLE_UNITS = by_spelling("angles")
POSITION_UNITS = by_spelling("positions")
_TURN = 2.0 * np.pi
_PER_TURN = {"rev": 1.0, "deg": 360.0, "gon": 400.0, "arcmin": 21600.0, "arcsec": 1296000.0}
RADIANS = {"rad": 1.0, "mrad": 1e-3, "µrad": 1e-6}
RADIANS |= {name: _TURN / count for name, count in _PER_TURN.items()}
METRES = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "µm": 1e-6, "nm": 1e-9, "in": 0.0254}
# An accelerometer on a pendulum does not measure a derivative of the angle.
ACCELEROMETER = "accelerometer"
