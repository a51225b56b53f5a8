"""Figure of a cross-checked identification: one function a panel, each taking an optional `ax`."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.decays.half_sines import envelope as half_sine_envelope
from sysid_trib.errors import SysidTribError
from sysid_trib.plots.style import LEGEND, LINES, axes, half_periods, logarithmic_amplitude, thinning
from sysid_trib.results.per_run import group_names, noise_of_run, record_groups

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def identification(tree: xr.DataTree, run: int = 0) -> "Figure":
    """Record with both models, what they leave of it, envelope, and frequency against amplitude.

    Parameters
    ----------
    tree : result of `cross_check`.
    run : which of several runs, from 0.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 7.6), layout="constrained")
    panels = figure.subplot_mosaic("AA;BB;CD", height_ratios=[1.2, 0.8, 1.2])
    record(tree, panels["A"], run)
    residual(tree, panels["B"], run)
    envelope(tree, panels["C"], run)
    frequency(tree, panels["D"], run)
    panels["B"].sharex(panels["A"])
    for label, panel in zip("abcd", panels.values(), strict=True):
        panel.set_title(f"({label})", loc="left", fontsize=9)
    return figure


def record(tree: xr.DataTree, ax: "Axes | None" = None, run: int = 0) -> "Axes":
    """The record and the angle of each identified model.

    Parameters
    ----------
    tree : result of `cross_check`.
    run : which of several runs, from 0.
    """
    ax = axes(ax)
    data = tree[record_groups(tree)[run]].ds
    step = thinning(data.sizes["time"])
    time = data.time.values[::step]
    ax.plot(time, data.angle.values[::step], ".", color="0.6", markersize=2.5, label="record")
    for name, line in model_lines(tree):
        ax.plot(time, data.simulated_angle.sel(model=name).values[::step], linewidth=0.8, label=name, **line)
    ax.set(xlabel="time (s)", ylabel="angle (rad)", xlim=(time[0], time[-1]))
    # Above the panel: inside there is no room that the oscillation leaves free.
    ax.legend(ncols=3, **LEGEND)
    return ax


def residual(tree: xr.DataTree, ax: "Axes | None" = None, run: int = 0) -> "Axes":
    """What each model leaves of the record, with the band of twice the noise.

    Parameters
    ----------
    tree : result of `cross_check`.
    run : which of several runs, from 0.
    """
    ax = axes(ax)
    data, checked = tree[record_groups(tree)[run]].ds, tree["comparison"].ds
    step = thinning(data.sizes["time"])
    time = data.time.values[::step]
    for name, line in model_lines(tree):
        gap = (data.angle - data.simulated_angle.sel(model=name)).values[::step]
        ax.plot(time, 1e3 * gap, linewidth=0.6, label=name, **line)
    noise = 1e3 * noise_of_run(tree[checked.attrs["second"]].to_dataset(), run)
    band = ax.axhspan(-2 * noise, 2 * noise, color="0.85", zorder=0)
    ax.legend([band], ["± 2 noise levels"], **LEGEND)
    ax.set(xlabel="time (s)", ylabel="record \N{MINUS SIGN} model (mrad)", xlim=(time[0], time[-1]))
    return ax


def envelope(tree: xr.DataTree, ax: "Axes | None" = None, run: int = 0) -> "Axes":
    """Amplitude of the half periods against time, of the record and of each model's motion.

    Parameters
    ----------
    tree : result of `cross_check`.
    run : which of several runs, from 0.
    """
    ax = axes(ax)
    measured = tree[group_names("envelope", len(record_groups(tree)))[run]].ds
    time, a = measured.instant_time.values, measured.amplitude.values
    half_periods(ax, time, a, measured.amplitude_standard_error.values)
    for name, line, moved in _simulated(tree, run):
        ax.plot(moved.instant_time.values, moved.amplitude.values, linewidth=1.0, label=name, **line)
    ax.set(xlabel="time (s)")
    logarithmic_amplitude(ax)
    return ax


def frequency(tree: xr.DataTree, ax: "Axes | None" = None, run: int = 0) -> "Axes":
    """Frequency of the half periods against their amplitude, of the record and of each model's motion.

    Parameters
    ----------
    tree : result of `cross_check`.
    run : which of several runs, from 0.
    """
    ax = axes(ax)
    measured = tree[group_names("envelope", len(record_groups(tree)))[run]].ds
    a, w = measured.amplitude.values, measured.frequency.values
    half_periods(ax, a, w, measured.frequency_standard_error.values)
    for name, line, moved in _simulated(tree, run):
        ax.plot(moved.amplitude.values, moved.frequency.values, linewidth=1.0, label=name, **line)
    # A few wild points at the noise floor must not squeeze the course into a line.
    low, high = np.percentile(w, [3, 97])
    ax.set(xlabel="amplitude (rad)", ylabel="frequency (rad/s)", xlim=(0.0, None))
    ax.set_ylim(low - 0.4 * (high - low), high + 0.4 * (high - low))
    return ax


def _simulated(tree: xr.DataTree, run: int) -> Iterator[tuple[str, dict[str, Any], xr.Dataset]]:
    """Each model's motion through the same half-sine fits; first order would differ at large amplitude."""
    record = tree[record_groups(tree)[run]].ds
    for name, line in model_lines(tree):
        moved = xr.Dataset({"angle": record.simulated_angle.sel(model=name)})
        # A model without a motion has nothing to show.
        if not bool(np.all(np.isfinite(moved.angle))):
            continue
        try:
            fitted = half_sine_envelope(moved)
        except SysidTribError:
            continue
        yield name, line, fitted


def model_lines(tree: xr.DataTree) -> list[tuple[str, dict[str, Any]]]:
    """The models by name with their lines, in the order of drawing."""
    checked = tree["comparison"].attrs
    # The second below the first: a dashed line on a full one shows both where they agree.
    return list(zip((checked["first"], checked["second"]), LINES, strict=True))[::-1]
