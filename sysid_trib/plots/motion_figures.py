"""Figures of a record and its models: one function a panel, each taking an optional `ax`."""

from collections.abc import Sequence

import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.plots.motion_data import MotionData, drawn_samples, motion_data
from sysid_trib.plots.style import LEGEND, axes, half_periods, letter, logarithmic_amplitude, new_figure


def identification(tree: xr.DataTree, run: int = 0) -> Figure:
    """Record with both models, residuals, envelope, and frequency against amplitude.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `cross_check`.
    run : int
        Which of several runs, from 0.
    """
    figure = new_figure(7.2, 7.6)
    panels = figure.subplot_mosaic("AA;BB;CD", height_ratios=[1.2, 0.8, 1.2])
    drawn = motion_data(tree, run)
    draw_record(panels["A"], drawn)
    draw_residual(panels["B"], drawn, list(drawn.lines))
    _envelope(panels["C"], drawn)
    _frequency(panels["D"], drawn)
    panels["B"].sharex(panels["A"])
    letter(panels.values())
    return figure


def discovery(tree: xr.DataTree, run: int = 0) -> Figure:
    """Record, residuals of the models before and after, envelope, and frequency against amplitude.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    run : int
        Which of several runs, from 0.
    """
    figure = new_figure(7.2, 8.8)
    panels = figure.subplot_mosaic("AA;BB;CC;DE", height_ratios=[1.2, 0.8, 0.8, 1.2])
    drawn = motion_data(tree, run)
    draw_record(panels["A"], drawn)
    for place, model in (("B", "before"), ("C", "after")):
        draw_residual(panels[place], drawn, [model])
        panels[place].sharex(panels["A"])
    for place in "AB":
        panels[place].set_xlabel("")
        panels[place].tick_params(labelbottom=False)
    _envelope(panels["D"], drawn)
    _frequency(panels["E"], drawn)
    letter(panels.values())
    return figure


def record(tree: xr.DataTree, ax: Axes | None = None, run: int = 0) -> Axes:
    """The record and the angle of each model.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `cross_check` or `discover`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.
    run : int
        Which of several runs, from 0.
    """
    return draw_record(axes(ax), motion_data(tree, run))


def residual(tree: xr.DataTree, ax: Axes | None = None, run: int = 0) -> Axes:
    """Record minus each model, with the band of twice the noise.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `cross_check` or `discover`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.
    run : int
        Which of several runs, from 0.
    """
    drawn = motion_data(tree, run)
    return draw_residual(axes(ax), drawn, list(drawn.lines))


def envelope(tree: xr.DataTree, ax: Axes | None = None, run: int = 0) -> Axes:
    """Amplitude of the half periods against time, of the record and of each model's motion.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `cross_check` or `discover`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.
    run : int
        Which of several runs, from 0.
    """
    return _envelope(axes(ax), motion_data(tree, run))


def frequency(tree: xr.DataTree, ax: Axes | None = None, run: int = 0) -> Axes:
    """Frequency of the half periods against their amplitude, of the record and of each model's motion.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `cross_check` or `discover`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.
    run : int
        Which of several runs, from 0.
    """
    return _frequency(axes(ax), motion_data(tree, run))


def draw_record(ax: Axes, drawn: MotionData) -> Axes:
    """Record and models against time."""
    shown = drawn_samples(drawn.angle)
    ax.plot(drawn.time[shown], drawn.angle[shown], ".", color="0.6", markersize=2.5, label="record")
    for name, style in drawn.lines.items():
        angle = drawn.motion(name)
        shown = drawn_samples(angle)
        ax.plot(drawn.time[shown], angle[shown], linewidth=0.8, label=drawn.labels[name], **style)
    ax.set(xlabel="time (s)", ylabel="angle (rad)", xlim=(drawn.time[0], drawn.time[-1]))
    # Above the panel: inside there is no room that the oscillation leaves free.
    ax.legend(ncols=3, **LEGEND)
    return ax


def draw_residual(ax: Axes, drawn: MotionData, models: Sequence[str]) -> Axes:
    """Residuals of models in one panel; one model alone is named by the axis."""
    for name in models:
        if name in drawn.lines:
            residuals = drawn.residual(name)
            shown = drawn_samples(residuals)
            style = dict(drawn.lines[name]) | ({"linestyle": "-"} if len(models) == 1 else {})
            ax.plot(drawn.time[shown], residuals[shown], linewidth=0.6, label=drawn.labels[name], **style)
    band = ax.axhspan(-2e3 * drawn.noise, 2e3 * drawn.noise, color="0.85", zorder=0)
    ax.legend([band], ["± 2 noise levels"], **LEGEND)
    model = f"model\n{models[0]}" if len(models) == 1 else "model"
    label = f"record \N{MINUS SIGN} {model} (mrad)"
    ax.set(xlabel="time (s)", ylabel=label, xlim=(drawn.time[0], drawn.time[-1]))
    return ax


def _envelope(ax: Axes, drawn: MotionData) -> Axes:
    for name, fits in drawn.half_periods.items():
        time, amplitude = fits.instant_time.values, fits.amplitude.values
        if name == "record":
            half_periods(ax, time, amplitude, fits.amplitude_standard_error.values)
            ax.set_ylim(drawn.amplitude_limits())
        else:
            ax.plot(time, amplitude, linewidth=1.0, label=drawn.labels[name], **drawn.lines[name])
    ax.set(xlabel="time (s)")
    logarithmic_amplitude(ax)
    return ax


def _frequency(ax: Axes, drawn: MotionData) -> Axes:
    for name, fits in drawn.half_periods.items():
        amplitude, values = fits.amplitude.values, fits.frequency.values
        if name == "record":
            half_periods(ax, amplitude, values, fits.frequency_standard_error.values)
            ax.set(xlim=(0.0, 1.05 * amplitude.max()), ylim=drawn.frequency_limits())
        else:
            ax.plot(amplitude, values, linewidth=1.0, label=drawn.labels[name], **drawn.lines[name])
    ax.set(xlabel="amplitude (rad)", ylabel="frequency (rad/s)")
    return ax
