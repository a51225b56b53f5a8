"""A result at a glance: the record, the residuals, the forces, and the missing force."""

from collections.abc import Mapping
from contextlib import suppress
from typing import Any

import matplotlib as mpl
import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sysid_trib.errors import SysidTribError
from sysid_trib.physics.force_weights import weights
from sysid_trib.plots import style
from sysid_trib.plots.figure import FONT_SIZE, FULL_WIDTH, LEGEND, TWO_COLUMNS, new_figure, shows
from sysid_trib.plots.looked import CURVE_LABELS, curves_of, draw_curve, driven_overview
from sysid_trib.plots.named_effects import COLOUR_PERCENT, DOT_BEYOND, draw_cells
from sysid_trib.plots.over_time import draw_in_time, draw_weights, drawn_models, held_out_sentence
from sysid_trib.printing.layout import value_with_error
from sysid_trib.records.half_sines import envelope
from sysid_trib.results.judged import follows, kept_results, last_of, preferred_of
from sysid_trib.results.kinds import is_of_driven, kind_of
from sysid_trib.results.variables import (
    HALF_INTERVAL,
    record_groups,
    signal_label,
    signal_symbol,
    signal_units,
    small_units,
)
from sysid_trib.validation.missing_force import residual_force

# Height of a row of panels and of a row of residuals, each for a full page and for a column, inch.
ROW_HEIGHT, RESIDUAL_HEIGHT = (1.75, 1.45), (1.2, 1.0)
# Panels of the residuals of one or two models, in the figure's mosaic.
RESIDUAL_PANELS = "BK"
# Range in which a coefficient is drawn, in units of its value; its numbers are on the right, where the axis
# continues.
COEFFICIENT_RANGE, END_OF_NUMBERS = (-0.5, 2.0), 5.0
MISSING_TITLE = f"missing force; dots: beyond {DOT_BEYOND:g} errors"
TOO_FEW = "too few samples a period"
FITTED = "with fitted start and sensor's zero"
WEIGHED = (
    "Share of each force in the decay and in the frequency shift against amplitude (to first order). Each "
    "coefficient over its value with its 95 % interval: if it contains zero, the coefficient may be zero."
)
EFFECTIVE_TITLE = "The model does not explain the record."


