"""Uncertainty of coefficients: profile likelihoods, other defensible fits, and two samples compared."""

from typing import Any

import numpy as np
import scipy
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import PchipInterpolator

from sysid_trib.arrays import Array
from sysid_trib.plots import style
from sysid_trib.plots.figure import FULL_WIDTH, TWO_COLUMNS, new_figure, shows
from sysid_trib.plots.looked import CURVE_LABELS, draw_curve
from sysid_trib.plots.style import BLUE, GREY, INK, ORANGE
from sysid_trib.printing.layout import value_with_error
from sysid_trib.results.kinds import SIDES

FONT = 6.5
# Colours of the kinds of fit.
KIND_COLOURS = {"window": BLUE, "start": ORANGE, "sampling": GREY, "noise": "#2a9d6f", "method": INK}
SAMPLE_COLOURS = dict(zip(SIDES, (BLUE, ORANGE), strict=True))
# Larger differences (in standard errors) are drawn at the edge.
MOST_ERRORS = 8.0


@shows("cross_check", "driven", block="Profiles", groups=("profile",))
def profile(data: xr.Dataset, width: float = FULL_WIDTH) -> Figure:
    """Deviance of each parameter against its value; the dashed parabola is that of its standard error.

    In each fit of the motion this parameter is fixed and all others are fitted. Orange: the 95 % point of
    chi-square, and the ends of the interval.

    Parameters
    ----------
    data : Dataset
        Result of `validation.profile`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import sysid_trib as st
    >>> decay = st.free_decay(st.records.paper_twin())
    >>> deviance = st.validation.profile(decay, st.identify(decay, method="direct"), ["zeta"])
    >>> figure = st.plots.profile(deviance)
    >>> figure.axes[0].get_ylabel()
    'deviance'
    """
    rows = [data.sel(parameter=name) for name in data.parameter.values.tolist()]
    width = width if len(rows) > 1 else min(width, TWO_COLUMNS)
    figure, panels = style.grid(len(rows), 4, width, row_height=2.2)
    for ax, row in zip(panels, rows, strict=True):
        _profile(ax, row)
    style.letter(panels)
    return figure


def _profile(ax: Axes, row: xr.Dataset) -> None:
    """Draw the deviance of one parameter; dashed, the parabola of the standard error."""
    known = np.isfinite(row.value.values)
    values, deviance = row.value.values[known], row.deviance.values[known]
    unit, label = _power_of_ten(values, row.parameter.item())
    fine = np.linspace(values[0], values[-1], 200)
    parabola = ((fine - row.estimate.item()) / row.standard_error.item()) ** 2
    roots = np.copysign(np.sqrt(deviance), values - row.estimate.item())
    ax.plot(fine / unit, parabola, color=GREY, linewidth=0.8, linestyle="--")
    ax.plot(fine / unit, PchipInterpolator(values, roots)(fine) ** 2, color=INK, linewidth=1.0)
    ax.plot(values / unit, deviance, color=INK, marker="o", markersize=3, linestyle="")
    ax.axhline(row.attrs["threshold"], color=ORANGE, linewidth=0.8)
    for end in ("low", "high"):
        if np.isfinite(row[end]):
            ax.axvline(row[end].item() / unit, color=ORANGE, linewidth=0.6)
    ax.set(xlabel=label, ylabel="deviance", ylim=(0.0, 1.6 * row.attrs["threshold"]))
    ax.locator_params(axis="x", nbins=4)


def _power_of_ten(values: Array, name: str) -> tuple[float, str]:
    """Return the factor of the drawn values and the label of their axis, without an offset."""
    power = int(np.floor(np.log10(np.nanmax(np.abs(values), initial=1e-300))))
    if -2 <= power <= 3:
        return 1.0, style.in_latex(name)
    return 10.0**power, f"{style.in_latex(name)} ($10^{{{power}}}$)"


@shows("cross_check", "driven", block="Sensitivity", groups=("sensitivity",))
def sensitivity(data: xr.Dataset, *, width: float = FULL_WIDTH) -> Figure:
    """Each coefficient by every fit with its error; the band is the stated value ± twice its error.

    The same forces are fitted with other windows, starts, samples and noise, and by other methods.

    Parameters
    ----------
    data : Dataset
        Result of `validation.sensitivity`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import sysid_trib as st
    >>> decay = st.free_decay(st.records.paper_twin())
    >>> fits = st.validation.sensitivity(decay, st.identify(decay, method="direct"))
    >>> figure = st.plots.sensitivity(fits)
    >>> [label.get_text() for label in figure.axes[0].get_yticklabels()][:4]
    ['window: first 70 %', 'window: middle 70 %', 'window: last 70 %', 'start: 1 periods later']
    """
    count, fits = data.sizes["force"], data.fit.values.tolist()
    figure, panels = style.grid(count, 6, width, row_height=0.15 * len(fits) + 0.6, sharing="y")
    colours = [KIND_COLOURS.get(kind, INK) for kind in data.kind.values.tolist()]
    for ax, symbol in zip(panels, data.force.values.tolist(), strict=True):
        row = data.sel(force=symbol)
        unit, label = _power_of_ten(row.coefficient.values, symbol)
        estimate, stated = row.estimate.item() / unit, row.stated_error.item() / unit
        ax.axvspan(estimate - 2.0 * stated, estimate + 2.0 * stated, color=INK, alpha=0.12, linewidth=0)
        ax.axvline(estimate, color=INK, linewidth=0.6)
        values, errors = row.coefficient.values / unit, row.standard_error.values / unit
        for at, (value, error, colour) in enumerate(zip(values, errors, colours, strict=True)):
            style.interval(ax, at, value, error, (-np.inf, np.inf), color=colour, linewidth=0.8)
        ax.set_xlabel(label, fontsize=FONT + 1.0)
        ax.locator_params(axis="x", nbins=2)
        ax.tick_params(labelsize=FONT)
    labels = [f"{kind}: {fit}" for kind, fit in zip(data.kind.values.tolist(), fits, strict=True)]
    style.name_rows(panels[0], labels)
    style.letter(panels)
    return figure


