"""The sensor's noise and the random force of a run, by the restricted likelihood of its weak rows.

The colour of the sensor's noise and the ratio of the two variances have one likelihood: that of the rows, and
that of the lines of the spectrum above their band. Without a random force the colour is another one. A colour
that were held while the ratio is sought would lend its own error to the random force.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from sysid_trib.arrays import Array, Mask
from sysid_trib.likelihood.colour import Lines, NoisePair, lines_above, most_likely_colour, sensor_colour
from sysid_trib.likelihood.linearisation import DeviationOperator, deviation_matrix
from sysid_trib.likelihood.optimizers import ConstraintMap
from sysid_trib.likelihood.problem import RunRegression
from sysid_trib.likelihood.random_force import RandomForce, RandomForceOption
from sysid_trib.likelihood.ratio_posterior import Prior, RatioLikelihood, WeighedRun
from sysid_trib.likelihood.rows import rows_about
from sysid_trib.likelihood.sensor_noise import NoiseModel, covariance_of_local_rows
from sysid_trib.likelihood.variance_ratio import VarianceRatio, held_ratio, ratio_span, variance_ratio
from sysid_trib.likelihood.weak_form import coloured
from sysid_trib.records.smoothing import smooth

# Lines of the spectrum above the swing say what the sensor's noise is, within the swing's band it may differ:
# they count as so many samples.
DEGREES_OF_PRIOR = 5


@dataclass(frozen=True)
class RowsLikelihood:
    """The restricted likelihood of a run's rows in its two noises.

    Attributes
    ----------
    run : RunRegression
    matrix : (row, sample) sparse array of float
        Operator of small deviations.
    table : (row, column) array of float
        Free columns, nuisances, target of the rows.
    shared_level : bool
        Whether the lines above the band count in full, since one autoregression holds there and in the band.
        White noise is but an approximation: its level in the band may be another.
    """

    run: RunRegression
    matrix: sp.csr_matrix
    table: Array
    shared_level: bool = False

    @cached_property
    def deviation(self) -> Array | None:
        """The record minus the free motion, rad; None where no free motion follows the record."""
        near = self.run.reference.near
        return None if near is None else self.run.measured - near.x

    @cached_property
    def tau(self) -> Array:
        """Time in units of 1/w."""
        problem = self.run.problem
        return problem.form.tau * (self.run.frequency / problem.nominal_frequency)

    @cached_property
    def lines(self) -> Lines:
        """Lines of the spectrum above the band of the rows: splines follow half an oscillation a knot."""
        assert self.deviation is not None
        band = np.pi * self.run.problem.form.rows / float(self.tau[-1] - self.tau[0])
        return lines_above(self.deviation, self.tau, band)

    def acting(self, sensor: NoiseModel) -> sp.csr_matrix:
        """The operator on the innovations of the sensor's noise."""
        return coloured(self.matrix, sensor.filter_)

    @cached_property
    def band_of_white(self) -> Array:
        """Covariance of the rows in white noise of the sensor, of unit variance: (band, row)."""
        return covariance_of_local_rows(self.matrix)

    def band(self, sensor: NoiseModel) -> Array:
        """Covariance of the rows by the sensor's noise, of unit innovations: (band, row)."""
        white = len(sensor.filter_) == 1
        return self.band_of_white if white else covariance_of_local_rows(self.acting(sensor))

    def with_sensor(self, sensor: NoiseModel) -> RatioLikelihood:
        """The likelihood by the ratio of the two variances, with a sensor's noise of one colour."""
        prior = Prior(DEGREES_OF_PRIOR, DEGREES_OF_PRIOR * sensor.innovation**2)
        if self.shared_level:
            lines, filter_ = self.lines, sensor.filter_
            prior = Prior(lines.independent, lines.squares(filter_), lines.log_determinant(filter_))
        gram = self.run.problem.form.gram
        return RatioLikelihood(self.band(sensor), gram, self.table, prior)

    def ratio(self, sensor: NoiseModel, start: float | None) -> VarianceRatio:
        """Ratio of most likelihood with a sensor's noise; near `start` if that is given."""
        tau = self.run.problem.form.tau
        low, high = ratio_span(float(tau[-1] - tau[0]), float(np.median(np.diff(tau))))
        return variance_ratio(self.with_sensor(sensor).rows, low, high, start)

    def held_ratio(self, sensor: NoiseModel, density: float) -> VarianceRatio:
        """The ratio with a density of the random force that is given, (rad/s^2)^2/Hz."""
        last = None if self.run.noises is None else self.run.noises.ratio.variance
        per_tau = RandomForce(density).per_tau(self.run.problem.nominal_frequency)
        return held_ratio(self.with_sensor(sensor).rows, per_tau, last)

    def sensor_alone(self, sensor: NoiseModel) -> VarianceRatio:
        """A ratio of zero: the sensor's noise without a random force."""
        return held_ratio(self.with_sensor(sensor).rows, 0.0, None)


