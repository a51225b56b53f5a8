"""Records and parameters of a trajectory fit: residuals of the motion, and their sensitivities."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.errors import SimulationError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.sensor_noise import autoregression, whitened
from sysid_trib.motion_fit.parameters import Parameters
from sysid_trib.records.inputs import KnownInput, inputs_for
from sysid_trib.records.runs import one_or_all
from sysid_trib.results import schema, variables
from sysid_trib.simulation.initial_conditions import true_start
from sysid_trib.simulation.measured_motion import measured_part
from sysid_trib.simulation.model import BY_ANGLE, BY_RATE, FREQUENCY, Model
from sysid_trib.simulation.motions import FEW_STEPS_A_PERIOD, STEPS_A_PERIOD, SimulatedMotion
from sysid_trib.simulation.stand_in import accuracy_of
from sysid_trib.simulation.trajectory import trajectory

# A motion is implausible beyond this multiple of the record's swing.
OUT_OF_PROPORTION = 10.0
# Relative step of a parameter for the difference quotient of a penalty.
PENALTY_STEP = 1e-5


@dataclass(frozen=True)
class WhitenedRecord:
    """One run, with the filter and weight that make its noise white and of unit variance.

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
    sensor : (str, float)
        Measured quantity (see `SimulatedMotion.shown`); `angle` and `weight` are in its unit.
    swing : float, rad, optional
        Largest angle, if the angle was not measured.
    inputs : mapping of str to KnownInput
        Inputs that drive the motion.
    uncounted : int
        Number of first samples that are not fitted, because the motion still depends on the initial states
        and memory.
    start_is_shown : bool
        Whether the start angle is the sensor's reading, which includes the sensor terms, instead of the
        motion's angle.
    """

    time: Array
    angle: Array
    filter_: Array = field(default_factory=lambda: np.ones(1))
    weight: float = 1.0
    sensor: tuple[str, float] = ("angle", 0.0)
    swing: float | None = None
    inputs: Mapping[str, KnownInput] = field(default_factory=dict)
    uncounted: int = 0
    start_is_shown: bool = False

    @classmethod
    def of_decay(cls, decay: xr.Dataset, library: ForceLibrary, warm_up: float) -> "WhitenedRecord":
        """Return the measurement of a run in the measured quantity: a rate is not integrated."""
        sensor, time, values = measured_part(decay)
        swing = None if sensor[0] == "angle" else float(np.max(np.abs(decay.angle.values)))
        inputs, uncounted = inputs_for(decay, library), int(np.searchsorted(time, time[0] + warm_up))
        # Smallest number of samples after a warm-up.
        if len(time) - uncounted < 20:
            raise UsageError(
                f"A warm-up of {warm_up:g} s leaves {len(time) - uncounted} samples; give a shorter one."
            )
        return cls(time, values, sensor=sensor, swing=swing, inputs=inputs, uncounted=uncounted)

    @property
    def size(self) -> float:
        """Largest angle of the motion, rad."""
        return float(np.max(np.abs(self.angle))) if self.swing is None else self.swing

    def first(self, part: float) -> "WhitenedRecord":
        """Return the first part of the fitted samples, with the samples before them."""
        count = self.uncounted + max(20, round(part * (len(self.time) - self.uncounted)))
        return replace(self, time=self.time[:count], angle=self.angle[:count])

    def residual(self, model: Model, per_run: Array) -> Array:
        """Return motion minus record.

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
        A penalty replaces a motion that is implausibly large or cannot be computed, and leads the optimiser
        back. If the frequency or the start is outside of the allowed region, the penalty grows with the
        distance from that region. Otherwise the residual is that of the first part of the record for which
        the motion can be computed. If there is no such part, the penalty grows with the coefficients, because
        without forces every motion can be computed.
        """
        far = OUT_OF_PROPORTION * self.size
        if (excess := self._excess(model, per_run)) > 1.0:
            return _penalty(far, excess - 1.0, len(self.time))
        if (motion := self._motion(model, per_run)) is not None:
            return self._difference(motion, per_run)
        # Shortest part of a record that is tried if a motion cannot be computed to the end.
        count, first = 20, None
        while count < len(self.time) and (motion := self._motion(model, per_run, count)) is not None:
            count, first = 2 * count, self._difference(motion, per_run)
        if first is None:
            return _penalty(far, float(np.linalg.norm(list(model.coefficients.values()))), len(self.time))
        # Compress large values: a diverging motion must not have a larger residual than one that cannot be
        # computed.
        size = np.maximum(np.abs(first) / far, 1.0)
        return np.append(first / size * (1.0 + np.log(size)), np.full(len(self.time) - len(first), far))

    def sensitivity(self, model: Model, per_run: Array, by: Sequence[str]) -> Array | None:
        """Return derivatives of the residual by parameters, (sample, parameter); None if it is a penalty."""
        if self._excess(model, per_run) > 1.0:
            return None
        motion = self._motion(model, per_run, by=by)
        if motion is None:
            return None
        columns = motion.shown_derivatives(*self.sensor)
        if self.start_is_shown and model.sensors:
            # A sensor term changes the start angle that gives the same reading.
            columns = columns + np.outer(columns[:, by.index(BY_ANGLE)], motion.start_by_sensor)
        return columns

    def _excess(self, model: Model, per_run: Array) -> float:
        """Return frequency or start over its largest plausible value, whichever ratio is larger."""
        # A diverging optimiser would ask for very fast swings, which take hours to compute.
        highest = np.pi * (len(self.time) - 1) / (self.time[-1] - self.time[0])
        far, (angle, rate, _) = OUT_OF_PROPORTION * self.size, per_run.tolist()
        return float(max(model.reference_frequency / highest, abs(angle) / far, abs(rate) / (far * highest)))

    def _motion(
        self, model: Model, per_run: Array, count: int | None = None, by: Sequence[str] = ()
    ) -> SimulatedMotion | None:
        acting, (angle, rate) = replace(model, inputs=self.inputs), self.start_of(model, per_run)
        # A motion without internal states takes more steps only if it diverges.
        plain = all(force.memoryless for force in model.library)
        steps = FEW_STEPS_A_PERIOD if plain else STEPS_A_PERIOD
        try:
            return trajectory(
                acting,
                self.time[:count],
                angle,
                rate,
                by=by,
                most_steps=steps,
                accuracy=accuracy_of(acting),
            )
        except SimulationError:
            return None

    def start_of(self, model: Model, per_run: Array) -> tuple[float, float]:
        """Return angle (rad) and rate (rad/s) of the motion at the first sample."""
        angle, rate, _ = per_run.tolist()
        return true_start(model, angle, rate) if self.start_is_shown else angle, rate

    def _difference(self, motion: SimulatedMotion, per_run: Array) -> Array:
        return np.asarray(motion.shown(*self.sensor) + per_run[2] - self.angle[: len(motion.angle)])

    def white(self, values: Array) -> Array:
        """Return the fitted samples of values, whitened and with unit variance of the noise."""
        return self.weight * whitened(values, self.filter_)[self.uncounted :]


def _penalty(far: float, distance: float, count: int) -> Array:
    """Return a residual larger than `far` whose sum of squares is smallest at distance zero."""
    residual = np.full(count, np.sqrt(2.0) * far)
    residual[::2] = far * distance
    return residual


@dataclass(frozen=True)
class FitProblem:
    """The runs and the parameters of their motions.

    Parameters
    ----------
    parameters : Parameters
        Names and order of the parameters in the vector of values.
    records : tuple of WhitenedRecord
        Measured values of the runs.
    runs : sequence of xarray.Dataset
        The decays themselves.
    offered : ForceLibrary
        All offered forces.
    """

    parameters: Parameters
    records: tuple[WhitenedRecord, ...]
    runs: Sequence[xr.Dataset]
    offered: ForceLibrary

    @property
    def driven(self) -> bool:
        """True if inputs drive each motion."""
        return all(record.inputs for record in self.records)

    def first(self, part: float) -> "FitProblem":
        """Return the problem with the first part of each record."""
        return replace(self, records=tuple(record.first(part) for record in self.records))

    def with_filters(self, filters: Sequence[Array]) -> "FitProblem":
        """Return the problem with a filter for each run that whitens its noise."""
        pairs = zip(self.records, filters, strict=True)
        return replace(self, records=tuple(replace(record, filter_=filter_) for record, filter_ in pairs))

    def weighted(self, values: Array, *, coloured: bool) -> "FitProblem":
        """Return the problem with the weight of each run's residual and, if wanted, its colour."""
        records = []
        for record, residual in zip(self.records, self.residuals(values), strict=True):
            filter_ = autoregression(residual) if coloured else np.ones(1)
            white = whitened(residual, filter_)[record.uncounted :]
            records.append(replace(record, filter_=filter_, weight=1.0 / root_mean_square(white)))
        # Weights are relative to the RMS noise, so that a whitened residual is an angle.
        common = root_mean_square([1.0 / record.weight for record in records])
        return replace(self, records=tuple(replace(r, weight=common * r.weight) for r in records))

    def residuals(self, values: Array) -> list[Array]:
        """Return the motion minus record of each run, (sample,) array of float each, rad."""
        parameters, per_run = self.parameters, self.parameters.per_run(values)
        pairs = enumerate(zip(self.records, per_run, strict=True))
        return [record.residual(parameters.model(values, run), start) for run, (record, start) in pairs]

    def white(self, values: Sequence[Array]) -> Array:
        """Return values of each run, (sample, ...), whitened, one after the other."""
        return np.concatenate([record.white(v) for record, v in zip(self.records, values, strict=True)])

    def white_sensitivity(self, values: Array, residuals: Sequence[Array]) -> Array:
        """Return the derivative of the whitened residuals by the free parameters, (sample, free).

        Parameters
        ----------
        values : (parameter,) array of float
            Values at which the derivative is taken.
        residuals : sequence of (sample,) array of float, rad
            Residuals of each run at these values.
        """
        tables = [self._sensitivity(values, run, here) for run, here in enumerate(residuals)]
        return np.asarray(self.white(tables) @ self.parameters.jacobian(values))

    def _sensitivity(self, values: Array, run: int, here: Array) -> Array:
        """Return derivatives of a run's residual (`here`) by parameters without ties; 0 for fixed ones."""
        parameters, record = self.parameters, self.records[run]
        table = np.zeros((len(here), len(values)))
        *starts, offset = range(len(values))[parameters.of_run(run)]
        fixed, common = parameters.constraints.fixed, parameters.common
        moving = [i for i in parameters.acting(run) if common[i] not in fixed]
        names, places = [*(common[i] for i in moving), BY_ANGLE, BY_RATE], [*moving, *starts]
        columns = record.sensitivity(parameters.model(values, run), parameters.per_run(values)[run], names)
        if columns is not None:
            table[:, places], table[:, offset] = columns, 1.0
            return table
        for i in (*places, offset):
            stepped = values.copy()
            stepped[i] += PENALTY_STEP * max(abs(values[i]), PENALTY_STEP)
            start = parameters.per_run(stepped)[run]
            residual = record.residual(parameters.model(stepped, run), start)
            table[:, i] = (residual - here) / (stepped[i] - values[i])
        return table

    def identification(
        self,
        method: Any,
        values: Array,
        covariance: Array,
        noises: Sequence[float],
        extra: Mapping[str, tuple[ArrayLike, str, str]],
    ) -> xr.Dataset:
        """Return a fit as the Dataset that every method returns.

        Parameters
        ----------
        method : dataclass with `shapes`
            The method, for the provenance.
        values, covariance : (parameter,) and (parameter, parameter) array of float
            The fitted values, and their covariance.
        noises : sequence of float, rad
            The sensor's noise in each run.
        extra : mapping of str to (values, units, long_name)
            Further variables, each with one number or one value per run.
        """
        parameters = self.parameters
        model, per_run = parameters.model(values), parameters.per_run(values)
        # Coefficients, then the frequency; the row of a held frequency is zero.
        count = len(parameters.library)
        places = [at for at, name in enumerate(parameters.common) if at < count or name == FREQUENCY]
        of_both = np.zeros((count + 1, count + 1))
        of_both[: len(places), : len(places)] = covariance[np.ix_(places, places)]
        pairs = enumerate(zip(self.records, per_run, strict=True))
        starts = [record.start_of(parameters.model(values, run), start) for run, (record, start) in pairs]
        of_starts = variables.start_variables(starts, per_run[:, 2])
        frequency, method = model.reference_frequency, replace(method, shapes=dict(model.shapes))
        errors = dict(zip(parameters.names, np.sqrt(np.diag(covariance)).tolist(), strict=True))
        shape_errors = {name: errors[name] for name in parameters.fit_shapes}
        extra = {**of_starts, **extra}
        estimate = schema.Estimate(values[:count], of_both, frequency, noises, extra, shape_errors)
        return schema.identification(
            method, one_or_all(self.runs), parameters.library, estimate, offered=self.offered
        )
