"""Colour of the sensor's noise with a random force, from the spectrum of the record minus a free motion.

The sensor's noise is an autoregression. The random force drives an oscillator, whose response falls off on
both sides of its resonance. Spectral lines near harmonics of the motion, where forces act, contain no
information on either.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from scipy.optimize import minimize

from sysid_trib.arrays import Array
from sysid_trib.likelihood.sensor_noise import NoiseModel, filter_of, filter_slopes, partial_autocorrelations
from sysid_trib.records.signal import is_uniform

MAX_COLOUR = 3
# Highest harmonic of the motion in which missing forces may leave a residual.
NOISE_HARMONICS = 6
# Least number of spectral lines that determine a colour.
FEWEST_LINES = 50
# Half width of the excluded band about each harmonic, in units of the frequency of the motion; with a random
# force, in lines. About the motion itself the band covers the effect of start and frequency; outside of it a
# random force dominates.
ABOUT_HARMONIC = 0.25
LINES_ABOUT_HARMONIC = 3.0
LINES_ABOUT_MOTION = 1.5
# Number of segments of a record, overlapping by half, over which lines above the motion are averaged.
SEGMENTS = 8
# Neighbouring lines are averaged to this number, which is enough for a spectrum with few bends.
MOST_LINES = 2000
# Number of independent values of the spectrum per line, for a Hann window.
INDEPENDENT_PART = 2.0 / 3.0
# First step of a search among colours, in units of arctanh(partial autocorrelation), and its tolerances: in
# these units and in the deviance.
COLOUR_STEP, COLOUR_TOLERANCE = 0.05, 0.02
# A long record determines a colour better: the first step is then this number of standard errors.
FIRST_STEP_IN_ERRORS = 3.0
# Relative accuracy of a gain far above significance, of which only the size matters.
PART_OF_GAIN = 0.01
# Largest partial autocorrelation in a search: a random walk has no stationary variance for its first sample.
MOST_CORRELATED = 0.999
# Trials of a search per tap: for noise that is almost a random walk (of an integrated rate) it converges
# slowly.
MOST_TRIALS = 25


@dataclass(frozen=True)
class Lines:
    """Lines of a spectrum, averaged to a small number.

    Attributes
    ----------
    line : (line,) array of float
        Frequency in cycles per sample.
    power : (line,) array of float
        Power; for white noise the variance of a sample.
    count : (line,) array of float
        Number of original lines in each averaged line.
    """

    line: Array
    power: Array
    count: Array

    @property
    def independent(self) -> float:
        """Equivalent number of independent samples of noise."""
        return 2.0 * INDEPENDENT_PART * float(np.sum(self.count))

    def noise(self, filter_: Array) -> NoiseModel:
        """Return the noise of a given colour, with the level of the lines."""
        variance = np.sum(self.count * self.power * self._gain(filter_)) / max(1.0, np.sum(self.count))
        return NoiseModel(float(np.sqrt(variance)), filter_)

    def as_samples(self, filter_: Array) -> tuple[float, float, float]:
        """Return the spectral lines as independent samples of a given colour (Whittle).

        Return their number, the sum of the squares of their innovations (rad^2), and the logarithm of the
        determinant of their covariance in units of the innovation variance.
        """
        logarithms = float(np.sum(self.count * np.log(self._gain(filter_))))
        squares = self.independent * self.noise(filter_).innovation ** 2
        return self.independent, squares, -2.0 * INDEPENDENT_PART * logarithms

    def colour(self, order: int) -> Array:
        """Return the whitening filter of the most likely autoregression of an order, from the lines alone."""
        return _whittle(self, np.zeros_like(self.line), order)[1].filter_

    def _gain(self, filter_: Array) -> Array:
        turns = np.exp(-2j * np.pi * np.multiply.outer(self.line, np.arange(len(filter_))))
        return np.asarray(np.abs(turns @ filter_) ** 2)


def lines_above(deviation: Array, tau: Array, band: float) -> Lines:
    """Return the spectral lines above a frequency (in units of the motion's); the rows contain those below.

    There are none if the time steps differ.

    Notes
    -----
    Lines are averages over overlapping segments (Welch 1967). A single window over the whole record would
    emphasise the noise in its middle, and the colour of a record interpolated from another clock varies over
    time.
    """
    line, power, k = _spectrum(deviation, tau, SEGMENTS)
    above = (k > band) & is_uniform(tau)
    return _averaged(line[above], power[above], float(SEGMENTS))


def most_likely_colour(
    deviance: Callable[[Array], float], starts: Sequence[Array], *, samples: float, least: float = np.inf
) -> tuple[Array, float]:
    """Return the whitening filter of least deviance, and its deviance.

    Parameters
    ----------
    deviance : callable
        Minus twice the log likelihood of a filter (tap,), with all other parameters profiled.
    starts : sequence of (tap,) arrays of float
        First estimates of one order; Nelder and Mead's search (1965) improves the best of them.
    samples : float
        Number of independent samples that determine the colour.
    least : float
        Deviance of an alternative explanation; a small relative accuracy of the difference from it is enough.
    """
    known = [deviance(start) for start in starts]
    value, best = min(known), starts[int(np.argmin(known))]
    order = len(best) - 1
    if not order:
        return best, value
    step = min(COLOUR_STEP, FIRST_STEP_IN_ERRORS / np.sqrt(samples))

    def filter_at(parameters: Array) -> Array:
        return filter_of(MOST_CORRELATED * np.tanh(parameters))

    while True:
        tolerance = _colour_tolerance(value - least)
        at = np.arctanh(
            np.clip(partial_autocorrelations(best) / MOST_CORRELATED, -MOST_CORRELATED, MOST_CORRELATED)
        )
        simplex = at + step * np.concatenate([np.zeros((1, order)), np.eye(order)])
        most = MOST_TRIALS * order
        options = {"initial_simplex": simplex, "xatol": COLOUR_STEP, "fatol": tolerance, "maxfev": most}
        minimum = minimize(lambda at: deviance(filter_at(at)), at, method="Nelder-Mead", options=options)
        # A start whose correlation exceeds the limit of the search may be the best.
        value, best = min((value, best), (float(minimum.fun), filter_at(minimum.x)), key=lambda pair: pair[0])
        if minimum.nfev >= most or _colour_tolerance(value - least) > 0.5 * tolerance:
            return best, value


def _colour_tolerance(gain: float) -> float:
    return max(COLOUR_TOLERANCE, PART_OF_GAIN * gain)


def sensor_colour(deviation: Array, tau: Array, *, random_force: bool) -> NoiseModel:
    """Return the sensor's noise, with its colour, from a deviation that may also contain a random force.

    Parameters
    ----------
    deviation : (sample,) array of float, rad
        The record minus a free motion.
    tau : (sample,) array of float
        Time in units of 1/w.
    random_force : bool
        Whether a random force is fitted with the noise. Lines of low frequency may be due to either; the
        likelihood of the rows decides.

    Returns
    -------
    NoiseModel
        The noise is white if the time steps differ, or if there are too few lines.

    Notes
    -----
    This is Whittle's likelihood for the spectrum variance/|filter|^2 + q/(1 - k^2)^2, with k the frequency in
    units of the motion's and a resonance as wide as a line. The order of the autoregression minimises the
    Bayesian information criterion.
    """
    line, power, k = _spectrum(deviation, tau)
    step = float(np.median(np.diff(tau)))
    harmonic = np.round(k)
    spacing = 2.0 * np.pi / (step * len(deviation))
    width_in_lines = np.where(harmonic == 1.0, LINES_ABOUT_MOTION, LINES_ABOUT_HARMONIC)
    width = spacing * width_in_lines if random_force else ABOUT_HARMONIC
    kept = (np.abs(k - harmonic) > width) | (harmonic > NOISE_HARMONICS)
    lines = _averaged(line[kept], power[kept])
    white = lines.noise(np.ones(1))
    if not is_uniform(tau) or len(lines.line) < 10 * (MAX_COLOUR + 2) or white.innovation == 0.0:
        return white
    away = (1.0 - (2.0 * np.pi * lines.line / step) ** 2) ** 2
    return _likeliest_colour(lines, random_force / (away + (2.0 * spacing) ** 2))


def colour_above(deviation: Array, tau: Array, band: float) -> NoiseModel:
    """Return the level and colour of noise from the lines of its spectrum above a frequency alone.

    Parameters
    ----------
    deviation : (sample,) array of float, rad
        A record minus a smooth motion.
    tau : (sample,) array of float
        Time in units of 1/w.
    band : float
        Frequency in units of the motion's; below it any force may act, and smooth curves follow.

    Returns
    -------
    NoiseModel
        The noise is white if the time steps differ, or if there are too few lines.
    """
    lines = lines_above(deviation, tau, band)
    if np.sum(lines.count) < FEWEST_LINES:
        return NoiseModel(float(np.std(deviation)), np.ones(1))
    return _likeliest_colour(lines, np.zeros_like(lines.line))


def _likeliest_colour(lines: Lines, response: Array) -> NoiseModel:
    """Return the noise of the best order, with a response to a random force."""
    best = _whittle(lines, response, 0)
    for order in range(1, MAX_COLOUR + 1):
        fit = _whittle(lines, response, order)
        if fit[0] >= best[0]:
            break
        best = fit
    return best[1]


def _spectrum(deviation: Array, tau: Array, segments: int = 1) -> tuple[Array, Array, Array]:
    """Return spectral lines (cycles per sample), their power, and their frequency over the motion's."""
    length = len(deviation) // segments
    line, power = scipy.signal.welch(deviation, nperseg=length, detrend="linear")
    # The one-sided spectrum takes half the time: each line except the first stands for two.
    line, power = line[: length // 2], power[: length // 2]
    power[1:] *= 0.5
    return line, power, 2.0 * np.pi * line / float(np.median(np.diff(tau)))


def _averaged(line: Array, power: Array, count_of_each: float = 1.0) -> Lines:
    """Return averages of neighbouring lines, at most `MOST_LINES`; a line counts as `count_of_each`."""
    width = max(1, -(-len(line) // MOST_LINES))
    first = np.arange(0, len(line), width)
    number = np.diff(np.append(first, len(line))).astype(float)
    if not len(line):
        return Lines(line, power, number)
    line, power = (np.add.reduceat(values, first) / number for values in (line, power))
    return Lines(line, power, count_of_each * number)


def _whittle(lines: Lines, response: Array, order: int) -> tuple[float, NoiseModel]:
    """Return the criterion and noise of the best autoregression of an order."""
    line, power, count = lines.line, lines.power, lines.count
    turns = np.exp(-2j * np.pi * np.multiply.outer(line, np.arange(order + 1)))
    level = float(np.sum(count * power) / np.sum(count))
    floor = float(np.median(power)) / np.log(2.0)
    weight = INDEPENDENT_PART * count

    def deviance(parameters: Array) -> tuple[float, Array]:
        """Return the deviance and its gradient."""
        partial = np.tanh(parameters[2:])
        filter_ = filter_of(partial)
        slopes = filter_slopes(partial) * (1.0 - partial**2)
        transfer = turns @ filter_
        size = np.abs(transfer) ** 2
        sensor, stochastic = np.exp(parameters[0]) / size, np.exp(parameters[1]) * response
        model = sensor + stochastic
        by_model = 2.0 * weight * (model - power) / model**2
        by_filter = -2.0 * np.real((np.conj(transfer) * by_model * sensor / size) @ turns)
        by_partial = by_filter @ slopes
        gradient = np.concatenate([[by_model @ sensor, by_model @ stochastic], by_partial])
        return float(2.0 * np.sum(weight * (np.log(model) + power / model))), gradient

    begin = np.array([np.log(floor), np.log(0.01 * level), *np.zeros(order)])
    limits = [(begin[0] - 12.0, begin[0] + 12.0), (begin[1] - 30.0, begin[1] + 20.0), *[(-4.0, 4.0)] * order]
    best = minimize(deviance, begin, jac=True, method="L-BFGS-B", bounds=limits)
    score = best.fun + order * np.log(float(np.sum(weight)))
    return score, NoiseModel(float(np.exp(0.5 * best.x[0])), filter_of(np.tanh(best.x[2:])))
