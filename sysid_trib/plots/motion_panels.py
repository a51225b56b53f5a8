"""A record with its models: panels over time, the figure of the half periods, and their numbers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from numpy.typing import NDArray

from sysid_trib.arrays import Array
from sysid_trib.plots.style import (
    LEGEND,
    MODEL_LINES,
    Style,
)
from sysid_trib.results.effects import tied_name
from sysid_trib.results.files import kind_of
from sysid_trib.results.variables import record_groups, signal_label, signal_units, small_units
from sysid_trib.validation.verdict import breakdown, run_record_noise

# Points of a curve: as many as a wide screen has, for each the least and the largest of its stretch.
MOST_POINTS = 3000
# Effects that a legend names.
MOST_NAMES = 2


@dataclass(frozen=True)
class MotionData:
    """A record, its models that have a motion, and the noise.

    Attributes
    ----------
    data : xr.Dataset
        `angle(time)` and, with models, `simulated_angle(model, time)`, rad.
    noise : float, rad
        Standard deviation of a sample.
    lines : mapping of str to style
        Line of each model by its name; lines of a higher `zorder` lie on others.
    labels : mapping of str to str
        What a legend calls each model.
    """

    data: xr.Dataset
    noise: float
    lines: Mapping[str, Style]
    labels: Mapping[str, str]

    @property
    def time(self) -> Array:
        """Instants of the samples, s."""
        return self.data.time.values

    @property
    def angle(self) -> Array:
        """Angle of the record, rad."""
        return self.data.angle.values

    def motion(self, model: str) -> Array:
        """Angle of a model, rad."""
        return self.data.simulated_angle.sel(model=model).values

    @property
    def units(self) -> str:
        """Unit of the record."""
        return signal_units(self.data)

    @property
    def label(self) -> str:
        """Label of an axis of the record."""
        return signal_label(self.units)

    @property
    def small_units(self) -> tuple[float, str]:
        """Factor and unit of what is small beside the record."""
        return small_units(self.units)

    def residual(self, model: str) -> Array:
        """Record minus model, in small units."""
        return self.small_units[0] * (self.angle - self.motion(model))


def motion_data(tree: xr.DataTree, run: int) -> MotionData:
    """The record of a run with the models of a cross-check, or those before and after of a discovery."""
    data = tree[record_groups(tree)[run]].to_dataset()
    if kind_of(tree) == "discover":
        names = ("before", "after")
        labels = {"before": "start model", "after": f"with {_few(_tied_names(tree))}"}
        shown = [np.isfinite(data.simulated_angle.sel(model=name).values).all() for name in names]
    else:
        checked = tree["comparison"].attrs
        names = (checked["first"], checked["second"])
        labels = {name: name for name in names}
        # A model that broke down must not set a scale.
        shown = [not breakdown(tree, name) for name in names]
    lines = {name: style for name, style, drawn in zip(names, MODEL_LINES, shown, strict=True) if drawn}
    noise = run_record_noise(tree, run)
    return MotionData(data, noise, lines, labels)


def _tied_names(tree: xr.DataTree) -> list[str]:
    """The effects of the final model, each with what it cannot be separated from."""
    count = tree["steps"].attrs["count"]
    names = [tied_name(tree["steps"].to_dataset().isel(step=at), 1) for at in range(count)]
    return [f"({name})" if " or " in name and count > 1 else name for name in names]


def _few(effects: Sequence[str]) -> str:
    """Names of effects, the first of many."""
    if len(effects) > MOST_NAMES:
        return f"{', '.join(effects[: MOST_NAMES - 1])} and {len(effects) - MOST_NAMES + 1} more"
    return " and ".join(effects) or "no effect"


def drawn_samples(values: Array) -> NDArray[np.intp]:
    """Samples that draw a curve: the least and the largest of each stretch, so that no peak is lost."""
    if values.size <= MOST_POINTS:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, MOST_POINTS // 2 + 1).astype(int)
    ends = [start + f(values[start:stop]) for start, stop in pairwise(edges) for f in (np.argmin, np.argmax)]
    return np.unique(ends)


RECORD_POINTS: Style = {"label": "record", "marker": ".", "linestyle": "", "color": "0.6", "markersize": 2.5}


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
    name = model if len(drawn.labels) > 1 else "model"
    label = f"record \N{MINUS SIGN} {name} ({unit})"
    ax.set(xlabel="time (s)", ylabel=label, xlim=(drawn.time[0], drawn.time[-1]))
