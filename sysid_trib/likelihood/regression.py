"""One record under regression: its weak form, its present estimate, and the path of its forces."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
import scipy.sparse as sp
import xarray as xr

from sysid_trib.arrays import Array, Mask, dependent_columns
from sysid_trib.errors import DecayError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.likelihood.force_columns import cell_averages, derivatives_along, value_along
from sysid_trib.likelihood.least_squares import ConstraintMap
from sysid_trib.likelihood.sensor_noise import NoiseModel, covariance_band
from sysid_trib.likelihood.variance_ratio import VarianceRatio
from sysid_trib.likelihood.weak_form import WeakForm, build_weak_form, cholesky_factor, noise_operator
from sysid_trib.records.inputs import KnownInput, inputs_for, values_of_inputs
from sysid_trib.records.roles import INPUT
from sysid_trib.records.smoothing import first_frequency, nominal_frequency, sensor_noise, smooth


@dataclass(frozen=True)
class RunRegression:
    """One record, its present estimate, and the path along which the forces are evaluated.

    Attributes
    ----------
    time, angle : (sample,) array of float, s and rad
    form : WeakForm
        Weak form on tau = `nominal_frequency` * time.
    library : ForceLibrary
        The offered forces, and terms of the sensor.
    shapes : mapping of str to float
    nominal_frequency : float, rad/s
    frequency_free : bool
        Whether the reference frequency is fitted.
    inputs : mapping of str to KnownInput
        Inputs of the record, by their names.
    run : int
        Number of the record, from 1.
    sensor, sensor_alone : NoiseModel
        Noise of the sensor with a random force and without one; each has its own colour.
    x, v : (sample,) array of float, rad
        theta and theta'/w of the path.
    columns : (sample, force) array of float, rad
        Forces and sensor terms along the path, with coefficient 1.
    coefficients : (force,) array of float
        Coefficients, common to all runs.
    frequency : float, rad/s
        Reference frequency, common to all runs.
    start : (float, float), rad and rad/s
        Angle and rate of the motion at the first sample.
    offset : float, rad
        Zero of the sensor.
    ratio : VarianceRatio or None
        Growth of the variance of v per unit of tau due to a random force, over the innovation variance of the
        sensor's noise; None if the only noise is the sensor's, and white.
    exact : bool
        Whether the path is a motion of the present model instead of the smoothed record.
    near : pair of (sample,) array of float, rad, or None
        An exact motion near a path that is not exact: theta, and (w/nominal)^2 (x + sum c h) along it. Its
        weak form vanishes, so only the difference from it has to be integrated accurately. A known input is
        the same for both motions and not part of it.
    sensitivity : (sample, 2) array of float or None
        Sensitivity of a motion of the model to its start, if a nearby one is known (see `fit_start`).
    """

    time: Array
    angle: Array
    form: WeakForm
    library: ForceLibrary
    shapes: Mapping[str, float]
    nominal_frequency: float
    frequency_free: bool
    inputs: Mapping[str, KnownInput]
    run: int
    sensor: NoiseModel
    sensor_alone: NoiseModel
    x: Array
    v: Array
    columns: Array
    coefficients: Array
    frequency: float
    start: tuple[float, float]
    offset: float = 0.0
    ratio: VarianceRatio | None = None
    exact: bool = False
    near: tuple[Array, Array] | None = None
    sensitivity: Array | None = None

    @property
    def elapsed(self) -> Array:
        """Time since the first sample, (sample,), s."""
        return self.time - self.time[0]

    @cached_property
    def bound(self) -> ForceLibrary:
        """Forces whose formulas have the present coefficients of other forces as numbers."""
        return self.library.bound(dict(zip(self.library.symbols, self.coefficients.tolist(), strict=True)))

    @property
    def stiffness_scale(self) -> float:
        """(frequency/nominal)^2."""
        return (self.frequency / self.nominal_frequency) ** 2

    @cached_property
    def forcing(self) -> Array | float:
        """Direct forcing over nominal^2 at the samples, (sample,), rad; zero without one."""
        known = self.inputs.get(INPUT)
        return 0.0 if known is None else known.of(self.elapsed) / self.nominal_frequency**2

    @cached_property
    def acts(self) -> Mask:
        """Mask of the forces that act on the motion of this run: no sensor terms, no terms of another run."""
        return np.array([force.kind == "force" and force.run in (None, self.run) for force in self.library])

    @cached_property
    def of_sensor(self) -> Mask:
        """Mask of the sensor terms of the library, (force,)."""
        return np.array([force.kind == "sensor" for force in self.library])

    @property
    def noise(self) -> float:
        """Standard deviation of the sensor's noise, or of its innovations if it is coloured (rad)."""
        return self.sensor.innovation if self.ratio is None else float(np.sqrt(self.ratio.variance))

    @property
    def acting(self) -> Array:
        """Coefficients (force,) of the forces that act on the motion of this run; zero for the others."""
        return np.where(self.acts, self.coefficients, 0.0)

    @property
    def measured(self) -> Array:
        """The record as an angle of the motion, (sample,), rad, without the sensor's zero and terms."""
        return self.angle - self.offset - self.columns @ np.where(self.of_sensor, self.coefficients, 0.0)

    @cached_property
    def gain(self) -> Array:
        """Derivative 1 + sum s dh/dx of the sensor's reading by the angle, (sample,), along the path."""
        own = [force.run in (None, self.run) for force in self.library]
        pairs = zip(self.library, np.where(own, self.coefficients, 0.0).tolist(), strict=True)
        terms = ((force, c, self.shapes) for force, c in pairs)
        return 1.0 + derivatives_along(terms, (self.elapsed, self.x, self.v), kind="sensor")[0]

    @cached_property
    def operator(self) -> sp.csr_matrix:
        """The operator of small deviations about the path, (row, sample); it does not depend on the noise.

        It acts on the sensor's reading: where sensor terms amplify a deviation of the motion, it divides by
        the gain.
        """
        k, time, acting = self.stiffness_scale, self.elapsed, self.acting.tolist()
        given = {name: values for force in self.library for name, values in self.given(force, time).items()}
        terms = ((force, c, self.shapes) for force, c in zip(self.bound, acting, strict=True))
        stiffness, damping = derivatives_along(terms, (time, self.x, self.v), given)
        matrix = noise_operator(self.form, k * (1.0 + stiffness), np.sqrt(k) * damping)
        return (matrix @ sp.diags_array(1.0 / self.gain)).tocsr() if self.of_sensor.any() else matrix

    @cached_property
    def white_factor(self) -> Array:
        """Cholesky factor of the covariance of the rows about the path, for white noise of unit size."""
        return cholesky_factor(covariance_band(self.operator))

    def given(self, force: Force, time: Array) -> dict[str, Array]:
        """Return the inputs of a force at times (s) since the first sample."""
        return values_of_inputs(self.inputs, force.channels, time, self.frequency)

    def columns_along(
        self, x: Array, v: Array, rate_error: float = 0.0, known: Mapping[str, Array] | None = None
    ) -> Array:
        """Return cell averages of forces, and terms of the sensor, along a path, (sample, force).

        Parameters
        ----------
        x, v : (sample,) array of float, rad
            theta and theta'/frequency.
        rate_error : float, rad
            Standard error of v.
        known : mapping of str to (sample,) array of float, optional
            Internal states and memory that are known, `{"dahl.z": ...}`.
        """
        acceleration = np.gradient(v, self.form.tau) * (self.nominal_frequency / self.frequency)
        columns = np.zeros((len(x), len(self.library)))
        memoryless = np.array([force.memoryless for force in self.library])
        averaged, motion = np.flatnonzero(self.acts & memoryless), (self.elapsed, x, v)
        forces = [self.bound.forces[at] for at in averaged]
        columns[:, averaged] = cell_averages(
            forces, (*motion, acceleration), self.frequency, self.shapes, self.given, rate_error
        )
        # Internal states are continuous, so cell averages are not needed; they would be costly.
        for at in np.flatnonzero(self.acts & ~memoryless):
            force = self.library.forces[at]
            columns[:, at] = value_along(force, motion, self.frequency, self.shapes, self.given, known)
        for at in np.flatnonzero(self.of_sensor):
            term = self.library.forces[at]
            # A sensor term of another run is zero in this run.
            if term.run in (None, self.run):
                columns[:, at] = term.value(x, v, self.elapsed, shapes=self.shapes)
        return columns

    def along_own_path(self) -> "RunRegression":
        """Return the run with the columns of its path at its present frequency."""
        columns = self.columns_along(self.x, self.v)
        return replace(self, columns=columns, exact=False, near=None, sensitivity=None)


