"""The unknowns of a trajectory fit, what their motion leaves of each record, and its sensitivities."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sysid_trib.errors import SimulationError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.noise.autoregression import whitened
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory

Array = NDArray[np.float64]

# What a motion that cannot be computed leaves, in swings: far, but finite for the optimiser.
FAR = 10.0
# Sensitivities are forward differences over a step that moves the phase by about this much (rad).
REACH = 1e-6
# Unknowns of each run: angle and rate at the start, zero of the sensor.
OWN = 3


@dataclass(frozen=True)
class Record:
    """One run: `filter_` whitens its noise, `weight` is one over what it has then."""

    time: Array
    angle: Array
    filter_: Array = field(default_factory=lambda: np.ones(1))
    weight: float = 1.0
    engine: str | None = None

    def residual(self, model: Model, own: Array) -> Array:
        """Motion minus record (rad); far off where it cannot be computed, or is out of all proportion."""
        far = FAR * float(np.max(np.abs(self.angle)))
        # The highest frequency that samples show. An optimiser astray asks for hours of faster swings.
        highest = np.pi * (len(self.time) - 1) / (self.time[-1] - self.time[0])
        if model.reference_frequency > highest or abs(own[0]) > far or abs(own[1]) > far * highest:
            return np.full(len(self.time), far)
        try:
            found = trajectory(model, self.time, float(own[0]), float(own[1]), engine=self.engine)
        except SimulationError:
            return np.full(len(self.time), far)
        return np.asarray(found.angle + own[2] - self.angle)

    def white(self, values: Array) -> Array:
        """Values with noise of one level and no colour."""
        return self.weight * whitened(values, self.filter_)


@dataclass(frozen=True)
class Problem:
    """The runs, and their unknowns in one vector: coefficients, shapes, w if free, then each run's own.

    `reference_frequency` : w in rad/s, held, or None where it is an unknown; `fit_shapes` : shape parameters
    that are unknowns, the others are in `shapes`; `bounds` : of coefficients and shapes.
    """

    library: ForceLibrary
    records: tuple[Record, ...]
    reference_frequency: float | None
    fit_shapes: tuple[str, ...]
    shapes: Mapping[str, float]
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def free(self) -> bool:
        """Whether the reference frequency is an unknown."""
        return self.reference_frequency is None

    @property
    def names(self) -> tuple[str, ...]:
        """Coefficients and shape parameters that are unknowns."""
        return (*self.library.symbols, *self.fit_shapes)

    @property
    def shared_names(self) -> tuple[str, ...]:
        """Unknowns that all runs share."""
        return (*self.names, "w") if self.free else self.names

    @property
    def shared(self) -> int:
        """Number of unknowns that all runs share."""
        return len(self.shared_names)

    def own(self, unknown: Array) -> Array:
        """Each run's own unknowns, (run, 3)."""
        return unknown[self.shared :].reshape(-1, OWN)

    def model(self, unknown: Array) -> Model:
        """The model of these unknowns."""
        count, named = len(self.library), len(self.names)
        coefficients = dict(zip(self.library.symbols, unknown[:count].tolist(), strict=True))
        shapes = dict(zip(self.fit_shapes, unknown[count:named].tolist(), strict=True))
        # A step of the optimiser below zero: only the square of the frequency counts.
        frequency = abs(float(unknown[named])) if self.free else float(self.reference_frequency or 0.0)
        return Model(self.library, coefficients, frequency, dict(self.shapes) | shapes)

    def first(self, part: float) -> "Problem":
        """The problem of the first part of each record."""
        counts = [max(20, round(part * len(record.time))) for record in self.records]
        cut = [
            replace(record, time=record.time[:count], angle=record.angle[:count])
            for record, count in zip(self.records, counts, strict=True)
        ]
        return replace(self, records=tuple(cut))

    def residuals(self, unknown: Array) -> list[Array]:
        """What each run's motion leaves, rad."""
        model, own = self.model(unknown), self.own(unknown)
        return [record.residual(model, mine) for record, mine in zip(self.records, own, strict=True)]

    def white(self, values: Sequence[Array]) -> Array:
        """Values of each run, (sample, ...), whitened, one after the other."""
        return np.concatenate([record.white(v) for record, v in zip(self.records, values, strict=True)])

    def white_residual(self, unknown: Array) -> Array:
        """Whitened residuals of all runs, one after the other."""
        return self.white(self.residuals(unknown))

    def white_sensitivity(self, unknown: Array, residuals: Sequence[Array]) -> Array:
        """Derivative of the whitened residuals by each unknown, (sample, unknown).

        `residuals` : those of these unknowns, as `residuals` gives them.
        """
        blocks = []
        for at, (record, here) in enumerate(zip(self.records, residuals, strict=True)):
            columns = record.white(self._sensitivity(unknown, at, here))
            block = np.zeros((len(columns), len(unknown)))
            mine = self.shared + OWN * at
            block[:, : self.shared] = columns[:, : self.shared]
            block[:, mine : mine + OWN] = columns[:, self.shared :]
            blocks.append(block)
        return np.concatenate(blocks)

    def _sensitivity(self, unknown: Array, at: int, here: Array) -> Array:
        """Derivative of one run's residual (`here`) by the shared unknowns and its own, (sample, unknown)."""
        record, own = self.records[at], self.own(unknown)[at]
        *shared, angle, rate, _ = self._steps(unknown, record)
        columns = []
        for j, step in enumerate(shared):
            moved = unknown.copy()
            moved[j] += step
            columns.append((record.residual(self.model(moved), own) - here) / step)
        model = self.model(unknown)
        for step in (np.array([angle, 0.0, 0.0]), np.array([0.0, rate, 0.0])):
            columns.append((record.residual(model, own + step) - here) / step.sum())
        return np.stack([*columns, np.ones_like(here)], axis=1)

    def _steps(self, unknown: Array, record: Record) -> Array:
        """Steps that move the motion by about `REACH` swings at the end of the record."""
        size = float(np.max(np.abs(record.angle)))
        frequency = self.model(unknown).reference_frequency
        phase = frequency * (record.time[-1] - record.time[0]) + 1.0
        x = size * np.cos(np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False))
        v = size * np.sin(np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False))
        hidden = 0.5 * size
        steps = []
        for force in self.library:
            names = dict.fromkeys((*force.state, *force.memory), hidden)
            # A force that grows with time is nothing at first, one that is periodic nothing at times.
            times = np.linspace(0.0, float(record.time[-1] - record.time[0]), len(x))
            scale = np.sqrt(np.mean(force.value(x, v, times, shapes=self.shapes, hidden=names) ** 2))
            steps.append(REACH * size / (phase * max(float(scale), 1e-9)))
        count = len(self.library)
        steps += [1e-5 * max(abs(value), 1e-3) for value in unknown[count : len(self.names)]]
        steps += [REACH * frequency / phase] if self.free else []
        return np.array([*steps, REACH * size, REACH * size * frequency, REACH * size])
