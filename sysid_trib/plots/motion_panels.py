"""A record with its models: what is drawn of them, and panels over time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from numpy.typing import NDArray

from sysid_trib.arrays import Array
from sysid_trib.plots.style import LEGEND, MODEL_LINES, Style
from sysid_trib.results.effects import tied_name
from sysid_trib.results.files import kind_of
from sysid_trib.results.variables import record_groups, signal_label, signal_units, small_units
from sysid_trib.validation.findings import LAST_THIRD, failures, is_refitted

# Points of a curve: as many as a wide screen has, for each the least and the largest of its stretch.
MOST_POINTS = 3000
# Effects that a legend names.
MOST_NAMES = 2
RECORD_POINTS: Style = {"label": "record", "marker": ".", "linestyle": "", "color": "0.6", "markersize": 2.5}


def held_out_sentence(tree: xr.DataTree, *, of_search: bool = False) -> str:
    """What of the records was held out; empty where nothing was.

    Parameters
    ----------
    tree : xr.DataTree
        Result of a command; of `compare` the figure has it on grey.
    of_search : bool
        Whether the figure is of the search itself, which never sees what is held out; models may be fitted to
        the whole records in the end.
    """
    if kind_of(tree) != "discover":
        return "The part of the record on grey was held out." if kind_of(tree) == "compare" else ""
    held = str(tree.attrs["held_out"])
    held += " of the record" * (held == LAST_THIRD)
    if is_refitted(tree):
        return f"Held out of the search, {'and of these numbers' if of_search else 'then fitted'}: {held}."
    return f"Held out, and not in this figure: {held}."


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

    def motion(self, model: str) -> Array:
        """Angle of a model, rad."""
        return self.data.simulated_angle.sel(model=model).values


def motion_data(tree: xr.DataTree, run: int) -> MotionData:
    """The record of a run with its models.

    Those of a cross-check, those before and after of a discovery, that which predicts best of a comparison.
    """
    data, kind = tree[record_groups(tree)[run]].to_dataset(), kind_of(tree)
    if kind == "discover":
        labels = {"before": "start model", "after": f"with {_few(_tied_names(tree))}"}
    else:
        checked = tree["comparison"].attrs
        names = [checked["best"]] if kind == "compare" else [checked["first"], checked["second"]]
        labels = dict(zip(names, names, strict=True))
    # A model that broke down must not set a scale.
    failed = failures(tree) if kind in ("cross_check", "driven") else {}
    drawn = [
        name not in failed
        and name in data.get("model", ())
        and np.isfinite(data.simulated_angle.sel(model=name).values).all()
        for name in labels
    ]
    looks = MODEL_LINES[1:] if kind == "compare" else MODEL_LINES
    lines = {name: look for name, look, there in zip(labels, looks, drawn, strict=False) if there}
    return MotionData(data, float(data.noise), lines, labels)


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


def curve(ax: Axes, time: Array, values: Array, look: Style) -> None:
    """A curve over time, decimated."""
    shown = drawn_samples(values)
    ax.plot(time[shown], values[shown], **look)


def draw_in_time(panels: Sequence[Axes], drawn: MotionData, models: Sequence[str]) -> None:
    """The record and, each in a panel of its own below it, the residuals of models, with one axis of time.

    In one panel a residual would hide another where models agree.
    """
    time, angle, units = drawn.data.time.values, drawn.data.angle.values, signal_units(drawn.data)
    curve(panels[0], time, angle, RECORD_POINTS)
    for name, look in drawn.lines.items():
        curve(panels[0], time, drawn.motion(name), {"linewidth": 0.8, "label": drawn.labels[name], **look})
    if "holdout_start" in drawn.data:
        panels[0].axvspan(drawn.data.holdout_start.item(), time[-1], color="0.93", zorder=0)
    panels[0].set_ylabel(signal_label(units))
    # Above the panel: inside there is no room that the oscillation leaves free.
    panels[0].legend(ncols=3, **LEGEND)
    factor, unit = small_units(units)
    for panel, model in zip(panels[1:], models, strict=True):
        if model in drawn.lines:
            look = {"linewidth": 0.6, **drawn.lines[model], "linestyle": "-"}
            curve(panel, time, factor * (angle - drawn.motion(model)), look)
        width = 2.0 * factor * drawn.noise
        band = panel.axhspan(-width, width, color="0.85", zorder=0)
        panel.legend([band], ["± 2 noise levels"], **LEGEND)
        # Named by the axis where there are several.
        name = model if len(drawn.labels) > 1 else "model"
        panel.set_ylabel(f"record \N{MINUS SIGN} {name} ({unit})")
        panel.sharex(panels[0])
    panels[0].set_xlim(time[0], time[-1])
    for panel in panels[:-1]:
        panel.tick_params(labelbottom=False)
    panels[-1].set_xlabel("time (s)")
