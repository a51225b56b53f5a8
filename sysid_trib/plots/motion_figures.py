"""Figures of a record and its models: one function a panel, each taking an optional `ax`."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.arrays import Array
from sysid_trib.plots.discovery_data import held_out_sentence
from sysid_trib.plots.motion_data import MotionData, drawn_samples, motion_data
from sysid_trib.plots.style import (
    BAR_WIDTH,
    FULL_WIDTH,
    LEGEND,
    OPEN_MARKS,
    Style,
    axes,
    footnote,
    legend_marks,
    letter,
    logarithmic_amplitude,
    new_figure,
)

RECORD_POINTS: Style = {"label": "record", "marker": ".", "linestyle": "", "color": "0.6", "markersize": 2.5}
# Of the rows of half periods, and of what models miss of them.
HALF_PERIOD_HEIGHTS = (1.2, 0.8)


def identification(tree: xr.DataTree, run: int = 0) -> Figure:
    """Record with both models, residuals, envelope, and frequency against amplitude.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `cross_check`.
    run : int
        Which of several runs, from 0.
    """
    drawn = motion_data(tree, run)
    return _motion_figure(drawn, [list(drawn.labels)])


def discovery(tree: xr.DataTree, run: int = 0) -> Figure:
    """Record, residuals of the models before and after, envelope, and frequency against amplitude.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `discover`.
    run : int
        Which of several runs, from 0.
    """
    drawn = motion_data(tree, run)
    figure = _motion_figure(drawn, [[model] for model in drawn.labels])
    footnote(figure, held_out_sentence(tree))
    return figure


def curve(ax: Axes, time: Array, values: Array, style: Style) -> None:
    """A curve over time, decimated."""
    shown = drawn_samples(values)
    ax.plot(time[shown], values[shown], **style)


def half_period_figure(tree: xr.DataTree, run: int = 0) -> Figure:
    """Envelope, frequency against amplitude, and what models miss of both."""
    figure = new_figure(FULL_WIDTH, 4.2)
    panels = figure.subplots(2, 2, height_ratios=HALF_PERIOD_HEIGHTS).ravel().tolist()
    drawn = motion_data(tree, run)
    _half_period_panels(panels, drawn)
    letter(panels)
    named = {drawn.labels[name]: {"marker": ""} | dict(style) for name, style in drawn.lines.items()}
    figure.legend(handles=legend_marks(named), ncols=2, loc="outside upper right", frameon=False, fontsize=8)
    return figure


def _motion_figure(drawn: MotionData, residuals: Sequence[Sequence[str]]) -> Figure:
    """Record, a panel for each group of models' residuals; envelope and frequency, and what models miss."""
    figure = new_figure(FULL_WIDTH, 7.6 + 1.2 * len(residuals))
    rows = ["AA", *("BB", "CC")[: len(residuals)], "DE", "FG"]
    heights = [1.2, *[0.8] * len(residuals), *HALF_PERIOD_HEIGHTS]
    panels = list(figure.subplot_mosaic(";".join(rows), height_ratios=heights).values())
    draw_in_time(panels[:-4], drawn, residuals)
    _half_period_panels(panels[-4:], drawn)
    letter(panels)
    return figure


def _half_period_panels(panels: Sequence[Axes], drawn: MotionData) -> None:
    """Envelope and frequency, and below each what models miss of it."""
    envelopes, frequencies, amplitude_missed, frequency_missed = panels
    _envelope(envelopes, drawn)
    _frequency(frequencies, drawn)
    _missed(amplitude_missed, drawn, "instant_time", "amplitude")
    _missed(frequency_missed, drawn, "amplitude", "frequency")
    for upper, lower in ((envelopes, amplitude_missed), (frequencies, frequency_missed)):
        lower.set_xlim(upper.get_xlim())
        upper.set_xlabel("")
        upper.tick_params(labelbottom=False)


def draw_in_time(panels: Sequence[Axes], drawn: MotionData, residuals: Sequence[Sequence[str]]) -> None:
    """Record and, below it, residuals of groups of models, with one axis of time."""
    _record(panels[0], drawn)
    for panel, models in zip(panels[1:], residuals, strict=True):
        _residual(panel, drawn, models)
        panel.sharex(panels[0])
    for panel in panels[:-1]:
        panel.set_xlabel("")
        panel.tick_params(labelbottom=False)


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
    return _record(axes(ax), motion_data(tree, run))


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
    return _residual(axes(ax), drawn, list(drawn.lines))


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


