"""Axes of one sensor: one motion seen along several of them, and its magnitude."""

import re

import numpy as np

from sysid_trib.arrays import Array

# Correlation of axes that see one motion, noise included.
IN_PHASE = 0.8
# Of its range: a magnitude comes back to zero as near as this in every swing.
NEAR_ZERO = 0.05
_AXIS = re.compile(r"^[xyz](?=[ _-])|(?<![^\W\d_]{2})[xyz]$|(?<=[ _-])[xyz]$|(?<=acc)[xyz]$|(?<=gyro)[xyz]$")


def are_axes(first: str, second: str) -> bool:
    """Whether two names differ by their axis alone: `gyroscope x` and `gyroscope y`, `ax` and `az`."""
    plain = [_AXIS.sub("", name) for name in (first, second)]
    return first != second and plain[0] == plain[1] and first not in plain and second not in plain


def in_phase(first: Array, second: Array) -> bool:
    """Whether two columns are one motion, of either sign, but for their noise."""
    if first.size != second.size:
        return False
    good = np.isfinite(first) & np.isfinite(second)
    x, y = first[good], second[good]
    return bool(x.size > 1 and np.ptp(x) and np.ptp(y) and abs(np.corrcoef(x, y)[0, 1]) > IN_PHASE)


def is_magnitude(values: Array) -> bool:
    """Whether a column is never negative but near zero to the end: a magnitude, not a signal with a sign."""
    good = values[np.isfinite(values)]
    if good.size < 2 or good.min() < 0.0:
        return False
    parts = [part for part in np.array_split(good, 4) if part.size]
    allowed = NEAR_ZERO * max(float(part.max()) for part in parts)
    return all(part.min() < allowed for part in parts)
