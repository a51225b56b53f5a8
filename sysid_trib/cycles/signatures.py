"""Signatures of forces: averages <h sin phi> and <h cos phi> over a cycle x = a cos phi, v = -a sin phi.

The first drives the envelope, the second the frequency (Le Bot et al. 2019, Appendix). Together they are the
describing function of the force (Krylov-Bogoliubov averages).
"""

from functools import lru_cache

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.cycles.cycle_averages import cycle_averages
from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force, ShapeValues

# Amplitudes averaged at once, to bound the memory used.
CHUNK = 128


def signature(
    force: Force, amplitude: ArrayLike, shapes: ShapeValues | None = None, *, time: ArrayLike = 0.0
) -> xr.Dataset:
    """Averages of a force over a cycle, by which it acts on envelope and frequency.

    Parameters
    ----------
    force : Force
        A force or sensor of a library.
    amplitude : float or (amplitude,) array of float, rad
        Not negative.
    shapes : mapping of str to float, optional
        Shape parameters, `{"dahl.s": 0.02}`; defaults where left out.
    time : float or (amplitude,) array of float, s
        t of the formula, held during the cycle.

    Returns
    -------
    Dataset
        `sine` = <h sin phi> and `cosine` = <h cos phi> (rad), over `amplitude` if it is a row.
        da/d(w t) = coefficient * sine; relative frequency shift = coefficient * cosine / a. A
        history-dependent force is averaged over its steady cycle. Inputs are zero.

    Raises
    ------
    UsageError
        An amplitude that is not a finite angle >= 0.
    LibraryError
        The force is not finite on the cycle, or has no steady cycle.
    """
    a = np.asarray(amplitude, dtype=float)
    if a.ndim > 1:
        raise UsageError("The amplitude of a signature must be a number or one row of numbers.")
    sine, cosine = averages(force, np.atleast_1d(a), shapes, time)
    dims = ("amplitude",) * a.ndim
    values = {"sine": sine.reshape(a.shape), "cosine": cosine.reshape(a.shape)}
    names = {"sine": "mean of h sin phi", "cosine": "mean of h cos phi"}
    return xr.Dataset(
        {k: (dims, value, {"units": "rad", "long_name": names[k]}) for k, value in values.items()},
        {"amplitude": (dims, a, {"units": "rad", "long_name": "amplitude of the cycle"})},
        {"force": force.symbol, "formula": force.formula.text},
    )


def averages(
    force: Force, amplitude: Array, shapes: ShapeValues | None = None, time: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """`signature` on plain arrays: (sine, cosine), each as long as `amplitude` (rad)."""
    a = np.asarray(amplitude, dtype=float)
    if not (np.all(np.isfinite(a)) and np.all(a >= 0)):
        raise UsageError(f"Force '{force.symbol}': amplitudes must be finite angles >= 0 (rad).")
    if a.size == 0:
        return np.zeros(0), np.zeros(0)
    if force.degree is not None:
        unit = _unit_averages(force)
        scale = a**force.degree
        return unit[0] * scale, unit[1] * scale
    # NumPy's numbers: a shape parameter of zero gives a value that is not finite, not an exception.
    shape_values = {k: np.float64(value) for k, value in force.shape_values(shapes).items()}
    # What drives is at rest.
    shape_values |= {channel.name: np.float64(0.0) for channel in force.channels}
    times = np.broadcast_to(np.asarray(time, dtype=float), a.shape)
    cuts = range(CHUNK, a.size, CHUNK)
    with np.errstate(all="ignore"):
        parts = [
            cycle_averages(force, *rows, shape_values)
            for rows in zip(np.split(a, cuts), np.split(times, cuts), strict=True)
        ]
    sine, cosine = zip(*parts, strict=True)
    return np.concatenate(sine), np.concatenate(cosine)


def dissipated_power(
    force: Force, amplitude: ArrayLike, shapes: ShapeValues | None = None, *, time: ArrayLike = 0.0
) -> Array:
    """Mean power <h v> = -a <h sin phi> (rad^2) taken from the cycle by a unit coefficient; >0 is a loss."""
    a = np.atleast_1d(np.asarray(amplitude, dtype=float))
    return np.asarray(-a * averages(force, a, shapes, time)[0]).reshape(np.shape(amplitude))


@lru_cache(maxsize=1024)
def _unit_averages(force: Force) -> tuple[float, float]:
    """Averages at a = 1, from which those of a homogeneous force follow by scaling."""
    sine, cosine = cycle_averages(force, np.ones(1), np.zeros(1), {})
    return float(sine[0]), float(cosine[0])
