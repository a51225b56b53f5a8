"""Maximum likelihood of the innovations: parameters of a motion that is pushed at random.

The record is linearised about a path (first a spline, then the smoothed motion); the Kalman filter makes the
record and all columns white; generalised least squares gives the step of the parameters, and the smoother the
next path. That is the iterated extended Kalman smoother (Bell 1994), Gauss-Newton with multiple shooting.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

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

MAX_ITERATIONS = 20
# A step this small, in standard errors, changes nothing.
SETTLED = 0.02


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

    def smoothed(self) -> Any:
        """statsmodels' smoother at the parameters of most likelihood."""
        return self.linear.smoothed(self.ratio.ratio, self.deviation)

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
    before: list[VarianceRatio | None] = [None] * len(records)
    for _ in range(MAX_ITERATIONS):
        try:
            linear = _linear_models(parameters, records, values, paths, by)
        except SimulationError as error:
            raise DecayError(f"No motion of these forces follows the record ({error})") from None
        jacobian = parameters.by_free(np.eye(len(values)), values)
        blocks = [jacobian[_places(parameters, run)] for run in range(len(records))]
        ratios = [
            _ratio(
                model, block, _density(random_force, run), parameters.model(values).reference_frequency, last
            )
            for run, (model, block, last) in enumerate(zip(linear, blocks, before, strict=True))
        ]
        before = [*ratios]
        rows = _stacked(linear, blocks, ratios)
        step, inverse = _step_within(parameters, values, rows)
        settled = np.abs(step) <= SETTLED * np.sqrt(np.diag(inverse))
        deviations = [block @ step for block in blocks]
        runs = tuple(PushedRun(*parts) for parts in zip(linear, ratios, deviations, strict=True))
        if settled.all():
            covariance = jacobian @ inverse @ jacobian.T
            return RandomMotionFit(
                _stepped(parameters, values, step),
                covariance,
                runs,
                rows.design @ step - rows.target,
                rows.design,
            )
        paths = [run.linear.path + run.smoothed().smoothed_state.T for run in runs]
        values = _stepped(parameters, values, step)
    raise DecayError(
        "The fit with a random force does not settle; offer fewer forces, or take random_force='off'."
    )


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
        kicks = model.steps.diffusion
        low, high = ratio_span(float(np.sum(kicks[:, 1, 1])), float(np.median(kicks[:, 1, 1])))
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
