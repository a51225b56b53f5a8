"""Modes of a sliding window by the eigensystem realisation algorithm (Juang & Pappa 1985)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
import xarray as xr
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from sysid_trib.arrays import Array, variable, with_error
from sysid_trib.errors import DecayError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import needed_forces
from sysid_trib.methods.classical import one_record
from sysid_trib.methods.scope import MethodScope
from sysid_trib.records.decay import root_mean_square
from sysid_trib.records.equilibrium import with_half_periods
from sysid_trib.records.half_periods import noise_of_record
from sysid_trib.records.smoothing import sensor_noise
from sysid_trib.results.effects import birge_ratio
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.results.signal_scale import in_units_of_the_motion

ComplexArray = NDArray[np.complex128]

# The Hankel matrix of a window has about 60 rows and columns: two periods of at least so many samples.
SAMPLES = 122


def windowed_modes(decay: xr.Dataset) -> xr.Dataset:
    """Frequency, decay rate and amplitude against time, without a model (Juang & Pappa 1985).

    Parameters
    ----------
    decay : Dataset
        `angle(time)` about its equilibrium; motion that is locally that of a damped linear oscillator.

    Returns
    -------
    Dataset
        Over `era_window`, windows of two periods half a period apart: `window_time` (s, the middle),
        `window_frequency` (rad/s), `window_decay_rate` (1/s), `window_amplitude` (rad); all but the time with
        their `..._standard_error`. Neighbouring windows share samples, and so their errors.

    Raises
    ------
    DecayError
        The decay has fewer than three windows, or too few samples in a half period.
    """
    return fit_windows(decay)[0]


def fit_windows(decay: xr.Dataset) -> tuple[xr.Dataset, ComplexArray, sp.csr_matrix]:
    """The `windowed_modes` of a decay, and the exponent (1/s) of each with the noise of the means in it.

    The motion of a window is the real part of a multiple of exp(exponent t); (window, mean) for the noise.
    """
    source = str(decay.attrs.get("source", "decay"))
    time, angle, halves = with_half_periods(decay)
    step = (time[-1] - time[0]) / (len(time) - 1)
    period = 2.0 * float(np.mean(halves.duration))
    if period < 10.0 * step:
        raise DecayError(f"{source}: fewer than five samples in a half period; sample faster.")
    noise = noise_of_record(time, angle)
    if np.ptp(np.diff(time)) > 1e-6 * step:
        even = time[0] + step * np.arange(len(time))
        time, angle = even, CubicSpline(time, angle)(even)
    # A second sample within a sixtieth of a period tells nothing that the mean of both does not.
    block = max(1, round(2.0 * period / step / SAMPLES))
    first, last = np.searchsorted(time, halves.crossing[[0, -1]])
    count = int(last - first) // block
    used = slice(first, first + count * block)
    coarse, y = (values[used].reshape(count, block).mean(axis=1) for values in (time, angle))
    length = round(2.0 * period / (block * step))
    starts = np.arange(0, count - length + 1, max(1, round(0.25 * length)))
    if len(starts) < 3:
        raise DecayError(f"{source}: fewer than three windows of two periods; give a longer record.")
    step, less, modes = float(coarse[1] - coarse[0]), noise / np.sqrt(block), []
    for start in starts:
        part = y[start : start + length]
        if (root := _mode_root(part)) is not None:
            modes.append((start, root, *_swing(part, root, block)))
    if len(modes) < 3:
        raise DecayError("Fewer than three windows hold an oscillation; the noise is too large.")
    kept, roots, weights, errors = (np.array(column) for column in zip(*modes, strict=True))
    rows = [_influence_on_root(*pair, length) / (pair[0] * step) for pair in zip(roots, weights, strict=True)]
    columns = np.add.outer(kept, np.arange(length))
    pointers = length * np.arange(len(kept) + 1)
    entries = less * np.concatenate(rows)
    influence = sp.csr_matrix((entries, columns.ravel(), pointers), (len(kept), len(y)))
    middle, exponent = coarse[kept] + 0.5 * (length - 1) * step, np.log(roots) / step
    variables = {"window_time": variable("era_window", middle, "middle of the window", "s")}
    for name, value, error, units, long_name in (
        ("window_frequency", exponent.imag, _errors(influence.imag), "rad/s", "instantaneous frequency"),
        ("window_decay_rate", -exponent.real, _errors(influence.real), "s-1", "instantaneous decay rate"),
        ("window_amplitude", np.abs(weights), less * errors, "rad", "amplitude"),
    ):
        variables |= with_error(name, "era_window", (value, error), long_name, units)
    return xr.Dataset(variables), exponent, influence


def _errors(influence: sp.csr_matrix) -> Array:
    """Standard errors by what independent unit errors make of values, (value,)."""
    return np.sqrt(np.asarray(influence.multiply(influence).sum(axis=1)).ravel())


def _mode_root(part: Array) -> complex | None:
    """Factor by which the mode of a window goes on from one sample to the next; None if it does not turn."""
    from control import eigensys_realization

    size = _hankel(len(part))
    system, _ = eigensys_realization(part, r=2, m=size, n=size)
    roots = np.linalg.eigvals(system.A)
    return complex(roots[np.argmax(roots.imag)]) if np.any(roots.imag > 0.0) else None


def _hankel(length: int) -> int:
    return (length - 2) // 2


def _swing(part: Array, root: complex, block: int) -> tuple[complex, float]:
    """Complex amplitude in the middle of a window, and the standard error of its size at a noise of 1."""
    exponent = np.log(root)
    mode = np.exp(exponent * (np.arange(len(part)) - 0.5 * (len(part) - 1)))
    # A mean over a block of samples is less than the motion in its middle.
    mode *= np.mean(np.exp(exponent * (np.arange(block) - 0.5 * (block - 1)) / block)).real
    design = np.stack([mode.real, -mode.imag], axis=1)
    inverse = np.linalg.inv(design.T @ design)
    size = inverse @ (design.T @ part)
    return complex(*size), float(np.sqrt(size @ inverse @ size) / np.hypot(*size))


def _influence_on_root(root: complex, weight: complex, length: int) -> ComplexArray:
    """Effect of unit errors of the samples on the root, to first order in the noise: (sample,).

    The samples are the real part of weight root^l, l counted from the middle. Errors of the Hankel matrices
    act on an eigenvalue by its left and right vectors, columns of pseudo-inverse Vandermonde matrices.
    """
    size = _hankel(length)
    powers = np.power.outer(np.array([root, np.conj(root)]), np.arange(size))
    left_vector = np.linalg.pinv(powers.T)[0]
    first = weight * root ** (-0.5 * (length - 1))
    both = np.convolve(left_vector, left_vector) / (0.5 * first * root)
    influence = np.zeros(length, dtype=complex)
    influence[2 : 2 + len(both)] += both
    influence[1 : 1 + len(both)] -= root * both
    return influence


@dataclass(frozen=True)
class WindowedERA:
    """Damping ratio zeta and frequency as means over windows of two periods; the windows are in the result.

    Notes
    -----
    A window's exponent s gives w = |s| and zeta = -Re s/|s|. The means are weighted by the windows'
    variances; their errors allow for shared samples, and are scaled by how much more the windows differ.
    For any other force `window_frequency` and `window_decay_rate` against `window_amplitude` show what acts.
    """

    scope: ClassVar = MethodScope(
        label="windowed ERA",
        assumes="over two periods the motion is that of a linear oscillator with viscous friction",
        observes="short windows",
        identifies="viscous friction",
        several_runs=False,
        example={"2*v": 0.0097},
    )

    @in_units_of_the_motion
    def identify(self, decay: xr.Dataset, library: ForceLibrary) -> xr.Dataset:
        """Identify the force of formula `2*v` of `library` from a decay with `angle(time)`.

        Returns
        -------
        Dataset (see `identify`), and over `era_window` the variables of `windowed_modes`.

        Raises
        ------
        DecayError
            The library lacks that force, or the decay is too short.
        UsageError
            Several decays.
        """
        decay = one_record(self, decay)
        asked = needed_forces(library, ["2*v"], self.scope.sentence_label)
        table, *windows = fit_windows(decay)
        values, influence, ratios = zip(*(_mean(*part) for part in _linear(*windows)), strict=True)
        scaled = np.stack(influence) * np.maximum(1.0, ratios)[:, None]
        both = root_mean_square(ratios)
        extra = {"birge_ratio": (both, "1", "Birge ratio of the windows' damping and frequency")}
        estimate = Estimate(
            np.array(values[:1]), scaled @ scaled.T, float(values[1]), [sensor_noise(decay)], extra
        )
        result = identification(self, decay, asked, estimate, offered=library).merge(table)
        return result.assign_attrs(first_order_bias_removed="not needed", assumes=self.scope.assumes)


def _linear(s: ComplexArray, influence: sp.csr_matrix) -> list[tuple[Array, sp.csr_matrix]]:
    """Damping ratio and undamped frequency of each window, by their exponents, and the noise in them."""
    w = np.abs(s)
    frequency = sp.diags_array(s.real / w) @ influence.real + sp.diags_array(s.imag / w) @ influence.imag
    damping = sp.diags_array(-1.0 / w) @ influence.real + sp.diags_array(s.real / w**2) @ frequency
    return [(-s.real / w, sp.csr_matrix(damping)), (w, sp.csr_matrix(frequency))]


def _mean(value: Array, influence: sp.csr_matrix) -> tuple[float, Array, float]:
    """Weighted mean, the noise of every sample in it, RMS of the windows about it over their errors."""
    variance = _errors(influence) ** 2
    weight = (1.0 / variance) / np.sum(1.0 / variance)
    mean = float(weight @ value)
    ratio = birge_ratio(float(np.sum((value - mean) ** 2 / variance)), len(value) - 1)
    return mean, influence.T @ weight, ratio