@shows("difference", block="Coefficients")
def difference(tree: xr.DataTree, *, width: float = FULL_WIDTH) -> Figure:
    """Damping and frequency of both samples against amplitude, and the difference of each coefficient.

    The curves are those of the records without a model, with 95 % bands (circles are single periods). Below,
    each difference is in units of its standard error, with an interval whose level is corrected for the
    number of forces: if it contains zero, the difference is not significant. Dark: coefficients that differ.

    Parameters
    ----------
    tree : DataTree
        Result of `held_against`, which the command `difference` writes.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import sysid_trib as st
    >>> contrast = st.difference(*[st.records.paper_twin(seed=seed) for seed in (1, 2)])
    >>> figure = st.plots.difference(contrast)
    >>> [ax.get_xlabel() for ax in figure.axes]
    ['amplitude (rad)', 'amplitude (rad)', 'first minus second, over its standard error']
    """
    count = tree.sizes["force"]
    wide = width >= TWO_COLUMNS
    # The curves, and the differences, a row each.
    heights = [2.4 * (2 - wide), 0.28 * (1.0 if wide else 1.5) * (count + 2)]
    figure = new_figure(width, sum(heights))
    # Texts next to the differences take no space from the curves.
    rows = figure.add_gridspec(2, 1, height_ratios=heights)
    curves = rows[0].subgridspec(*((1, 2) if wide else (2, 1)))
    panels = [figure.add_subplot(curves[at]) for at in range(2)]
    for ax, name in zip(panels, CURVE_LABELS, strict=True):
        _draw_samples(ax, tree, name)
    differences = figure.add_subplot(rows[1])
    _draw_differences(differences, tree, wide)
    style.letter([*panels, differences])
    lines, labels = panels[0].get_legend_handles_labels()
    figure.legend(lines, labels, ncols=2 if wide else 1, loc="outside upper right", frameon=False, fontsize=8)
    return figure


def _draw_samples(ax: Axes, tree: xr.DataTree, name: str) -> None:
    """Draw one curve of the backbone of every run, in the colour of its sample."""
    limits = []
    for side, colour in SAMPLE_COLOURS.items():
        groups = [k for k in tree.children if k.startswith(f"backbone_{side}")]
        for at, group in enumerate(groups):
            label = f"{side} sample, 95 %" if at == 0 else None
            draw_curve(ax, tree[group].to_dataset(), name, colour=colour, label=label)
            limits.append((*ax.get_ylim(), *ax.get_xlim()))
    if limits:
        low, high, left, right = np.array(limits).T
        ax.set(ylim=(low.min(), high.max()), xlim=(left.min(), right.max()))


def _draw_differences(ax: Axes, tree: xr.DataTree, wide: bool) -> None:
    """Draw one row for each force: first minus second over the standard error, with its interval."""
    data = tree.to_dataset()
    symbols, z = data.force.values.tolist(), data.z.values
    half = float(scipy.stats.norm.isf(0.5 * float(data.attrs["level"]) / len(symbols)))
    edge = min(MOST_ERRORS, float(np.nanmax(np.abs(z), initial=half))) + 1.1 * half
    ax.axvline(0.0, color=GREY, linewidth=0.6)
    for at, symbol in enumerate(symbols):
        row = data.sel(force=symbol)
        if not np.isfinite(z[at]):
            continue
        colour = INK if row.differs.item() else GREY
        style.interval(ax, at, z[at], half, (-MOST_ERRORS, MOST_ERRORS), color=colour, markersize=4)
        pair = (value_with_error(row[k].item(), row[f"{k}_standard_error"].item()) for k in SIDES)
        outside = f"  z = {z[at]:+.0f}" if abs(z[at]) > MOST_ERRORS else ""
        # Place the text next to the row, or above it in a column.
        place, side = ((1.01, at), "center") if wide else ((0.02, at - 0.16), "bottom")
        note: dict[str, Any] = {"xycoords": ("axes fraction", "data"), "annotation_clip": False}
        note |= {"va": side, "color": colour, "fontsize": 8 if wide else FONT}
        note["bbox"] = None if wide else style.WHITE
        ax.annotate(" and ".join(pair) + outside, place, **note)
    ax.set_xlim(-edge, edge)
    style.name_rows(ax, [style.in_latex(symbol) for symbol in symbols])
    ax.set_xlabel("first minus second, over its standard error", fontsize=8)
