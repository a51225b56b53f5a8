"""Swing within a record, and its equilibrium."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import DecayError
from sysid_trib.records import half_periods
from sysid_trib.records.signal import checked_signal

BINOMIAL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
DRIFT_BLOCKS = 8
SHORT_BINOMIAL = np.array([1.0, 2.0, 1.0]) / 4.0
# Half periods summed at once: with a hundred samples each, their terms fit into the cache of a core.
HALF_PERIODS_AT_ONCE = 64


@dataclass(frozen=True)
class Swing:
    """The regular part of an oscillation, split about its equilibrium, and the parts cut from its piece.

    Attributes
    ----------
    time, signal : of its piece, s and in any unit.
    oscillation : the smoothed signal, not centred.
    halves : all half periods of the piece, about the equilibrium.
    run : those of them that belong to the regular swing.
    equilibrium, standard_error : in the signal's unit; the error is nan where the equilibrium was given.
    free : the samples in which it swings freely.
    before, after : what is cut, and why.
    stop_time : s, when it stopped for good; nan if it did not.
    mended : what was done to its samples before.
    """

    time: Array
    signal: Array
    oscillation: half_periods.Oscillation
    halves: half_periods.HalfPeriods
    run: slice
    equilibrium: float
    standard_error: float
    free: slice
    before: str = ""
    after: str = ""
    stop_time: float = float("nan")
    mended: str = ""

    @property
    def peaks(self) -> Array:
        """Largest absolute value of each half period of the run."""
        return self.halves.peak[self.run]

    @property
    def extrema(self) -> Array:
        """Size of each extremum of the run, from all samples."""
        centred = self.signal - self.equilibrium
        return np.abs(signed_extrema(self.time, centred, self.halves.select(self.run)))

    @property
    def scatter(self) -> float:
        """Upper estimate of an extremum's scatter: noise averaged over a third of a period, and steps."""
        return 3.0 * self.oscillation.smoothed_noise + 0.5 * self.oscillation.step


def find_swing(time: Array, signal: Array, equilibrium: float | None = None) -> Swing | None:
    """Find the regular swing of a signal and, unless it is given, its equilibrium.

    Return None if no oscillation is visible above the noise.
    """
    periods = half_periods.dominant_periods(time, signal)
    swings = [_settle(time, signal, period, equilibrium) for period in periods]
    travels = max(swings, key=lambda swing: float(swing.peaks.sum()), default=None)
    if travels is None:
        return None
    # Mains hum has a long travel of small movements. The swing is the motion whose amplitude is, in some half
    # periods, several times that of the line with the longest travel.
    period = travels.oscillation.period
    far = 2.0 * _largest(travels)
    larger = [s for s in swings if s.peaks.size >= 5 and s.oscillation.period > period and _largest(s) > far]
    return max(larger, key=_largest, default=travels)


def _largest(swing: Swing) -> float:
    return float(swing.peaks.max(initial=0.0))


def with_half_periods(
    decay: xr.Dataset, fewest: int = 3, equilibrium: float | None = 0.0
) -> tuple[Array, Array, half_periods.HalfPeriods]:
    """Return times (s), angles (rad) and whole half periods of a centred decay.

    Parameters
    ----------
    decay : Dataset
        `angle(time)`. The half periods of the last decays are cached, because several parts of the program
        need them.
    fewest : int
        Least number of half periods; an envelope needs three.
    equilibrium : float or None, rad
        Equilibrium; with None it is estimated.

    Raises
    ------
    DecayError
        There are fewer half periods.
    """
    checked_signal(decay)
    time = decay.time.values.astype(float)
    angle = decay.angle.values.astype(float)
    source = str(decay.attrs.get("source", "decay"))
    halves = _whole_half_periods(time.tobytes(), angle.tobytes(), equilibrium)
    if halves is None:
        raise DecayError(f"{source}: no oscillation is visible above the noise.")
    count = halves.sign.size
    if count < fewest:
        raise DecayError(f"{source}: only {count} whole half periods; at least {fewest} needed.")
    return time, angle, halves


@lru_cache(maxsize=64)
def _whole_half_periods(
    time: bytes, angle: bytes, equilibrium: float | None
) -> half_periods.HalfPeriods | None:
    swing = find_swing(np.frombuffer(time), np.frombuffer(angle), equilibrium)
    return None if swing is None else swing.halves.select(swing.run)


def _settle(time: Array, signal: Array, period: float, equilibrium: float | None) -> Swing:
    """Split and centre alternately: the split depends on the centre and the centre on the split."""
    oscillation = half_periods.smooth(time, signal, period)
    centre = _centre_of_travel(oscillation) if equilibrium is None else equilibrium
    error = np.nan
    halves, run = _split(oscillation, centre)
    # Start with the smoothed points, which is fast, then use all samples.
    for source_time, source in ((oscillation.time, oscillation.signal),) * 3 + ((time, signal),) * 2:
        if equilibrium is not None or run.stop - run.start < 4:
            break
        extrema = centre + signed_extrema(source_time, source - centre, halves.select(run))
        # The cosine uses four times as many samples as an averaged point, with unequal weights.
        centre, error = robust_mean(extrema, 0.6 * oscillation.smoothed_noise)
        halves, run = _split(oscillation, centre)
    return Swing(time, signal, oscillation, halves, run, centre, error, slice(0, time.size))


def _split(oscillation: half_periods.Oscillation, centre: float) -> tuple[half_periods.HalfPeriods, slice]:
    halves = half_periods.find_half_periods(oscillation, centre)
    return halves, half_periods.regular_run(halves, oscillation.period)


