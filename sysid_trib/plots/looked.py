"""A record before identification: decays, spectrum, inputs; frequency and damping against amplitude."""

from itertools import cycle
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.cycles.backbone import backbone as backbone_of
from sysid_trib.cycles.look import look as look_at
from sysid_trib.plots import style
from sysid_trib.plots.figure import FULL_WIDTH, LEGEND, new_figure, shows
from sysid_trib.plots.over_time import RECORD_POINTS, curve
from sysid_trib.plots.style import BLUE, GREY, INK, MODEL_LINES, ORANGE
from sysid_trib.records.inputs import inputs_of
from sysid_trib.results.judged import kept_results, preferred_of
from sysid_trib.results.variables import (
    frequency_unit_of,
    group_names,
    record_groups,
    signal_label,
    signal_units,
)

CURVE_LABELS = {"frequency": "frequency", "damping_ratio": "damping ratio"}
# Margin around the bands, as a fraction of their range: single periods may scatter far outside.
MARGIN = 0.15
DOTS: dict[str, Any] = style.OPEN_MARKS | {"marker": "o", "markersize": 2, "linestyle": "", "zorder": 1}


@shows("backbone", groups=("backbone",), of_record=backbone_of)
def backbone(data: xr.Dataset | xr.DataTree, run: int = 0, *, width: float = FULL_WIDTH) -> Figure:
    """Frequency and damping ratio against amplitude, with 95 % bands; circles are single periods.

    Parameters
    ----------
    data : Dataset or DataTree
        Result of `backbone`, or a record; or a result of `identify`: then the curves of its models are drawn
        over those of the record.
    run : int
        Index of the run in a result, from 0.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import sysid_trib as st
    >>> figure = st.plots.backbone(st.records.paper_twin())
    >>> [ax.get_ylabel() for ax in figure.axes]
    ['frequency (rad/s)', 'damping ratio']
    """
    data, models = curves_of(data, run) if isinstance(data, xr.DataTree) else (data, None)
    figure, panels = style.grid(2, 2, width, 2.6)
    for ax, name in zip(panels, CURVE_LABELS, strict=True):
        draw_curve(ax, data, name, models)
    style.letter(panels)
    if models is not None:
        panels[1].legend(**LEGEND, ncols=2)
    return figure


def curves_of(tree: xr.DataTree, run: int) -> tuple[xr.Dataset, xr.Dataset | None]:
    """Return the backbone of a run in a result of `cross_check`, and its models' curves if there are any.

    Raises
    ------
    KeyError
        The run has no backbone.
    """
    count, kept = len(record_groups(tree)), list(kept_results(tree))
    names = (group_names(name, count)[run] for name in ("backbone", "lack_of_fit"))
    of_record, of_models = (tree[name].to_dataset() for name in names)
    return of_record, of_models.sel(model=kept) if kept else None


def draw_curve(
    ax: Axes,
    data: xr.Dataset,
    name: str,
    models: xr.Dataset | None = None,
    *,
    colour: str = INK,
    label: str | None = "record, 95 %",
) -> None:
    """Draw one curve of a backbone with its band, its single periods, and the models' curves.

    The frequency of a mode is in Hz, as in the table.

    Parameters
    ----------
    ax : Axes
    data : Dataset
        Result of `backbone`.
    name : {"frequency", "damping_ratio"}
    models : Dataset, optional
        Result of `lack_of_fit`.
    colour, label : str
        Colour and label of the band and its curve.
    """
    amplitude = data.amplitude.values
    unit, divisor = frequency_unit_of(data.attrs) if name == "frequency" else ("", 1.0)
    middle, low, high = (data[f"{name}{end}"].values / divisor for end in ("", "_low", "_high"))
    dots = {"color": GREY} if colour == INK else {"color": colour, "alpha": 0.4}
    ax.plot(data.period_amplitude, data[f"period_{name}"] / divisor, **DOTS, **dots)
    ax.fill_between(amplitude, low, high, color=colour, alpha=0.2, linewidth=0, zorder=2, label=label)
    ax.plot(amplitude, middle, color=colour, linewidth=0.8, zorder=2)
    labels = models.model.values.tolist() if models is not None else []
    for model, series in zip(labels, cycle(MODEL_LINES)):
        lines = models[name].sel(model=model)  # type: ignore[index]
        ax.plot(lines.amplitude, lines / divisor, **style.line(series), zorder=series["zorder"], label=model)
    # The whole curve, but only the narrow part of the band: a band at an end of few periods would hide the
    # rest.
    narrow = high - low <= 4.0 * np.median(high - low)
    bottom = min(float(low[narrow].min()), float(middle.min()))
    top = max(float(high[narrow].max()), float(middle.max()))
    ax.set(ylim=(bottom - MARGIN * (top - bottom), top + MARGIN * (top - bottom)), xscale="log")
    ax.set(xlabel=f"amplitude ({data.amplitude.attrs['units']})")
    ax.set(ylabel=f"{CURVE_LABELS[name]} ({unit})" if unit else CURVE_LABELS[name])
    style.logarithmic_ticks(ax.xaxis, float(amplitude[0]), float(amplitude[-1]))


