"""A step of the fit of a motion with a random force: ratios of variances, then all parameters."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.likelihood.colour import most_likely_colour
from sysid_trib.likelihood.random_force import RandomForce
from sysid_trib.likelihood.ratio_posterior import average_over_ratios
from sysid_trib.likelihood.variance_ratio import (
    VarianceRatio,
    WhiteRows,
    held_ratio,
    ratio_span,
    variance_ratio,
)
from sysid_trib.motion_fit.kalman import LinearModel
from sysid_trib.motion_fit.parameters import Parameters


def likely_ratio(
    linear: LinearModel, rows: Callable[[float], WhiteRows] | None = None, start: float | None = None
) -> VarianceRatio:
    """The ratio per_tau / variance of most restricted likelihood.

    Parameters
    ----------
    linear : LinearModel
    rows : callable, optional
        White rows of a ratio, in the place of the model's with all its columns.
    start : float, optional
        Where the ratio was last.

    Raises
    ------
    DecayError
        Friction holds the body all the time.
    """
    impulses = linear.steps.diffusion[:, 1, 1]
    # A body that friction holds is not pushed.
    impulses = impulses[impulses > 0.0]
    if not len(impulses):
        raise DecayError("Friction of this size holds the body all the time; take random_force='off'.")
    low, high = ratio_span(float(np.sum(impulses)), float(np.median(impulses)))
    return variance_ratio(linear.rows if rows is None else rows, low, high, start)


@dataclass(frozen=True)
class Iterate:
    """Where the iteration is, and the step that it would take.

    Attributes
    ----------
    parameters : Parameters
    values : (parameter,) array of float
        Where the runs are linear.
    linear : sequence of LinearModel
        The runs about their filtered paths, with the columns of all common parameters, then of the run's own.
    ratios : sequence of VarianceRatio
        Of each run: per_tau of the random force over the variance of the sensor's noise.
    """

    parameters: Parameters
    values: Array
    linear: Sequence[LinearModel]
    ratios: Sequence[VarianceRatio] = ()

    def with_ratios(self, densities: Sequence[float | None], before: "Iterate | None") -> "Iterate":
        """Iterate with the ratio of each run, by its own restricted likelihood or by a given density.

        Parameters
        ----------
        densities : sequence of float or None, (rad/s^2)^2/Hz
            Held in each run; None where it is estimated.
        before : Iterate or None
            The last one, near which the ratios are.
        """
        last = before.ratios if before else [None] * len(self.linear)
        frequency = self.parameters.model(self.values).reference_frequency
        ratios = []
        for run, (density, of_run) in enumerate(zip(densities, last, strict=True)):
            rows = self._rows_by_ratio(run)
            if density is None:
                ratio = likely_ratio(self.linear[run], rows, of_run.ratio if of_run else None)
            else:
                per_tau = RandomForce(density).per_tau(frequency)
                ratio = held_ratio(rows, per_tau, of_run.variance if of_run else None)
            ratios.append(ratio)
        return replace(self, ratios=ratios)

    @cached_property
    def jacobian(self) -> Array:
        """Derivative of all parameters by the free ones, (parameter, free)."""
        return self.parameters.by_free(np.eye(len(self.values)), self.values)

    @cached_property
    def _blocks(self) -> list[Array]:
        """Derivative of the columns' parameters of each run by the free ones, (column, free)."""
        common = self.jacobian[: len(self.parameters.common)]
        own = [self.jacobian[self.parameters.of_run(run)] for run in range(len(self.linear))]
        return [np.concatenate([common, part]) for part in own]

    @cached_property
    def rows(self) -> WhiteRows:
        """Normalised innovations of all runs as one regression on the free parameters."""
        of_runs = [model.rows(ratio.ratio) for model, ratio in zip(self.linear, self.ratios, strict=True)]
        sizes = [np.sqrt(ratio.variance) for ratio in self.ratios]
        target = np.concatenate([rows.target / size for rows, size in zip(of_runs, sizes, strict=True)])
        design = [
            rows.design @ block / size for rows, block, size in zip(of_runs, self._blocks, sizes, strict=True)
        ]
        return WhiteRows(target, np.concatenate(design), 0.0)

    @cached_property
    def solution(self) -> tuple[Array, Array]:
        """Step of the free parameters within their limits, and their covariance without limits.

        Parameters that would pass a limit go to it, and the others are solved again.
        """
        rows, free = self.rows, self.parameters.free
        step, inverse = rows.solution()
        low, high = (limit[free] - self.values[free] for limit in self.parameters.limits)
        passed = (step < low) | (step > high)
        if passed.any():
            limited = np.clip(step, low, high)
            target = rows.target - rows.design[:, passed] @ limited[passed]
            rest = replace(rows, target=target, design=rows.design[:, ~passed])
            limited[~passed] = np.clip(rest.solution()[0], low[~passed], high[~passed])
            step = limited
        return step, inverse

    @property
    def remaining(self) -> float:
        """The step in standard errors, of the parameter where it is largest."""
        step, covariance = self.solution
        return float(np.max(np.abs(step) / np.sqrt(np.diag(covariance))))

    def deviation(self, run: int) -> Array:
        """The parameters of most likelihood from where a run is linear, (column,)."""
        return np.asarray(self._blocks[run] @ self.solution[0])

    def filtered_motion(self, run: int) -> tuple[Array, Array]:
        """The path by the samples up to each one (sample, state), and the standard error of v (sample,), rad.

        At the parameters of most likelihood.
        """
        linear, ratio = self.linear[run], self.ratios[run]
        change, covariance = linear.filtered_motion(ratio.ratio, self.deviation(run))
        return linear.path + change[..., 0], np.sqrt(ratio.variance * np.maximum(covariance[:, 1, 1], 0.0))

    def innovations(self, run: int) -> Array:
        """What is predicted wrongly one sample ahead, (sample,), rad."""
        return self.linear[run].innovations(self.ratios[run].ratio, self.deviation(run))[1][:, 0]

    def stepped(self, step: Array) -> Array:
        """The parameters after a step of the free ones, within their limits."""
        free = self.parameters.free
        low, high = (limit[free] for limit in self.parameters.limits)
        return self.parameters.expand(np.clip(self.values[free] + step, low, high))

    def average_by_ratio(self, run: int) -> tuple[Array, Array]:
        """The step of the free parameters over the ratios of a run that its record leaves open."""

        def solved(ratio: VarianceRatio) -> tuple[Array, Array]:
            return replace(self, ratios=[*self.ratios[:run], ratio, *self.ratios[run + 1 :]]).solution

        samples = len(self.linear[run].record)
        return average_over_ratios(self._rows_by_ratio(run), self.ratios[run], samples, solved)

    def with_gains_over_colours(self) -> "Iterate":
        """Iterate with each random force's gain over the sensor's noise alone, in a colour of its own.

        Both colours are of most likelihood, of the order that the sensor's noise has. With the random force
        the ratio is held where it is: the gain is no larger than with both free.
        """
        ratios = [
            ratio if len(model.sensor_filter) == 1 or ratio.gain == 0.0 else self._with_gain(run)
            for run, (model, ratio) in enumerate(zip(self.linear, self.ratios, strict=True))
        ]
        return replace(self, ratios=ratios)

    def _with_gain(self, run: int) -> VarianceRatio:
        linear, ratio = self.linear[run], self.ratios[run]

        def least_deviance(of: float) -> float:
            def deviance(colour: Array) -> float:
                return self._rows_by_ratio(run, colour)(of).restricted_deviance()[0]

            return most_likely_colour(deviance, [linear.sensor_filter], samples=len(linear.record))[1]

        return replace(ratio, gain=max(0.0, least_deviance(0.0) - least_deviance(ratio.ratio)))

    def penalised_deviance(self) -> float:
        """Deviance of the innovations with the Bayesian information criterion's price of the colours."""
        total = 0.0
        for run, (linear, ratio) in enumerate(zip(self.linear, self.ratios, strict=True)):
            deviance, _ = self._rows_by_ratio(run)(ratio.ratio).restricted_deviance()
            total += deviance + (len(linear.sensor_filter) - 1) * np.log(len(linear.record))
        return total

    def _rows_by_ratio(self, run: int, colour: Array | None = None) -> Callable[[float], WhiteRows]:
        """Innovations of a run by the ratio of its variances, as a regression on the parameters it has."""
        block, linear = self._blocks[run], self.linear[run]
        linear = linear if colour is None else replace(linear, sensor_filter=colour)

        def rows(ratio: float) -> WhiteRows:
            white = linear.rows(ratio)
            design = white.design @ block
            return replace(white, design=design[:, np.any(design != 0.0, axis=0)])

        return rows
