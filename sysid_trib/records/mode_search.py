"""Search for the modes in a decay that several sensors record: lines of the spectrum, fitted together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import maximum_filter1d, median_filter

from sysid_trib.arrays import Array, Mask
from sysid_trib.records.ringing import (
    MOST_CANCELLING,
    Component,
    carrier,
    component_shape,
    fit_envelopes,
    noise_of_cancelling,
    with_common_part,
)

# The blow starts where the signals first reach this fraction of their largest value. The ringing is free
# after this number of samples, or this fraction of the record.
ONSET, BLOW_SAMPLES, BLOW_PART = 0.1, 3, 5e-4
# Number of parts of a record in which a second blow is searched, and the least jump of the signals at it.
BLOW_BLOCKS, SECOND_BLOW = 200, 3.0
# Bins of the spectrum on a logarithmic axis: their width, the number of bins on either side of which a line
# is the largest, and the number of bins whose median it exceeds by this factor.
LINE_BIN, LARGEST_OF_BINS, MEDIAN_BINS, ABOVE_MEDIAN = 0.005, 4, 60, 5.0
LOWEST_LINE = 8
# Degree of the polynomial in time that is the drift of a sensor: slower than the lowest line.
SENSOR_DRIFT_DEGREE = 8
# It is one if it is this part of the residual of all lines: otherwise lines are not fitted well.
DRIFT_OF_RESIDUAL = 0.7
# Logarithm of one over the probability that noise alone makes a line of a spectrum this high.
CERTAIN_LINE = 30.0
# Rounds of the search, fits per round, most new lines per round, and most lines in total.
SEARCH_ROUNDS, REFINEMENTS, MOST_NEW, MOST_COMPONENTS = 4, 3, 8, 24
# A line at this relative distance from a known one is another mode if it has this fraction of its height.
NEAR_LINE, LEAST_HEIGHT = 0.2, 0.02
# Knots of an envelope: beats with the next line per knot, knots per fall by e, least and largest number.
BEATS_A_KNOT, KNOTS_A_FALL, LEAST_KNOTS, MOST_KNOTS = 2.0, 4.0, 4, 60
# Bandwidth of a carrier, as a fraction of the distance to the next line, or of the frequency.
BAND_OF_DISTANCE, BAND_OF_FREQUENCY = 0.4, 0.08
# Number of standard errors below which an envelope is lost in the noise, and least number of samples of a
# component.
LOST_IN_NOISE, FEWEST_RINGING = 3.0, 50
# Least first amplitude of a mode over the largest one, at the sensor where the mode is strongest.
LEAST_AMPLITUDE = 0.003
# A line is a harmonic if it is this near to a multiple of a stronger line and has at most this fraction of
# its amplitude.
MULTIPLE_TOLERANCE, LARGEST_HARMONIC, MOST_MULTIPLE = 4e-3, 0.1, 9
# A line is steady if its amplitude in the last third exceeds this fraction of that in the first.
STEADY = 0.7
# Relative frequency difference below which two modes are not separated reliably: by their frequencies alone,
# and by different shapes at several sensors.
CLOSE_FREQUENCIES, CLOSE_WITH_SHAPES = 0.07, 0.033
# Least number of beats that resolves two oscillations.
FEWEST_BEATS = 3.0
# Noise of a signal, over its range, below which modes are not separated.
LEAST_NOISE = 1e-7


@dataclass(frozen=True, eq=False)
class Ringing:
    """Oscillations in signals after a blow.

    Attributes
    ----------
    onset, start : int
        Sample at which the blow starts, and first sample of the free ringing.
    interval : float, s
    signals : (sensor, sample) array of float
        Signals from the start of the ringing, about their offsets.
    noise : (sensor,) array of float
        Standard deviation of the white noise of the signals.
    components : tuple of Component
        Components by increasing frequency.
    kinds : tuple of str
        Kind of each: ``mode``, ``harmonic``, ``line`` (steady), ``weak``.
    residual : (sensor,) array of float
        RMS residual of all components.
    second_blow : int or None
        Sample at which the signals jump again; later samples are left out.
    drifts : (sensor,) array of bool
        Whether a slow drift of the sensor was subtracted.
    """

    onset: int
    start: int
    interval: float
    signals: Array
    noise: Array
    components: tuple[Component, ...]
    kinds: tuple[str, ...]
    residual: Array
    second_blow: int | None
    drifts: Mask

    @property
    def duration(self) -> float:
        """Duration of the free ringing, s."""
        return self.signals.shape[1] * self.interval

    @property
    def modes(self) -> list[Component]:
        """Modes, by rising frequency."""
        return self.of_kind("mode")

    def of_kind(self, wanted: str) -> list[Component]:
        """Return the components of a kind."""
        return [
            component for component, kind in zip(self.components, self.kinds, strict=True) if kind == wanted
        ]


def find_ringing(signals: Array, interval: float) -> Ringing:
    """Find the decaying oscillations in signals, and fit them.

    Parameters
    ----------
    signals : (sensor, sample) array of float
    interval : float, s
        Interval of the samples.
    """
    onset, start, second = _free_part(signals)
    noise = np.maximum(_white_noise(signals[:, start:second]), LEAST_NOISE * np.ptp(signals, axis=1))
    signals = signals[:, start:second] - _offset(signals[:, start:second])[:, None]
    components, rest = _components_and_rest(signals, interval, noise)
    drift = _drift(rest)
    size = np.std(drift, axis=1)
    drifts = (size > noise) & (size > DRIFT_OF_RESIDUAL * np.std(rest, axis=1))
    if drifts.any():
        signals = signals - np.where(drifts[:, None], drift, 0.0)
        components, rest = _components_and_rest(signals, interval, noise)
    return Ringing(
        onset=onset,
        start=start,
        interval=interval,
        signals=signals,
        noise=noise,
        components=tuple(components),
        kinds=tuple(_kinds(components, interval)),
        residual=np.sqrt(np.mean(rest**2, axis=1)),
        second_blow=second,
        drifts=drifts,
    )


def _components_and_rest(signals: Array, interval: float, noise: Array) -> tuple[list[Component], Array]:
    """Return every oscillation above the noise, and the signals without them, (sensor, sample)."""
    components = _components(signals, interval, noise)
    return components, signals - sum((component.signal() for component in components), np.zeros_like(signals))


def _components(signals: Array, interval: float, noise: Array) -> list[Component]:
    """Find and fit every oscillation above the noise, by rising frequency."""
    components: list[Component] = []
    lines: dict[float, float] = {}
    rest = signals
    for _ in range(SEARCH_ROUNDS):
        new = _lines(rest / noise[:, None], interval, lines)
        if not new or len(components) >= MOST_COMPONENTS:
            break
        candidates = [*lines, *new]
        started = [_started(rest, interval, frequency, candidates, noise) for frequency in new]
        lines |= new
        if not any(started):
            break
        components += [component for component in started if component is not None]
        components = [_with_knots(component, components, interval) for component in components]
        for _ in range(REFINEMENTS):
            components = [
                with_common_part(component, noise) for component in fit_envelopes(signals, components)
            ]
        components = fit_envelopes(signals, components)
        rest = signals - sum(component.signal() for component in components)
    seen = [
        component
        for component in (_until_lost(component, noise) for component in components)
        if component is not None
    ]
    return sorted(seen, key=lambda component: central_frequency(component, interval))


def _free_part(signals: Array) -> tuple[int, int, int | None]:
    """Return the first sample of the blow, of the free ringing, and of a second blow, if there is one."""
    middle = np.median(signals, axis=1)[:, None]
    size = np.abs(signals - middle)
    size = np.max(size / np.maximum(np.max(size, axis=1), 1e-300)[:, None], axis=0)
    onset = int(np.argmax(size > ONSET))
    start = onset + max(BLOW_SAMPLES, round(BLOW_PART * size.size))
    block = max(8, size.size // BLOW_BLOCKS)
    count = (size.size - start) // block
    if count < 4:
        return onset, start, None
    largest = size[start : start + count * block].reshape(count, block).max(axis=1)
    before = np.maximum.accumulate(largest[::-1])[::-1]
    floor = 10.0 * float(np.median(largest[-max(2, count // 20) :]))
    for at in range(2, count):
        recent = largest[max(0, at - 4) : at].max()
        if largest[at] > SECOND_BLOW * recent and largest[at] > floor and before[at] > ONSET:
            return onset, start, start + (at - 1) * block
    return onset, start, None


def _white_noise(signals: Array) -> Array:
    """Estimate the standard deviation of the white noise, (sensor,), by the median of the spectra."""
    last = signals[:, signals.shape[1] // 2 :]
    window = np.hanning(last.shape[1])
    power = np.abs(rfft(last * window)) ** 2 / np.sum(window**2)
    return np.asarray(np.sqrt(np.median(power, axis=1) / np.log(2.0)))


def _offset(signals: Array) -> Array:
    """Return the offsets of signals, (sensor,), by their last half."""
    last = signals[:, signals.shape[1] // 2 :]
    window = np.hanning(last.shape[1])
    return np.asarray(last @ window / window.sum())


def _drift(rest: Array) -> Array:
    """Return the slow drift of signals without their oscillations, (sensor, sample): a polynomial in time."""
    time = np.linspace(-1.0, 1.0, rest.shape[1])
    columns = np.linalg.qr(np.polynomial.legendre.legvander(time, SENSOR_DRIFT_DEGREE))[0]
    return np.asarray(rest @ columns @ columns.T)


def _lines(signals: Array, interval: float, known: Mapping[float, float]) -> dict[float, float]:
    """Return the frequencies of lines of the spectrum with their heights, the strongest first."""
    count = signals.shape[1]
    size = next_fast_len(count, real=True)
    window = np.ones(count)
    # The window rises within a few samples, so that a strong line has no wide skirts, and falls at the end.
    rise, fall = max(8, count // 100), count // 10
    window[:rise] = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, rise))
    window[-fall:] = 0.5 + 0.5 * np.cos(np.linspace(0.0, np.pi, fall))
    spectra = np.abs(rfft(signals * window, size)) ** 2 / np.sum(window**2)
    spectrum = np.sqrt(np.sum(spectra, axis=0))[LOWEST_LINE:]
    index = np.arange(LOWEST_LINE, LOWEST_LINE + spectrum.size)
    bins = np.floor(np.log(index / LOWEST_LINE) / LINE_BIN).astype(int)
    first = np.flatnonzero(np.diff(bins, prepend=-1))
    largest = np.maximum.reduceat(spectrum, first)
    lines = largest >= maximum_filter1d(largest, 2 * LARGEST_OF_BINS + 1)
    lines &= largest > ABOVE_MEDIAN * median_filter(largest, 2 * MEDIAN_BINS + 1, mode="nearest")
    lines &= largest > np.sqrt(signals.shape[0] + 2.0 * np.log(spectrum.size) + CERTAIN_LINE)
    if not (known or lines.any()) and largest.max() > ABOVE_MEDIAN * np.median(spectrum):
        # In a short record, the median includes the skirts of its single line.
        lines[int(np.argmax(largest))] = True
    made = []
    for at in np.flatnonzero(lines):
        stop = first[at + 1] if at + 1 < first.size else spectrum.size
        line = first[at] + int(np.argmax(spectrum[first[at] : stop]))
        around = slice(max(0, line - 2), line + 3)
        centre = float(np.average(index[around], weights=spectrum[around] ** 2)) / (size * interval)
        height = float(largest[at])
        near = [size for other, size in known.items() if abs(centre / other - 1.0) < NEAR_LINE]
        if height > LEAST_HEIGHT * max(near, default=0.0):
            made.append((height, centre))
    return {frequency: height for height, frequency in sorted(made, reverse=True)[:MOST_NEW]}


def _started(
    rest: Array, interval: float, frequency: float, lines: Sequence[float], noise: Array
) -> Component | None:
    """Return a component at a line, without its envelope; None if it is below the noise."""
    distance = min((abs(other - frequency) for other in lines if other != frequency), default=frequency)
    half_band = min(BAND_OF_DISTANCE * distance, BAND_OF_FREQUENCY * frequency)
    made = carrier(rest, interval, frequency, half_band, noise)
    if made is None:
        return None
    phase, level, stop = made
    return Component(phase, level - level[0], stop, float(stop), np.zeros((0, 0), complex), np.zeros(0))


def _with_knots(component: Component, components: Sequence[Component], interval: float) -> Component:
    """Set the knots of a component from the distance of the next line and from its rate of decay."""
    own = central_frequency(component, interval)
    others = (central_frequency(other, interval) for other in components if other is not component)
    distance = min((abs(other - own) for other in others), default=own)
    fall = max(float(component.level[0] - component.level[component.stop - 1]), 0.0)
    count = float(np.clip(KNOTS_A_FALL * fall, LEAST_KNOTS, MOST_KNOTS))
    spacing = max(component.stop / count, BEATS_A_KNOT / max(distance, 1e-9) / interval, 2.0 / own / interval)
    return replace(component, spacing=min(spacing, float(component.stop)))


def _until_lost(component: Component, noise: Array) -> Component | None:
    """Cut a component where it falls below the noise; return None if it is below it from the start."""
    points = np.linspace(0.0, component.stop - 1.0, 4 * component.splines)
    size = np.sqrt(np.mean(np.abs(component.envelope_at(points) / noise) ** 2, axis=1))
    seen = np.flatnonzero(size > LOST_IN_NOISE * component.error_at(points))
    if not seen.size:
        return None
    if seen[-1] >= points.size - 2:
        return component
    stop = int(points[seen[-1]]) + 1
    return replace(component, stop=stop) if stop > FEWEST_RINGING else None


def central_frequency(component: Component, interval: float) -> float:
    """Return the mean frequency (Hz) of a component, weighted by its energy."""
    level = component.level[: component.stop]
    return float(
        np.average(
            component.frequency(interval)[: component.stop], weights=np.exp(2.0 * (level - level.max()))
        )
    )


def amplitude_at(component: Component, samples: Array) -> Array:
    """Return the amplitude at every sensor, (point, sensor)."""
    level = np.interp(samples, np.arange(component.phase.size), component.level)
    return np.asarray(np.abs(component.envelope_at(samples)) * np.exp(level)[:, None])


def is_multiple(ratio: float) -> bool:
    """Return true if a ratio of frequencies is 2, 3, ..."""
    whole = round(ratio)
    return 2 <= whole <= MOST_MULTIPLE and abs(ratio / whole - 1.0) < MULTIPLE_TOLERANCE


def too_close(component: Component, other: Component, ringing: Ringing) -> str:
    """Describe why two modes are too close to be separated reliably; empty if they are not."""
    frequency, second = (central_frequency(part, ringing.interval) for part in (component, other))
    apart = abs(second / frequency - 1.0)
    if apart > CLOSE_FREQUENCIES:
        return ""
    if ringing.noise.size == 1:
        return "one sensor does not separate such close modes reliably"
    own, shape = (component_shape(part, ringing.noise).real for part in (component, other))
    if noise_of_cancelling(own, [shape], ringing.noise) > MOST_CANCELLING:
        return "their shapes at these sensors are too similar to separate such close modes reliably"
    if apart < CLOSE_WITH_SHAPES:
        return "even different shapes do not separate such close modes reliably"
    return ""


def unresolved(component: Component, ringing: Ringing) -> list[Component]:
    """Return the modes and lines whose beats with a component are too few to separate them."""
    frequency = central_frequency(component, ringing.interval)
    return [
        other
        for other in (*ringing.modes, *ringing.of_kind("line"))
        if other is not component
        and abs(central_frequency(other, ringing.interval) - frequency)
        * min(other.stop, component.stop)
        * ringing.interval
        < FEWEST_BEATS
    ]


def second_blow_at(time: float) -> str:
    """Describe a jump of the signals at a time (s)."""
    return f"the signals jump at {time:.4g} s, as after a second blow: later samples are left out"


def _kinds(components: Sequence[Component], interval: float) -> list[str]:
    """Classify each component: a mode, a harmonic of one, a steady line, or a weak one."""
    frequency = [central_frequency(component, interval) for component in components]
    first = [float(amplitude_at(component, np.zeros(1)).max()) for component in components]
    kinds = []
    for own, size, component in zip(frequency, first, components, strict=True):
        third = component.stop / 3.0
        early, late = (
            float(np.mean(amplitude_at(component, np.linspace(low, low + third, 20)).max(axis=1)))
            for low in (0.0, component.stop - 1.0 - third)
        )
        stronger = [f for f, other in zip(frequency, first, strict=True) if size < LARGEST_HARMONIC * other]
        if late > STEADY * early:
            kinds.append("line")
        elif any(is_multiple(own / other) for other in stronger):
            kinds.append("harmonic")
        else:
            kinds.append("mode" if size > LEAST_AMPLITUDE * max(first) else "weak")
    return kinds
