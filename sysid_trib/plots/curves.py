"""Frequency and damping ratio against amplitude: the record's with their bands, and the models'."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.plots.style import (
    FULL_WIDTH,
    GREY,
    INK,
    LEGEND,
    MODEL_LINES,
    OPEN_MARKS,
    grid,
    letter,
    line,
    logarithmic_ticks,
)
from sysid_trib.results.variables import group_names, record_groups
from sysid_trib.validation.findings import kept_results

CURVE_HEIGHT = 2.6
CURVE_LABELS = {"frequency": "frequency (rad/s)", "damping_ratio": "damping ratio"}
# Room about the bands, in parts of their extent: single periods may scatter far beyond them.
MARGIN = 0.15
# A band so many times the median is an end's.
END_WIDTH = 4.0
DOTS: dict[str, Any] = OPEN_MARKS | {
    "color": GREY,
    "marker": "o",
    "markersize": 2,
    "linestyle": "",
    "zorder": 1,
}


def backbone(data: xr.Dataset | xr.DataTree, run: int = 0) -> Figure:
    """Frequency and damping ratio against amplitude, with 95 % bands; dots are single periods.

    Parameters
    ----------
    data : Dataset or DataTree
        Of `backbone`; or a result of `cross_check`, whose models' curves are drawn over those of its record.
    run : int
        Which of several runs of a result, from 0.
    """
    data, models = curves_of(data, run) if isinstance(data, xr.DataTree) else (data, None)
    figure, panels = grid(2, 2, FULL_WIDTH, CURVE_HEIGHT)
    for ax, name in zip(panels, CURVE_LABELS, strict=True):
        draw_curve(ax, data, name, models)
    letter(panels)
    if models is not None:
        panels[1].legend(**LEGEND, ncols=2)
    return figure


def curves_of(tree: xr.DataTree, run: int) -> tuple[xr.Dataset, xr.Dataset | None]:
    """The backbone of a run in a result of `cross_check`, and its models' curves if any model is kept.

    Raises
    ------
    KeyError
        The run has no backbone.
    """
    count, kept = len(record_groups(tree)), list(kept_results(tree))
    names = (group_names(name, count)[run] for name in ("backbone", "lack_of_fit"))
    of_record, of_models = (tree[name].to_dataset() for name in names)
    return of_record, of_models.sel(model=kept) if kept else None


def draw_curve(ax: Axes, data: xr.Dataset, name: str, models: xr.Dataset | None = None) -> None:
    """One curve of a backbone with its band, its single periods, and the models' curves.

    Parameters
    ----------
    ax : Axes
    data : Dataset
        Of `backbone`.
    name : {"frequency", "damping_ratio"}
    models : Dataset, optional
        Of `lack_of_fit`.
    """
    amplitude = data.amplitude.values
    low, high = (data[f"{name}_{end}"].values for end in ("low", "high"))
    ax.plot(data.period_amplitude, data[f"period_{name}"], **DOTS)
    ax.fill_between(amplitude, low, high, color=INK, alpha=0.2, linewidth=0, zorder=2, label="record, 95 %")
    ax.plot(amplitude, data[name], color=INK, linewidth=0.8, zorder=2)
    if models is not None:
        _draw_models(ax, models, name)
    # All of the curve, and the band where it is narrow: an end of few periods would hide all else.
    narrow = high - low <= END_WIDTH * np.median(high - low)
    bottom = min(float(low[narrow].min()), float(data[name].min()))
    top = max(float(high[narrow].max()), float(data[name].max()))
    ax.set(ylim=(bottom - MARGIN * (top - bottom), top + MARGIN * (top - bottom)), xscale="log")
    ax.set(xlabel=f"amplitude ({data.amplitude.attrs['units']})", ylabel=CURVE_LABELS[name])
    logarithmic_ticks(ax.xaxis, float(amplitude[0]), float(amplitude[-1]))


def _draw_models(ax: Axes, models: xr.Dataset, name: str) -> None:
    for at, label in enumerate(models.model.values.tolist()):
        series, curve = MODEL_LINES[at % len(MODEL_LINES)], models[name].sel(model=label)
        ax.plot(models.amplitude, curve, **line(series), zorder=series["zorder"], label=label)