def _record(ax: Axes, drawn: MotionData) -> Axes:
    curve(ax, drawn.time, drawn.angle, RECORD_POINTS)
    for name, style in drawn.lines.items():
        curve(ax, drawn.time, drawn.motion(name), {"linewidth": 0.8, "label": drawn.labels[name], **style})
    if "holdout_start" in drawn.data:
        ax.axvspan(drawn.data.holdout_start.item(), drawn.time[-1], color="0.93", zorder=0)
    ax.set(xlabel="time (s)", ylabel=drawn.label, xlim=(drawn.time[0], drawn.time[-1]))
    # Above the panel: inside there is no room that the oscillation leaves free.
    ax.legend(ncols=3, **LEGEND)
    return ax


def _residual(ax: Axes, drawn: MotionData, models: Sequence[str]) -> Axes:
    """Residuals of models in one panel; one of several is named by the axis."""
    for name in models:
        if name in drawn.lines:
            style = dict(drawn.lines[name]) | ({"linestyle": "-"} if len(models) == 1 else {})
            look = {"linewidth": 0.6, "label": drawn.labels[name], **style}
            curve(ax, drawn.time, drawn.residual(name), look)
    factor, unit = drawn.small_units
    band = ax.axhspan(-2.0 * factor * drawn.noise, 2.0 * factor * drawn.noise, color="0.85", zorder=0)
    ax.legend([band], ["± 2 noise levels"], **LEGEND)
    model = f"model\n{models[0]}" if len(models) == 1 < len(drawn.labels) else "model"
    label = f"record \N{MINUS SIGN} {model} ({unit})"
    ax.set(xlabel="time (s)", ylabel=label, xlim=(drawn.time[0], drawn.time[-1]))
    return ax


def _envelope(ax: Axes, drawn: MotionData) -> Axes:
    _half_periods(ax, drawn, "instant_time", "amplitude")
    if "record" in drawn.half_periods:
        ax.set_ylim(drawn.amplitude_limits())
    ax.set(xlabel="time (s)")
    logarithmic_amplitude(ax, drawn.units)
    return ax


def _frequency(ax: Axes, drawn: MotionData) -> Axes:
    _half_periods(ax, drawn, "amplitude", "frequency")
    if "record" in drawn.half_periods:
        highest = drawn.half_periods["record"].amplitude.values.max()
        ax.set(xlim=(0.0, 1.05 * highest), ylim=drawn.frequency_limits())
    ax.set(xlabel=f"amplitude ({drawn.units})", ylabel="frequency (rad/s)")
    return ax


def _missed(ax: Axes, drawn: MotionData, x: str, y: str) -> Axes:
    """Half periods of the record minus those of each model, with the record's errors.

    On one axis they lie on each other where a model is nearly right.
    """
    factor, unit = drawn.small_units if y == "amplitude" else (1e3, "mrad/s")
    measured, ends = drawn.half_periods.get("record"), []
    for name, fits in drawn.half_periods.items():
        if measured is None or name == "record":
            continue
        order = np.argsort(fits[x].values)
        model = np.interp(measured[x].values, fits[x].values[order], fits[y].values[order])
        missed = factor * (measured[y].values - model)
        error = factor * measured[f"{y}_standard_error"].values
        bar: Style = {"fmt": "o", "color": drawn.lines[name]["color"], "linewidth": BAR_WIDTH, **OPEN_MARKS}
        ax.errorbar(measured[x].values, missed, error, **bar)
        # Outliers at the noise floor are outside.
        ends += [*np.percentile(missed, [3, 97]), *(side * 2.0 * float(np.median(error)) for side in (-1, 1))]
    if ends:
        room = 0.4 * (max(ends) - min(ends))
        ax.set_ylim(min(ends) - room, max(ends) + room)
    ax.axhline(0.0, color="0.6", linewidth=BAR_WIDTH)
    label = "time (s)" if x == "instant_time" else f"amplitude ({drawn.units})"
    ax.set(xlabel=label, ylabel=f"record \N{MINUS SIGN} model\n({unit})")
    return ax


def _half_periods(ax: Axes, drawn: MotionData, x: str, y: str) -> None:
    """Half periods of the record with their errors, named above the panel, and lines of the models."""
    for name, fits in drawn.half_periods.items():
        at, value = fits[x].values, fits[y].values
        if name == "record":
            error = fits[f"{y}_standard_error"].values
            points = ax.errorbar(at, value, error, fmt="o", color="0.5", linewidth=BAR_WIDTH, **OPEN_MARKS)
            ax.legend([points], ["half periods of the record"], **LEGEND)
        else:
            ax.plot(at, value, linewidth=1.0, label=drawn.labels[name], **drawn.lines[name])
