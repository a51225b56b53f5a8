"""Influence of the samples on identifications, and the covariance of their difference.

To first order, a coefficient changes linearly with the noise of each sample; the factors are its influence
(Hampel 1974). The influences of two methods on the same samples give the scatter of their difference; if one
method is efficient, this is Hausman's test (Econometrica 1978).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import scipy
import scipy.linalg
import scipy.signal
import scipy.sparse as sp
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.likelihood.force_columns import derivatives_along
from sysid_trib.likelihood.least_squares import ConstraintMap, constraint_map
from sysid_trib.likelihood.sensor_noise import covariance_band, sensor_noise_of
from sysid_trib.likelihood.weak_form import build_weak_form, cholesky_factor, coloured, noise_operator, whiten
from sysid_trib.methods import Averaging, Direct, Trajectory, method_of
from sysid_trib.motion_fit.kalman import LinearModel
from sysid_trib.motion_fit.linearised import linearised_along
from sysid_trib.records.smoothing import first_frequency, nominal_frequency
from sysid_trib.results import models, schema
from sysid_trib.results.models import forces_in_model
from sysid_trib.results.random_force import random_force_of
from sysid_trib.simulation.initial_conditions import FittedMotion, first_zero
from sysid_trib.simulation.measured_motion import MEASURED
from sysid_trib.simulation.model import BY_ANGLE, BY_RATE, FREQUENCY
from sysid_trib.simulation.trajectory import trajectory
from sysid_trib.validation import common_reference
from sysid_trib.validation.residuals import FollowedRuns

# Condition number beyond which a record does not separate parameters.
WORST_CONDITION = 1e12


class Covariances(NamedTuple):
    """Covariances due to the noise of the samples, (quantity, quantity) each."""

    difference: Array
    first: Array
    second: Array


@dataclass(frozen=True)
class RunNoise:
    """Noise of a run in an identification: of the sensor, white or coloured, and a random force.

    Attributes
    ----------
    level : float, rad
        Standard deviation of the sensor's noise, or of its innovations if it is coloured.
    per_tau : float, rad^2
        Growth of the variance of v per unit of tau due to the random force.
    filter_ : (tap,) array of float
        Whitening filter of the sensor's noise.
    linear : LinearModel or None
        Linear model of the motion about itself; None if the noise is white.
    """

    level: float
    per_tau: float
    filter_: Array
    linear: LinearModel | None

    @cached_property
    def ratio(self) -> float:
        """Random force over the variance of the sensor's noise."""
        return self.per_tau / self.level**2

    def white(self, columns: Array) -> Array:
        """Return columns (sample, column) as innovations, in units of the sensor's noise."""
        if self.linear is None:
            return columns
        samples, size = self.linear.path.shape
        nothing = np.zeros((samples, size, columns.shape[1]))
        shown = replace(self.linear, observed_parameters=columns, start=nothing[0], by_column=nothing[1:])
        return shown.rows(self.ratio).design

    def transposed_white(self, columns: Array) -> Array:
        """Apply the transposed matrix of `white` to columns."""
        if self.linear is None:
            return columns
        gain, variance = self.linear.gains(self.ratio)
        weighted = columns / np.sqrt(variance)[:, None]
        source = self.linear.observed_states[:, :, None] * weighted[:, None]
        later = self.linear.recursion(gain, source, backward=True)
        weighted[:-1] -= np.einsum("na,nac->nc", gain[:-1], later[1:])
        return weighted

    def covariance(self, influence: Array) -> Array:
        """Return the covariance of numbers on which the samples have this influence, (number, sample)."""
        innovations = scipy.signal.lfilter([1.0], self.filter_, influence[:, ::-1], axis=1)
        covariance = self.level**2 * innovations @ innovations.T
        if self.linear is not None and self.per_tau:
            source = self.linear.observed[:, :, None] * influence.T[:, None]
            still = np.zeros(self.linear.path.shape)
            later = self.linear.recursion(still, source, backward=True)[1:]
            driven = self.linear.steps.diffusion @ later
            covariance += self.per_tau * np.einsum("sai,saj->ij", later, driven)
        return np.asarray(covariance)


@dataclass(frozen=True)
class WeakRows:
    """Rows of the equation in weak form, which contain part of the noise; same interface as `RunNoise`.

    Attributes
    ----------
    operator : (row, sample) sparse array of float
        Operator of small deviations about the motion.
    factor : (band, row) array of float
        Cholesky factor of the covariance of the rows, in units of the variance of the sensor's noise.
    """

    operator: sp.csr_matrix
    factor: Array

    def white(self, columns: Array) -> Array:
        """Return columns (sample, column) as white rows."""
        return whiten(self.factor, self.operator @ columns)

    def transposed_white(self, columns: Array) -> Array:
        """Apply the transposed matrix of `white` to columns."""
        solved, _ = scipy.linalg.lapack.dtbtrs(self.factor, columns, uplo="L", trans="T")
        return np.asarray(self.operator.T @ solved)


