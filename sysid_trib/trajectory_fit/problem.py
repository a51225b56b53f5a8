"""Records and parameters of a trajectory fit: residuals of the motion, and their sensitivities."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import SimulationError
from sysid_trib.noise.autoregression import whitened
from sysid_trib.records.inputs import KnownInput
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import FAST, trajectory
from sysid_trib.trajectory_fit.observation import Observation
from sysid_trib.trajectory_fit.parameters import FREQUENCY, Parameters

# A motion is out of all proportion beyond so many swings of the record.
OUT_OF_PROPORTION = 10.0
# Sensitivities are forward differences over a step that moves the phase by about this much (rad).
PHASE_STEP = 1e-6
# The shortest part of a record that is tried where a motion cannot be computed to the end.
FIRST_SAMPLES = 20


@dataclass(frozen=True)
class WhitenedRecord:
    """One run, with what makes its noise white and of one level.

    Parameters
    ----------
    time : (sample,) array of float, s
        Times of the samples.
    angle : (sample,) array of float, rad
        Measured angle.
    filter_ : (tap,) array of float
        Filter that whitens the noise.
    weight : float, 1/rad
        One over the standard deviation of the whitened noise.
    engine : str or None
        Engine of the simulation.
    observation : Observation
        What was measured; `angle` and `weight` are in its unit.
    swing : float, rad, optional
        Largest angle, where that was not measured.
    known_input : KnownInput, optional
        What drives the motion.
    """

    time: Array
    angle: Array
    filter_: Array = field(default_factory=lambda: np.ones(1))
    weight: float = 1.0
    engine: str | None = None
    observation: Observation = field(default_factory=Observation)
    swing: float | None = None
    known_input: KnownInput | None = None

    @property
    def size(self) -> float:
        """Largest angle of the motion, rad."""
        return float(np.max(np.abs(self.angle))) if self.swing is None else self.swing

    def residual(self, model: Model, per_run: Array) -> Array:
        """Motion minus record.

        Parameters
        ----------
        model : Model
            The model.
        per_run : (3,) array of float
            Angle (rad) and rate (rad/s) at the first sample, and offset (rad).

        Returns
        -------
        (sample,) array of float, rad

        Notes
        -----
        A motion that is out of all proportion, or that cannot be computed, has a penalty in its place that
        leads back. Where the frequency or the start is outside of the allowed region, it grows with the
        distance from that region. Else the residual is that of the first part of the record that the motion
        can be computed for. Where there is none, the penalty grows with the coefficients, without which every
        motion can be computed.
        """
        model = replace(model, known_input=self.known_input)
        far = OUT_OF_PROPORTION * self.size
        # The highest frequency that samples show. An optimiser astray asks for hours of faster swings.
        highest = np.pi * (len(self.time) - 1) / (self.time[-1] - self.time[0])
        angle, rate, offset = per_run.tolist()
        excess = max(model.reference_frequency / highest, abs(angle) / far, abs(rate) / (far * highest))
        if excess > 1.0:
            return _penalty(far, excess - 1.0, len(self.time))

        def residual(count: int, engine: str | None) -> Array | None:
            try:
                motion = trajectory(model, self.time[:count], angle, rate, engine=engine)
            except SimulationError:
                return None
            shown = self.observation.shown(model, motion, self.time[:count])
            return np.asarray(shown + offset - self.angle[:count])

        if (whole := residual(len(self.time), self.engine)) is not None:
            return whole
        count, first = FIRST_SAMPLES, None
        while count < len(self.time) and (longer := residual(count, FAST)) is not None:
            count, first = 2 * count, longer
        if first is None:
            return _penalty(far, float(np.linalg.norm(list(model.coefficients.values()))), len(self.time))
        # Compressed: what diverges is not to count for more than what cannot be computed.
        size = np.maximum(np.abs(first) / far, 1.0)
        return np.append(first / size * (1.0 + np.log(size)), np.full(len(self.time) - len(first), far))

    def white(self, values: Array) -> Array:
        """Values with noise of one level and no colour."""
        return self.weight * whitened(values, self.filter_)


def _penalty(far: float, distance: float, count: int) -> Array:
    """A residual above `far` whose least squares are where the distance is zero."""
    residual = np.full(count, np.sqrt(2.0) * far)
    residual[::2] = far * distance
    return residual


@dataclass(frozen=True)
class FitProblem:
    """The runs and the parameters of their motions.

    Parameters
    ----------
    parameters : Parameters
        What the vector of values holds.
    records : tuple of WhitenedRecord
        The runs.
    """

    parameters: Parameters
    records: tuple[WhitenedRecord, ...]

    def first(self, part: float) -> "FitProblem":
        """The problem of the first part of each record."""
        counts = [max(20, round(part * len(record.time))) for record in self.records]
        cut = [
            replace(record, time=record.time[:count], angle=record.angle[:count])
            for record, count in zip(self.records, counts, strict=True)
        ]
        return replace(self, records=tuple(cut))

    def residuals(self, values: Array) -> list[Array]:
        """Motion minus record of each run, (sample,) array of float each, rad."""
        model, per_run = self.parameters.model(values), self.parameters.per_run(values)
        return [record.residual(model, start) for record, start in zip(self.records, per_run, strict=True)]

    def white(self, values: Sequence[Array]) -> Array:
        """Values of each run, (sample, ...), whitened, one after the other."""
        return np.concatenate([record.white(v) for record, v in zip(self.records, values, strict=True)])

    def white_residual(self, values: Array) -> Array:
        """Whitened residuals of all runs, one after the other, (sample,) array of float."""
        return self.white(self.residuals(values))

    def white_sensitivity(self, values: Array, residuals: Sequence[Array]) -> Array:
        """Derivative of the whitened residuals by each parameter, as if none were tied.

        Parameters
        ----------
        values : (parameter,) array of float
            Where it is taken.
        residuals : sequence of (sample,) array of float, rad
            The residuals there, of each run.

        Returns
        -------
        (sample, parameter) array of float; 0 for parameters that are fixed.
        """
        return self.white([self._sensitivity(values, run, here) for run, here in enumerate(residuals)])

    def _sensitivity(self, values: Array, run: int, here: Array) -> Array:
        """Derivative of one run's residual (`here`) by all parameters."""
        parameters, record = self.parameters, self.records[run]
        table = np.zeros((len(here), len(values)))
        *places, offset = [*range(len(parameters.common)), *range(len(values))[parameters.of_run(run)]]
        table[:, offset] = 1.0
        for i, step in zip(places, self._steps(values, record), strict=True):
            if parameters.names[i] not in parameters.constraints.fixed:
                stepped = values.copy()
                stepped[i] += step
                start = parameters.per_run(stepped)[run]
                table[:, i] = (record.residual(parameters.model(stepped), start) - here) / step
        return table

    def _steps(self, values: Array, record: WhitenedRecord) -> list[float]:
        """Steps of the common parameters, and of a run's start: each moves the phase at the end as much."""
        parameters = self.parameters
        size = record.size
        frequency = parameters.model(values).reference_frequency
        duration = float(record.time[-1] - record.time[0])
        phase = frequency * duration + 1.0
        x = size * np.cos(np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False))
        v = size * np.sin(np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False))
        # A force that grows with time is nothing at first, one that is periodic nothing at times.
        times = np.linspace(0.0, duration, len(x))
        steps = {name: 1e-5 * max(abs(values[parameters.index(name)]), 1e-3) for name in parameters.common}
        for force in parameters.library:
            hidden = dict.fromkeys((*force.state, *force.memory), 0.5 * size)
            h = force.value(x, v, times, shapes=parameters.shapes, hidden=hidden)
            steps[force.symbol] = PHASE_STEP * size / (phase * max(float(np.sqrt(np.mean(h**2))), 1e-9))
        if FREQUENCY in steps:
            steps[FREQUENCY] = PHASE_STEP * frequency / phase
        return [*steps.values(), PHASE_STEP * size, PHASE_STEP * size * frequency]
