"""Shape parameters that are frequencies or phases of their forces."""

from functools import lru_cache

import numpy as np

from sysid_trib.forces.force import Force

# Relative difference between a natural frequency and the shape that gives it.
SAME = 0.05
TURN = 2.0 * np.pi


@lru_cache(maxsize=1024)
def is_frequency(force: Force, name: str) -> bool:
    """Return true if a shape parameter is the angular frequency of a force periodic in time."""
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
    """Return true if a shape parameter is the natural frequency of a force's states (by their equations)."""
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
    """Return true if a shape parameter is a frequency of either kind; the record's spectrum then gives it."""
    return is_frequency(force, name) or is_resonance(force, name)


def has_frequency_parameter(force: Force) -> bool:
    """Return true if a force has such a frequency."""
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