@shows(
    *("cross_check", "driven", "compare", "discover"),
    block="At a glance",
    captions={
        "discover": f"The record and the motion of the final model, {FITTED}. {WEIGHED}",
        "driven": f"The inputs, the record with the motion of the preferred model, {FITTED}, and "
        f"the residual "
        "of each method's model.",
    },
)
def overview(tree: xr.DataTree, run: int = 0, *, width: float = FULL_WIDTH) -> Figure:
    """A result at a glance: the record and its models, their residuals, and the forces.

    Frequency and damping ratio against amplitude, if there is a backbone. Circles are single periods of the
    record; the black line is their curve without any model, the grey band its 95 % band; coloured lines are
    the models. The record and the motion of each model,
    with fitted start and sensor's zero, and below them the residual of each model; the band is plus and minus
    twice the noise. Share of each force in the decay and in the frequency shift against amplitude (to first
    order). Each coefficient divided by its value, with its 95 % interval: if the interval contains zero, the
    coefficient may be zero. Finally, the force that the model lacks, computed from the record (spline), in
    cells of angle and rate; a dot marks a cell in which it exceeds three standard errors.

    Parameters
    ----------
    tree : xr.DataTree
        Result of `cross_check`, `compare` or `discover`; for `discover`, `story` shows the residuals and the
        missing force. For driven records, the inputs, the motion of the preferred model and the residuals are
        shown.
    run : int
        Index of the run, from 0.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import sysid_trib as st
    >>> figure = st.plots.overview(st.identify(st.records.paper_twin()), width=7.2)
    >>> figure.savefig("overview.png")
    >>> figure.get_size_inches()[0].item()
    7.2
    """
    if is_of_driven(tree):
        # The motion of a driven record has no half periods.
        figure = driven_overview(tree, run, width=width)
        style.footnote(figure, held_out_sentence(tree))
        return figure
    record, of_discovery = tree[record_groups(tree)[run]].to_dataset(), kind_of(tree) == "discover"
    lines, results = drawn_models(tree, run)[0], _results(tree)
    curves = None
    with suppress(KeyError):
        curves = curves_of(tree, run)
    wide = width >= TWO_COLUMNS
    models = () if of_discovery else tuple(lines) or ("",)
    residuals = RESIDUAL_PANELS[: len(models)]
    usual, of_residual = (heights[not wide] for heights in (ROW_HEIGHT, RESIDUAL_HEIGHT))
    most = max((result.sizes["force"] for result in results.values()), default=0)
    # A row has room for three coefficients.
    of_coefficients = usual + 0.25 * max(0, most - 3)
    rows = {"IJ": usual} if curves else {}
    rows |= {"AA": usual, **{name * 2: of_residual for name in residuals}, "CD": usual}
    rows |= {"EF" if wide and not of_discovery else "EE": of_coefficients}
    rows |= {} if wide or of_discovery else {"FF": usual}
    with mpl.rc_context({"font.size": FONT_SIZE, "axes.titlesize": FONT_SIZE + 0.5}):
        figure = new_figure(width, sum(rows.values()))
        panels = figure.subplot_mosaic(";".join(rows), height_ratios=list(rows.values()))
        draw_in_time([panels["A"], *(panels[name] for name in residuals)], tree, run, models)
        if curves is not None:
            for panel, name in zip("IJ", CURVE_LABELS, strict=True):
                draw_curve(panels[panel], curves[0], name, curves[1])
        main = next(reversed(list(results.values())), None)
        weighed = None if main is None else _weighed(main, record)
        units = signal_units(record)
        _shares(panels["C"], weighed, "decay_share", f"amplitude ({units})", "share of decay (%)")
        _shares(panels["D"], weighed, "frequency_share", f"amplitude ({units})", "share of shift (%)")
        _coefficients(panels["E"], results, lines, units)
        titles = [""] * len(panels)
        if "F" in panels:
            # A model that failed has no weights, but its residual can be shown.
            place = "right" if wide else "bottom"
            if main is None:
                _surface(panels["F"], last_of(tree), record[["angle"]], run, place)
            else:
                _surface(panels["F"], main, record.sel(model=[*results][-1]), run, place)
            titles[-1] = MISSING_TITLE
        style.letter(panels.values(), titles, fontsize=FONT_SIZE + 0.5)
        style.footnote(figure, held_out_sentence(tree))
        if not follows(tree):
            figure.suptitle(EFFECTIVE_TITLE, fontsize=FONT_SIZE, color="0.3")
    return figure


def _results(tree: xr.DataTree) -> Mapping[str, xr.Dataset]:
    """Return the identifications shown, the main one last."""
    if kind_of(tree) == "discover":
        return {"final model": tree["after"].to_dataset()}
    if kind_of(tree) == "compare":
        best = tree["comparison"].attrs["best"]
        return {best: tree[best].to_dataset()}
    results = kept_results(tree).items()
    return dict(sorted(results, key=lambda pair: pair[0] == preferred_of(tree)))


def _weighed(result: xr.Dataset, record: xr.Dataset) -> xr.Dataset | None:
    """Return weights of the forces at a decay's amplitudes, with their times; None if there are none."""
    with suppress(SysidTribError):
        halves = envelope(record[["angle"]]).sortby("amplitude")
        amplitude = halves.amplitude.values
        # `t` of a formula is the time since the first sample.
        elapsed = (halves.instant_time - float(record.time[0])).values
        drawn = np.linspace(float(amplitude[0]), float(amplitude[-1]), 60)
        return weights(result, drawn, time=np.interp(drawn, amplitude, elapsed))
    return None


def _shares(ax: Axes, weighed: xr.Dataset | None, quantity: str, *labels: str) -> None:
    """Draw the share of each force with a band of one standard error, against amplitude."""
    if weighed is None or not np.isfinite(weighed[quantity].values).any():
        style.no_data(ax, "no force acts here")
        return
    draw_weights(ax, weighed, quantity, factor=100.0, zeros=False)
    low, high = ax.get_ylim()
    # Errors of shares may exceed the possible range of a share.
    ax.set(xlabel=labels[0], ylabel=labels[1], ylim=(max(low, -110.0), min(high, 110.0)))


