"""The least-squares spline through a record: motion and its derivatives, and the noise beside it."""

from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_lsq_spline

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError

SPLINE_DEGREE = 5
KNOTS_PER_PERIOD = 12
# Fewer samples than this between knots and the splines would follow the noise.
SAMPLES_PER_KNOT = 2


class SmoothedMotion(NamedTuple):
    """A smoothed record.

    Attributes
    ----------
    x, v, acceleration : (sample,) or (sample, record) array of float, rad
        The angle and its first and second derivatives by tau.
    noise : float, rad
        Standard deviation of a sample about the spline.
    """

    x: Array
    v: Array
    acceleration: Array
    noise: float


def knot_intervals(tau: Array, fewest: float = SAMPLES_PER_KNOT) -> int:
    """Intervals of a twelfth of a period (2 pi in tau), of whole samples if possible, of so many at least."""
    step = (tau[-1] - tau[0]) / (len(tau) - 1)
    per_knot = max(fewest, 2.0 * np.pi / KNOTS_PER_PERIOD / step)
    per_knot = round(per_knot) if per_knot >= SAMPLES_PER_KNOT else per_knot
    return max(1, round((len(tau) - 1) / per_knot))


def knot_sequence(tau: Array, intervals: int | None = None) -> Array:
    """Clamped uniform knots, as many intervals as are given, else `knot_intervals`."""
    return clamped_knots(tau, intervals or knot_intervals(tau), SPLINE_DEGREE)


def clamped_knots(tau: Array, intervals: int, degree: int) -> Array:
    """Uniform knots between the first and the last sample, so many intervals, of splines of a degree."""
    inner = np.linspace(tau[0], tau[-1], max(1, intervals) + 1)
    return np.concatenate([np.full(degree, tau[0]), inner, np.full(degree, tau[-1])])


def smooth(tau: Array, angle: Array) -> SmoothedMotion:
    """Smooth one or several records by the least-squares spline on `knot_sequence`.

    Parameters
    ----------
    tau : (sample,) array of float
        Time times the frequency of the motion, increasing.
    angle : (sample,) or (sample, record) array of float, rad

    Returns
    -------
    SmoothedMotion

    Raises
    ------
    DecayError
        The samples do not determine the spline: too few, or with gaps.
    """
    knots = knot_sequence(tau)
    try:
        # The normal equations of B-splines are well conditioned, and banded.
        spline = make_lsq_spline(tau, angle, knots, k=SPLINE_DEGREE, check_finite=False, method="norm-eq")
    except ValueError:
        raise DecayError(
            "The samples of this record do not determine a spline; check its sampling."
        ) from None
    x, v, acceleration = (spline(tau, order) for order in range(3))
    degrees_of_freedom = max(1, len(tau) - len(spline.c))
    return SmoothedMotion(x, v, acceleration, float(np.sqrt(np.sum((angle - x) ** 2) / degrees_of_freedom)))
