"""Maximum likelihood of the innovations: parameters of a motion that is pushed at random.

The record is linearised about a path (first a spline, then the smoothed motion); the Kalman filter makes the
record and all columns white; generalised least squares gives the step of the parameters, and the smoother the
next path. That is the iterated extended Kalman smoother (Bell 1994), Gauss-Newton with multiple shooting.

Where friction holds the body or nearly so, the linear model jumps with the path, and a whole step may lead
back and forth between branches. Then path and parameters go only a part of the step (relaxation).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, SimulationError
from sysid_trib.noise.random_force import RandomForce, RandomForceOption
from sysid_trib.noise.variance_ratio import (
    VarianceRatio,
    WhiteRows,
    held_ratio,
    ratio_span,
    variance_ratio,
)
from sysid_trib.state_space.kalman import LinearModel
from sysid_trib.state_space.linearised import Derivatives, linearised_about, spline_path
from sysid_trib.trajectory_fit.parameters import Parameters

MAX_ITERATIONS = 24
# A step this small, in standard errors, changes nothing.
SETTLED = 0.02
# What may be left after so many iterations, where they hop between branches; it is then among the errors.
NEARLY_SETTLED = 0.2
PATIENCE = 10
# By what the relaxation changes where a step turns back, and where it goes on, by the cosine of their angle.
SHORTER, LONGER, TURNED = 0.5, 1.5, 0.3
LEAST_PART = 0.05


@dataclass(frozen=True)
class PushedRun:
    """One run, linear about its smoothed path.

    Attributes
    ----------
    linear : LinearModel
        With the columns of all common parameters, then of the run's own.
    ratio : VarianceRatio
        per_tau of the random force over the variance of the sensor's noise.
    deviation : (column,) array of float
        Of the parameters from where it is linear.
    """

    linear: LinearModel
    ratio: VarianceRatio
    deviation: Array

    def smoothed_motion(self) -> Array:
        """The path at the parameters of most likelihood, (sample, state)."""
        return self.linear.smoothed_motion(self.ratio.ratio, self.deviation)

    def innovations(self) -> Array:
        """What is predicted wrongly one sample ahead, (sample,), rad."""
        innovations, columns, _ = self.linear.innovations(self.ratio.ratio)
        return np.asarray(innovations - columns @ self.deviation)


@dataclass(frozen=True)
class RandomMotionFit:
    """Parameters of most likelihood with a random force.

    Attributes
    ----------
    values : (parameter,) array of float
    covariance : (parameter, parameter) array of float
    runs : tuple of PushedRun
    residual : (sample,) array of float
        Normalised innovations of all runs, the predicted minus the measured.
    sensitivity : (sample, free) array of float
        Its derivative by the free parameters.
    """

    values: Array
    covariance: Array
    runs: tuple[PushedRun, ...]
    residual: Array
    sensitivity: Array


def fit_random_motion(
    parameters: Parameters,
    records: Sequence[tuple[Array, Array]],
    values: Array,
    random_force: RandomForceOption | Sequence[float] = "auto",
    filters: Sequence[Array] | None = None,
) -> RandomMotionFit:
    """Fit a motion that is pushed at random.

    Parameters
    ----------
    parameters : Parameters
        Fixed ones are held, ties hold, limits are not passed.
    records : sequence of ((sample,), (sample,)) arrays of float, s and rad
        Time and angle of each run.
    values : (parameter,) array of float
        First guess.
    random_force : "auto", "off", float or one float for each run, (rad/s^2)^2/Hz
        One-sided density; estimated in each run with `auto`.
    filters : sequence of (tap,) arrays of float, optional
        Each whitens the sensor's noise of a run; white where left out.

    Returns
    -------
    RandomMotionFit

    Raises
    ------
    DecayError
        The iteration does not settle, or the motion cannot be computed.
    """
    by = Derivatives((*parameters.library.symbols, *parameters.fit_shapes), _frequency_is_free(parameters))
    paths = [spline_path(parameters.model(values), time, angle) for time, angle in records]
    densities = [_density(random_force, run) for run in range(len(records))]
    now: Iterate | None = None
    best: Iterate | None = None
    part = 1.0
    for number in range(MAX_ITERATIONS):
        try:
            linear = _linear_models(parameters, records, values, paths, by)
            if filters is not None:
                linear = [
                    replace(run, sensor_filter=filter_) for run, filter_ in zip(linear, filters, strict=True)
                ]
        except SimulationError as error:
            raise DecayError(f"No motion of these forces follows the record ({error})") from None
        before, now = now, _iterate(parameters, values, linear, densities, now)
        best = now if best is None or now.remaining < best.remaining else best
        if best.remaining <= (SETTLED if number < PATIENCE else NEARLY_SETTLED):
            return best.fit(parameters)
        part = _relaxed(part, before, now)
        paths = [run.linear.path + part * (run.smoothed_motion() - run.linear.path) for run in now.runs]
        values = _stepped(parameters, values, part * now.step)
    raise DecayError(
        "The fit with a random force does not settle; offer fewer forces, or take random_force='off'."
    )


@dataclass(frozen=True)
class Iterate:
    """Where the iteration is, and the step that it would take.

    Attributes
    ----------
    values : (parameter,) array of float
    runs : tuple of PushedRun
    rows : WhiteRows
        Normalised innovations of all runs, as a regression on the free parameters.
    step : (free,) array of float
        Of the free parameters.
    covariance : (free, free) array of float
        Of the free parameters, without limits.
    """

    values: Array
    runs: tuple[PushedRun, ...]
    rows: WhiteRows
    step: Array
    covariance: Array

    @property
    def remaining(self) -> float:
        """The step in standard errors, of the parameter where it is largest."""
        return float(np.max(np.abs(self.step) / np.sqrt(np.diag(self.covariance))))

    def fit(self, parameters: Parameters) -> RandomMotionFit:
        """The fit after the last step, which is among its errors."""
        jacobian = parameters.by_free(np.eye(len(self.values)), self.values)
        covariance = self.covariance + np.outer(self.step, self.step)
        return RandomMotionFit(
            _stepped(parameters, self.values, self.step),
            jacobian @ covariance @ jacobian.T,
            self.runs,
            self.rows.design @ self.step - self.rows.target,
            self.rows.design,
        )


def _iterate(
    parameters: Parameters,
    values: Array,
    linear: Sequence[LinearModel],
    densities: Sequence[float | None],
    before: Iterate | None,
) -> Iterate:
    """Ratio of each run, then the step of all parameters."""
    jacobian = parameters.by_free(np.eye(len(values)), values)
    blocks = [jacobian[_places(parameters, run)] for run in range(len(linear))]
    frequency = parameters.model(values).reference_frequency
    last = [run.ratio for run in before.runs] if before else [None] * len(linear)
    ratios = [
        _ratio(model, block, density, frequency, of_run)
        for model, block, density, of_run in zip(linear, blocks, densities, last, strict=True)
    ]
    rows = _stacked(linear, blocks, ratios)
    step, covariance = _step_within(parameters, values, rows)
    deviations = [block @ step for block in blocks]
    runs = tuple(PushedRun(*parts) for parts in zip(linear, ratios, deviations, strict=True))
    return Iterate(values, runs, rows, step, covariance)


def _relaxed(part: float, before: Iterate | None, now: Iterate) -> float:
    """The part of the step to go: less where it turns back on the last one, more where it goes on."""
    if before is None:
        return part
    # In the metric of the errors.
    first, second = now.rows.design @ before.step, now.rows.design @ now.step
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    cosine = float(first @ second) / size if size > 0.0 else 0.0
    factor = SHORTER if cosine < -TURNED else LONGER if cosine > TURNED else 1.0
    return float(np.clip(factor * part, LEAST_PART, 1.0))


def _frequency_is_free(parameters: Parameters) -> bool:
    return parameters.reference_frequency is None


def _places(parameters: Parameters, run: int) -> list[int]:
    """Places in the vector of all parameters that the columns of a run have."""
    return [*range(len(parameters.common)), *range(len(parameters))[parameters.of_run(run)]]


def _linear_models(
    parameters: Parameters,
    records: Sequence[tuple[Array, Array]],
    values: Array,
    paths: Sequence[Array],
    by: Derivatives,
) -> list[LinearModel]:
    model, per_run = parameters.model(values), parameters.per_run(values)
    return [
        linearised_about(model, time, angle, path, at_start, by)
        for (time, angle), path, at_start in zip(records, paths, per_run, strict=True)
    ]


def _density(random_force: RandomForceOption | Sequence[float], run: int) -> float | None:
    """The density that is given for a run; None where it is to be estimated."""
    if random_force == "auto":
        return None
    if random_force == "off":
        return 0.0
    return float(random_force) if isinstance(random_force, int | float) else float(random_force[run])


def _ratio(
    model: LinearModel, block: Array, density: float | None, frequency: float, last: VarianceRatio | None
) -> VarianceRatio:
    """The ratio of variances of one run, by its own restricted likelihood or by a given density."""

    def rows(ratio: float) -> WhiteRows:
        white = model.rows(ratio)
        design = white.design @ block
        return replace(white, design=design[:, np.any(design != 0.0, axis=0)])

    if density is None:
        kicks = model.steps.diffusion[:, 1, 1]
        # A body that friction holds is not pushed.
        kicks = kicks[kicks > 0.0]
        if not len(kicks):
            raise DecayError("Friction of this size holds the body all the time; take random_force='off'.")
        low, high = ratio_span(float(np.sum(kicks)), float(np.median(kicks)))
        return variance_ratio(rows, low, high, last.ratio if last else None)
    return held_ratio(rows, RandomForce(density).per_tau(frequency), last.variance if last else None)


def _stacked(
    linear: Sequence[LinearModel], blocks: Sequence[Array], ratios: Sequence[VarianceRatio]
) -> WhiteRows:
    """Normalised innovations of all runs as one regression on the free parameters."""
    of_runs = [model.rows(ratio.ratio) for model, ratio in zip(linear, ratios, strict=True)]
    sizes = [np.sqrt(ratio.variance) for ratio in ratios]
    target = np.concatenate([rows.target / size for rows, size in zip(of_runs, sizes, strict=True)])
    design = np.concatenate(
        [rows.design @ block / size for rows, block, size in zip(of_runs, blocks, sizes, strict=True)]
    )
    return WhiteRows(target, design, 0.0)


def _step_within(parameters: Parameters, values: Array, rows: WhiteRows) -> tuple[Array, Array]:
    """Step of the free parameters within their limits, and their covariance without limits.

    Parameters that would pass a limit go to it, and the others are solved again.
    """
    step, inverse = rows.solution()
    now = values[parameters.free]
    low, high = (limit[parameters.free] - now for limit in parameters.limits)
    passed = (step < low) | (step > high)
    if passed.any():
        limited = np.clip(step, low, high)
        rest = replace(
            rows,
            target=rows.target - rows.design[:, passed] @ limited[passed],
            design=rows.design[:, ~passed],
        )
        limited[~passed] = np.clip(rest.solution()[0], low[~passed], high[~passed])
        step = limited
    return step, inverse


def _stepped(parameters: Parameters, values: Array, step: Array) -> Array:
    """The next values, within their limits."""
    low, high = (limit[parameters.free] for limit in parameters.limits)
    return parameters.expand(np.clip(values[parameters.free] + step, low, high))