def _centre_of_travel(oscillation: half_periods.Oscillation) -> float:
    """Return the median weighted by the distance travelled, in which holding and resting do not count."""
    middle = 0.5 * (oscillation.signal[1:] + oscillation.signal[:-1])
    distance = np.abs(np.diff(oscillation.signal))
    order = np.argsort(middle)
    travelled = np.cumsum(distance[order])
    return float(middle[order][np.searchsorted(travelled, 0.5 * travelled[-1])])


def signed_extrema(time: Array, signal: Array, halves: half_periods.HalfPeriods) -> Array:
    """Return the extremum of each half period of a roughly centred signal: a cosine fits its middle part.

    A remaining offset is transmitted with gain one, apart from the cosine's curvature.
    """
    duration = halves.duration
    local = np.convolve(np.pad(duration, 1, mode="edge"), SHORT_BINOMIAL, "valid")
    middle = 0.5 * (halves.crossing[1:] + halves.crossing[:-1])
    reach = np.maximum(local / 3.0, 1.5 * (time[-1] - time[0]) / (time.size - 1))
    low = np.searchsorted(time, middle - reach)
    high = np.minimum(np.searchsorted(time, middle + reach), np.append(low[1:], time.size))
    sample, half, first = samples_between(low, high)
    phase = np.pi * (time[sample] - middle[half]) / local[half]
    cc, cs, ss, cy, sy = harmonic_sums(phase, signal[sample], np.ones(half.size), first)
    determinant = np.maximum(cc * ss - cs * cs, 1e-12 * cc * cc)
    p = (ss * cy - cs * sy) / determinant
    q = (cc * sy - cs * cy) / determinant
    return np.copysign(np.hypot(p, q), p)


def samples_between(low: Index, high: Index) -> tuple[Index, Index, Index]:
    """Return the samples of all half periods: their indices, their half periods, and each first one."""
    count = high - low
    half = np.repeat(np.arange(count.size), count)
    first = np.cumsum(count) - count
    return np.arange(half.size) + (low - first)[half], half, first


def harmonic_sums(phase: Array, value: Array, weight: Array, first: Index) -> Array:
    """Return sums of cos cos, cos sin, sin sin, cos y and sin y over half periods that start at `first`."""
    sums = np.empty((5, len(first)))
    # Work in blocks: the intermediate arrays then stay in the cache for any length of the record.
    for start in range(0, len(first), HALF_PERIODS_AT_ONCE):
        begin = first[start : start + HALF_PERIODS_AT_ONCE]
        # A half period without samples uses the first sample of the next one.
        last = start + len(begin)
        end = len(phase) if last == len(first) else max(first[last], begin[-1] + 1)
        part = slice(begin[0], end)
        cosine = np.cos(phase[part])
        sine = np.sin(phase[part])
        y = value[part]
        c = weight[part] * cosine
        s = weight[part] * sine
        terms = (c * cosine, c * sine, s * sine, c * y, s * y)
        sums[:, start:last] = [np.add.reduceat(term, begin - begin[0]) for term in terms]
    return sums


def robust_mean(extrema: Array, noise: float) -> tuple[float, float]:
    """Return the mean of (b[i-1] + 2 b[i] + b[i+1])/4 over signed extrema, and its standard error.

    If the envelope is curved, these terms alternate about the equilibrium by a quarter of its second
    difference. The difference between extrema of one sign shows this amount: it is subtracted (which makes
    the weights 1 4 6 4 1) and reduces the weight of the term. Outlying terms have less weight too (Huber).
    The error is at least that due to ``noise``, the noise of an extremum.
    """
    kernel = BINOMIAL if extrema.size >= 5 else SHORT_BINOMIAL
    terms = np.convolve(extrema, kernel, "valid")
    weights = np.ones(terms.size)
    curvature = np.abs(extrema[2:] - extrema[:-2]) / 4.0
    if extrema.size >= 5:
        curvature = np.abs(extrema[4:] - 2.0 * extrema[2:-2] + extrema[:-4]) / 16.0
        usual = max(float(np.median(curvature)), noise, 1e-15 * float(np.max(np.abs(extrema))))
        weights = 1.0 / np.maximum(1.0, curvature / usual) ** 2
    total = weights
    mean = float(np.average(terms, weights=weights))
    for _ in range(5):
        deviation = np.abs(terms - mean)
        limit = 1.5 * 1.4826 * float(np.median(deviation))
        total = weights * limit / np.maximum(deviation, limit) if limit > 0.0 else weights
        mean = float(np.average(terms, weights=total))
    # Neighbouring terms share extrema: the error follows from the final weight of each extremum.
    influence = float(np.sqrt(np.sum(np.convolve(total / total.sum(), kernel) ** 2)))
    scatter = np.sqrt(np.average((terms - mean) ** 2, weights=total) * terms.size / max(terms.size - 1, 1))
    error = float(scatter / np.sqrt(np.sum(kernel**2))) * influence
    # The scatter of a few terms may be small by chance.
    if terms.size < 12:
        error = max(error, noise * influence)
    if terms.size < 4:
        error = max(error, float(np.mean(curvature)))
    return mean, max(error, _drift_error(terms, total, error))


def _drift_error(terms: Array, weights: Array, error: float) -> float:
    """Return the mean's error from eight blocks, if it is clearly larger: the equilibrium drifts."""
    if terms.size < 4 * DRIFT_BLOCKS:
        return 0.0
    bounds = np.arange(DRIFT_BLOCKS) * terms.size // DRIFT_BLOCKS
    mass = np.add.reduceat(weights, bounds)
    blocks = np.add.reduceat(weights * terms, bounds) / mass
    weight = mass / mass.sum()
    scatter = np.sum((weight * (blocks - np.sum(weight * blocks))) ** 2) * DRIFT_BLOCKS / (DRIFT_BLOCKS - 1)
    drift = float(np.sqrt(scatter))
    return drift if drift > 1.7 * error else 0.0
