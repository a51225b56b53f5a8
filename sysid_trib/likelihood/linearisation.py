"""The equation of small deviations about a motion: how it acts on noise, and what is too fine for rows."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sysid_trib.arrays import Array
from sysid_trib.forces.force import Force
from sysid_trib.likelihood.sensor_noise import covariance_of_local_rows
from sysid_trib.likelihood.weak_form import WeakForm, cholesky_factor, log_determinant, noise_operator

# Width, in units of the local amplitude, over which the noise feels a jump of a force at zero.
JUMP_WIDTH = 0.8
# Part of the amplitude within which a force that rises at zero is one that jumps there: test functions, whose
# knots are half a radian apart, do not see how.
STEEP = 0.2


def derivatives_along(
    forces: Iterable[tuple[Force, float]],
    shapes: Mapping[str, float],
    time: Array,
    x: Array,
    v: Array,
    given: Mapping[str, Array] | None = None,
) -> tuple[Array, Array]:
    """Stiffness 1 + sum c dh/dx and damping sum c dh/dv along a motion.

    Parameters
    ----------
    forces : iterable of (Force, float)
        Each with its coefficient; what depends on history is left out.
    shapes : mapping of str to float
    time : (sample,) array of float, s
        Since the first sample.
    x, v : (sample,) array of float, rad
    given : mapping of str to (sample,) array of float, optional
        What formulas hold of inputs.

    Returns
    -------
    stiffness, damping : (sample,) array of float

    Notes
    -----
    A force that jumps with v, as sign(v), damps the noise by a spike at each reversal. The test functions
    see no spike, but its mean: a sharper one would whiten away what they can see. A jump at zero is therefore
    distributed over `JUMP_WIDTH`, and so is a rise that is nearly as steep, as that of abs(v)**0.1 sign(v).
    A kink, as that of x abs(x), is none.
    """
    derivatives = [np.ones_like(x), np.zeros_like(x)]
    for force, coefficient in forces:
        if force.kind == "sensor" or not force.memoryless or coefficient == 0.0:
            continue
        names = {"x": x, "v": v, "t": time} | dict(given or {}) | force.shape_values(shapes)
        for i, name in enumerate("xv"):
            if name not in force.formula.names:
                continue
            with np.errstate(all="ignore"):
                slope = np.broadcast_to(force.formula.derivative(names, name), x.shape)
            # Where a power is singular the motion is for an instant.
            slope = np.where(np.isfinite(slope), slope, 0.0)
            if force.formula.surfaces:
                slope = _with_jump(force, names, name, slope, coefficient)
            derivatives[i] = derivatives[i] + coefficient * slope
    return derivatives[0], derivatives[1]


def sensor_slopes(
    terms: Iterable[tuple[Force, float]], shapes: Mapping[str, float], time: Array, x: Array, v: Array
) -> tuple[Array, Array]:
    """By which errors of the sensor grow with the angle and with its rate along a motion, (sample,) each.

    Parameters
    ----------
    terms : iterable of (Force, float)
        Each with its coefficient; what is none of the sensor is left out.
    shapes : mapping of str to float
    time : (sample,) array of float, s
        Since the first sample.
    x, v : (sample,) array of float, rad
    """
    slopes = np.zeros((2, len(x)))
    for term, coefficient in terms:
        if term.kind == "sensor":
            names = {"x": x, "v": v, "t": time} | term.shape_values(shapes)
            for slope, name in zip(slopes, "xv", strict=True):
                slope += coefficient * term.formula.derivative(names, name)
    return slopes[0], slopes[1]


def _with_jump(force: Force, names: dict[str, Any], of: str, slope: Array, coefficient: float) -> Array:
    """Slope of a force by x or v along a motion, with what jumps at zero as a bump.

    What is left of the rise within `STEEP` of the amplitude by the tangents at its ends is the jump.
    """
    x, v = names["x"], names["v"]
    # A root of squares takes a seventh of the time of numpy's hypot.
    amplitude, along = np.sqrt(x * x + v * v) + 1e-12, names[of]
    steep = STEEP * amplitude
    rises, slopes = [], []
    for side in (-1.0, 1.0):
        with np.errstate(all="ignore"):
            value, tangent = force.formula.with_derivative(names | {of: side * steep}, of)
        value, tangent = np.broadcast_to(value, x.shape), np.broadcast_to(tangent, x.shape)
        rises.append(side * value)
        slopes.append(np.where(np.isfinite(tangent), tangent, 0.0))
    rise = rises[0] + rises[1]
    jump = rise - steep * (slopes[0] + slopes[1])
    jump = np.where(jump * rise > 0.0, jump, 0.0)
    if not jump.any():
        return slope
    at_end = np.where(along < 0.0, slopes[0], slopes[1])
    slope = np.where((np.abs(along) < steep) & (jump != 0.0), at_end, slope)
    # The swing is about a centre that the jump shifts by half of itself: near rest that is its size.
    width = JUMP_WIDTH * (amplitude + 0.5 * np.abs(coefficient * jump))
    bump = np.clip(1.0 - (along / width) ** 2, 0.0, None)
    return np.asarray(slope + jump * bump**2 * 15.0 / (16.0 * width))


def unresolved(
    form: WeakForm, tau: Array, stiffness: Array, damping: Array, operator: sp.csr_matrix
) -> float:
    """By how much the logarithm of the determinant of the rows' white noise is too large.

    Parameters
    ----------
    form : WeakForm
    tau : (point,) array of float
    stiffness, damping : (point,) array of float
        Of small deviations.
    operator : (row, sample) sparse array of float
        Of these.

    Returns
    -------
    float
        0 where the stiffness is constant, or is resolved.

    Notes
    -----
    A slow modulation of the swing leaves nearly nothing in the rows, so that a small random force shows.
    Smooth test functions cannot follow a stiffness that jumps; then something is left, and it takes more of a
    random force to show. But the determinant of the equation of small deviations is known: it goes as that of
    the Gram matrix of its free motions with unit starts (Gelfand and Yaglom 1960; Forman 1987). So it is
    compared with that of the mean stiffness and damping, which are resolved.
    """
    even = np.linspace(tau[0], tau[-1], len(tau))
    k, d = (np.interp(even, tau, values) for values in (stiffness, damping))
    means = [np.full_like(values, np.mean(values)) for values in (k, d)]
    samples = operator.shape[1]
    constant = noise_operator(form, *(np.full(samples, mean[0]) for mean in means))
    with np.errstate(all="ignore"):
        # A motion that grows beyond all numbers says nothing.
        free = _log_determinant_of_free_motions(even, k, d) - _log_determinant_of_free_motions(even, *means)
    noise, resolved = (
        log_determinant(cholesky_factor(covariance_of_local_rows(rows))) for rows in (operator, constant)
    )
    excess = noise - resolved - free
    return max(0.0, excess) if np.isfinite(excess) else 0.0


def _log_determinant_of_free_motions(tau: Array, stiffness: Array, damping: Array) -> float:
    """Log determinant of the Gram matrix of the free motions with unit angle and unit rate."""
    step, count = tau[1] - tau[0], len(tau)
    half = 0.5 * step * damping
    # Central differences, each angle from the two before it: a lower triangular band.
    band = np.zeros((3, count))
    band[0, :2], band[0, 2:] = 1.0, 1.0 + half[1:-1]
    band[1, 1:-1], band[2, :-2] = step**2 * stiffness[1:-1] - 2.0, 1.0 - half[1:-1]
    start = np.zeros((count, 2))
    start[0] = 1.0, 0.0
    start[1] = 1.0 - 0.5 * step**2 * stiffness[0], step * (1.0 - half[0])
    try:
        motions = scipy.linalg.solve_banded((2, 0), band, start, check_finite=False)
    except np.linalg.LinAlgError:
        # What drives so strongly that steps do not follow it has no free motions to speak of.
        return float("nan")
    return float(np.linalg.slogdet(motions.T @ motions)[1])
