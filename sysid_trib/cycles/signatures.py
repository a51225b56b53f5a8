"""Signatures of forces: averages <h sin phi> and <h cos phi> over a cycle x = a cos phi, v = -a sin phi.

The first acts on the envelope, the second on the frequency (Le Bot et al. 2019, Appendix). Together they are
the describing function of the force (Krylov-Bogoliubov averages).
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import xarray as xr
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, variable
from sysid_trib.cycles.one_cycle import CANCELLATION, ROUNDING_ERROR, cycle_averages
from sysid_trib.errors import UsageError
from sysid_trib.forces.force import Force, ForceLibrary, ShapeValues

# Number of amplitudes averaged at once, which limits the memory.
CHUNK = 128
# Number of nodes and tolerance of the series of averages in parts of an octave: (low, high, coefficients).
CHEBYSHEV_NODES, SERIES_TOLERANCE = 16, 1e-11


class OctavePart(NamedTuple):
    """A series of averages between two amplitudes, in parts of an octave."""

    low: float
    high: float
    coefficients: Array


def signature(
    force: Force, amplitude: ArrayLike, shapes: ShapeValues | None = None, *, time: ArrayLike = 0.0
) -> xr.Dataset:
    """Return the averages of a force over a cycle, which determine its effect on envelope and frequency.

    Parameters
    ----------
    force : Force
        A force or sensor of a library.
    amplitude : float or (amplitude,) array of float, rad
        Amplitudes, not negative.
    shapes : mapping of str to float, optional
        Shape parameters, `{"dahl.s": 0.02}`; default values for missing ones.
    time : float or (amplitude,) array of float, s
        `t` of the formula, constant during the cycle.

    Returns
    -------
    Dataset
        `sine` = <h sin phi> and `cosine` = <h cos phi> (rad), over `amplitude` if that is an array.
        da/d(w t) = coefficient * sine; relative frequency shift = coefficient * cosine / a. A
        history-dependent force is averaged over its steady cycle. Inputs are zero.

    Raises
    ------
    UsageError
        An amplitude is not a finite angle >= 0.
    LibraryError
        The force is not finite on the cycle, or has no steady cycle.

    Examples
    --------
    Solid friction takes the same amplitude from each cycle, viscous friction the same fraction of it.

    >>> import sysid_trib as st
    >>> library = st.load_library("contact_forces")
    >>> for symbol in ("lambda", "zeta"):
    ...     print(symbol, st.signature(library[symbol], [0.1, 0.2]).sine.round(4).values.tolist())
    lambda [-0.6366, -0.6366]
    zeta [-0.1, -0.2]
    """
    a = np.asarray(amplitude, dtype=float)
    if a.ndim > 1:
        raise UsageError("The amplitude of a signature must be a number or one row of numbers.")
    sine, cosine = averages(force, np.atleast_1d(a), shapes, time)
    dims = ("amplitude",) * a.ndim
    data = {
        "sine": variable(dims, sine.reshape(a.shape), "mean of h sin phi", "rad"),
        "cosine": variable(dims, cosine.reshape(a.shape), "mean of h cos phi", "rad"),
    }
    at = {"amplitude": variable(dims, a, "amplitude of the cycle", "rad")}
    return xr.Dataset(data, at, {"force": force.symbol, "formula": force.formula.text})


def averages(
    force: Force, amplitude: Array, shapes: ShapeValues | None = None, time: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """Compute `signature` on plain arrays: (sine, cosine), each as long as `amplitude` (rad)."""
    a = np.asarray(amplitude, dtype=float)
    if not (np.all(np.isfinite(a)) and np.all(a >= 0)):
        raise UsageError(f"Force '{force.symbol}': amplitudes must be finite angles >= 0 (rad).")
    if a.size == 0:
        return np.zeros(0), np.zeros(0)
    if force.degree is not None:
        unit = _unit_averages(force)
        scale = a**force.degree
        return unit[0] * scale, unit[1] * scale
    # Use NumPy's numbers: a shape parameter of zero then gives a non-finite value instead of an exception.
    shape_values = {k: np.float64(value) for k, value in force.shape_values(shapes).items()}
    # Inputs are at rest.
    shape_values |= {channel.name: np.float64(0.0) for channel in force.channels}
    times = np.broadcast_to(np.asarray(time, dtype=float), a.shape)
    cuts = range(CHUNK, a.size, CHUNK)
    with np.errstate(all="ignore"):
        rows = zip(np.split(a, cuts), np.split(times, cuts), strict=True)
        parts = [cycle_averages(force, *some, shape_values) for some in rows]
    sine, cosine = zip(*parts, strict=True)
    return np.concatenate(sine), np.concatenate(cosine)


def signatures_of(library: ForceLibrary) -> xr.Dataset:
    """Return the averages of the forces of a library over a cycle, and their effect on the energy.

    Parameters
    ----------
    library : ForceLibrary

    Returns
    -------
    Dataset
        Over `force`: `sine` and `cosine` at two `amplitude` (rad), one second after the start for a force
        that depends on time; and `power`, the effect of a positive coefficient on the energy: `yes` if it
        removes energy, `no`, `gains power` or `by amplitude`; empty for an error of the sensor.
    """
    amplitudes = np.array([0.1, 1.0])
    pairs = [averages(force, amplitudes, None, 1.0 if force.holds_time else 0.0) for force in library]
    power = ["" if force.kind == "sensor" else _loses_power(force) for force in library]
    sine, cosine = np.moveaxis(np.array(pairs), 1, 0)
    values = {
        "sine": (("force", "amplitude"), sine),
        "cosine": (("force", "amplitude"), cosine),
        "power": ("force", power),
    }
    return xr.Dataset(values, {"force": list(library.symbols), "amplitude": amplitudes})


def _loses_power(force: Force) -> str:
    """Return the effect of a positive coefficient on the energy, at typical amplitudes of a pendulum."""
    a = np.array([0.05, 0.3, 1.0])
    # Rounding of the averages.
    rounding = 1e-13
    power = -a * averages(force, a, time=1.0)[0]
    if np.all(np.abs(power) < rounding):
        return "no"
    if np.all(power > -rounding):
        return "yes"
    return "gains power" if np.all(power < rounding) else "by amplitude"


def tabulated_averages(
    force: Force, amplitude: Array, shapes: ShapeValues | None = None, time: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """Compute `averages` at many amplitudes above zero (rad), from a cached series except for powers."""
    if force.degree is not None or force.holds_time:
        return averages(force, amplitude, shapes, time)
    at, held = np.log2(amplitude), tuple(force.shape_values(shapes).items())
    both = np.empty((2, len(at)))
    for octave in np.unique(np.floor(at)):
        for low, high, series in _octave(force, held, float(octave)):
            inside = (at >= low) & (at < high)
            if inside.any():
                both[:, inside] = chebyshev.chebval(2.0 * (at[inside] - low) / (high - low) - 1.0, series)
    return both[0], both[1]


def tabulated_averages_of(
    forces: Sequence[Force], amplitude: Array, shapes: ShapeValues | None = None, time: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """Compute `tabulated_averages` of many forces: (sine, cosine), each (amplitude, force), rad.

    Basis functions of a smooth curve that differ only in their scale share one table.
    """
    both = np.empty((2, len(amplitude), len(forces)))
    scaled: dict[str, list[int]] = {}
    for at, force in enumerate(forces):
        if force.curve and _is_scaled(force):
            scaled.setdefault(force.formula.text, []).append(at)
        else:
            both[:, :, at] = tabulated_averages(force, amplitude, shapes, time)
    for places in scaled.values():
        scales = np.array([next(iter(forces[at].shape_values(shapes).values())) for at in places])
        ratios = amplitude[:, None] / scales
        of_unit = tabulated_averages(_of_unit_scale(forces[places[0]]), ratios.ravel())
        for part, values in zip(both, of_unit, strict=True):
            part[:, places] = scales * values.reshape(ratios.shape)
    return both[0], both[1]


@lru_cache(maxsize=1024)
def _is_scaled(force: Force) -> bool:
    """Return True if the only shape parameter of a force is a scale: s f(x/s, v/s)."""
    if len(force.shape) != 1 or not force.memoryless or force.holds_time or force.channels:
        return False
    (name,) = force.shape
    x, v = np.random.default_rng(0).uniform(-1.0, 1.0, (2, 20))
    small, large = (force.value(k * x, k * v, shapes={f"{force.symbol}.{name}": 0.3 * k}) for k in (1.0, 4.0))
    return bool(np.allclose(4.0 * small, large, rtol=1e-13, atol=0.0))


def _of_unit_scale(force: Force) -> Force:
    """Return a force with its only shape parameter equal to 1, common to all basis functions of a curve."""
    ((name, shape),) = force.shape.items()
    return replace(force, symbol="part", name="part of a curve", shape={name: replace(shape, default=1.0)})


@lru_cache(maxsize=1024)
def _octave(force: Force, held: tuple[tuple[str, float], ...], octave: float) -> list[OctavePart]:
    """Return the parts of an octave of amplitudes, each with its series."""
    shapes = {f"{force.symbol}.{name}": value for name, value in held}
    return list(_panels(force, shapes, octave, octave + 1.0))


def _panels(
    force: Force, shapes: ShapeValues, low: float, high: float, before: float = np.inf
) -> Iterator[OctavePart]:
    """Yield Chebyshev series in log2 a for parts of an octave, halved until the last terms are negligible.

    `before` is the size of the last terms in the part that was halved; rounding errors do not decrease
    further.
    """
    nodes = chebyshev.chebpts1(CHEBYSHEV_NODES)
    a = 2.0 ** (low + 0.5 * (nodes + 1.0) * (high - low))
    values = np.stack(averages(force, a, shapes), axis=1)
    series: Array = np.asarray(chebyshev.chebfit(nodes, values, CHEBYSHEV_NODES - 1), dtype=float)
    # The rounding error of a formula such as sin(x) - x is negligible compared with the spring's a.
    size = max(np.abs(series).max(initial=1e-300), CANCELLATION / SERIES_TOLERANCE * 2.0**high)
    last = np.abs(series[-3:]).max() / size
    # Smallest part of an octave: a signature with a kink, as at the onset of slip, is not halved further.
    if last < SERIES_TOLERANCE or high - low < 0.01 or 0.5 * before < last < ROUNDING_ERROR:
        yield OctavePart(low, high, series)
    else:
        middle = 0.5 * (low + high)
        yield from _panels(force, shapes, low, middle, last)
        yield from _panels(force, shapes, middle, high, last)


@lru_cache(maxsize=1024)
def _unit_averages(force: Force) -> tuple[float, float]:
    """Return averages at a = 1; those of a homogeneous force at other amplitudes follow by scaling."""
    sine, cosine = cycle_averages(force, np.ones(1), np.zeros(1), {})
    return float(sine[0]), float(cosine[0])