# Largest number of drawn points of a long record.
MOST_POINTS_DRAWN = 20_000


@shows("look", of_record=look_at)
def look(tree: xr.DataTree, *, width: float = FULL_WIDTH) -> Figure:
    """The record with its decays marked, the amplitude over time, and the spectral density of each decay.

    Parameters
    ----------
    tree : DataTree
        Result of `look`, or a record.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import sysid_trib as st
    >>> figure = st.plots.look(st.records.paper_twin())
    >>> [ax.get_ylabel() for ax in figure.axes]
    ['angle (rad)', 'amplitude (rad)', 'density (rad$^2$/Hz)']
    """
    figure, panels = style.grid(3, 1, width, row_height=2.1)
    decays = [node.to_dataset() for name, node in tree.children.items() if name.startswith("decay")]
    records = [node.to_dataset() for name, node in tree.children.items() if name.startswith("record")]
    unit = str(records[0].angle.attrs["units"])
    for record in records:
        drawn = record.isel(time=slice(None, None, max(1, record.sizes["time"] // MOST_POINTS_DRAWN)))
        panels[0].plot(drawn.time, drawn.angle, color="0.6", linewidth=0.5)
    for decay in decays:
        panels[0].axvspan(decay.start.item(), decay.stop.item(), color=BLUE, alpha=0.12, linewidth=0)
        panels[1].plot(decay.instant_time, decay.amplitude, **style.line(MODEL_LINES[0]))
        panels[2].plot(decay.frequency_line, decay.spectrum, color=ORANGE, linewidth=0.8)
    panels[0].set(xlabel="time (s)", ylabel=f"{records[0].angle.attrs.get('long_name', 'angle')} ({unit})")
    panels[1].set(xlabel="time (s)", ylabel=f"amplitude ({unit})", yscale="log")
    panels[2].set(xlabel="frequency (Hz)", ylabel=f"density ({unit}$^2$/Hz)", xscale="log", yscale="log")
    for axis in (panels[1].yaxis, panels[2].xaxis, panels[2].yaxis):
        style.logarithmic_ticks(axis, *axis.get_view_interval())
    style.letter(panels)
    return figure


def driven_overview(tree: xr.DataTree, run: int = 0, *, width: float = FULL_WIDTH) -> Figure:
    """Draw inputs, record and motion of the preferred model, and the residuals of the models, over time.

    Parameters
    ----------
    tree : DataTree
        Result of `identify` or `discover` of a driven record.
    run : int
        Index of the run, from 0.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.
    """
    record = tree[record_groups(tree)[run]].to_dataset()
    # For a discovery, take the last model.
    answer = preferred_of(tree) or record.model.values[-1]
    inputs, time, unit = inputs_of(record), record.time.values, signal_units(tree)
    # Each panel has room for its label.
    figure = new_figure(width, height=1.6 * (len(inputs) + 2))
    panels = figure.subplots(len(inputs) + 2, 1, sharex=True, squeeze=False)[:, 0].tolist()
    for panel, (name, given) in zip(panels, inputs.items(), strict=False):
        curve(panel, time[0] + given.elapsed, given.values, {"color": "0.3", "linewidth": 0.6})
        units = str(record[name].attrs.get("units", ""))
        panel.set_ylabel(f"input {name}{f' ({style.unit_label(units)})' if units else ''}")
    motion, residual = panels[-2:]
    curve(motion, time, record.angle.values, RECORD_POINTS)
    moving = record.dropna("model", how="all", subset=["simulated_angle"]).model.values.tolist()
    for name, colour in zip(moving, (ORANGE, BLUE), strict=False):
        simulated = record.simulated_angle.sel(model=name).values
        if name == answer:
            curve(motion, time, simulated, {"color": colour, "linewidth": 0.8, "label": name})
        remainder = record.angle.values - simulated
        rms = float(np.sqrt(np.mean(remainder**2)))
        label = f"{name}, RMS {rms:.3g} {style.unit_label(unit)}"
        curve(residual, time, remainder, {"color": colour, "linewidth": 0.6, "label": label})
    motion.set_ylabel(signal_label(unit))
    residual.set(xlabel="time (s)", ylabel=f"record \N{MINUS SIGN} model ({style.unit_label(unit)})")
    for panel in (motion, residual):
        panel.legend(ncols=3, **LEGEND)
    residual.set_xlim(time[0], time[-1])
    style.letter(panels)
    return figure
