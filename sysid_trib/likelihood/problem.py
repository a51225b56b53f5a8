"""What the weak form of a record holds, and the estimate of its forces under way."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.cycles.identifiability import dependent_columns
from sysid_trib.errors import DecayError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.colour import NoisePair
from sysid_trib.likelihood.optimizers import ConstraintMap
from sysid_trib.likelihood.weak_form import WeakForm, build_weak_form
from sysid_trib.records.inputs import INPUT, KnownInput, inputs_for, values_of_inputs
from sysid_trib.records.smoothing import first_frequency, nominal_frequency, sensor_noise, smooth
from sysid_trib.simulation.model import rescaling_factors

if TYPE_CHECKING:
    from sysid_trib.likelihood.pysindy_features import ForceFeatures


@dataclass(frozen=True)
class WeakFormProblem:
    """What is held of one record.

    Attributes
    ----------
    time, angle : (sample,) array of float, s and rad
    form : WeakForm
        On tau = `nominal_frequency` * time.
    library : ForceLibrary
        The forces offered, and terms of the sensor.
    shapes : mapping of str to float
    nominal_frequency : float, rad/s
    frequency_free : bool
        Whether the reference frequency is fitted.
    noise : float, rad
        Standard deviation of a sample.
    inputs : mapping of str to KnownInput
        Of the record, by their names.
    run : int
        Number of the record, from 1.
    """

    time: Array
    angle: Array
    form: WeakForm
    library: ForceLibrary
    shapes: Mapping[str, float]
    nominal_frequency: float
    frequency_free: bool
    noise: float
    inputs: Mapping[str, KnownInput] = field(default_factory=dict)
    run: int = 1

    @property
    def elapsed(self) -> Array:
        """Time since the first sample, (sample,), s."""
        return self.time - self.time[0]

    def features(self, frequency: float) -> "ForceFeatures":
        """The forces as a feature library of pysindy, at a reference frequency (rad/s)."""
        # Here, since importing pysindy takes as long as twenty identifications.
        from sysid_trib.likelihood.pysindy_features import ForceFeatures

        features = ForceFeatures(self.library, reference_frequency=frequency, shapes=self.shapes)
        return features.driven_by(self.inputs)

    @cached_property
    def forcing(self) -> Array | float:
        """What pushes by itself over nominal^2 at the samples, (sample,), rad; zero without any."""
        known = self.inputs.get(INPUT)
        return 0.0 if known is None else known.of(self.elapsed) / self.nominal_frequency**2

    def given(self, frequency: float) -> dict[str, Array]:
        """What formulas hold of the inputs at the samples, by name, (sample,) each."""
        return values_of_inputs(self.inputs, self.library.channels, self.elapsed, frequency)

    @cached_property
    def acts(self) -> Mask:
        """Which forces drive the motion of this run: no terms of the sensor, none of another run's own."""
        return np.array([force.kind == "force" and force.run in (None, self.run) for force in self.library])

    @cached_property
    def of_sensor(self) -> Mask:
        """Which of the library are terms of the sensor, (force,) array of bool."""
        return np.array([force.kind == "sensor" for force in self.library])

    def averaged_columns(
        self,
        frequency: float,
        x: Array,
        v: Array,
        *,
        rate_error: float = 0.0,
        hidden: Mapping[str, Array] | None = None,
    ) -> Array:
        """Forces, averaged over each sample's cell, and terms of the sensor along a path, (sample, force).

        Values at the samples alone would turn with the sampling where a period has a whole number of them:
        a sign that is off in the same places of every period seems to tell forces apart.

        Parameters
        ----------
        frequency : float, rad/s
            Reference frequency.
        x, v : (sample,) array of float, rad
            theta and theta'/frequency.
        rate_error : float, rad
            Standard error to which v is known.
        hidden : mapping of str to (sample,) array of float, optional
            Internal states and memory that are known, `{"dahl.z": ...}`.
        """
        acceleration = np.gradient(v, self.form.tau) * (self.nominal_frequency / frequency)
        forces = self.features(frequency).cell_averages(
            self.elapsed, x, v, acceleration, rate_error=rate_error, internal=hidden
        )
        columns = self.with_sensor_terms(forces, x, v)
        columns[:, ~(self.acts | self.of_sensor)] = 0.0
        return columns

    def with_sensor_terms(self, forces: Array, x: Array, v: Array) -> Array:
        """Columns of the forces with h(x, v, t) of each term of the sensor among them, (sample, force)."""
        if not self.of_sensor.any():
            return forces
        columns = np.empty((len(x), len(self.library)))
        columns[:, ~self.of_sensor] = forces
        for at in np.flatnonzero(self.of_sensor):
            columns[:, at] = self.library.forces[at].value(x, v, self.elapsed, shapes=self.shapes)
        return columns


