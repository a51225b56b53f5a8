"""Forces of coefficient 1 along a motion: averaged over each sample's cell, and their derivatives."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.constants import golden_ratio
from scipy.special import ndtri

from sysid_trib.arrays import Array, Mask
from sysid_trib.forces.force import Force, ShapeValues
from sysid_trib.simulation.internal_states import states_along

# Points of each sample's cell at which forces with jumps are averaged.
POINTS_OF_CELL, CELLS_AT_ONCE = 34, 10_000
# Values of the inputs in the formulas of a force at times (s), by name.
InputsAt = Callable[[Force, Array], Mapping[str, Array]]


def value_along(
    force: Force,
    motion: Sequence[Array],
    frequency: float,
    shapes: ShapeValues | None,
    given: InputsAt,
    known: Mapping[str, Array] | None = None,
) -> Array:
    """Return one force along a motion, (sample,), rad.

    Parameters
    ----------
    force : Force
    motion : (sample,) arrays of float
        Time from the first sample (s), theta and theta'/frequency (rad).
    frequency : float, rad/s
    shapes : mapping of str to float, optional
    given : InputsAt
    known : mapping of str to (sample,) array of float, optional
        Known internal states and memory, `{"dahl.z": ...}`; the others are computed along the motion.
    """
    time, x, v = motion
    names = {name: f"{force.symbol}.{name}" for name in (*force.state, *force.memory)}
    if known is not None and all(name in known for name in names.values()):
        hidden = {name: known[full] for name, full in names.items()}
    else:
        hidden = states_along(force, time * frequency, x, v, shapes, time=time)
    return force.value(x, v, time, shapes=shapes, hidden={**hidden, **given(force, time)})


def cell_averages(
    forces: Sequence[Force],
    motion: Sequence[Array],
    frequency: float,
    shapes: ShapeValues,
    given: InputsAt,
    rate_error: float = 0.0,
) -> Array:
    """Average memoryless forces over each sample's cell, so that sign(v) switches between two samples.

    Parameters
    ----------
    forces : sequence of Force
    motion : (sample,) arrays of float
        Time from the first sample (s), theta, theta' and theta'' (rad).
    frequency : float, rad/s
    shapes : mapping of str to float
    given : InputsAt
    rate_error : float, rad
        Standard deviation of the rate if it is uncertain: the average is over its normal distribution too.

    Returns
    -------
    (sample, force) array of float, rad

    Notes
    -----
    Values at the samples alone would depend on the sampling if a period has a whole number of samples: a sign
    that is wrong at the same places of every period seems to distinguish forces. With an uncertain rate the
    points are a Kronecker sequence over cell and probability, symmetric about their middle, so that every
    point has its own time and error. Cells without switching are averaged too, by two points (Gauss): with
    few samples a period, a mixture of values and averages would be a pattern that no motion has.
    """
    columns = np.empty((len(motion[0]), len(forces)))
    number = np.arange(POINTS_OF_CELL) - 0.5 * (POINTS_OF_CELL - 1)
    parts = number / POINTS_OF_CELL
    errors = rate_error * ndtri(np.mod(golden_ratio * number + 0.5, 1.0))

    def near(part: Any, error: Any, samples: Sequence[Array]) -> tuple[Array, Array, Array]:
        cell, at, angle, rate, acceleration = samples
        ahead = part * cell
        return angle + ahead * rate, rate + ahead * acceleration + error, at + ahead / frequency

    def value(force: Force, point: tuple[Array, Array, Array]) -> Array:
        return force.value(*point, shapes=shapes, hidden=given(force, point[2]))

    time, x, v, _ = motion
    every, extremes = (frequency * np.gradient(time), *motion), np.unique([errors.min(), errors.max()])
    corners = [(x, v, time)]
    corners += [near(part, error, every) for part in parts[[0, -1]] for error in extremes]
    before, after = (near(side / np.sqrt(12.0), 0.0, every) for side in (-1.0, 1.0))
    for i, force in enumerate(forces):
        columns[:, i] = 0.5 * (value(force, before) + value(force, after))
        # Use many points only for the few cells that contain a switch.
        at = np.flatnonzero(_switches(force, corners, shapes, given))
        for few in np.array_split(at, 1 + len(at) // CELLS_AT_ONCE) if len(at) else ():
            points = near(parts[:, None], errors[:, None], [values[few] for values in every])
            columns[few, i] = value(force, points).mean(axis=0)
    return columns


def _switches(
    force: Force, points: Sequence[tuple[Array, Array, Array]], shapes: ShapeValues, given: InputsAt
) -> Mask:
    """Return the mask of samples with points (x, v, t) on both sides of a switching surface, (sample,)."""
    switches = np.zeros(len(points[0][0]), bool)
    if not force.surfaces:
        return switches
    shape = force.shape_values(shapes)
    names = [{"x": x, "v": v, "t": t, **given(force, t), **shape} for x, v, t in points]
    for surface in force.surfaces:
        first, *others = (surface.evaluate(at) > 0.0 for at in names)
        for other in others:
            switches |= first != other
    return switches


# Width, in units of the local amplitude, over which a jump of a force at zero acts on the noise.
JUMP_WIDTH = 0.8
# Fraction of the amplitude within which a steep rise at zero counts as a jump: test functions, whose knots
# are half a radian apart, do not resolve it.
STEEP = 0.2


def derivatives_along(
    terms: Iterable[tuple[Force, float, ShapeValues]],
    motion: tuple[Array, Array, Array],
    given: Mapping[str, Array] | None = None,
    kind: str = "force",
) -> tuple[Array, Array]:
    """Return derivatives sum c dh/dx and sum c dh/dv along a motion, (sample,) each.

    Parameters
    ----------
    terms : iterable of (Force, float, mapping of str to float)
        Each force with its coefficient and shape parameters; history-dependent forces are left out.
    motion : three (sample,) arrays of float
        Time since the first sample (s), x and v (rad).
    given : mapping of str to (sample,) array of float, optional
        Inputs in the formulas.
    kind : {"force", "sensor"}
        Derivatives of forces, which are stiffness and damping, or of errors of the sensor.

    Notes
    -----
    A force that jumps with v, such as sign(v), damps the noise by an impulse at each reversal. The test
    functions respond only to the mean of this impulse; a narrower impulse would remove information by
    whitening. A jump at zero is therefore distributed over `JUMP_WIDTH`, and so is a rise that is nearly as
    steep, such as that of abs(v)**0.1 sign(v). A kink, such as that of x abs(x), is not a jump.
    """
    time, x, v = motion
    slopes = np.zeros((2, len(x)))
    for force, coefficient, shapes in terms:
        if force.kind != kind or not force.memoryless or coefficient == 0.0:
            continue
        names = {"x": x, "v": v, "t": time} | dict(given or {}) | force.shape_values(shapes)
        for total, name in zip(slopes, "xv", strict=True):
            if name not in force.formula.names:
                continue
            with np.errstate(all="ignore"):
                slope = np.broadcast_to(force.formula.derivative(names, name), x.shape)
            # The motion passes the singularity of a power only at an instant.
            slope = np.where(np.isfinite(slope), slope, 0.0)
            if kind == "force" and force.formula.surfaces:
                slope = _with_jump(force, names, name, slope, coefficient)
            total += coefficient * slope
    return slopes[0], slopes[1]


def _with_jump(force: Force, names: dict[str, Any], of: str, slope: Array, coefficient: float) -> Array:
    """Return the derivative of a force by x or v along a motion, with jumps at zero as smooth bumps.

    The jump is the rise within `STEEP` of the amplitude, minus that of the tangents at its ends.
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
    # The jump shifts the centre of the swing by half of its size; near rest this shift is the size of the
    # motion.
    width = JUMP_WIDTH * (amplitude + 0.5 * np.abs(coefficient * jump))
    bump = np.clip(1.0 - (along / width) ** 2, 0.0, None)
    return np.asarray(slope + jump * bump**2 * 15.0 / (16.0 * width))
