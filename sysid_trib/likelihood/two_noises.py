"""The sensor's noise and the random force of a run, by the restricted likelihood of its weak rows.

The colour of the sensor's noise and the ratio of the two variances are estimated from one likelihood: that of
the rows and of the spectral lines above their band. Without a random force the most likely colour differs. If
the colour were held while the ratio is estimated, its error would become part of the random force.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from sysid_trib.arrays import Array
from sysid_trib.likelihood.colour import Lines, lines_above, most_likely_colour, sensor_colour
from sysid_trib.likelihood.least_squares import ConstraintMap
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.likelihood.regression import RunRegression
from sysid_trib.likelihood.rows import Rows, rows_about
from sysid_trib.likelihood.sensor_noise import NoiseModel, covariance_band
from sysid_trib.likelihood.variance_ratio import (
    VarianceRatio,
    WhiteRows,
    held_ratio,
    rows_by_ratio,
    variance_ratio,
)
from sysid_trib.likelihood.weak_form import cholesky_factor, coloured
from sysid_trib.records.smoothing import smooth
from sysid_trib.results.random_force import RandomForce

# Spectral lines above the swing give the level of the sensor's noise. Within the band of the swing the level
# may differ, so these lines count as few samples.
DEGREES_OF_PRIOR = 5


@dataclass(frozen=True)
class WeighedRun:
    """A run's rows, and their restricted likelihood in its two noises.

    Attributes
    ----------
    run : RunRegression
        Run with the last most likely noises.
    matrix : (row, sample) sparse array of float
        Operator of small deviations.
    rows : Rows
    table : (row, column) array of float
        Free columns, nuisances and target of the rows.
    shared_level : bool
        Whether the lines above the band have full weight, because one autoregression describes the noise
        there and in the band. White noise is only an approximation, so its level in the band may differ.
    """

    run: RunRegression
    matrix: sp.csr_matrix
    rows: Rows
    table: Array
    shared_level: bool = False

    @cached_property
    def deviation(self) -> Array:
        """The record minus the free motion, rad."""
        assert self.run.near is not None
        return self.run.measured - self.run.near[0]

    @cached_property
    def tau(self) -> Array:
        """Time in units of 1/w."""
        return self.run.form.tau * (self.run.frequency / self.run.nominal_frequency)

    @cached_property
    def lines(self) -> Lines:
        """Spectral lines above the band of the rows: splines follow half an oscillation per knot."""
        band = np.pi * self.run.form.rows / float(self.tau[-1] - self.tau[0])
        return lines_above(self.deviation, self.tau, band)

    @cached_property
    def acting(self) -> sp.csr_matrix:
        """The operator on the innovations of the sensor's noise."""
        return coloured(self.matrix, self.run.sensor.filter_)

    @cached_property
    def _band(self) -> Array:
        return covariance_band(self.acting)

    def factor(self, ratio: float) -> Array:
        """Return the Cholesky factor of the rows' covariance with this ratio of the run's noise variances."""
        return cholesky_factor(self._band, self.run.form.gram, ratio)

    def with_ratio(self, ratio: VarianceRatio | None) -> "WeighedRun":
        """Return the run and its rows with a ratio of the two variances."""
        assert ratio is not None
        run, factor = replace(self.run, ratio=ratio), self.factor(ratio.ratio)
        return replace(self, run=run, rows=replace(self.rows, runs=(run,), factor=factor))

    def by_ratio(self, sensor: NoiseModel) -> Callable[[float], WhiteRows]:
        """Return the function that gives the white rows for a ratio, with a sensor noise of one colour."""
        degrees = float(DEGREES_OF_PRIOR)
        further = degrees, degrees * sensor.innovation**2, 0.0
        if self.shared_level:
            further = self.lines.as_samples(sensor.filter_)
        same = np.array_equal(sensor.filter_, self.run.sensor.filter_)
        band = self._band if same else covariance_band(coloured(self.matrix, sensor.filter_))
        return rows_by_ratio(band, self.run.form.gram, self.table, further)

    def ratio(self, sensor: NoiseModel, start: float | None) -> VarianceRatio:
        """Return the most likely ratio with a given sensor noise; near `start` if that is given."""
        tau = self.run.form.tau
        return variance_ratio(
            self.by_ratio(sensor), float(np.ptp(tau)), float(np.median(np.diff(tau))), start
        )

    def without_force(self, sensor: NoiseModel) -> VarianceRatio:
        """Return the variance of the sensor's noise alone."""
        return held_ratio(self.by_ratio(sensor), 0.0, None)


