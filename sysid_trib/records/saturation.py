"""Saturation of a sensor: a driven signal that stays at its extreme value, and arrives there at speed."""

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError

# Number of equal samples at an extreme value that count as a stay.
FEWEST_EQUAL = 4
# Number of steps on each side of a stay that must all exceed this fraction of the signal's RMS step: a body
# that reverses or comes to rest is slower, and the steps of a coarse sensor are uneven.
FEWEST_FAST, FAST_PART = 4, 0.5


def refuse_saturated(time: Array, values: Array, name: str, unit: str) -> None:
    """Raise an error for a signal that is clipped at the end of the sensor's range.

    Parameters
    ----------
    time, values : (sample,) array of float
        Times (s) and measured values.
    name, unit : str
        Name and unit of the signal, for the message.

    Raises
    ------
    DecayError
        The signal stays at its largest or smallest value, and moves fast before and after.
    """
    for side in (-1.0, 1.0):
        stays = _stays(side * values)
        if stays:
            first = stays[0]
            limit = f"{values[first.start]:.6g} {unit}".strip()
            times = f"{time[first.start]:.4g} to {time[first.stop - 1]:.4g} s"
            more = f" and {len(stays) - 1} more" if len(stays) > 1 else ""
            raise DecayError(
                f"The sensor saturates: the {name} is cut off at {limit} ({times}{more}); record with a "
                "wider range, or take a part without it (--window)."
            )


def _stays(values: Array) -> list[slice]:
    """Return the stays at the largest value that start and end at speed."""
    at_limit = np.concatenate([[False], values == values.max(), [False]])
    edges = np.flatnonzero(np.diff(at_limit.astype(int)))
    stays = [slice(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    steps = np.abs(np.diff(values))
    fast = FAST_PART * float(np.sqrt(np.mean(steps**2)))

    def is_cut(stay: slice) -> bool:
        """Return true if the signal arrives and leaves faster than one that reverses."""
        # The steps next to a stay are truncated.
        before = steps[max(0, stay.start - 1 - FEWEST_FAST) : max(0, stay.start - 1)]
        after = steps[stay.stop : stay.stop + FEWEST_FAST]
        around = np.append(before, after)
        is_long = stay.stop - stay.start >= FEWEST_EQUAL and len(around) == 2 * FEWEST_FAST
        return is_long and bool(np.min(around) > fast)

    return [stay for stay in stays if is_cut(stay)]