@dataclass(frozen=True)
class NearbyMotion:
    """An exact motion near the reference trajectory: of it the weak form vanishes, whatever the sampling.

    Attributes
    ----------
    x : (sample,) array of float, rad
        theta.
    force : (sample,) array of float, rad
        (w/nominal)^2 (x + sum c h) along it; a known input, the same for both motions, is no part of it.
    """

    x: Array
    force: Array


@dataclass(frozen=True)
class ReferenceTrajectory:
    """The motion along which the forces are evaluated.

    Attributes
    ----------
    x, v : (sample,) array of float, rad
        theta and theta'/w.
    columns : (sample, force) array of float, rad
        Of forces, and of terms of the sensor.
    exact : bool
        Whether it is a motion of the present model, not the smoothed record.
    near : NearbyMotion or None
        Where it is neither: so that sums of the weak form need be right of the difference alone.
    """

    x: Array
    v: Array
    columns: Array
    exact: bool
    near: NearbyMotion | None = None

    @property
    def rms_forces(self) -> Array:
        """RMS of each force along the motion (force,), rad: a coefficient in units of it is a force."""
        rms = np.sqrt(np.mean(self.columns**2, axis=0))
        return np.where(rms > 0, rms, 1.0)


@dataclass(frozen=True)
class RunRegression:
    """One record, its present estimate and the motion that belongs to it.

    Attributes
    ----------
    problem : WeakFormProblem
        What is held.
    reference : ReferenceTrajectory
        The motion.
    coefficients : (force,) array of float
        Common to all runs.
    frequency : float, rad/s
        Reference frequency, common to all runs.
    offset : float, rad
        Zero of the sensor.
    start : (float, float), rad and rad/s
        Angle and rate of the motion at the first sample.
    noises : NoisePair or None
        A random force and the colour of the sensor's noise; None where the noise is the sensor's, and white.
    """

    problem: WeakFormProblem
    reference: ReferenceTrajectory
    coefficients: Array
    frequency: float
    offset: float
    start: tuple[float, float]
    noises: NoisePair | None = None

    @property
    def noise(self) -> float:
        """Standard deviation of the sensor's noise, of its innovations where it is coloured (rad)."""
        return self.problem.noise if self.noises is None else float(np.sqrt(self.noises.ratio.variance))

    @property
    def acting(self) -> Array:
        """The coefficients (force,), zero for terms of the sensor: what drives the motion of this run."""
        return np.where(self.problem.acts, self.coefficients, 0.0)

    @property
    def measured(self) -> Array:
        """The record as an angle of the motion, (sample,), rad: without the sensor's zero and its terms."""
        terms = np.where(self.problem.of_sensor, self.coefficients, 0.0)
        return self.problem.angle - self.offset - self.reference.columns @ terms


Runs: TypeAlias = tuple[RunRegression, ...]


