"""How much of what moves a record about its path is a random force."""

from collections.abc import Callable

import numpy as np

from sysid_trib.errors import DecayError
from sysid_trib.noise.variance_ratio import VarianceRatio, WhiteRows, ratio_span, variance_ratio
from sysid_trib.state_space.kalman import LinearModel


def likely_ratio(
    linear: LinearModel, rows: Callable[[float], WhiteRows] | None = None, start: float | None = None
) -> VarianceRatio:
    """The ratio per_tau / variance of most restricted likelihood.

    Parameters
    ----------
    linear : LinearModel
    rows : callable, optional
        White rows of a ratio, in the place of the model's with all its columns.
    start : float, optional
        Where the ratio was last.

    Raises
    ------
    DecayError
        Friction holds the body all the time.
    """
    kicks = linear.steps.diffusion[:, 1, 1]
    # A body that friction holds is not pushed.
    kicks = kicks[kicks > 0.0]
    if not len(kicks):
        raise DecayError("Friction of this size holds the body all the time; take random_force='off'.")
    low, high = ratio_span(float(np.sum(kicks)), float(np.median(kicks)))
    return variance_ratio(linear.rows if rows is None else rows, low, high, start)
