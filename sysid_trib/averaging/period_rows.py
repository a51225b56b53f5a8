"""Damping ratio and frequency of each whole period: rows of two curves of the amplitude, with their noise."""

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.decays.kick_response import half_period_responses

WHOLE_TURN = 2.0 * np.pi
# The first and last half-sine take their frequency from their neighbours: left out where there are so many.
FEWEST_WITHOUT_ENDS = 9
# A period from extremum to extremum, on the mean of both sides: where the zero wanders, one falls more and
# the other less. Few half periods leave one side.
BOTH_SIDES, ONE_SIDE = (0.5, 0.5, -0.5, -0.5), (1.0, 0.0, -1.0)
LEAST_RELATIVE_NOISE = 1e-10
# Damping moves the frequency of a free decay, and whole periods the damping ratio, in second order: by up to
# so many times its square, in parts. Averages leave it open.
SECOND_ORDER = {"damping_ratio": 2.0, "frequency": 1.0}


@dataclass(frozen=True)
class PeriodRows:
    """Periods, one after the other by half a period.

    Attributes
    ----------
    log_amplitude : (row,) array of float
        Of the geometric mean of the extrema at their ends.
    damping_ratio, frequency : (row,) array of float
        Logarithmic decrement over 2 pi; rad/s.
    sensor, walk : mapping of str to sparse array (row, draw)
        How unit draws of the sensor's noise, and of a random force, move each.
    """

    log_amplitude: Array
    damping_ratio: Array
    frequency: Array
    sensor: dict[str, sp.csr_matrix]
    walk: dict[str, sp.csr_matrix]


def period_rows(measured: xr.Dataset, slopes: dict[str, Array] | None = None) -> PeriodRows:
    """Rows of an envelope, a half period apart, without what differs between the two sides.

    Parameters
    ----------
    measured : Dataset
        Of `envelope`; four half periods at least.
    slopes : mapping of str to (row,) array, optional
        Derivatives of both curves by the log amplitude: an amplitude that is off moves a row along its curve.
    """
    b, t = measured.extremum.values, measured.extremum_time.values
    ends = 1 if len(b) >= FEWEST_WITHOUT_ENDS else 0
    change = np.array(BOTH_SIDES if ends else ONE_SIDE)
    fall, middle, later = (
        _sliding(weights, len(b), ends)
        # A kick before an extremum moves it and all later ones.
        for weights in (change, np.abs(change) / 2.0, np.append(0.0, np.cumsum(change[::-1])[-2::-1]))
    )
    damping, frequency = fall @ np.log(b) / WHOLE_TURN, -WHOLE_TURN / (fall @ t)
    # How much extrema scatter is sought here: their errors are those of the samples' white noise alone.
    relative = _errors(measured, "extremum", "scatter_of_extrema") / b
    late = _errors(measured, "extremum_time", "scatter_of_times")
    lasting, passing = half_period_responses(measured)
    per_turn, per_time = np.full(len(damping), 1.0 / WHOLE_TURN), frequency**2 / WHOLE_TURN
    sensor, walk = {}, {}
    for name, value, scale, by, error, part in (
        ("damping_ratio", damping, per_turn, 1.0 / b, relative * b, slice(0, len(b))),
        ("frequency", frequency, per_time, np.ones_like(b), late, slice(len(b), 2 * len(b))),
    ):
        of_rows = sp.diags(scale) @ fall @ sp.diags(by * error)
        along = -sp.diags(slopes[name] if slopes else np.zeros_like(value)) @ middle @ sp.diags(relative)
        second = sp.diags(SECOND_ORDER[name] * damping**2 * value)
        noises = [of_rows + along, second] if name == "damping_ratio" else [of_rows, along, second]
        sensor[name] = sp.hstack(noises, format="csr")
        walk[name] = sp.diags(scale) @ (
            fall @ sp.diags(by) @ passing[part] + later @ sp.diags(by) @ lasting[part]
        )
    return PeriodRows(middle @ np.log(b), damping, frequency, sensor, walk)


def _sliding(weights: Array, count: int, ends: int) -> sp.csr_matrix:
    """Sums of neighbouring extrema with the given weights, (row, extremum), without so many at either end."""
    rows = count - len(weights) + 1 - 2 * ends
    return sum(w * sp.eye(rows, count, k=ends + at, format="csr") for at, w in enumerate(weights))


def _errors(measured: xr.Dataset, name: str, scatter: str) -> Array:
    """Standard errors by the white noise of the samples, not below rounding."""
    error = measured[f"{name}_standard_error"].values / measured.attrs.get(scatter, 1.0)
    b = measured.extremum.values
    size = b if name == "extremum" else 1.0 / measured.frequency.values.max()
    return np.asarray(np.maximum(error, LEAST_RELATIVE_NOISE * size))
