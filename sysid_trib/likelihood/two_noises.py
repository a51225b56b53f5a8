"""The sensor's noise and the random force of a run, by the restricted likelihood of its weak rows.

The colour of the sensor's noise and the ratio of the two variances have one likelihood: that of the rows, and
that of the lines of the spectrum above their band. Without a random force the colour is another one. A colour
that were held while the ratio is sought would lend its own error to the random force.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp

from sysid_trib.arrays import Array, Mask
from sysid_trib.likelihood.colour import Lines, lines_above, most_likely_colour, sensor_colour
from sysid_trib.likelihood.least_squares import ConstraintMap
from sysid_trib.likelihood.random_force import RandomForce, RandomForceOption
from sysid_trib.likelihood.regression import RunRegression
from sysid_trib.likelihood.rows import Rows, deviation_matrix, rows_about
from sysid_trib.likelihood.sensor_noise import NoiseModel, covariance_of_local_rows
from sysid_trib.likelihood.variance_ratio import RowsByRatio, VarianceRatio
from sysid_trib.likelihood.weak_form import coloured
from sysid_trib.records.smoothing import smooth

# Lines of the spectrum above the swing say what the sensor's noise is, within the swing's band it may differ:
# they count as so many samples.
DEGREES_OF_PRIOR = 5


class WeighedRun(NamedTuple):
    """A run with its noises, its rows, their operator on the sensor's innovations, and their likelihood."""

    run: RunRegression
    rows: Rows
    acting: sp.csr_matrix
    by_ratio: RowsByRatio


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

    @property
    def follows(self) -> bool:
        """True if a free motion follows the record."""
        return self.run.near is not None

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
        """Lines of the spectrum above the band of the rows: splines follow half an oscillation a knot."""
        band = np.pi * self.run.form.rows / float(self.tau[-1] - self.tau[0])
        return lines_above(self.deviation, self.tau, band)

    @cached_property
    def band_of_white(self) -> Array:
        """Covariance of the rows in white noise of the sensor, of unit variance: (band, row)."""
        return covariance_of_local_rows(self.matrix)

    def by_ratio(self, sensor: NoiseModel) -> RowsByRatio:
        """The rows by the ratio of the two variances, with a sensor's noise of one colour."""
        filter_, degrees = sensor.filter_, float(DEGREES_OF_PRIOR)
        further = degrees, degrees * sensor.innovation**2, 0.0
        if self.shared_level:
            further = self.lines.as_samples(filter_)
        band = self.band_of_white
        if len(filter_) > 1:
            band = covariance_of_local_rows(coloured(self.matrix, filter_))
        return RowsByRatio(band, self.run.form.gram, self.table, further)

    def ratio(self, sensor: NoiseModel, start: float | None) -> VarianceRatio:
        """Ratio of most likelihood with a sensor's noise; near `start` if that is given."""
        tau = self.run.form.tau
        return self.by_ratio(sensor).likeliest(float(np.ptp(tau)), float(np.median(np.diff(tau))), start)


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
    target = weak.target - weak.columns @ kept.constant
    # By columns, as LAPACK takes them many times.
    table = np.asfortranarray(np.column_stack([weak.columns @ kept.matrix, weak.nuisances, target]))
    likelihood = RowsLikelihood(run, matrix, table)
    if not isinstance(option, str):
        per_tau = RandomForce(float(option)).per_tau(run.nominal_frequency)
        last = None if run.ratio is None else run.ratio.variance
        weighed = replace(run, ratio=likelihood.by_ratio(run.sensor).held(per_tau, last))
    else:
        likelihood, weighed = _estimated(likelihood, colour)
    by_ratio, ratio = likelihood.by_ratio(weighed.sensor), weighed.ratio
    assert ratio is not None
    acting = coloured(matrix, weighed.sensor.filter_)
    return WeighedRun(weighed, replace(weak, factor=by_ratio.factor(ratio.ratio)), acting, by_ratio)


def _estimated(likelihood: RowsLikelihood, colour: bool) -> tuple[RowsLikelihood, RunRegression]:
    """Likelihood and run with its most likely noises; the sensor's alone where a force is no likelier."""
    run = likelihood.run
    sensor, sensor_alone = run.sensor, run.sensor_alone
    start = None if run.ratio is None else run.ratio.ratio
    if colour:
        sensor, sensor_alone, start = _colours(likelihood)
    white = len(sensor.filter_) == len(sensor_alone.filter_) == 1
    if not white:
        likelihood = replace(likelihood, shared_level=likelihood.follows)
    ratio = likelihood.ratio(sensor, start)
    if not white:
        without = likelihood.by_ratio(sensor_alone).held(0.0)
        gain = without.deviance - ratio.deviance
        if gain > 0.0 and ratio.ratio > 0.0:
            ratio = replace(ratio, gain=gain)
        else:
            ratio = replace(without, upper=likelihood.ratio(sensor_alone, None).upper)
            sensor = sensor_alone
    return likelihood, replace(run, ratio=ratio, sensor=sensor, sensor_alone=sensor_alone)


def _colours(likelihood: RowsLikelihood) -> tuple[NoiseModel, NoiseModel, float | None]:
    """Most likely noises of the sensor with a random force and without, and a ratio near that of the first.

    The orders are those that the spectrum asks for with a random force, and without one; of the two that of
    the lower Bayesian information criterion. A random force is tested beside colours of one order: a higher
    one could resonate as the motion does.
    """
    if not likelihood.follows:
        # Of a record that no free motion follows, by what the spline leaves.
        angle, tau = likelihood.run.angle, likelihood.run.form.tau
        white = NoiseModel(float(np.std(angle - smooth(tau, angle)[0])), np.ones(1))
        return white, white, None
    guesses = [
        sensor_colour(likelihood.deviation, likelihood.tau, random_force=stochastic)
        for stochastic in (True, False)
    ]
    if all(len(guess.filter_) == 1 for guess in guesses):
        return guesses[0], guesses[0], None
    likelihood = replace(likelihood, shared_level=True)
    lines = likelihood.lines
    samples = len(likelihood.table) + lines.independent
    penalty = np.log(samples)
    orders = {len(guess.filter_): guess.filter_ for guess in guesses}
    starts = [(guess, lines.colour(taps - 1)) for taps, guess in orders.items()]
    ratios = (likelihood.ratio(lines.noise(by_lines), None) for _, by_lines in starts)
    first = min(ratios, key=lambda ratio: ratio.deviance)

    def with_force(filter_: Array) -> float:
        return likelihood.ratio(lines.noise(filter_), first.ratio).deviance

    def sensor_alone(filter_: Array) -> float:
        return likelihood.by_ratio(lines.noise(filter_)).held(0.0).deviance

    def criterion(fit: tuple[Array, float]) -> float:
        return fit[1] + penalty * (len(fit[0]) - 1)

    def searched(deviance: Callable[[Array], float], least: float) -> list[tuple[Array, float]]:
        return [most_likely_colour(deviance, of, samples=samples, least=least) for of in starts]

    still = searched(sensor_alone, first.deviance)
    stochastic = searched(with_force, np.inf)
    best, without = min(stochastic, key=criterion), min(still, key=criterion)
    taps = len(best[0])
    if len(without[0]) != taps and criterion(without) < criterion(best) + penalty:
        # Another colour is the better explanation, and a random force has to be likely with that.
        return lines.noise(without[0]), lines.noise(without[0]), None
    same_order = next(filter_ for filter_, _ in still if len(filter_) == taps)
    return lines.noise(best[0]), lines.noise(same_order), first.ratio
