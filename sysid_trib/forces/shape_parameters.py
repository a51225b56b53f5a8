"""Shape parameters of forces: which of them are frequencies or phases, and their scale over their range."""

from functools import lru_cache

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.forces.force import Force, Shape

# How nearly a natural frequency is the shape that gives it.
SAME = 0.05
TURN = 2.0 * np.pi


@lru_cache(maxsize=1024)
def is_frequency(force: Force, name: str) -> bool:
    """True if a shape parameter is the angular frequency of a force periodic in time (by its formula)."""
    if not force.memoryless or "t" not in force.formula.names:
        return False
    shape, t = force.shape[name], np.linspace(0.0, 3.0, 41)
    if shape.low <= 0.0:
        return False
    x = np.full_like(t, 0.3)
    for value in (shape.default, 1.7 * shape.default):
        shapes = {f"{force.symbol}.{name}": value}
        here = force.value(x, 0.7 * x, t, shapes=shapes)
        later = force.value(x, 0.7 * x, t + 2.0 * np.pi / value, shapes=shapes)
        if not np.allclose(here, later, rtol=1e-6, atol=1e-9) or np.ptp(here) == 0.0:
            return False
    return True


@lru_cache(maxsize=1024)
def is_resonance(force: Force, name: str) -> bool:
    """True if a shape parameter is the natural frequency of a force's states (by their equations)."""
    states = tuple(force.state)
    for factor in (1.0, 1.7):
        value = factor * force.shape[name].default
        shapes = force.shape_values({f"{force.symbol}.{name}": value})
        rest = {"x": 0.0, "v": 0.0, "t": 0.0, **dict.fromkeys((*states, *force.memory), 0.0), **shapes}
        with np.errstate(all="ignore"):
            jacobian = [[float(f.derivative(rest, z)) for z in states] for f in force.state.values()]
        if not np.all(np.isfinite(jacobian)):
            return False
        natural = np.abs(np.imag(np.linalg.eigvals(np.reshape(jacobian, (len(states),) * 2))))
        if not np.any(np.abs(natural - value) < SAME * value):
            return False
    return True


def is_frequency_parameter(force: Force, name: str) -> bool:
    """True if a shape parameter is a frequency of either kind, which is found among those of the record."""
    return is_frequency(force, name) or is_resonance(force, name)


def has_frequency_parameter(force: Force) -> bool:
    """True if a force has such a frequency."""
    return any(is_frequency_parameter(force, name) for name in force.shape)


@lru_cache(maxsize=1024)
def is_phase(force: Force, name: str) -> bool:
    """Return true if a shape parameter is periodic and its range covers a turn."""
    shape, points = force.shape[name], force.test_points
    if not force.memoryless or shape.high - shape.low < TURN:
        return False
    turned = [
        force.formula.evaluate(points | {name: shape.default + part * TURN}) for part in (0.0, 0.3, 1.0)
    ]
    return bool(np.allclose(turned[0], turned[2]) and not np.allclose(turned[0], turned[1]))


def is_wide(shape: Shape) -> bool:
    """Return true if a shape parameter spans more than a decade, so that its logarithm is uniform."""
    return shape.low > 0.0 and shape.high > 10.0 * shape.low


def evened(shape: Shape, value: float) -> float:
    """Return the coordinate of a shape parameter that is uniform over its range."""
    return float(np.log(value)) if is_wide(shape) else value


def from_unit(shape: Shape, part: Array) -> Array:
    """Return values of a shape parameter from their positions in its range."""
    low, high = evened(shape, shape.low), evened(shape, shape.high)
    values = low + part * (high - low)
    return np.asarray(np.clip(np.exp(values), shape.low, shape.high) if is_wide(shape) else values)


def slope_of_unit(shape: Shape, value: float) -> float:
    """Return the derivative of a shape parameter by its position in the range."""
    return value * float(np.log(shape.high / shape.low)) if is_wide(shape) else shape.high - shape.low