def covariances_of_difference(
    pair: Sequence[FollowedRuns], truth: FollowedRuns, kept: Sequence[str]
) -> Covariances | None:
    """Compute the covariance of the difference of two identifications to first order.

    Parameters
    ----------
    pair : sequence of FollowedRuns
        Both identifications.
    truth : FollowedRuns
        The identification whose noise and random force are used.
    kept : sequence of str
        Symbols of the compared forces.

    Returns
    -------
    Covariances or None
        Covariance of `common_reference.comparison_values`; None if the influence of a method is unknown.
    """
    try:
        noises = [_noise(truth, run) for run in truth.runs]
        frequency = truth.result.reference_frequency.item()
        influences = [_influence(followed, noises, kept, frequency) for followed in pair]
    except (SysidTribError, np.linalg.LinAlgError):
        return None
    first, second = influences
    if first is None or second is None:
        return None

    def covariance(influence: Sequence[Array]) -> Array:
        return np.sum([n.covariance(part) for n, part in zip(noises, influence, strict=True)], axis=0)

    difference = [a - b for a, b in zip(first, second, strict=True)]
    covariances = Covariances(covariance(difference), covariance(first), covariance(second))
    return covariances if all(np.all(np.isfinite(part)) for part in covariances) else None


def _noise(truth: FollowedRuns, run: int) -> RunNoise:
    """Return the noise of a run in an identification."""
    result, motion = truth.result, truth.motions[run]
    assert motion is not None
    sensor = sensor_noise_of(result, run)
    model = schema.model_of(result, run)
    per_tau = random_force_of(result, run).per_tau(model.reference_frequency)
    # Even a record without noise has a finite number of digits.
    level = max(sensor.innovation, 1e-12 * float(np.max(np.abs(motion.x))))
    if not per_tau and len(sensor.filter_) == 1:
        return RunNoise(level, 0.0, sensor.filter_, None)
    time = truth.runs[run].time.values.astype(float)
    linear = linearised_along(model, time, trajectory(model, time, motion.angle, motion.rate))
    return RunNoise(level, per_tau, sensor.filter_, replace(linear, sensor_filter=sensor.filter_))


@dataclass(frozen=True)
class _Parameters:
    """Free parameters of an identification; the reference frequency is the last, if it is free.

    Attributes
    ----------
    symbols : list of str
        Forces in the model.
    free : ConstraintMap
        Constraints of the coefficients of these forces.
    shapes : list of str
        Shape parameters that were fitted.
    frequency : bool
        Whether the reference frequency is free.
    """

    symbols: list[str]
    free: ConstraintMap
    shapes: list[str]
    frequency: bool

    @property
    def names(self) -> list[str]:
        """Names of the parameters by which the motion is differentiated."""
        return [*self.symbols, *self.shapes, *([FREQUENCY] if self.frequency else [])]

    @property
    def by_free(self) -> Array:
        """Derivatives of these parameters by the free parameters, (name, parameter)."""
        further = len(self.shapes) + self.frequency
        return np.asarray(scipy.linalg.block_diag(self.free.matrix, np.eye(further)))

    @property
    def values(self) -> Array:
        """Derivatives of coefficients and reference frequency by the free parameters, (force + 1, ...)."""
        table = self.by_free
        count = len(self.symbols)
        last = table[-1:] if self.frequency else np.zeros((1, table.shape[1]))
        return np.concatenate([table[:count], last])


def _parameters(result: xr.Dataset, method: Any) -> _Parameters:
    symbols = forces_in_model(result)
    library = models.library_of(result).select(symbols)
    shapes = dict(models.shape_values_of(result))
    constraints = Constraints(method.constraints)
    if "constraint" in result.coords:
        bound = result.force.values[result.constraint.values == "at its bound"].tolist()
        constraints = constraints.holding({s: result.coefficient.sel(force=s).item() for s in bound})
    # A held shape parameter is not a coefficient of the map.
    known = {name: value for name, value in constraints.table.items() if name in symbols}
    free = constraint_map(Constraints(known), library, shapes)
    fitted = list(getattr(method, "fit_shapes", ()))
    return _Parameters(symbols, free, fitted, method.reference_frequency is None)


