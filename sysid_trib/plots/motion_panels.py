"""A record with its models: panels over time, and the figure of the half periods."""

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
    footnote,
    legend_marks,
    letter,
    logarithmic_amplitude,
    new_figure,
)

RECORD_POINTS: Style = {"label": "record", "marker": ".", "linestyle": "", "color": "0.6", "markersize": 2.5}
# Of the rows of half periods, and of what models miss of them: parts of the height.
HALF_PERIOD_HEIGHTS = (1.2, 0.8)


def half_periods(tree: xr.DataTree, run: int = 0) -> Figure:
    """Amplitude against time, frequency against amplitude, and what each model misses of both.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `cross_check` or `discover`.
    run : int
        Which of several runs, from 0.
    """
    figure = new_figure(FULL_WIDTH, 4.2)
    panels = figure.subplots(2, 2, height_ratios=HALF_PERIOD_HEIGHTS).ravel().tolist()
    envelopes, frequencies, amplitude_missed, frequency_missed = panels
    drawn = motion_data(tree, run)
    _envelope(envelopes, drawn)
    _frequency(frequencies, drawn)
    _missed(amplitude_missed, drawn, "instant_time", "amplitude")
    _missed(frequency_missed, drawn, "amplitude", "frequency")
    for upper, lower in ((envelopes, amplitude_missed), (frequencies, frequency_missed)):
        lower.set_xlim(upper.get_xlim())
        upper.set_xlabel("")
        upper.tick_params(labelbottom=False)
    letter(panels)
    named = {drawn.labels[name]: {"marker": ""} | dict(style) for name, style in drawn.lines.items()}
    figure.legend(handles=legend_marks(named), ncols=2, loc="outside upper right", frameon=False, fontsize=8)
    footnote(figure, held_out_sentence(tree))
    return figure


def curve(ax: Axes, time: Array, values: Array, style: Style) -> None:
    """A curve over time, decimated."""
    shown = drawn_samples(values)
    ax.plot(time[shown], values[shown], **style)


def draw_in_time(panels: Sequence[Axes], drawn: MotionData, models: Sequence[str]) -> None:
    """The record and, each in a panel of its own below it, the residuals of models, with one axis of time.

    In one panel a residual would hide another where models agree.
    """
    _record(panels[0], drawn)
    for panel, model in zip(panels[1:], models, strict=True):
        _residual(panel, drawn, model)
        panel.sharex(panels[0])
    for panel in panels[:-1]:
        panel.set_xlabel("")
        panel.tick_params(labelbottom=False)


def _record(ax: Axes, drawn: MotionData) -> None:
    curve(ax, drawn.time, drawn.angle, RECORD_POINTS)
    for name, style in drawn.lines.items():
        curve(ax, drawn.time, drawn.motion(name), {"linewidth": 0.8, "label": drawn.labels[name], **style})
    if "holdout_start" in drawn.data:
        ax.axvspan(drawn.data.holdout_start.item(), drawn.time[-1], color="0.93", zorder=0)
    ax.set(xlabel="time (s)", ylabel=drawn.label, xlim=(drawn.time[0], drawn.time[-1]))
    # Above the panel: inside there is no room that the oscillation leaves free.
    ax.legend(ncols=3, **LEGEND)


def _residual(ax: Axes, drawn: MotionData, model: str) -> None:
    """The residual of a model, named by the axis where there are several."""
    if model in drawn.lines:
        look = {"linewidth": 0.6, **drawn.lines[model], "linestyle": "-"}
        curve(ax, drawn.time, drawn.residual(model), look)
    factor, unit = drawn.small_units
    band = ax.axhspan(-2.0 * factor * drawn.noise, 2.0 * factor * drawn.noise, color="0.85", zorder=0)
    ax.legend([band], ["± 2 noise levels"], **LEGEND)
    name = f"model\n{model}" if len(drawn.labels) > 1 else "model"
    label = f"record \N{MINUS SIGN} {name} ({unit})"
    ax.set(xlabel="time (s)", ylabel=label, xlim=(drawn.time[0], drawn.time[-1]))


def _envelope(ax: Axes, drawn: MotionData) -> None:
    _half_periods(ax, drawn, "instant_time", "amplitude")
    if "record" in drawn.half_periods:
        ax.set_ylim(drawn.amplitude_limits())
    ax.set(xlabel="time (s)")
    logarithmic_amplitude(ax, drawn.units)


def _frequency(ax: Axes, drawn: MotionData) -> None:
    _half_periods(ax, drawn, "amplitude", "frequency")
    if "record" in drawn.half_periods:
        highest = drawn.half_periods["record"].amplitude.values.max()
        ax.set(xlim=(0.0, 1.05 * highest), ylim=drawn.frequency_limits())
    ax.set(xlabel=f"amplitude ({drawn.units})", ylabel="frequency (rad/s)")


def _missed(ax: Axes, drawn: MotionData, x: str, y: str) -> None:
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