def with_noises(
    run: RunRegression, active: Mask, constraints: ConstraintMap, option: RandomForceOption, *, colour: bool
) -> WeighedRun:
    """A run with its two noises.

    Parameters
    ----------
    run : RunRegression
    active : (force,) array of bool
        Forces that are in the model.
    constraints : ConstraintMap
    option : "auto" or float, (rad/s^2)^2/Hz
        A number is the one-sided density, held.
    colour : bool
        Whether the colour of the sensor's noise is estimated anew.

    Notes
    -----
    The gain of the likelihood by a random force is over the most likely noise of the sensor without one,
    which has a colour of its own.
    """
    matrix = deviation_matrix(run)
    weak, kept = rows_about(run, matrix), constraints.keep(active)
    free = weak.columns @ (weak.scale[:, None] * kept.matrix)
    target = weak.target - weak.columns @ (weak.scale * kept.constant)
    # By columns, as LAPACK takes them many times.
    table = np.asfortranarray(np.column_stack([free, weak.nuisances, target]))
    likelihood = RowsLikelihood(run, matrix, table)
    if not isinstance(option, str):
        sensor = _white(run)
        noises = NoisePair(likelihood.held_ratio(sensor, float(option)), sensor, sensor)
    else:
        likelihood, noises = _estimated(likelihood, colour)
    by_ratio = likelihood.with_sensor(noises.sensor)
    factor = by_ratio.factor(noises.ratio.ratio)
    operator = DeviationOperator(matrix, likelihood.acting(noises.sensor), factor)
    return WeighedRun(replace(run, noises=noises), replace(weak, factor=factor), operator, by_ratio)


def _white(run: RunRegression) -> NoiseModel:
    return NoiseModel(run.problem.noise, np.ones(1)) if run.noises is None else run.noises.sensor


def _estimated(likelihood: RowsLikelihood, colour: bool) -> tuple[RowsLikelihood, NoisePair]:
    """Both noises of most likelihood, and that; the sensor's where it is as likely without a force."""
    last = likelihood.run.noises
    sensor = sensor_alone = _white(likelihood.run)
    start = None
    if last is not None:
        sensor_alone, start = last.sensor_alone, last.ratio.ratio
    if colour:
        sensor, sensor_alone, start = _colours(likelihood)
    if len(sensor.filter_) == len(sensor_alone.filter_) == 1:
        return likelihood, NoisePair(likelihood.ratio(sensor, start), sensor, sensor_alone)
    likelihood = replace(likelihood, shared_level=likelihood.deviation is not None)
    ratio, without = likelihood.ratio(sensor, start), likelihood.sensor_alone(sensor_alone)
    gain = without.deviance - ratio.deviance
    if gain > 0.0 and ratio.ratio > 0.0:
        return likelihood, NoisePair(replace(ratio, gain=gain), sensor, sensor_alone)
    without = replace(without, upper=likelihood.ratio(sensor_alone, None).upper)
    return likelihood, NoisePair(without, sensor_alone, sensor_alone)


def _colours(likelihood: RowsLikelihood) -> tuple[NoiseModel, NoiseModel, float | None]:
    """Most likely noises of the sensor with a random force and without, and a ratio near that of the first.

    The orders are those that the spectrum asks for with a random force, and without one; of the two that of
    the lower Bayesian information criterion. A random force is tested beside colours of one order: a higher
    one could resonate as the motion does.
    """
    if likelihood.deviation is None:
        # Of a record that no free motion follows, by what the spline leaves.
        problem = likelihood.run.problem
        unexplained = problem.angle - smooth(problem.form.tau, problem.angle).x
        white = NoiseModel(float(np.std(unexplained)), np.ones(1))
        return white, white, None
    guesses = [
        sensor_colour(likelihood.deviation, likelihood.tau, random_force=stochastic)
        for stochastic in (True, False)
    ]
    if all(len(guess.filter_) == 1 for guess in guesses):
        return guesses[0], guesses[0], None
    likelihood = replace(likelihood, shared_level=True)
    lines = likelihood.lines
    penalty = np.log(len(likelihood.table) + lines.independent)

    def with_sensor(filter_: Array) -> float:
        return likelihood.ratio(lines.noise(filter_), first.ratio).deviance

    def sensor_alone(filter_: Array) -> float:
        return likelihood.sensor_alone(lines.noise(filter_)).deviance

    def criterion(fit: tuple[Array, float]) -> float:
        return fit[1] + penalty * (len(fit[0]) - 1)

    orders = {len(guess.filter_): guess.filter_ for guess in guesses}
    starts = [(guess, lines.colour(taps - 1)) for taps, guess in orders.items()]
    samples = len(likelihood.table) + lines.independent
    ratios = (likelihood.ratio(lines.noise(by_lines), None) for _, by_lines in starts)
    first = min(ratios, key=lambda ratio: ratio.deviance)

    def searched(deviance: Callable[[Array], float], least: float) -> list[tuple[Array, float]]:
        return [most_likely_colour(deviance, of, samples=samples, least=least) for of in starts]

    still = searched(sensor_alone, first.deviance)
    stochastic = searched(with_sensor, np.inf)
    best, without = min(stochastic, key=criterion), min(still, key=criterion)
    taps = len(best[0])
    if len(without[0]) != taps and criterion(without) < criterion(best) + penalty:
        # Another colour is the better explanation, and a random force has to be likely with that.
        return lines.noise(without[0]), lines.noise(without[0]), None
    same_order = next(filter_ for filter_, _ in still if len(filter_) == taps)
    return lines.noise(best[0]), lines.noise(same_order), first.ratio
