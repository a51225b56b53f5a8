"""Half periods of an oscillation that may be noisy, quantised, jittered, or held by hand at first."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import maximum_filter1d

from sysid_trib.arrays import Array, Index

POINTS_PER_PERIOD = 24
"""Number of points per period after smoothing: enough for zero crossings, few enough for speed."""


@dataclass(frozen=True)
class Oscillation:
    """A signal averaged over a twelfth of its period, and what disturbs it.

    Attributes
    ----------
    time, signal : (point,)
        The averaged signal, with points a twenty-fourth of a period apart if the sampling allows.
    period : s
        Dominant period.
    step : float
        Quantisation step of the original signal (tiny if there is none).
    smoothed_noise : float
        White noise of one averaged point.
    samples : int
        Number of samples averaged in a point.
    """

    time: Array
    signal: Array
    period: float
    step: float
    smoothed_noise: float
    samples: int

    @property
    def floor(self) -> float:
        """Amplitude below which noise or quantisation could imitate a half period."""
        return max(5.0 * self.smoothed_noise, 0.75 * self.step)


@dataclass(frozen=True)
class HalfPeriods:
    """Consecutive half periods, bounded by zero crossings; their signs alternate.

    Attributes
    ----------
    crossing : (half_period + 1,) s
        Zero crossings; the first and last value are the ends of the averaged signal, unless a part was
        selected.
    sign : (half_period,)
        +1 or -1.
    peak : (half_period,)
        Largest absolute value of the averaged signal.
    """

    crossing: Array
    sign: Index
    peak: Array

    @property
    def duration(self) -> Array:
        """Time between the crossings of each half period."""
        return np.diff(self.crossing)

    def select(self, part: slice) -> "HalfPeriods":
        """Return the half periods ``part.start`` to ``part.stop - 1``."""
        return HalfPeriods(self.crossing[part.start : part.stop + 1], self.sign[part], self.peak[part])

    def samples(self, time: Array) -> tuple[Index, Index]:
        """Return the first sample of each half period, and one past its last."""
        bounds = np.searchsorted(time, self.crossing)
        return bounds[:-1], bounds[1:]


def noise_level(time: Array, signal: Array) -> float:
    """Return the white noise of one sample, from sixth differences, which a smooth motion does not affect.

    Jittered times require divided differences; equal steps would turn motion into noise. Single spikes and
    the kinks of dry friction are left out.
    """
    if signal.size < 12:
        return 0.0
    steps = np.diff(time)
    if np.ptp(steps) < 1e-6 * steps.mean():
        difference = np.abs(np.diff(signal, 6)) / np.sqrt(924.0)
    else:
        difference = _divided_difference(time / steps.mean(), signal)
    usual = float(np.quantile(difference, 0.7))
    if usual > 0.0:
        difference = difference[difference < 8.0 * usual]
    return float(np.sqrt(np.mean(difference**2)))


def _divided_difference(time: Array, signal: Array) -> Array:
    """Return the size of the sixth divided differences, scaled to the noise of one sample."""
    count = time.size - 6
    near, values = ([array[at : at + count] for at in range(7)] for array in (time, signal))
    difference = np.zeros(count)
    squares = np.zeros(count)
    # One point after another: all spacings of a long record at once would take a gigabyte.
    for at in range(7):
        weight = 1.0 / math.prod(near[at] - near[other] for other in range(7) if other != at)
        difference += weight * values[at]
        squares += weight**2
    return np.asarray(np.abs(difference) / np.sqrt(squares))


def quantisation_step(signal: Array) -> float:
    """Return the smallest spacing between values; for continuous values it is negligible.

    Spacings below a millionth of the range are rounding of the quantised values, not their step.
    """
    values = np.sort(signal[:: max(1, signal.size // 20_000)])
    spacing = np.diff(values)
    spacing = spacing[spacing > 1e-6 * (values[-1] - values[0])]
    return float(spacing.min()) if spacing.size else 0.0


def noise_of_record(time: Array, signal: Array) -> float:
    """Return the noise of one sample: white noise, or that of quantisation if it is larger."""
    return max(noise_level(time, signal), quantisation_step(signal) / np.sqrt(12.0))


def dominant_periods(time: Array, signal: Array) -> list[float]:
    """Return periods of the strongest line in the rate and, if others, in the rate's root and the signal.

    Holding by hand, lifting and rest are slow: the rate suppresses them, but amplifies mains hum. The result
    is empty if no line exceeds the spectrum's median clearly, as in noise. If this holds for the whole
    record, a soon damped swing may still have a line in the part with most motion.
    """
    good = np.isfinite(signal)
    time = time[good]
    signal = signal[good]
    if signal.size < 2:
        return []
    interval = (time[-1] - time[0]) / (time.size - 1)
    if periods := _periods_of_lines(signal, interval):
        return periods
    power = np.cumsum(np.square(signal - np.median(signal)))
    length = signal.size // PART
    while length >= SHORTEST_PART:
        start = int(np.argmax(power[length:] - power[:-length]))
        if periods := _periods_of_lines(signal[start : start + length], interval):
            return periods
        length //= PART
    return []


# A record without a strong line is searched in parts that are shorter by this factor each time, down to this
# number of samples.
PART = 4
SHORTEST_PART = 32


def _periods_of_lines(signal: Array, interval: float) -> list[float]:
    """Return the periods of `dominant_periods` for samples with this time between them."""
    size = next_fast_len(2 * signal.size, real=True)
    spectrum = np.abs(rfft(signal - np.median(signal), size))[1:]
    # Few lines are strong: do the next steps with these only.
    out = np.flatnonzero(~(spectrum < 8.0 * np.median(spectrum)))
    spectrum = spectrum[out]
    index = out + 1
    if not spectrum.size:
        return []
    peaks = [int(np.argmax(spectrum * index**power)) for power in (1.0, 0.5, 0.0)]
    if spectrum[peaks[0]] == 0.0:
        return []
    periods: list[float] = []
    for peak in peaks:
        period = float(size * interval / index[peak])
        # With times near the smallest number, a period may become zero.
        if period > 0.0 and not any(0.8 < period / other < 1.25 for other in periods):
            periods.append(period)
    return periods


def smooth(time: Array, signal: Array, period: float) -> Oscillation:
    """Average over a twelfth of the period."""
    interval = (time[-1] - time[0]) / (time.size - 1)
    width = max(1, round(2 * period / POINTS_PER_PERIOD / interval))
    first = np.arange(0, time.size - width + 1, max(1, width // 2))

    def average(values: Array) -> Array:
        total = np.concatenate(([0.0], np.cumsum(values - values[0])))
        return (total[first + width] - total[first]) / width + values[0]

    noise = float(noise_level(time, signal) / np.sqrt(width))
    return Oscillation(average(time), average(signal), period, quantisation_step(signal), noise, width)


def find_half_periods(oscillation: Oscillation, equilibrium: float = 0.0) -> HalfPeriods:
    """Split an oscillation at the zero crossings that lead from one clear side to the other.

    A side is clear beyond a tenth of the local amplitude, and beyond noise and quantisation (hysteresis). Of
    several noisy crossings, the middle is used.
    """
    time = oscillation.time
    signal = oscillation.signal - equilibrium
    magnitude = np.abs(signal)
    points = max(3, round(oscillation.period * (time.size - 1) / (time[-1] - time[0])))
    clear = magnitude > np.maximum(0.1 * maximum_filter1d(magnitude, points), oscillation.floor)
    where = np.flatnonzero(clear)
    side = np.sign(signal[where]).astype(np.int64)
    turn = np.flatnonzero(np.diff(side))
    if where.size == 0:
        empty = np.zeros(0)
        return HalfPeriods(empty, empty.astype(np.int64), empty)
    crossing = _middle_crossing(time, signal, where[turn], where[turn + 1])
    crossing = np.concatenate(([time[0]], crossing, [time[-1]]))
    first = np.concatenate(([0], turn + 1))
    peak = np.maximum.reduceat(magnitude[where], first)
    return HalfPeriods(crossing, side[first], peak)


def _middle_crossing(time: Array, signal: Array, before: Index, after: Index) -> Array:
    """Return the mean of the first and last zero crossing between the points ``before`` and ``after``."""
    change = np.flatnonzero((signal[:-1] > 0) != (signal[1:] > 0))
    low = signal[change]
    high = signal[change + 1]
    instant = time[change] + (time[change + 1] - time[change]) * low / (low - high)
    first = np.searchsorted(change, before)
    last = np.searchsorted(change, after) - 1
    return 0.5 * (instant[first] + instant[last])


def regular_run(halves: HalfPeriods, period: float) -> slice:
    """Return the run of whole half periods with steady durations that covers the longest travel.

    Rest, lifting, holding and a stuck tail last too long or too short to belong to it.
    """
    half = halves.duration / (0.5 * period)
    fits = (half > 0.4) & (half < 2.5)
    # The first and the last half period are cut off by the ends of the record.
    fits[:1] = fits[-1:] = False
    steady = np.abs(np.log(half[1:] / half[:-1])) < np.log(1.67)
    goes_on = steady & fits[1:] & fits[:-1]
    run = np.concatenate(([0], np.cumsum(~goes_on)))[: fits.size]
    travel = np.bincount(run, halves.peak * fits, minlength=1)
    best = np.flatnonzero(fits & (run == np.argmax(travel)))
    return slice(int(best[0]), int(best[-1]) + 1) if best.size else slice(0, 0)
