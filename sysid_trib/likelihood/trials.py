"""Candidates as trials: each force or sensor effect, at a grid of its shapes; shapes that are frequencies."""

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.forces.force import Force, Shape
from sysid_trib.forces.notation import reference_powers
from sysid_trib.likelihood.settings import DEFAULTS, Settings
from sysid_trib.simulation.internal_states import is_stepped

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
    """True if a turn more of a shape parameter is the same, and its range is a turn at least."""
    shape, points = force.shape[name], force.test_points
    if not force.memoryless or shape.high - shape.low < TURN:
        return False
    turned = [
        force.formula.evaluate(points | {name: shape.default + part * TURN}) for part in (0.0, 0.3, 1.0)
    ]
    return bool(np.allclose(turned[0], turned[2]) and not np.allclose(turned[0], turned[1]))


# Part of a range within which a shape parameter is at its end.
END = 1e-9
# Detunings at which a resonance is looked for where it makes no line of its own, in the swing's.
OFF_RESONANCE = (0.03, 0.08, 0.2)


@dataclass(frozen=True)
class TrialEffect:
    """A candidate with its shape parameters held (`{"dahl.s": 0.02}`).

    `starts` : others of it, from which a fit starts where that from these shapes fails.
    """

    force: Force
    shapes: Mapping[str, float]
    starts: tuple["TrialEffect", ...] = field(default=(), compare=False)

    def referred(self, factor: float) -> "TrialEffect":
        """The effect, within the ranges of its shapes, with a reference frequency higher by a factor."""
        powers = reference_powers(self.force)
        if powers is None or not self.shapes:
            return self
        values = self.force.shape_values(self.shapes)
        shapes = {
            f"{self.force.symbol}.{name}": float(
                np.clip(values[name] * factor ** powers[name], shape.low, shape.high)
            )
            for name, shape in self.force.shape.items()
        }
        return replace(self, shapes=shapes)


def shape_values(trials: Iterable[TrialEffect]) -> list[tuple[Shape, float]]:
    """The shape parameters of trials, and the value of each."""
    return [
        (t.force.shape[name], t.shapes[f"{t.force.symbol}.{name}"]) for t in trials for name in t.force.shape
    ]


def reference_power(force: Force) -> float:
    """Power of the reference frequency of a coefficient; where none is known, that of a force of x alone."""
    powers = reference_powers(force)
    return -2.0 if powers is None else powers[""]


def trials_of(
    candidates: Iterable[Force], frequencies: Sequence[float], w: float, settings: Settings = DEFAULTS
) -> list[TrialEffect]:
    """Every candidate at a grid of its shape parameters.

    Parameters
    ----------
    candidates : iterable of Force
    frequencies : sequence of float, rad/s
        At which a force that is periodic in time is tried, and a resonance too.
    w : float, rad/s
        Reference frequency, in units of which a resonance is.
    settings : Settings
    """
    trials = []
    for force in candidates:
        grids = [_grid(force, name, frequencies, w, settings) for name in force.shape]
        pairs = zip(grids, force.shape, strict=True)
        tried = max((len(grid) for grid, name in pairs if is_frequency_parameter(force, name)), default=0)
        most = max(settings.combinations, tried * settings.shape_values)
        while np.prod([len(grid) for grid in grids], dtype=int) > most:
            longest = int(np.argmax([len(grid) for grid in grids]))
            grids[longest] = grids[longest][::2]
        for values in itertools.product(*grids):
            shapes = {f"{force.symbol}.{k}": float(v) for k, v in zip(force.shape, values, strict=True)}
            trials.append(TrialEffect(force, shapes))
    return trials


def frequencies_of(trial: TrialEffect, w: float) -> list[float]:
    """Frequencies (rad/s) at which a force is periodic or resonates, with `w` rad/s as the reference."""
    force, frequencies = trial.force, list[float]()
    for name in force.shape:
        value = trial.shapes[f"{force.symbol}.{name}"]
        if is_frequency_parameter(force, name):
            frequencies.append(value if is_frequency(force, name) else value * w)
    return frequencies


def _grid(force: Force, name: str, frequencies: Sequence[float], w: float, settings: Settings) -> Array:
    shape = force.shape[name]
    if is_frequency(force, name):
        inside = [q for q in frequencies if shape.low <= q <= shape.high]
        return np.array(inside or [shape.default])
    if is_resonance(force, name):
        inside = [q / w for q in frequencies if shape.low <= q / w <= shape.high]
        # It may be so broad that it makes no line, or in the swing's own.
        broad = np.geomspace(shape.low, shape.high, settings.lines)
        nearby = [1.0 + side * off for off in OFF_RESONANCE for side in (-1.0, 1.0)]
        return np.sort([*inside, *broad, *(k for k in nearby if shape.low <= k <= shape.high)])
    if is_phase(force, name):
        # Neither end: from there the way is as long as it can be.
        return np.linspace(-0.5, 0.5, settings.shape_values, endpoint=False) * TURN + _middle(shape)
    # Fewer of one alone, whose grid is made finer where it matters; where each is followed in time by itself,
    # which is slow; and beside so many frequencies.
    fast = force.memoryless or is_stepped(force)
    count = settings.shape_values if fast and len(force.shape) > 1 else (settings.shape_values + 1) // 2
    if any(is_resonance(force, other) for other in force.shape):
        count = (count + 3) // 4
    return from_unit(shape, np.linspace(0.0, 1.0, count))


def stepped_shape(force: Force, name: str, value: float, step: float) -> float:
    """A shape parameter a step further, in parts of its range: within it, a phase by less than a turn."""
    shape = force.shape[name]
    further = to_unit(shape, value) + step
    if is_phase(force, name):
        angle = float(from_unit(shape, np.asarray(further))) - _middle(shape)
        return _middle(shape) + float(np.remainder(angle + 0.5 * TURN, TURN)) - 0.5 * TURN
    return float(from_unit(shape, np.clip(further, 0.0, 1.0)))


def _middle(shape: Shape) -> float:
    return 0.5 * (shape.low + shape.high)


def is_wide(shape: Shape) -> bool:
    """True if a shape parameter spans more than a decade, so that its logarithm is what is even."""
    return shape.low > 0.0 and shape.high > 10.0 * shape.low


def _evened(shape: Shape, value: float) -> float:
    """What of a shape parameter is even over its range."""
    return float(np.log(value)) if is_wide(shape) else value


def from_unit(shape: Shape, part: Array) -> Array:
    """Values of a shape parameter from parts of its range, in which it is even."""
    low, high = _evened(shape, shape.low), _evened(shape, shape.high)
    values = low + part * (high - low)
    return np.asarray(np.clip(np.exp(values), shape.low, shape.high) if is_wide(shape) else values)


def to_unit(shape: Shape, value: float) -> float:
    """Part of its range at which a shape parameter is."""
    low, high = _evened(shape, shape.low), _evened(shape, shape.high)
    return (_evened(shape, value) - low) / (high - low)


def slope_of_unit(shape: Shape, value: float) -> float:
    """Change of a shape parameter by a part of its range."""
    return value * float(np.log(shape.high / shape.low)) if is_wide(shape) else shape.high - shape.low


def end_of_range(shape: Shape, value: float) -> int:
    """-1 or 1 of a shape parameter at the low or the high end of its range, else 0."""
    part = to_unit(shape, value)
    return -1 if part <= END else 1 if part >= 1.0 - END else 0