def with_noises(
    run: RunRegression, constraints: ConstraintMap, option: RandomForceOption, *, colour: bool
) -> WeighedRun:
    """Return a run with its two noises.

    Parameters
    ----------
    run : RunRegression
    constraints : ConstraintMap
        Constraints of the forces that are in the model.
    option : "auto" or float, (rad/s^2)^2/Hz
        A number is the one-sided density, which is fixed.
    colour : bool
        Whether the colour of the sensor's noise is estimated again.

    Notes
    -----
    The gain of a random force is relative to the most likely sensor noise without one, which has its own
    colour.
    """
    rows = rows_about(run, run.operator)
    free, target = rows.columns @ constraints.matrix, rows.target - rows.columns @ constraints.constant
    # Column order, because LAPACK uses the columns many times.
    table = np.asfortranarray(np.column_stack([free, rows.nuisances, target]))
    weighed = WeighedRun(run, run.operator, rows, table)
    if isinstance(option, str):
        weighed = _estimated(weighed, colour)
    else:
        per_tau = RandomForce(float(option)).per_tau(run.nominal_frequency)
        last = None if run.ratio is None else run.ratio.variance
        ratio = held_ratio(weighed.by_ratio(run.sensor), per_tau, last)
        weighed = replace(weighed, run=replace(run, ratio=ratio))
    return weighed.with_ratio(weighed.run.ratio)


def _estimated(weighed: WeighedRun, colour: bool) -> WeighedRun:
    """Return a run with its most likely noises; sensor noise alone if a random force is less likely."""
    run = weighed.run
    sensor, sensor_alone = run.sensor, run.sensor_alone
    start = None if run.ratio is None else run.ratio.ratio
    if colour:
        sensor, sensor_alone, start = _colours(weighed)
    white = len(sensor.filter_) == len(sensor_alone.filter_) == 1
    if not white:
        weighed = replace(weighed, shared_level=run.near is not None)
    ratio = weighed.ratio(sensor, start)
    if not white:
        without = weighed.without_force(sensor_alone)
        gain = without.deviance - ratio.deviance
        if gain > 0.0 and ratio.ratio > 0.0:
            ratio = replace(ratio, gain=gain)
        else:
            ratio = replace(without, upper=weighed.ratio(sensor_alone, None).upper)
            sensor = sensor_alone
    return replace(weighed, run=replace(run, ratio=ratio, sensor=sensor, sensor_alone=sensor_alone))


def _colours(weighed: WeighedRun) -> tuple[NoiseModel, NoiseModel, float | None]:
    """Return the most likely sensor noises with and without a random force, and a likely ratio.

    Two orders are tried: those of the spectrum with and without a random force. The one with the lower
    Bayesian information criterion is used. The random force is tested with colours of the same order, because
    a colour of higher order could resonate as the motion does.
    """
    if weighed.run.near is None:
        # If no free motion follows the record, use the residual of the spline.
        angle, tau = weighed.run.angle, weighed.run.form.tau
        white = NoiseModel(float(np.std(angle - smooth(tau, angle)[0])), np.ones(1))
        return white, white, None
    deviation, tau = weighed.deviation, weighed.tau
    guesses = [sensor_colour(deviation, tau, random_force=with_one) for with_one in (True, False)]
    if all(len(guess.filter_) == 1 for guess in guesses):
        return guesses[0], guesses[0], None
    weighed = replace(weighed, shared_level=True)
    lines = weighed.lines
    samples = len(weighed.table) + lines.independent
    penalty = np.log(samples)
    orders = {len(guess.filter_): guess.filter_ for guess in guesses}
    starts = [(guess, lines.colour(taps - 1)) for taps, guess in orders.items()]
    ratios = (weighed.ratio(lines.noise(by_lines), None) for _, by_lines in starts)
    first = min(ratios, key=lambda ratio: ratio.deviance)

    def with_force(filter_: Array) -> float:
        return weighed.ratio(lines.noise(filter_), first.ratio).deviance

    def sensor_alone(filter_: Array) -> float:
        return weighed.without_force(lines.noise(filter_)).deviance

    def criterion(fit: tuple[Array, float]) -> float:
        return fit[1] + penalty * (len(fit[0]) - 1)

    def searched(deviance: Callable[[Array], float], least: float) -> list[tuple[Array, float]]:
        return [most_likely_colour(deviance, of, samples=samples, least=least) for of in starts]

    still = searched(sensor_alone, first.deviance)
    stochastic = searched(with_force, np.inf)
    best, without = min(stochastic, key=criterion), min(still, key=criterion)
    taps = len(best[0])
    if len(without[0]) != taps and criterion(without) < criterion(best) + penalty:
        # Another colour is the better explanation: test the random force with that colour.
        return lines.noise(without[0]), lines.noise(without[0]), None
    same_order = next(filter_ for filter_, _ in still if len(filter_) == taps)
    return lines.noise(best[0]), lines.noise(same_order), first.ratio
