"""Modes of a sliding window by the eigensystem realisation algorithm (Juang & Pappa 1985)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import scipy.sparse as sp
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.decays.windowed_modes import Windows, fit_windows, table
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.classical import needed_forces, one_record
from sysid_trib.methods.scope import MethodScope
from sysid_trib.noise.level import sensor_noise
from sysid_trib.records.runs import root_mean_square
from sysid_trib.results.birge import birge_ratio
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.results.signal_scale import in_units_of_the_motion


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
        asked = needed_forces(self, library, ["2*v"])
        windows = fit_windows(decay)
        values, influence, ratios = zip(*(_mean(windows, *part) for part in _linear(windows)), strict=True)
        scaled = np.stack(influence) * np.maximum(1.0, ratios)[:, None]
        both = root_mean_square(ratios)
        extra = {"birge_ratio": (both, "1", "Birge ratio of the windows' damping and frequency")}
        estimate = Estimate(
            np.array(values[:1]), scaled @ scaled.T, float(values[1]), [sensor_noise(decay)], extra
        )
        result = identification(self, decay, asked, estimate, offered=library).merge(table(windows))
        return result.assign_attrs(first_order_bias_removed="not needed", assumes=self.scope.assumes)


def _linear(windows: Windows) -> list[tuple[Array, sp.csr_matrix]]:
    """Damping ratio and undamped frequency of each window, and how errors of the samples move them."""
    s = windows.exponent
    w = np.abs(s)
    by_real, by_imag = windows.influence.real, windows.influence.imag
    frequency = sp.diags_array(s.real / w) @ by_real + sp.diags_array(s.imag / w) @ by_imag
    damping = sp.diags_array(-1.0 / w) @ by_real + sp.diags_array(s.real / w**2) @ frequency
    return [(-s.real / w, sp.csr_matrix(damping)), (w, sp.csr_matrix(frequency))]


def _mean(windows: Windows, value: Array, influence: sp.csr_matrix) -> tuple[float, Array, float]:
    """Weighted mean, the noise of every sample in it, RMS of the windows about it over their errors."""
    variance = windows.noise**2 * np.asarray(influence.multiply(influence).sum(axis=1)).ravel()
    weight = (1.0 / variance) / np.sum(1.0 / variance)
    mean = float(weight @ value)
    ratio = birge_ratio(float(np.sum((value - mean) ** 2 / variance)), len(value) - 1)
    return mean, windows.noise * (influence.T @ weight), ratio
