"""Displacement from a rate or an acceleration, without the drift that a sensor's bias becomes."""

import numpy as np
import scipy.sparse as sp
from scipy.interpolate import BSpline, CubicSpline, make_interp_spline

from sysid_trib.arrays import Array

# Knots of drift and envelope are so many periods apart: slower than the swing, faster than a bias wanders.
DRIFT_PERIODS_PER_KNOT = 2.0
DRIFT_DEGREE = 3


def integrated(time: Array, signal: Array, period: float) -> Array:
    """Integral of an oscillation over time, about its slow mean.

    Parameters
    ----------
    time : (sample,) array of float, s
        Rising.
    signal : (sample,) array of float
    period : float, s
        Of the oscillation.

    Returns
    -------
    (sample,) array of float
        In the signal's unit times s.

    Notes
    -----
    The antiderivative of the quintic spline through the samples, less its drift: the slow part of the least
    squares fit of splines (knots two periods apart) times 1, cos and sin. Without the waves the ends of the
    swing would pass for drift.
    """
    spline = (
        make_interp_spline(time, signal - np.median(signal), 5)
        if time.size > 6
        else CubicSpline(time, signal)
    )
    whole = np.asarray(spline.antiderivative()(time), dtype=float)
    return whole - _drift(time, whole, period)


def _drift(time: Array, signal: Array, period: float) -> Array:
    spans = max(1, int((time[-1] - time[0]) / (DRIFT_PERIODS_PER_KNOT * period)))
    knots = np.linspace(time[0], time[-1], spans + 1)
    padded = np.concatenate((np.full(DRIFT_DEGREE, knots[0]), knots, np.full(DRIFT_DEGREE, knots[-1])))
    slow = BSpline.design_matrix(time, padded, DRIFT_DEGREE).tocsr()
    phase = 2.0 * np.pi * (time - time[0]) / period
    design = sp.hstack([slow, *(sp.diags_array(wave(phase)) @ slow for wave in (np.cos, np.sin))]).tocsr()
    # Normal equations: a few hundred unknowns of many thousand samples.
    normal = (design.T @ design).toarray()
    solution = np.linalg.lstsq(normal, design.T @ signal, rcond=1e-12)[0]
    return np.asarray(slow @ solution[: slow.shape[1]])