def begin(
    decays: Sequence[xr.Dataset],
    library: ForceLibrary,
    constraints: ConstraintMap,
    *,
    reference_frequency: float | None,
    shapes: Mapping[str, float],
) -> Runs:
    """Weak forms of the runs, with the smoothed records as first reference trajectories.

    Parameters
    ----------
    decays : sequence of Dataset
        With `angle(time)`.
    library : ForceLibrary
        The forces to identify.
    constraints : ConstraintMap
    reference_frequency : float or None, rad/s
        None has it fitted.
    shapes : mapping of str to float

    Returns
    -------
    tuple of RunRegression

    Raises
    ------
    DecayError
        The records are too short, or some of the forces are the same on them.
    """
    # A scale of time: near the motion's frequency, and the same for all runs.
    free = reference_frequency is None
    nominal = reference_frequency or nominal_frequency(first_frequency(decays))
    # What is held acts from the first estimate on: a stiffness is no part of the frequency then.
    held = constraints.impose(np.zeros(len(library)))
    first = [_first_run(decay, library, shapes, nominal, free, run) for run, decay in enumerate(decays, 1)]
    runs = tuple(replace(run, coefficients=held) for run in first)
    rows = sum(run.problem.form.rows for run in runs)
    if rows < len(library) + 3 + len(runs):
        raise DecayError(f"{rows} rows cannot decide {len(library)} forces; give a longer record.")
    columns = np.concatenate([_as_forces(run) for run in runs]) @ constraints.matrix
    names = [library.symbols[i] for i in constraints.free]
    if free:
        columns = np.column_stack([columns, np.concatenate([run.reference.x for run in runs])])
        names.append("the frequency")
    if same := dependent_columns(columns):
        equal = " and ".join(names[i] for i in same[0])
        raise DecayError(f"On this record {equal} are the same force; leave one out (--forces).")
    return runs


def _first_run(
    decay: xr.Dataset,
    library: ForceLibrary,
    shapes: Mapping[str, float],
    nominal: float,
    free: bool,
    run: int,
) -> RunRegression:
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    form = build_weak_form(nominal * (time - time[0]))
    x, v, _, _ = smooth(form.tau, angle)
    problem = WeakFormProblem(
        time,
        angle,
        form,
        library,
        dict(shapes),
        nominal,
        free,
        sensor_noise(decay),
        inputs_for(decay, library),
        run,
    )
    reference = ReferenceTrajectory(x, v, problem.averaged_columns(nominal, x, v), exact=False)
    start = float(x[0]), float(v[0] * nominal)
    return RunRegression(problem, reference, np.zeros(len(library)), nominal, 0.0, start)


def along_own_path(run: RunRegression) -> RunRegression:
    """A run with the columns of its path at its present frequency."""
    path = run.reference
    columns = run.problem.averaged_columns(run.frequency, path.x, path.v)
    return replace(run, reference=ReferenceTrajectory(path.x, path.v, columns, exact=False))


def _as_forces(run: RunRegression) -> Array:
    """Columns of the first path, (sample, force): in place of a sensor's term the force that shows alike."""
    columns, of_sensor, tau = run.reference.columns.copy(), run.problem.of_sensor, run.problem.form.tau
    if of_sensor.any():
        terms = columns[:, of_sensor]
        columns[:, of_sensor] = terms + np.gradient(np.gradient(terms, tau, axis=0), tau, axis=0)
    return columns


def update(runs: Runs, coefficients: Array, steps: Array, constraints: ConstraintMap) -> Runs:
    """The runs with the next estimate; a fitted stiffness is turned into the reference frequency.

    Parameters
    ----------
    runs : tuple of RunRegression
    coefficients : (force,) array of float
    steps : (run,) or (run + 1,) array of float
        Zeros of the sensor (rad), then the stiffness where the frequency is fitted.
    constraints : ConstraintMap

    Returns
    -------
    tuple of RunRegression
        The columns of their motions are those before.
    """
    problem, former = runs[0].problem, runs[0].frequency
    frequency = former
    if problem.frequency_free:
        frequency = float(former * np.sqrt(max(0.25, 1.0 + steps[-1])))
        factors = rescaling_factors(problem.library.forces, former, frequency)
        # A force without a degree in v keeps its size at least: w^2 c stays. A term of the sensor has no w^2.
        factors = np.where(np.isnan(factors), (former / frequency) ** 2, factors)
        coefficients = coefficients * np.where(problem.of_sensor, 1.0, factors)
    coefficients = constraints.impose(coefficients)
    return tuple(
        replace(
            run,
            coefficients=coefficients,
            frequency=frequency,
            offset=run.offset + float(step),
            reference=replace(run.reference, v=run.reference.v * (former / frequency)),
        )
        for run, step in zip(runs, steps, strict=False)
    )
