"""A step of the fit of a motion with a random force: ratios of variances, then all parameters."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.likelihood.colour import most_likely_colour
from sysid_trib.likelihood.random_force import RandomForce
from sysid_trib.likelihood.ratio_posterior import RatioAverage, average_over_ratios
from sysid_trib.likelihood.variance_ratio import VarianceRatio, WhiteRows, held_ratio
from sysid_trib.motion_fit.kalman import LinearModel, likely_ratio
from sysid_trib.motion_fit.parameters import Parameters


@dataclass(frozen=True)
class PushedRun:
    """One run, linear about its filtered path.

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

    def filtered_motion(self) -> tuple[Array, Array]:
        """The path by the samples up to each one (sample, state), and the standard error of v (sample,), rad.

        At the parameters of most likelihood.
        """
        path, rate_error = self.linear.filtered_motion(self.ratio.ratio, self.deviation)
        return path, np.sqrt(self.ratio.variance) * rate_error

    def innovations(self) -> Array:
        """What is predicted wrongly one sample ahead, (sample,), rad."""
        innovations, columns, _ = self.linear.innovations(self.ratio.ratio)
        return np.asarray(innovations - columns @ self.deviation)


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


def iterate(
    parameters: Parameters,
    values: Array,
    linear: Sequence[LinearModel],
    densities: Sequence[float | None],
    before: Iterate | None,
) -> Iterate:
    """Ratio of each run, then the step of all parameters.

    Parameters
    ----------
    parameters : Parameters
    values : (parameter,) array of float
        Where the runs are linear.
    linear : sequence of LinearModel
        The runs.
    densities : sequence of float or None, (rad/s^2)^2/Hz
        Held in each run; None where it is estimated.
    before : Iterate or None
        The last one.
    """
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


def average_by_ratio(parameters: Parameters, at: Iterate, run: int) -> RatioAverage:
    """The step of the free parameters over the ratios of a run that its record leaves open.

    Parameters
    ----------
    parameters : Parameters
    at : Iterate
        The last one.
    run : int
        Of which the ratio was estimated.
    """
    jacobian = parameters.by_free(np.eye(len(at.values)), at.values)
    linear, ratios = (
        [stochastic.linear for stochastic in at.runs],
        [stochastic.ratio for stochastic in at.runs],
    )
    blocks = [jacobian[_places(parameters, number)] for number in range(len(linear))]

    def solved(ratio: VarianceRatio) -> tuple[Array, Array]:
        of_runs = [*ratios[:run], ratio, *ratios[run + 1 :]]
        return _step_within(parameters, at.values, _stacked(linear, blocks, of_runs))

    samples = len(linear[run].record)
    return average_over_ratios(_rows_by_ratio(linear[run], blocks[run]), ratios[run], samples, solved)


def with_gains_over_colours(parameters: Parameters, settled: Iterate) -> tuple[PushedRun, ...]:
    """Runs with the gain of each one's random force over the sensor's noise alone, in a colour of its own.

    Parameters
    ----------
    parameters : Parameters
    settled : Iterate
        The last one.

    Notes
    -----
    Both colours are of most likelihood, of the order that the sensor's noise has. With the random force the
    ratio is held where it is: the gain is no larger than with both free.
    """
    jacobian = parameters.by_free(np.eye(len(settled.values)), settled.values)
    blocks = [jacobian[_places(parameters, run)] for run in range(len(settled.runs))]
    return tuple(_with_gain(*pair) for pair in zip(settled.runs, blocks, strict=True))


def penalised_deviance(parameters: Parameters, values: Array, runs: Sequence[PushedRun]) -> float:
    """Deviance of the innovations with the Bayesian information criterion's price of the colours.

    Parameters
    ----------
    parameters : Parameters
    values : (parameter,) array of float
        Of most likelihood.
    runs : sequence of PushedRun
        Linear about their filtered paths.
    """
    jacobian = parameters.by_free(np.eye(len(values)), values)
    total = 0.0
    for at, run in enumerate(runs):
        rows = _rows_by_ratio(run.linear, jacobian[_places(parameters, at)])
        taps = len(run.linear.sensor_filter) - 1
        total += rows(run.ratio.ratio).restricted_deviance()[0] + taps * np.log(len(run.linear.record))
    return total


def _with_gain(run: PushedRun, block: Array) -> PushedRun:
    filter_, ratio = run.linear.sensor_filter, run.ratio
    if len(filter_) == 1 or ratio.gain == 0.0:
        return run

    def least_deviance(of: float) -> float:
        def deviance(colour: Array) -> float:
            linear = replace(run.linear, sensor_filter=colour)
            return _rows_by_ratio(linear, block)(of).restricted_deviance()[0]

        return most_likely_colour(deviance, [filter_], samples=len(run.linear.record))[1]

    gain = max(0.0, least_deviance(0.0) - least_deviance(ratio.ratio))
    return replace(run, ratio=replace(ratio, gain=gain))


def _places(parameters: Parameters, run: int) -> list[int]:
    """Places in the vector of all parameters that the columns of a run have."""
    return [*range(len(parameters.common)), *range(len(parameters))[parameters.of_run(run)]]


def _ratio(
    model: LinearModel, block: Array, density: float | None, frequency: float, last: VarianceRatio | None
) -> VarianceRatio:
    """The ratio of variances of one run, by its own restricted likelihood or by a given density."""
    rows = _rows_by_ratio(model, block)
    if density is None:
        return likely_ratio(model, rows, last.ratio if last else None)
    return held_ratio(rows, RandomForce(density).per_tau(frequency), last.variance if last else None)


def _rows_by_ratio(model: LinearModel, block: Array) -> Callable[[float], WhiteRows]:
    """Innovations of one run by the ratio of its variances, as a regression on the parameters that it has."""

    def rows(ratio: float) -> WhiteRows:
        white = model.rows(ratio)
        design = white.design @ block
        return replace(white, design=design[:, np.any(design != 0.0, axis=0)])

    return rows


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
