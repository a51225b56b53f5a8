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
LEAST_RELATIVE_NOISE = 1e-10
# Damping moves the frequency of a free decay, and whole periods the damping ratio, in second order: by up to
# so many times its square, in parts. Averages leave it open.
SECOND_ORDER = {"damping_ratio": 2.0, "frequency": 1.0}


@dataclass(frozen=True)
class PeriodRows:
    """A row for every half period but the first and last: the period about it.

    Attributes
    ----------
    log_amplitude : (row,) array of float
        Of the geometric mean of the extrema at its ends.
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
    """Rows of an envelope, of which whole periods leave out what differs between the two sides.

    Parameters
    ----------
    measured : Dataset
        Of `envelope`; four half periods at least.
    slopes : mapping of str to (row,) array, optional
        Derivatives of both curves by the log amplitude: an amplitude that is off moves a row along its curve.
    """
    b, t = measured.extremum.values, measured.extremum_time.values
    count = len(b)
    rows = count - 2
    kept = slice(1, -1) if count >= FEWEST_WITHOUT_ENDS else slice(None)
    fall = sp.eye(rows, count, format="csr") - sp.eye(rows, count, k=2, format="csr")
    middle = 0.5 * (sp.eye(rows, count, format="csr") + sp.eye(rows, count, k=2, format="csr"))
    # What a kick before an extremum adds to it and to all later ones, it takes from the fall across it.
    later = -(sp.eye(rows, count, k=1, format="csr") + sp.eye(rows, count, k=2, format="csr"))
    log_b = np.log(b)
    damping, frequency = fall @ log_b / WHOLE_TURN, -WHOLE_TURN / (fall @ t)
    # The scatter of extrema is what is sought here; their errors are those of the samples alone.
    relative = _errors(measured, "extremum", "scatter_of_extrema") / b
    late = _errors(measured, "extremum_time", "scatter_of_times")
    lasting, passing = half_period_responses(measured)
    per_time = frequency**2 / WHOLE_TURN
    to_row = {
        "damping_ratio": (sp.diags(1.0 / np.full(rows, WHOLE_TURN)), sp.diags(1.0 / b), slice(0, count)),
        "frequency": (sp.diags(per_time), sp.eye(count), slice(count, 2 * count)),
    }
    noise = {"damping_ratio": b * relative, "frequency": late}
    open_part = {"damping_ratio": damping, "frequency": frequency}
    sensor, walk = {}, {}
    for name, (scale, per_unit, part) in to_row.items():
        of_rows = scale @ fall @ per_unit @ sp.diags(noise[name])
        along = sp.csr_matrix((rows, count))
        if slopes is not None:
            along = -sp.diags(_at_all(slopes[name], rows)) @ middle @ sp.diags(relative)
        both = of_rows + along if name == "damping_ratio" else sp.hstack([of_rows, along])
        second = SECOND_ORDER[name] * damping**2 * open_part[name]
        sensor[name] = sp.hstack([both, sp.diags(second)]).tocsr()[kept]
        walk[name] = (scale @ (fall @ per_unit @ passing[part] + later @ per_unit @ lasting[part])).tocsr()[
            kept
        ]
    log_amplitude = (middle @ log_b)[kept]
    return PeriodRows(log_amplitude, damping[kept], frequency[kept], sensor, walk)


def _errors(measured: xr.Dataset, name: str, scatter: str) -> Array:
    """Standard errors by the white noise of the samples, not below rounding."""
    error = measured[f"{name}_standard_error"].values / measured.attrs.get(scatter, 1.0)
    b = measured.extremum.values
    size = b if name == "extremum" else 1.0 / measured.frequency.values.max()
    return np.asarray(np.maximum(error, LEAST_RELATIVE_NOISE * size))


def _at_all(slopes: Array, rows: int) -> Array:
    """Slopes of the rows that are kept, of the others as well."""
    return slopes if len(slopes) == rows else np.pad(slopes, 1, mode="edge")
