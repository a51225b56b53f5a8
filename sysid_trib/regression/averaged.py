"""The averaged equations of one decay: amplitude rate and frequency of each instant, by the signatures."""

from functools import lru_cache

import numpy as np
import scipy.sparse as sp
import xarray as xr
from scipy.interpolate import CubicSpline

from sysid_trib.arrays import Array
from sysid_trib.averaging.signatures import averages
from sysid_trib.decays.half_sines import instant_derivatives
from sysid_trib.forces.force import Force, ForceLibrary, ShapeValues

# A cubic spline through these is exact to 1e-10 rad, at a kink (Jenkins) to 1e-5.
NODES_PER_OCTAVE = 64


def averaged_equations(
    measured: xr.Dataset, library: ForceLibrary, shapes: ShapeValues
) -> tuple[Array, Array]:
    """The averaged equations of an envelope.

    Parameters
    ----------
    measured : Dataset
        The envelope (see `envelope`), with `first_time` (s) in its attrs.
    library : ForceLibrary
    shapes : mapping of str to float

    Returns
    -------
    design : (2 instants, force + 1) array of float
        Against w c of each force, and w; amplitude rate and frequency of each instant, in turn.
    target : (2 instants,) array of float
    """
    a, w = measured.amplitude.values, measured.frequency.values
    design = np.zeros((len(a), 2, len(library) + 1))
    design[:, :, :-1] = _signature_columns(measured, library, shapes, a)
    design[:, 1, -1] = 1.0
    target = np.stack([measured.amplitude_rate.values, w], axis=1)
    return design.reshape(-1, len(library) + 1), target.reshape(-1)


def _signature_columns(
    measured: xr.Dataset, library: ForceLibrary, shapes: ShapeValues, amplitude: Array
) -> Array:
    """L and M: <h sin phi> and <h cos phi>/a, (instant, 2, force)."""
    t = measured.instant_time.values - measured.attrs["first_time"]
    columns = np.zeros((len(amplitude), 2, len(library)))
    low, high = np.floor(np.log2(amplitude.min())), np.ceil(np.log2(amplitude.max()))
    for j, force in enumerate(library):
        if force.degree is not None or force.holds_time:
            sine, cosine = averages(force, amplitude, shapes, t)
        else:
            held = tuple(force.shape_values(shapes).items())
            sine, cosine = _table(force, held, float(low), float(high))(np.log2(amplitude)).T
        columns[:, 0, j], columns[:, 1, j] = sine, cosine / amplitude
    return columns


@lru_cache(maxsize=64)
def _table(force: Force, held: tuple[tuple[str, float], ...], low: float, high: float) -> CubicSpline:
    """Signature against log2 of the amplitude: a history-dependent force takes a millisecond an amplitude."""
    nodes = np.linspace(low, high, max(2, round(NODES_PER_OCTAVE * (high - low))) + 1)
    shapes = {f"{force.symbol}.{name}": value for name, value in held}
    return CubicSpline(nodes, np.stack(averages(force, 2.0**nodes, shapes), axis=1))


def slopes_of_equations(
    measured: xr.Dataset, library: ForceLibrary, shapes: ShapeValues, coefficients: Array
) -> sp.csr_matrix:
    """Derivatives of the averaged equations by the extrema and their times.

    Parameters
    ----------
    measured : Dataset
        The envelope.
    library : ForceLibrary
    shapes : mapping of str to float
    coefficients : (force,) array of float, rad/s
        w c of each force.

    Returns
    -------
    (2 instants, 2 half periods) sparse array of float
        By the extrema, then by their times.
    """
    slope = instant_derivatives(measured)
    a = measured.amplitude.values
    step = 1e-4 * a
    near = [_signature_columns(measured, library, shapes, a + s * step) @ coefficients for s in (-1.0, 1.0)]
    slope_by_amplitude = (near[1] - near[0]) / (2.0 * step)[:, None]
    by_amplitude = slope_by_amplitude[:, :, None] * slope["amplitude_by_extremum"][:, None]
    # Of each instant: rate and frequency, by extrema and by times, before and after.
    slopes = np.empty((len(a), 2, 2, 2))
    slopes[:, 0, 0] = slope["amplitude_rate_by_extremum"] - by_amplitude[:, 0]
    slopes[:, 0, 1] = slope["amplitude_rate_by_time"]
    slopes[:, 1, 0] = -by_amplitude[:, 1]
    slopes[:, 1, 1] = slope["frequency_by_time"]
    half_periods = len(a) + 2
    columns = np.add.outer(np.arange(len(a)), np.add.outer([0, half_periods], [0, 2]))[:, None]
    places = np.broadcast_to(columns, slopes.shape).ravel(), np.arange(0, slopes.size + 1, 4)
    return sp.csr_matrix((slopes.ravel(), *places), (2 * len(a), 2 * half_periods))
