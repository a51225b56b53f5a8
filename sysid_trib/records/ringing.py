"""Decaying oscillations of slowly varying amplitude and frequency, fitted to all sensors at once.

Each is exp(level(t)) Re(envelope(t) exp(i phase(t))). `phase` and `level` are common to all sensors; the
envelope, splines in time, is separate for each sensor. A fit is linear in the envelopes. Their common part is
then moved to phase and level, so that the envelopes of the next fit are nearly constant: they are the shape.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.fft import ifft, next_fast_len, rfft
from scipy.interpolate import CubicSpline, make_smoothing_spline

from sysid_trib.arrays import Array

Complex: TypeAlias = NDArray[np.complex128]

# Number of splines that are not zero at a point, and of samples processed at once.
SPLINE_ORDER, SAMPLES_AT_ONCE = 6, 1024
# Coefficients of the powers 0 to 5 of each uniform B-spline of degree five within an interval.
SPLINE_POWERS = (
    np.array(
        [
            [1, -5, 10, -10, 5, -1],
            [26, -50, 20, 20, -20, 5],
            [66, 0, -60, 0, 30, -10],
            [26, 50, 20, -20, -20, 10],
            [1, 5, 10, 10, 5, -5],
            [0, 0, 0, 0, 0, 1],
        ]
    )
    / 120.0
)
# Ridge of the normal equations, over their largest diagonal element: smaller parts are ignored.
NORMAL_RIDGE = 1e-11
# Least number of lines of a spectrum on either side of a component, for its start.
FEWEST_LINES_OF_BAND = 12
# Weight of the curvature of the start curves of phase and level, for times from 0 to 1.
CARRIER_PENALTY = 1e-5
# Number of times at which a mean shape is computed.
SHAPE_POINTS = 200
# Sensors separate two modes by their shapes if cancelling one of them increases the noise by at most this
# factor.
MOST_CANCELLING = 1.5
# Number of points of an envelope between its knots, at which phase and level are corrected.
POINTS_A_KNOT = 3


@dataclass(frozen=True, eq=False)
class Component:
    """A decaying oscillation at all sensors: a mode, a harmonic of one, or a steady line.

    Attributes
    ----------
    phase, level : (sample,) array of float
        Phase (rad), and log amplitude, at the samples from the start of the ringing.
    stop : int
        Number of samples in which the component is visible; it is zero after them.
    spacing : float
        Spacing of the knots of its envelope, in samples.
    envelope : (spline, sensor) array of complex
        Coefficients of the splines.
    error : (spline,) array of float
        Standard errors of the coefficients for noise of unit size at a sensor.
    """

    phase: Array
    level: Array
    stop: int
    spacing: float
    envelope: Complex
    error: Array

    @property
    def splines(self) -> int:
        """Number of splines of the envelope."""
        return int(np.ceil((self.stop - 1) / self.spacing + 1e-9)) + SPLINE_ORDER - 1

    def splines_at(self, samples: Array) -> tuple[NDArray[np.intp], Array]:
        """Return the first spline at samples, (point,), and the values from it on, (order, point)."""
        return _splines_at(samples / self.spacing, self.splines)

    def weights(self) -> tuple[NDArray[np.intp], Array]:
        """Return the first spline of each sample, (sample,), and the values from it on, (order, sample)."""
        return self.splines_at(np.arange(self.stop, dtype=float))

    def envelope_at(self, samples: Array) -> Complex:
        """Return the envelope of every sensor at some samples, (point, sensor)."""
        first, values = self.splines_at(samples)
        return np.asarray(sum(values[k][:, None] * self.envelope[first + k] for k in range(SPLINE_ORDER)))

    def error_at(self, samples: Array) -> Array:
        """Return the approximate standard error of each part of the envelope, for unit noise, (point,)."""
        first, values = self.splines_at(samples)
        return np.sqrt(sum((values[k] * self.error[first + k]) ** 2 for k in range(SPLINE_ORDER)))

    def signal(self, sensors: slice | int = slice(None)) -> Array:
        """Return the oscillation at sensors, (sensor, sample), zero after its stop."""
        first, values = self.weights()
        coefficients = self.envelope[:, sensors]
        made = sum(values[k] * coefficients[first + k].T for k in range(SPLINE_ORDER))
        wave = np.exp(self.level[: self.stop] + 1j * self.phase[: self.stop])
        out = np.zeros((*made.shape[:-1], self.phase.size))
        out[..., : self.stop] = (made * wave).real
        return out

    def frequency(self, interval: float) -> Array:
        """Return the frequency (Hz) of samples at an interval (s)."""
        return np.gradient(self.phase) / (2.0 * np.pi * interval)


def _splines_at(position: Array, count: int) -> tuple[NDArray[np.intp], Array]:
    """Return the uniform B-splines of degree five at positions in units of their knots."""
    first = np.clip(np.floor(position).astype(np.intp), 0, count - SPLINE_ORDER)
    return first, SPLINE_POWERS @ np.vander(position - first, SPLINE_ORDER, increasing=True).T


def fit_envelopes(signals: Array, components: Sequence[Component]) -> list[Component]:
    """Fit the envelopes of components to signals, all at once, by least squares.

    Parameters
    ----------
    signals : (sensor, sample) array of float
    components : sequence of Component
        Phases, levels and knots.
    """
    offsets = np.concatenate([[0], np.cumsum([2 * component.splines for component in components])])
    size = int(offsets[-1])
    normal, right = np.zeros((size, size)), np.zeros((size, signals.shape[0]))
    parts = []
    for component in components:
        first, values = component.weights()
        wave = np.exp(component.level[: component.stop] + 1j * component.phase[: component.stop])
        parts.append((first, values * wave.real, values * -wave.imag))
    longest = max((component.stop for component in components), default=0)
    for low in range(0, longest, SAMPLES_AT_ONCE):
        blocks, places = [], []
        for component, offset, (first, cosine, sine) in zip(components, offsets, parts, strict=False):
            high = min(low + SAMPLES_AT_ONCE, component.stop)
            if high <= low:
                continue
            of = first[low:high]
            lowest, width = int(of[0]), int(of[-1] - of[0]) + SPLINE_ORDER
            rows, block = np.arange(high - low), np.zeros((2, SAMPLES_AT_ONCE, width))
            for k in range(SPLINE_ORDER):
                block[0, rows, of - lowest + k] = cosine[k, low:high]
                block[1, rows, of - lowest + k] = sine[k, low:high]
            blocks += [block[0], block[1]]
            at = offset + lowest + np.arange(width)
            places += [at, at + component.splines]
        columns, where = np.hstack(blocks), np.concatenate(places)
        measured = signals[:, low : low + SAMPLES_AT_ONCE]
        columns = columns[: measured.shape[1]]
        normal[np.ix_(where, where)] += columns.T @ columns
        right[where] += columns.T @ measured.T
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.inv(scale[:, None] * normal * scale + NORMAL_RIDGE * np.eye(size))
    solution = scale[:, None] * (inverse @ (scale[:, None] * right))
    error = scale * np.sqrt(np.diag(inverse))
    fitted = []
    for component, offset in zip(components, offsets, strict=False):
        middle, end = offset + component.splines, offset + 2 * component.splines
        envelope = solution[offset:middle] + 1j * solution[middle:end]
        fitted.append(
            replace(
                component, envelope=envelope, error=np.hypot(error[offset:middle], error[middle:end]) / 2**0.5
            )
        )
    return fitted


def with_common_part(component: Component, noise: Array) -> Component:
    """Move the common part of all sensors' envelopes to phase and level; the amplitude is unchanged.

    `noise` : (sensor,) standard deviations, which weight the sensors.
    """
    points = np.linspace(0.0, component.stop - 1.0, POINTS_A_KNOT * component.splines)
    envelope = component.envelope_at(points)
    shape = common_shape(envelope / noise)
    common = envelope / noise @ shape.conj()
    angle, size = np.unwrap(np.angle(common)), np.log(np.maximum(np.abs(common), 1e-300))
    # The change of the level starts at zero, so that the shape keeps the amplitude.
    size = size - size[0]
    samples = np.arange(component.phase.size, dtype=float)
    inside = np.minimum(samples, component.stop - 1.0)
    phase = component.phase + CubicSpline(points, angle)(inside)
    return replace(component, phase=phase, level=component.level + CubicSpline(points, size)(inside))


def common_shape(values: Complex) -> Complex:
    """Return the first right singular vector of a matrix, (column,)."""
    _, _, right = np.linalg.svd(values, full_matrices=False)
    return np.asarray(right[0].conj()).conj()


def component_shape(component: Component, noise: Array) -> Complex:
    """Return the mean shape of a component over that at its largest sensor, (sensor,)."""
    points = np.linspace(0.0, component.stop - 1.0, SHAPE_POINTS)
    level = np.interp(points, np.arange(component.phase.size), component.level)
    values = component.envelope_at(points) * np.exp(level)[:, None]
    shape = common_shape(values / noise) * noise
    return np.asarray(shape / shape[int(np.argmax(np.abs(shape)))])


def cancelling_weights(own: Array, others: Sequence[Array], noise: Array) -> Array:
    """Return the weights of sensors with the least noise that keep one shape and cancel others, (sensor,)."""
    table = np.stack([own, *others], axis=1) / noise[:, None]
    return np.asarray(np.linalg.pinv(table)[0] / noise)


def noise_of_cancelling(own: Array, others: Sequence[Array], noise: Array) -> float:
    """Return the noise of a combination that cancels other shapes, over that without cancelling.

    It is infinite if the sensors cannot cancel the shapes.
    """
    if len(others) >= noise.size:
        return np.inf
    kept, free = cancelling_weights(own, others, noise), cancelling_weights(own, (), noise)
    if not np.isclose(kept @ own, 1.0):
        return np.inf
    return float(np.linalg.norm(kept * noise) / np.linalg.norm(free * noise))


def carrier(
    signals: Array, interval: float, frequency: float, half_band: float, noise: Array
) -> tuple[Array, Array, int] | None:
    """Return the phase, level and stop of the oscillation in a band, as a start; None if below the noise.

    Parameters
    ----------
    signals : (sensor, sample) array of float
        Signals from the start of the ringing.
    interval : float, s
    frequency, half_band : float, Hz
    noise : (sensor,) array of float
    """
    count = signals.shape[1]
    size = next_fast_len(2 * count, real=True)
    spectra = rfft(signals / noise[:, None], size)
    line = 1.0 / (size * interval)
    middle, half = round(frequency / line), max(FEWEST_LINES_OF_BAND, round(half_band / line))
    half = min(half, middle - 1, spectra.shape[1] - middle - 1)
    band = spectra[:, middle - half : middle + half + 1]
    window = np.cos(0.5 * np.pi * np.arange(-half, half + 1) / (half + 1)) ** 2
    shape = common_shape(band.T * window[:, None])
    # The envelope on a coarse grid, from the lines of the band alone.
    coarse = np.zeros(2 * half + 1, dtype=complex)
    coarse[np.arange(-half, half + 1)] = (shape.conj() @ band) * window
    envelope = 2.0 * ifft(coarse) * (coarse.size / size)
    at = np.arange(coarse.size) * (size / coarse.size)
    rise = 0.5 / half_band / interval
    inside = (at < count - rise) & (at > min(rise, 0.1 * count))
    floor = 2.0 * np.sqrt(np.sum(window**2) / size)
    size_of_envelope = np.abs(envelope)
    if not inside.any():
        return None
    # It ends where it stays below the noise of its band.
    seen = np.flatnonzero(inside & (size_of_envelope > 3.0 * floor))
    if seen.size < 6:
        return None
    gaps = np.flatnonzero(np.diff(seen) > max(8, 0.05 * coarse.size))
    last = seen[gaps[0]] if gaps.size else seen[-1]
    used = np.flatnonzero(inside & (np.arange(coarse.size) <= last))
    if used.size < 6:
        return None
    x, values = at[used], envelope[used]
    weight = np.minimum(size_of_envelope[used] / floor, 100.0) ** 2
    phase, level = np.unwrap(np.angle(values)), np.log(size_of_envelope[used])
    samples = np.arange(count, dtype=float)
    carried = 2.0 * np.pi * middle * line * interval * samples
    scaled, where = x / count, samples / count
    smooth = [_smooth(scaled, part, weight, where) for part in (phase, level)]
    to_end = last >= np.flatnonzero(inside)[-1] - 1
    return carried + smooth[0], smooth[1], count if to_end else int(at[last]) + 1


def _smooth(x: Array, y: Array, weight: Array, where: Array) -> Array:
    """Return a smooth curve through points, continued as a line."""
    spline = make_smoothing_spline(x, y, w=weight, lam=CARRIER_PENALTY * float(weight.sum()))
    inside = np.clip(where, x[0], x[-1])
    slope = np.where(where < x[0], spline(x[0], 1), spline(x[-1], 1))
    return np.asarray(spline(inside) + slope * (where - inside))
