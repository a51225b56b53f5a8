"""Many runs against their conditions, and the next run: what each release and duration would tell."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from sysid_trib.plots import style
from sysid_trib.plots.declared import shows
from sysid_trib.plots.style import FULL_WIDTH, INK, ORANGE

ACROSS = 2
# Beyond these runs bars hide the marks.
MANY_RUNS = 300
# Runs that stand out are drawn in another colour: standard deviations.
FAR = 4.0
# So many of them are named.
MOST_NAMES_DRAWN = 8


def against_condition(
    compared: xr.Dataset, name: str, condition: ArrayLike, *, width: float = FULL_WIDTH
) -> Figure:
    """Each quantity of all runs against a condition, with standard errors; outliers in another colour.

    Parameters
    ----------
    compared : Dataset
        Of `between_runs`.
    name : str
        Of the condition.
    condition : (run,) array_like
        Its value in each run, numbers or texts.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    quantities = compared.quantity.values.tolist()
    figure, panels = style.grid(len(quantities), ACROSS, width, 2.2)
    for quantity, panel in zip(quantities, panels, strict=True):
        _of_quantity(panel, compared, quantity, name, condition)
    return figure


def _of_quantity(ax: Axes, compared: xr.Dataset, quantity: str, name: str, condition: ArrayLike) -> None:
    """One quantity of all runs, with standard errors; outliers in another colour."""
    of_quantity = compared.sel(quantity=quantity)
    at, ticks = places(np.asarray(condition))
    far = np.abs(of_quantity.z.values) > FAR
    few = len(at) <= MANY_RUNS
    for chosen, color in ((~far, INK), (far, ORANGE)):
        value, error = of_quantity.value.values[chosen], of_quantity.standard_error.values[chosen]
        bars = {"yerr": error, "elinewidth": 0.8} if few else {}
        ax.errorbar(at[chosen], value, fmt="o", markersize=3 if few else 1.5, color=color, **bars)
    if np.count_nonzero(far) <= MOST_NAMES_DRAWN:
        _name_runs(ax, of_quantity.isel(run=far), at[far])
    if ticks:
        ax.set_xticks(range(len(ticks)), ticks)
    unit = str(of_quantity.unit.item()).removeprefix("1") if "unit" in of_quantity.coords else ""
    ax.set(xlabel=name, ylabel=f"{quantity} ({style.unit_label(unit)})" if unit else quantity)


def _name_runs(ax: Axes, named: xr.Dataset, at: np.ndarray) -> None:
    """The name of each run beside its mark, towards the middle, where there is room."""
    middle = np.mean(ax.get_xlim())
    for x, value, name in zip(at, named.value.values, named.run.values, strict=True):
        side, end = (5, "left") if x < middle else (-5, "right")
        ax.annotate(str(name), (x, value), (side, 0), ha=end, fontsize=6, **style.LABEL_OFFSET)


def places(condition: np.ndarray) -> tuple[np.ndarray, Sequence[str]]:
    """Where the runs stand on the axis of a condition, and the labels of texts."""
    if condition.dtype.kind in "fiu":
        return condition.astype(float), ()
    labels, numbers = np.unique(condition.astype(str), return_inverse=True)
    at = numbers.astype(float)
    for group in range(len(labels)):
        # Runs of a group side by side about its label, so that none hides another.
        count = np.count_nonzero(numbers == group)
        at[numbers == group] += (np.arange(count) + 0.5) / (2.0 * count) - 0.25
    return at, labels.tolist()


PLAN_HEIGHT = 2.4


@shows("plan")
def plan(data: xr.Dataset, *, width: float = FULL_WIDTH) -> Figure:
    """What each run leaves against its release: entropy of the models, and errors; where two models part.

    A line stands for an error that is wanted. Where none is and there is one model: the largest of all
    errors over the least.

    Parameters
    ----------
    data : Dataset
        Of `validation.plan`.
    width : float, inch
        Of the figure; a column of a journal has 88 mm (3.46).
    """
    drawn = {"entropy left (nat)": data.entropy} if "parting" in data else {}
    limits = {
        f"error of {style.in_latex(symbol)}": float(error) for symbol, error in data.attrs["wanted"].items()
    }
    errors = [data.standard_error.sel(force=symbol) for symbol in data.attrs["wanted"]]
    drawn |= dict(zip(limits, errors, strict=True))
    if not drawn:
        drawn["largest error / least"] = (data.standard_error / data.standard_error.min("run")).max("force")
    figure, panels = style.grid(len(drawn) + ("parting" in data), 2, width, PLAN_HEIGHT)
    for panel, (name, values) in zip(panels, drawn.items(), strict=False):
        _against_release(panel, data.assign(shown=values))
        panel.set_ylabel(name)
        if name in limits:
            style.threshold(panel, limits[name], f"wanted: {limits[name]:g}")
            panel.set_yscale("log")
            style.logarithmic_ticks(panel.yaxis, *panel.get_ylim())
    panels[0].legend(**style.LEGEND, ncols=3)
    titles = [""] * len(panels)
    if "parting" in data:
        panels[-1].plot(data.time, data.parting, color=INK, linewidth=1.0)
        panels[-1].set(xlabel="time (s)", ylabel="log likelihood ratio", ylim=(0.0, None))
        style.threshold(panels[-1], np.log(data.attrs["odds"]), f"odds of {data.attrs['odds']:g} to 1")
        titles[-1] = " or ".join(data.parting.attrs["models"])
    if len(panels) > 1:
        style.letter(panels, titles)
    return figure


def _against_release(ax: Axes, data: xr.Dataset) -> None:
    """What is shown of each run, a line for a duration, and a ring about the best run."""
    durations = np.unique(data.duration.values)
    for at, length in enumerate(durations):
        rows = data.isel(run=np.flatnonzero(data.duration.values == length)).sortby("amplitude")
        shade = str(0.75 * (1.0 - (at + 1) / len(durations)))
        ax.plot(rows.amplitude, rows.shown, color=shade, marker="o", markersize=3, label=f"{length:.3g} s")
    ring: dict[str, Any] = {
        "color": ORANGE,
        "marker": "o",
        "markersize": 7,
        "fillstyle": "none",
        "linestyle": "",
    }
    ax.plot(data.amplitude[0], data.shown[0], **ring, label="best")
    ax.set_xlabel(f"release ({data.amplitude.attrs['units']})")
