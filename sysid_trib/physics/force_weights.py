"""How much each force weighs at an amplitude (Le Bot et al. 2019, Sec. 4)."""

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.averaging.signatures import averages
from sysid_trib.averaging.steady_cycles import cycles_at
from sysid_trib.forces.force import Force
from sysid_trib.physics.error_propagation import amplitude_row
from sysid_trib.physics.model_estimate import model_estimate
from sysid_trib.results.variables import with_error

# Points of a cycle on which the peak of a force is sought; every maximum of a power of x or v is one of them.
POINTS = 1440
POINTS_WITH_HISTORY = 360


def weights(result: xr.Dataset, amplitude: ArrayLike, *, time: ArrayLike = 0.0) -> xr.Dataset:
    """Weigh the forces of an identification against each other, in envelope and in frequency.

    Parameters
    ----------
    result : Dataset
        An identification.
    amplitude : float or (amplitude,) array of float, rad
        A number or one row of them.
    time : float or (amplitude,) array of float, s
        `t` of the formulas, at all amplitudes or at each.

    Returns
    -------
    Dataset
        Over `force` (and `amplitude`): `peak_force` = |c| max |h| (rad; the paper's lambda, 2 zeta a,
        delta a^2), `decay` = -c <h sin phi> (rad of amplitude lost per rad of phase), `frequency_shift` =
        c <h cos phi>/a (1); `decay_share` and `frequency_share`, each over the sum of their sizes, negative
        where a force feeds energy in or lowers the frequency, nan if none acts. Each with its standard
        error. All at the result's reference frequency, also an alpha that was stated at another.

    Raises
    ------
    UsageError
        Not an identification, or not positive angles.
    LibraryError
        A force that is not finite on such a cycle.
    """
    estimate, a = model_estimate(result), amplitude_row(amplitude)
    forces, shapes, at = estimate.forces, estimate.shapes, np.broadcast_to(np.asarray(time, float), a.shape)
    unit = np.array([averages(force, a, shapes, at) for force in forces])
    peaks = np.array([peak(force, a, shapes, at) for force in forces])
    c, covariance = estimate.coefficients[:, None], estimate.coefficient_covariance
    errors, dims = np.sqrt(np.diag(covariance))[:, None], ("force", "amplitude")
    # A zero without a sign.
    decay, shift = 0.0 - unit[:, 0], unit[:, 1] / a + 0.0
    decay_shares, shift_shares = (shares(c * part, part, covariance) for part in (decay, shift))
    data = (
        with_error("peak_force", dims, (np.abs(c) * peaks, errors * peaks), "peak force", "rad")
        | with_error("decay", dims, (c * decay, errors * np.abs(decay)), "loss of amplitude per rad", "rad")
        | with_error("frequency_shift", dims, (c * shift, errors * np.abs(shift)), "frequency shift")
        | with_error("decay_share", dims, decay_shares, "share in the decay")
        | with_error("frequency_share", dims, shift_shares, "share in the shift")
    )
    return estimate.over_amplitude(data, amplitude)


def shares(terms: Array, unit: Array, covariance: Array) -> tuple[Array, Array]:
    """Each term over the sum of their sizes, and its standard error.

    Parameters
    ----------
    terms : (force, amplitude) array of float
        The terms.
    unit : (force, amplitude) array of float
        The terms of coefficients 1.
    covariance : (force, force) array of float
        Covariance of the coefficients.
    """
    total = np.abs(terms).sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        weight = terms / total + 0.0
        # d share_i / d c_j = u_j (delta_ij - share_i sgn_j) / total
        sign = np.where(terms < 0, -1.0, 1.0)
        slope = (np.eye(len(terms))[:, :, None] - weight[:, None, :] * sign[None]) * unit[None] / total
    variance = np.einsum("ija,jk,ika->ia", slope, covariance, slope)
    return weight, np.sqrt(np.maximum(variance, 0.0))


def peak(force: Force, a: Array, shapes: Mapping[str, float], time: ArrayLike = 0.0) -> Array:
    """Largest |h| on the cycles of these amplitudes (rad); internal states are on their settled cycle.

    Of a force with memory it is half from peak to peak.
    """
    if force.degree is not None:
        return np.asarray(_unit_peak(force) * a**force.degree)
    at = np.broadcast_to(np.asarray(time, float), a.shape)
    if not force.memoryless:
        return _steady_peaks(force, a, shapes, at)
    phi = 2.0 * np.pi * np.arange(POINTS) / POINTS
    x, v = np.multiply.outer(a, np.cos(phi)), -np.multiply.outer(a, np.sin(phi))
    return np.asarray(np.abs(force.value(x, v, at[:, None], shapes=shapes)).max(axis=1))


@lru_cache(maxsize=1024)
def _unit_peak(force: Force) -> float:
    phi = 2.0 * np.pi * np.arange(POINTS) / POINTS
    return float(np.abs(force.value(np.cos(phi), -np.sin(phi))).max())


def _steady_peaks(force: Force, a: Array, shapes: Mapping[str, float], time: Array) -> Array:
    """Peaks on the steady cycles; of a memory half from peak to peak: an offset is what it began with."""
    peaks = np.zeros(a.size)
    for rows, cycles in cycles_at(force, a, time, shapes):
        for row, (phi, hidden) in zip(rows, cycles.along(POINTS_WITH_HISTORY), strict=True):
            h = force.value(
                a[row] * np.cos(phi), -a[row] * np.sin(phi), time[row], shapes=shapes, hidden=hidden
            )
            peaks[row] = 0.5 * np.ptp(h) if force.memory else np.abs(h).max()
    return peaks
