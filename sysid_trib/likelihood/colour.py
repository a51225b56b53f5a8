"""Colour of the sensor's noise with a random force, by the spectrum of what a free motion leaves.

The sensor's noise is an autoregression; the random force moves an oscillator, whose response falls off on
both sides of its resonance. Lines near harmonics of the motion, where forces act, say nothing of either.
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
# Harmonics of the motion that any force may leave.
NOISE_HARMONICS = 6
# Lines of a spectrum that tell a colour at all.
FEWEST_LINES = 50
# Half of the width that is left out about each harmonic, in units of the frequency of the motion; in lines if
# a random force is fitted too. About the motion itself this covers the effect of start and frequency: farther
# away, a random force dominates.
ABOUT_HARMONIC = 0.25
LINES_ABOUT_HARMONIC = 3.0
LINES_ABOUT_MOTION = 1.5
# Segments of a record, half of each in the next, over which lines above the motion are averaged.
SEGMENTS = 8
# Averages of neighbouring lines suffice, of which a spectrum of few bends has no more than this to tell.
MOST_LINES = 2000
# For a Hann window: number of independent values of the spectrum in each line.
INDEPENDENT_PART = 2.0 / 3.0
# First step of a search among colours, in units of arctanh(partial autocorrelation), and where it ends: in
# these units and in the deviance.
COLOUR_STEP, COLOUR_TOLERANCE = 0.05, 0.02
# A long record determines a colour better than that: the first step is then this number of standard errors.
FIRST_STEP_IN_ERRORS = 3.0
# Accuracy of a gain that is far beyond chance: only its size matters.
PART_OF_GAIN = 0.01
# Largest partial autocorrelation in a search: a walk has no variance that its first sample could have.
MOST_CORRELATED = 0.999
# Trials of a search for each tap: where noise is all but a random walk (an integrated rate's) it would creep.
MOST_TRIALS = 25


@dataclass(frozen=True)
class Lines:
    """Lines of a spectrum, averaged until they are few.

    Attributes
    ----------
    line : (line,) array of float
        Cycles a sample.
    power : (line,) array of float
        Power; for white noise the variance of a sample.
    count : (line,) array of float
        How many are in each.
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

        How many, the sum of the squares of their innovations (rad^2), and the logarithm of the determinant
        of their covariance in units of the variance of the innovations.
        """
        logarithms = float(np.sum(self.count * np.log(self._gain(filter_))))
        squares = self.independent * self.noise(filter_).innovation ** 2
        return self.independent, squares, -2.0 * INDEPENDENT_PART * logarithms

    def colour(self, order: int) -> Array:
        """Return the whitening filter of the most likely autoregression of an order, by the lines alone."""
        return _whittle(self, np.zeros_like(self.line), order)[1].filter_

    def _gain(self, filter_: Array) -> Array:
        turns = np.exp(-2j * np.pi * np.multiply.outer(self.line, np.arange(len(filter_))))
        return np.asarray(np.abs(turns @ filter_) ** 2)


def lines_above(deviation: Array, tau: Array, band: float) -> Lines:
    """Return the spectral lines above a frequency (in units of that of the motion); rows include those below.

    There are none if the time steps differ.

    Notes
    -----
    Averages over overlapping segments (Welch 1967): one window over the whole record would see the noise of
    its middle, and a record that was interpolated from another clock has a colour that comes and goes.
    """
    line, power, k = _spectrum(deviation, tau, SEGMENTS)
    above = (k > band) & is_uniform(tau)
    return _averaged(line[above], power[above], float(SEGMENTS))


def most_likely_colour(
    deviance: Callable[[Array], float], starts: Sequence[Array], *, samples: float, least: float = np.inf
) -> tuple[Array, float]:
    """Return the whitening filter of least deviance, and that.

    Parameters
    ----------
    deviance : callable
        Minus twice the logarithm of the likelihood of a filter (tap,), all else profiled.
    starts : sequence of (tap,) arrays of float
        First guesses, of one order; the best is improved by Nelder and Mead's search (1965).
    samples : float
        Number of independent samples that tell the colour.
    least : float
        Deviance of another explanation: how far it is from that need be known to a part of itself alone.
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
        # A start of stronger correlation than the limit of the search may be the best.
        value, best = min((value, best), (float(minimum.fun), filter_at(minimum.x)), key=lambda pair: pair[0])
        if minimum.nfev >= most or _colour_tolerance(value - least) > 0.5 * tolerance:
            return best, value


def _colour_tolerance(gain: float) -> float:
    return max(COLOUR_TOLERANCE, PART_OF_GAIN * gain)


def sensor_colour(deviation: Array, tau: Array, *, random_force: bool) -> NoiseModel:
    """Return level and colour of the sensor's noise in a deviation that a random force may contain as well.

    Parameters
    ----------
    deviation : (sample,) array of float, rad
        The record, minus a free motion.
    tau : (sample,) array of float
        Time in units of 1/w.
    random_force : bool
        Whether one is fitted with the noise. Lines of low frequency can be explained by either: which it
        is, the likelihood of the rows tells.

    Returns
    -------
    NoiseModel
        White where the steps of time differ, or the lines are too few.

    Notes
    -----
    Whittle's likelihood of the spectrum variance/|filter|^2 + q/(1 - k^2)^2, k the frequency in units of the
    motion's, the resonance as wide as a line. The order of the autoregression minimises the Bayesian
    information criterion.
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
    """Return the level and colour of noise by the lines of its spectrum above a frequency alone.

    Parameters
    ----------
    deviation : (sample,) array of float, rad
        A record minus a smooth motion.
    tau : (sample,) array of float
        Time in units of 1/w.
    band : float
        In units of the motion's frequency: below, any force may act, and what is smooth follows.

    Returns
    -------
    NoiseModel
        White where the steps of time differ, or the lines are too few.
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
    """Return spectral lines in cycles a sample, their power, and their frequency in units of the motion's."""
    length = len(deviation) // segments
    line, power = scipy.signal.welch(deviation, nperseg=length, detrend="linear")
    # One-sided, which takes half of the time: each line except the first occurs twice.
    line, power = line[: length // 2], power[: length // 2]
    power[1:] *= 0.5
    return line, power, 2.0 * np.pi * line / float(np.median(np.diff(tau)))


def _averaged(line: Array, power: Array, count_of_each: float = 1.0) -> Lines:
    """Return neighbouring lines averaged until they are few; each stands for so many of the whole record."""
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