Runs: TypeAlias = tuple[RunRegression, ...]


def begin(
    decays: Sequence[xr.Dataset],
    library: ForceLibrary,
    constraints: ConstraintMap,
    *,
    reference_frequency: float | None,
    shapes: Mapping[str, float],
) -> Runs:
    """Return the weak forms of the runs, with the smoothed records as first paths.

    Parameters
    ----------
    decays : sequence of Dataset
        Runs with `angle(time)`.
    library : ForceLibrary
        The forces to identify.
    constraints : ConstraintMap
    reference_frequency : float or None, rad/s
        Reference frequency, which is fixed; with None it is fitted.
    shapes : mapping of str to float

    Returns
    -------
    tuple of RunRegression

    Raises
    ------
    DecayError
        The records are too short, or some forces are identical on them.
    """
    # Scale of time: near the frequency of the motion, and the same for all runs.
    free = reference_frequency is None
    nominal = reference_frequency or nominal_frequency(first_frequency(decays))
    # Held forces act from the first estimate on, so that a held stiffness does not change the fitted
    # frequency.
    held = constraints.impose(np.zeros(len(library)))
    runs = []
    for number, decay in enumerate(decays, 1):
        time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
        form = build_weak_form(nominal * (time - time[0]))
        x, v, _, _ = smooth(form.tau, angle)
        inputs, white = inputs_for(decay, library), NoiseModel(sensor_noise(decay), np.ones(1))
        record = (time, angle, form, library, dict(shapes), nominal, free, inputs, number)
        start = float(x[0]), float(v[0] * nominal)
        run = RunRegression(*record, white, white, x, v, np.empty((0, 0)), held, nominal, start)
        runs.append(run.along_own_path())
    rows = sum(run.form.rows for run in runs)
    # The penalty of a curve separates its basis functions.
    outside = [at for at, i in enumerate(constraints.free) if not library.forces[i].curve]
    names = [library.symbols[constraints.free[at]] for at in outside]
    count = sum(not force.curve for force in library)
    if rows < count + 3 + len(runs):
        raise DecayError(f"{rows} rows cannot determine {count} forces; give a longer record.")
    columns = np.concatenate([_as_forces(run) for run in runs]) @ constraints.matrix[:, outside]
    if free:
        columns = np.column_stack([columns, np.concatenate([run.x for run in runs])])
        names.append("the frequency")
    if same := dependent_columns(columns):
        equal = " and ".join(names[i] for i in same[0])
        raise DecayError(f"On this record {equal} are the same force; leave one out (--forces).")
    return tuple(runs)


def _as_forces(run: RunRegression) -> Array:
    """Return the columns of the first path, (sample, force): sensor terms as equivalent forces."""
    columns, tau = run.columns.copy(), run.form.tau
    if run.of_sensor.any():
        terms = columns[:, run.of_sensor]
        columns[:, run.of_sensor] = terms + np.gradient(np.gradient(terms, tau, axis=0), tau, axis=0)
    return columns


def with_common_values(runs: Sequence[RunRegression], coefficients: Array, frequency: float) -> Runs:
    """Return the runs with these coefficients (force,) and this reference frequency (rad/s)."""
    return tuple(replace(run, coefficients=coefficients, frequency=frequency) for run in runs)


def common_values(runs: Runs) -> Array:
    """Return coefficients and reference frequency."""
    return np.append(runs[0].coefficients, runs[0].frequency)


def shifted(runs: Runs, by: Array, constraints: ConstraintMap) -> Runs:
    """Return the runs with other coefficients and another reference frequency, by (force + 1,)."""
    common = common_values(runs) + by
    return with_common_values(runs, constraints.impose(common[:-1]), float(common[-1]))