def _influence(
    followed: FollowedRuns, noises: Sequence[RunNoise], kept: Sequence[str], frequency: float
) -> list[Array] | None:
    """Return the influence of each sample on the compared quantities, (quantity, sample), or None."""
    result, motions = followed.result, followed.motions
    moving = [motion for motion in motions if motion is not None]
    known = all(result.active.values) and len(moving) == len(motions)
    if not known or any(MEASURED in run for run in followed.runs.values()):
        return None
    method = method_of(result)
    if not isinstance(method, Averaging | Direct | Trajectory):
        return None
    parameters = _parameters(result, method)
    slopes = common_reference.comparison_slopes(result, kept, frequency) @ parameters.values
    if not isinstance(method, Averaging):
        if isinstance(method, Direct) and not _is_refined(method, result):
            return None
        of_motion = _of_motion(followed, noises, parameters, of_rows=isinstance(method, Direct))
        return None if of_motion is None else [slopes @ part for part in of_motion]
    if method.curve != "half-sines" or not result.get("first_order_bias_removed", False):
        return None
    runs = [*followed.runs.values()]
    library = models.library_of(result).select(parameters.symbols)
    density = [random_force_of(result, run).density for run in followed.runs]
    pairs = [(noise.level, of_run) for noise, of_run in zip(noises, density, strict=True)]
    free_motions = [
        xr.Dataset({"angle": ("time", motion.x)}, {"time": run.time})
        for run, motion in zip(runs, moving, strict=True)
    ]
    by_sample = method.influence(runs, free_motions, library, parameters.free, pairs)
    places = [*parameters.free.free, *([len(parameters.symbols)] if parameters.frequency else [])]
    of_free = [part[places] for part in by_sample]
    columns = [_sensitivities(followed, run, parameters)[0] for run in followed.runs]
    # Indirect inference subtracts the error of the method on simulated motions: the remaining values follow
    # the parameters exactly.
    answer = np.sum([part @ table for part, table in zip(of_free, columns, strict=True)], axis=0)
    scale = np.linalg.norm(answer, axis=1)
    if np.any(scale == 0.0) or np.linalg.cond(answer / scale[:, None]) > WORST_CONDITION:
        return None
    return [slopes @ np.linalg.solve(answer, part) for part in of_free]


def _is_refined(method: Direct, result: xr.Dataset) -> bool:
    """Return true if the rows are about the motion of the identified model."""
    return method.form == "weak" and bool(result.get("refined", False))


def _sensitivities(followed: FollowedRuns, run: int, parameters: _Parameters) -> tuple[Array, Array]:
    """Return the derivatives of the angle by the free parameters, and by the run's start and zero."""
    motion = followed.motions[run]
    assert isinstance(motion, FittedMotion)
    model = schema.model_of(followed.result, run)
    time = followed.runs[run].time.values.astype(float)
    names = [*parameters.names, BY_ANGLE, BY_RATE]
    columns = trajectory(model, time, motion.angle, motion.rate, by=names).derivatives["angle"]
    own = columns[:, -2:]
    if first_zero(model) is not None:
        own = np.column_stack([own, np.ones(len(time))])
    return columns[:, :-2] @ parameters.by_free, own


def _of_motion(
    followed: FollowedRuns, noises: Sequence[RunNoise], parameters: _Parameters, *, of_rows: bool
) -> list[Array] | None:
    """Return the influence on the free parameters of a least-squares motion fit, (parameter, sample) per run.

    The fit uses all information in the samples, or only that in the rows of `Direct`.
    """
    tables: list[Array] = []
    seen: list[RunNoise | WeakRows] = []
    for run, noise in zip(followed.runs, noises, strict=True):
        rows = _weak_rows(followed, run, noise) if of_rows else noise
        seen.append(rows)
        common, own = _sensitivities(followed, run, parameters)
        # The rows do not depend on the start.
        common, own = rows.white(common), rows.white(own[:, 2:] if of_rows else own)
        own = own / np.maximum(np.linalg.norm(own, axis=0), np.finfo(float).tiny)
        # Project out the start and the zero of the run.
        tables.append((common - own @ np.linalg.lstsq(own, common, rcond=None)[0]) / noise.level)
    information = np.sum([table.T @ table for table in tables], axis=0)
    size = np.sqrt(np.diag(information))
    if np.any(size == 0.0):
        return None
    scaled = information / np.outer(size, size)
    if np.linalg.cond(scaled) > WORST_CONDITION:
        return None
    inverse = np.linalg.inv(scaled) / np.outer(size, size)
    return [
        (rows.transposed_white(table) @ inverse).T / noise.level
        for table, rows, noise in zip(tables, seen, noises, strict=True)
    ]


def _weak_rows(followed: FollowedRuns, run: int, noise: RunNoise) -> WeakRows:
    """Return the rows of `Direct` about the motion of its model in a run."""
    decay, motion = followed.runs[run], followed.motions[run]
    assert motion is not None
    model = schema.model_of(followed.result, run)
    time = decay.time.values.astype(float)
    held = method_of(followed.result).reference_frequency
    nominal = held or nominal_frequency(first_frequency([*followed.runs.values()]))
    form = build_weak_form(nominal * (time - time[0]))
    scale = model.reference_frequency / nominal
    along = time - time[0], motion.x, motion.v
    terms = [(model.library[symbol], c, model.shapes) for symbol, c in model.coefficients.items()]
    stiffness, damping = derivatives_along([term for term in terms if term[0].kind == "force"], along)
    operator = noise_operator(form, scale**2 * (1.0 + stiffness), scale * damping)
    if any(force.kind == "sensor" for force, _, _ in terms):
        gain = 1.0 + derivatives_along(terms, along, kind="sensor")[0]
        operator = (operator @ sp.diags_array(1.0 / gain)).tocsr()
    band = covariance_band(coloured(operator, noise.filter_))
    return WeakRows(operator, cholesky_factor(band, form.gram, scale**3 * noise.ratio))