def _coefficients(
    ax: Axes, results: Mapping[str, xr.Dataset], lines: Mapping[str, style.Style], units: str
) -> None:
    """Draw the coefficients over the values of the main identification, with 95 % intervals and numbers."""
    if not results:
        style.no_data(ax, style.ALL_FAILED)
        return
    main = list(results.values())[-1]
    symbols = main.force.values.tolist()
    # A single result is drawn like the second of two.
    usual = style.MODEL_LINES[2 - len(results) :]
    note: dict[str, Any] = {"ha": "right", "va": "center", "fontsize": FONT_SIZE - 1}
    for at, ((name, result), look) in enumerate(zip(results.items(), usual, strict=False)):
        color, shift = lines.get(name, look)["color"], 0.3 * (at - 0.5 * (len(results) - 1))
        ax.plot([], [], "o-", markersize=3, linewidth=1.0, color=color, label=name)
        for row, symbol in enumerate(symbols):
            scale = main.coefficient.sel(force=symbol).item()
            if symbol in result.force and scale != 0.0:
                of_force = result.sel(force=symbol)
                error = HALF_INTERVAL * abs(of_force.standard_error.item() / scale)
                _interval(ax, of_force.coefficient.item() / scale, error, row + shift, color)
    for row, symbol in enumerate(symbols):
        of_force = main.sel(force=symbol)
        text = value_with_error(of_force.coefficient.item(), of_force.standard_error.item())
        unit = style.short_unit(of_force.unit.item(), units)[0]
        written = ax.text(0.99, row, f"{text}{unit}", transform=ax.get_yaxis_transform(), **note)
        written.set_bbox(style.WHITE)
    ax.axvline(0.0, color="0.6", linewidth=0.6, linestyle=":")
    ax.axvline(1.0, color="0.85", linewidth=0.6, zorder=0)
    style.name_rows(ax, [style.in_latex(symbol) for symbol in symbols])
    ax.set(xlim=(COEFFICIENT_RANGE[0], END_OF_NUMBERS), xticks=[0, 1, 2], ylim=(len(symbols) - 0.4, -0.7))
    ax.set_xlabel(f"coefficient over its value, 95 % intervals{style.short_unit('', units)[1]}")
    ax.legend(ncols=2, **LEGEND)


def _interval(ax: Axes, value: float, error: float, row: float, color: Any) -> None:
    """Draw a value with its interval, or an arrow if the interval leaves the drawn range."""
    low, high = COEFFICIENT_RANGE
    ends = np.array([value - error, value + error])
    style.interval(ax, row, value, np.abs(ends.clip(low, high) - value)[:, None], (low, high), color=color)
    for end in ends if low <= value <= high else ():
        tip = "<" if end < low else ">" if end > high else "|"
        ax.plot(np.clip(end, low, high), row, tip, clip_on=False, color=color, markersize=3)


def _surface(ax: Axes, result: xr.Dataset, record: xr.Dataset, run: int, bar_at: str) -> None:
    """Draw the mean missing force over angle and rate, with dots if it exceeds three standard errors."""
    units = signal_units(record)
    factor, unit = small_units(units)
    try:
        missing = residual_force(record, result, run)
    except SysidTribError:
        style.no_data(ax, TOO_FEW)
        return
    force, error = (factor * missing[name] for name in ("force", "force_standard_error"))
    # Cells with noise only stay pale.
    largest, noise = (np.nanpercentile(np.abs(part.values), COLOUR_PERCENT) for part in (force, error))
    mesh = draw_cells(ax, force, error, float(max(largest, DOT_BEYOND * noise)) or 1.0)
    bar = ax.figure.colorbar(mesh, ax=ax, extend="both", pad=0.02, location=bar_at)
    bar.set_label(f"force over $I\\omega^2$ ({unit})")
    symbol = signal_symbol(units)
    ax.set(xlabel=f"{signal_label(units).split()[0]} ${symbol}$ ({units})")
    ax.set(ylabel=rf"$\dot{{{symbol}}}/\omega$ ({units})")
