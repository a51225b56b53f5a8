"""What a residual asks for: a force over angle and rate, or a line in the spectrum."""

import numpy as np
import xarray as xr
from scipy.stats import binned_statistic, binned_statistic_2d

from sysid_trib.arrays import Array, Mask
from sysid_trib.records.equilibrium import with_half_periods
from sysid_trib.records.signal import unit_of_signal
from sysid_trib.records.smoothing import knot_intervals, sensor_noise, smooth
from sysid_trib.results.schema import model_of
from sysid_trib.results.variables import variable, with_error
from sysid_trib.simulation.internal_states import states_along
from sysid_trib.simulation.model import Model

# Cells each way, drawings of noise for the errors, and a seed for them.
SURFACE_CELLS, SURFACE_DRAWS, DRAWS_SEED = 13, 24, 0
# Longer records are drawn by every second sample (third, ...), which keeps so many between knots.
MOST_DRAWN, DRAWN_PER_KNOT = 20_000, 4


def residual_force(decay: xr.Dataset, result: xr.Dataset, run: int = 0) -> xr.Dataset:
    """Mean force that a model lacks in cells of angle and rate, by the record's own motion.

    Parameters
    ----------
    decay : Dataset
        `angle(time)` of a run.
    result : Dataset
        An identification of it.
    run : int
        Which of the result's runs it is.

    Returns
    -------
    Dataset
        Over `x` and `v` (rate over w): `force` over I w^2 with its `force_standard_error` by the sensor's
        noise, nan in cells without samples; over each alone, the mean over the other, `force_of_x` and
        `force_of_v` with their errors. All in the unit of the record.

    Raises
    ------
    DecayError
        The samples do not determine the motion.

    Notes
    -----
    -(x'' + x) - f(x, x') with derivatives by tau = w t (Masri and Caughey 1979), x by the least-squares
    spline; f goes through the same spline, so that what smoothing takes from a jump of friction it takes from
    both. Errors are those of drawings of white noise of the sensor's level through the same steps. No motion
    is simulated: a model that slips in phase has its surface too.
    """
    time, angle, _ = with_half_periods(decay)
    model = model_of(result)
    tau = model.reference_frequency * (time - time[0])
    every = max(1, min(-(-len(time) // MOST_DRAWN), len(time) // (DRAWN_PER_KNOT * knot_intervals(tau))))
    zero = float(np.ravel(result.offset)[run]) if "offset" in result else 0.0
    motion = smooth(tau, angle)
    x, v = motion.x - zero, motion.v
    asked = -(motion.acceleration + x) - smooth(tau, model_force(model, tau, x, v, time - time[0])).x
    tau, x, v, asked = tau[::every], x[::every], v[::every], asked[::every]
    white = np.random.default_rng(DRAWS_SEED).standard_normal((len(tau), SURFACE_DRAWS))
    # Fewer samples of less noise: a spline averages both to the same.
    drawn = smooth(tau, sensor_noise(decay) / np.sqrt(every) * white)
    # A spline bends freely in the quarter period before its ends.
    inside = np.minimum(tau, tau[-1] - tau) > 0.5 * np.pi
    values = np.vstack([asked, -(drawn.acceleration + drawn.x).T])[:, inside]
    return _in_cells(x[inside], v[inside], values, unit_of_signal(decay))


def model_force(model: Model, tau: Array, x: Array, v: Array, time: Array) -> Array:
    """Sum of coefficient times force along a motion, (sample,); terms of the sensor are no forces."""
    total = np.zeros_like(x)
    for force in model.library:
        if force.kind == "force" and (coefficient := model.coefficients.get(force.symbol, 0.0)):
            hidden = states_along(force, tau, x, v, model.shapes, time=time)
            h = force.value(x, v, time, shapes=model.shapes, hidden=hidden or None)
            total = total + coefficient * h
    return total


def _in_cells(x: Array, v: Array, values: Array, units: str) -> xr.Dataset:
    """Means over cells of the force (the first row) and their scatter over drawings (the others)."""
    size = 1.001 * float(np.max(np.hypot(x, v)))
    edges = np.linspace(-size, size, SURFACE_CELLS + 1)
    surface = binned_statistic_2d(x, v, values, "mean", bins=[edges, edges]).statistic
    along = {
        name: binned_statistic(on, values, "mean", bins=edges).statistic for name, on in (("x", x), ("v", v))
    }
    data = with_error("force", ("x", "v"), _mean_and_error(surface), "mean residual force over I w^2", units)
    for name, means in along.items():
        text = f"mean residual force over {'angle' if name == 'x' else 'rate over w'}"
        data |= with_error(f"force_of_{name}", (name,), _mean_and_error(means), text, units)
    middle = 0.5 * (edges[1:] + edges[:-1])
    coords = {"x": variable("x", middle, "angle", units), "v": variable("v", middle, "rate over w", units)}
    return xr.Dataset(data, coords)


def _mean_and_error(means: Array) -> tuple[Array, Array]:
    return means[0], np.sqrt(np.mean(means[1:] ** 2, axis=0))


# The level about a line is that of so many neighbours on either side, beyond those into which it leaks.
LEVEL_LINES, LEAK = 48, 4
# Up to this harmonic what is left of a motion is the motion's.
MOTION_HARMONICS = 7
SLOWEST = 4.0
NO_LINE = (float("nan"), float("nan"))


def spectral_line(time: Array, residual: Array, motion: tuple[Array, Array]) -> tuple[float, float]:
    """Angular frequency (rad/s) and amplitude of a line in a residual; nan where there is none.

    Parameters
    ----------
    time, residual : (sample,) array of float
        In s, and in any unit.
    motion : two (sample,) arrays of float
        x and v of the model, whose harmonics are left out.

    Notes
    -----
    A line's power over the mean of 2 m neighbours' is F distributed with 2 and 4 m degrees of freedom where
    the spectrum is flat about it: P(> r) = (1 + r/(2 m))^(-2 m); times the number of lines (Bonferroni).
    """
    samples = len(residual)
    power = np.abs(np.fft.rfft(residual - residual.mean())) ** 2
    resolution = 2.0 * np.pi * (samples - 1) / (samples * (time[-1] - time[0]))
    excluded = _harmonics(time, motion, resolution, len(power))
    excluded[[0, -1]] = True
    if len(power) <= 2 * LEVEL_LINES or excluded.all():
        return NO_LINE
    window = np.ones(2 * LEVEL_LINES + 1)
    window[LEVEL_LINES - LEAK : LEVEL_LINES + LEAK + 1] = 0.0
    counted = np.where(excluded, 0.0, 1.0)
    total, count = (np.convolve(values, window, "same") for values in (power * counted, counted))
    count = np.maximum(count, 1.0)
    log_p = -count * np.log1p(power / np.maximum(total, 1e-300))
    at = int(np.argmin(np.where(excluded, 0.0, log_p)))
    # Significance level of the highest line among all.
    if log_p[at] + np.log(counted.sum()) > np.log(1e-6):
        return NO_LINE
    frequency = resolution * (at + _between_bins(power, at))
    waves = np.column_stack([wave(frequency * (time - time[0])) for wave in (np.cos, np.sin, np.ones_like)])
    line = waves @ np.linalg.lstsq(waves, residual, rcond=None)[0]
    # A line counts whose RMS is beyond this part of that of the rest: a fainter one changes nothing.
    marked = np.std(line) > 0.5 * np.std(residual - line)
    return (frequency, float(np.sqrt(2.0) * np.std(line))) if marked else NO_LINE


def _harmonics(time: Array, motion: tuple[Array, Array], resolution: float, count: int) -> Mask:
    """Which lines are within two of a harmonic of the motion at its start, at its end, or between."""
    phase = np.unwrap(np.arctan2(-motion[1], motion[0]))
    quarter = max(2, len(time) // 4)
    rates = [(phase[b] - phase[a]) / (time[b] - time[a]) for a, b in ((0, quarter), (-quarter - 1, -1))]
    at = resolution * np.arange(count)
    low, high = min(np.abs(rates)), max(np.abs(rates))
    # What drifts slowly is no line.
    excluded = at <= SLOWEST * resolution
    for harmonic in range(1, MOTION_HARMONICS + 1):
        middle, half = 0.5 * harmonic * (low + high), 0.5 * harmonic * (high - low)
        excluded |= np.abs(at - middle) <= half + 2.0 * resolution
    return np.asarray(excluded)


def _between_bins(power: Array, at: int) -> float:
    """Where between the lines of a spectrum its peak is, by the ratio of the two highest amplitudes."""
    left, peak, right = np.sqrt(power[at - 1 : at + 2])
    return float(right / (peak + right) if right > left else -left / (peak + left))
