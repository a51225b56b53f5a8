"""Motions over time: a record with its models; and the figures of Le Bot et al. 2019 (envelopes, weights)."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any, Literal

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from numpy.typing import NDArray

from sysid_trib import records
from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.plots import style
from sysid_trib.plots.figure import LEGEND
from sysid_trib.plots.style import MODEL_LINES, Style
from sysid_trib.records.drawn import drawn_samples
from sysid_trib.records.runs import RecordLike
from sysid_trib.results.effects import steps_taken, tied_name
from sysid_trib.results.judged import LAST_THIRD, failures, is_refitted, judged_of
from sysid_trib.results.kinds import kind_of
from sysid_trib.results.variables import record_groups, signal_label, signal_symbol, signal_units, small_units

# Number of effects named in a legend.
MOST_NAMES = 2
RECORD_POINTS: Style = {"label": "record", "marker": ".", "linestyle": "", "color": "0.6", "markersize": 2.5}


def held_out_sentence(tree: xr.DataTree, *, of_search: bool = False) -> str:
    """Describe the held-out part of the records; empty if there is none.

    Parameters
    ----------
    tree : xr.DataTree
        Result of a command; for `compare`, the figure shows the held-out part on grey.
    of_search : bool
        True for a figure of the search itself, which never uses the held-out part; the final models may be
        fitted to the whole records.
    """
    if kind_of(tree) != "discover":
        return "The part of the record on grey was held out." if kind_of(tree) == "compare" else ""
    held = str(tree.attrs["held_out"])
    held += " of the record" * (held == LAST_THIRD)
    if is_refitted(tree):
        return f"Held out of the search, {'and of these numbers' if of_search else 'then fitted'}: {held}."
    return f"Held out, and not in this figure: {held}."


def drawn_models(tree: xr.DataTree, run: int) -> tuple[dict[str, Style], dict[str, str]]:
    """Return the lines of a run's models that have a motion, and their common name in legends, by name.

    These are the models of a cross-check, the start and final model of a discovery, or the best of a
    comparison.
    """
    data = tree[record_groups(tree)[run]].to_dataset()
    kind = kind_of(tree)
    if kind == "discover":
        labels = {"before": "start model", "after": f"with {_effects(tree)}"}
    else:
        compared = kind == "compare"
        names = [tree["comparison"].attrs["best"]] if compared else judged_of(tree).model.values.tolist()
        labels = dict(zip(names, names, strict=True))
    # A model that diverged must not set the scale.
    failed = failures(tree) if kind in ("cross_check", "driven") else {}
    looks = MODEL_LINES[1:] if kind == "compare" else MODEL_LINES
    lines: dict[str, Style] = {}
    for name, look in zip(labels, looks, strict=False):
        there = name not in failed and name in data.get("model", ())
        if there and np.isfinite(data.simulated_angle.sel(model=name).values).all():
            lines[name] = look
    return lines, labels


def _effects(tree: xr.DataTree) -> str:
    """Return the first effects of the final model, each with the effects that it cannot be separated from."""
    names = [tied_name(step, 1) for step in steps_taken(tree)]
    names = [f"({name})" if " or " in name and len(names) > 1 else name for name in names]
    if len(names) > MOST_NAMES:
        return f"{', '.join(names[: MOST_NAMES - 1])} and {len(names) - MOST_NAMES + 1} more"
    return " and ".join(names) or "no effect"


def curve(ax: Axes, time: Array, values: Array, look: Style) -> None:
    """Draw a decimated curve over time."""
    shown = drawn_samples(values)
    ax.plot(time[shown], values[shown], **look)


def draw_in_time(panels: Sequence[Axes], tree: xr.DataTree, run: int, models: Sequence[str]) -> None:
    """Draw the record and, in a separate panel below for each model, its residual, on a common time axis.

    In a common panel, one residual would hide another where models agree.
    """
    data, (lines, labels) = tree[record_groups(tree)[run]].to_dataset(), drawn_models(tree, run)
    time = data.time.values
    angle = data.angle.values
    units = signal_units(data)
    motions_of = {name: data.simulated_angle.sel(model=name).values for name in lines}
    curve(panels[0], time, angle, RECORD_POINTS)
    for name, look in lines.items():
        curve(panels[0], time, motions_of[name], {"linewidth": 0.8, "label": labels[name], **look})
    if "holdout_start" in data:
        panels[0].axvspan(data.holdout_start.item(), time[-1], color="0.93", zorder=0)
    panels[0].set_ylabel(signal_label(units))
    # Above the panel: the oscillation leaves no free space inside.
    panels[0].legend(ncols=3, **LEGEND)
    factor, unit = small_units(units)
    width = 2.0 * factor * float(data.noise)
    for panel, model in zip(panels[1:], models, strict=True):
        if model in lines:
            look = {"linewidth": 0.6, **lines[model], "linestyle": "-"}
            curve(panel, time, factor * (angle - motions_of[model]), look)
        band = panel.axhspan(-width, width, color="0.85", zorder=0)
        panel.legend([band], ["± 2 noise levels"], **LEGEND)
        # The axis shows the names if there are several.
        name = model if len(labels) > 1 else "model"
        panel.set_ylabel(f"record \N{MINUS SIGN} {name} ({unit})")
        panel.sharex(panels[0])
    panels[0].set_xlim(time[0], time[-1])
    for panel in panels[:-1]:
        panel.tick_params(labelbottom=False)
    panels[-1].set_xlabel("time (s)")


def frequency_shift(
    measured: Mapping[str, xr.Dataset], predicted: Mapping[str, xr.Dataset], ax: Axes | None = None
) -> Axes:
    """Draw frequency against amplitude: half periods as marks, averaged models as lines (Figs. 3, 4, 5, 10).

    Parameters
    ----------
    measured : mapping of str to xr.Dataset
        By label: `amplitude(instant)` in rad and `frequency(instant)` in rad/s from `envelope`.
    predicted : mapping of str to xr.Dataset
        By label: `amplitude(time)` and `frequency(time)` from `predict_envelope`. A model with the same label
        as a measurement has the same colour.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.

    Examples
    --------
    >>> import sysid_trib as st
    >>> half_sines = st.envelope(st.records.paper_twin())
    >>> ax = st.plots.frequency_shift({"run": half_sines}, {})
    >>> ax.get_xlabel()
    'amplitude $a$ (rad)'
    """
    for shifts in (*measured.values(), *predicted.values()):
        if not {"amplitude", "frequency"} <= set(shifts.variables):
            raise UsageError(
                "plots.frequency_shift shows what envelope and predict_envelope return, by label: "
                "{'record': st.envelope(decay)}, and of models likewise."
            )
    ax = style.axes(ax)
    styles = dict(zip(dict.fromkeys([*measured, *predicted]), cycle(style.SERIES)))
    for label, shifts in measured.items():
        a, w, error = (shifts[k].values for k in ("amplitude", "frequency", "frequency_standard_error"))
        ax.plot(a, w, label=label, linestyle="", **style.mark(styles[label]))
        ax.errorbar(a, w, error, fmt="none", ecolor=styles[label]["color"], elinewidth=style.BAR_WIDTH)
    for label, shifts in predicted.items():
        named = "" if label in measured else label
        ax.plot(shifts.amplitude.values, shifts.frequency.values, label=named, **style.line(styles[label]))
    units = signal_units(next(iter({**measured, **predicted}.values()), xr.Dataset()))
    ax.set(xlabel=f"amplitude $a$ ({units})", ylabel=r"frequency $\omega$ (rad/s)", xlim=(0.0, None))
    ax.legend(ncols=4, **LEGEND)
    return ax


def motions(
    record: RecordLike,
    models: Mapping[str, xr.Dataset] | None = None,
    ax: Axes | None = None,
    *,
    half_periods: xr.Dataset | None = None,
) -> Axes:
    """Draw a record, and motions or averaged envelopes of models, or its half-sines (Figs. 2, 6 and 7).

    Parameters
    ----------
    record : record
        `angle(time)` in rad, or `(t, angle)`.
    models : mapping of str to xr.Dataset
        By label: `angle(time)` from `simulate`, or `amplitude(time)` from `predict_envelope`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.
    half_periods : xr.Dataset, optional
        `envelope` of the whole decay. Half-sines are drawn on the record, which should be a few half periods
        of it (`decay.sel(time=slice(0, 1.5))`), with the values that three of them give at t_i.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> record = st.records.paper_twin()
    >>> model = st.physics.model_of(st.identify(record, method="direct"))
    >>> ax = st.plots.motions(record, {"model": st.simulate(model, record.time, angle=0.3)})
    >>> ax.get_xlabel(), ax.get_legend_handles_labels()[1]
    ('time (s)', ['record', 'model'])
    """
    ax = style.axes(ax)
    measured = records.one_record(record, "motions")
    curve(ax, measured.time.values, measured.angle.values, RECORD_POINTS)
    if half_periods is not None:
        _half_sines(ax, measured, half_periods)
    for (label, motion), series in zip((models or {}).items(), cycle(style.SERIES)):
        look = style.line(series) | {"label": label, "linewidth": 0.9}
        if "angle" in motion:
            curve(ax, motion.time.values, motion.angle.values, look)
            continue
        for sign in (1.0, -1.0):
            curve(ax, motion.time.values, sign * motion.amplitude.values, look)
            look |= {"label": ""}
    units = signal_units(measured)
    name, unit = signal_label(units).split(" ", 1)
    ax.set(xlabel="time (s)", ylabel=f"{name} ${signal_symbol(units)}$ {unit}", xlim=_ends(measured))
    ax.legend(ncols=4, **LEGEND)
    return ax


def weights(
    weighed: xr.Dataset,
    quantity: Literal["peak_force", "decay", "frequency_shift", "decay_share", "frequency_share"],
    ax: Axes | None = None,
) -> Axes:
    """Draw the weight of each force against amplitude, with bands of one standard error (Figs. 8 and 9).

    Parameters
    ----------
    weighed : xr.Dataset
        `weights` at an array of amplitudes; choose forces with `.sel(force=[...])`.
    quantity : str
        Name of the variable that is drawn.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> weights = st.physics.weights(result, np.linspace(0.01, 0.3, 50))
    >>> ax = st.plots.weights(weights.sel(force=["zeta", "delta"]), "decay_share")
    >>> ax.get_xlabel()
    'amplitude $a$ (rad)'
    """
    if quantity not in weighed:
        raise UsageError(
            f"plots.weights shows {quantity} from physics.weights(result, amplitudes); give that, and "
            "peak_force, decay, frequency_shift, decay_share or frequency_share."
        )
    ax = style.axes(ax)
    attrs = weighed[quantity].attrs
    unit = "" if attrs["units"] == "1" else f" ({attrs['units']})"
    draw_weights(ax, weighed, quantity)
    of_amplitude = weighed.amplitude.attrs.get("units", "rad")
    ax.set(xlabel=f"amplitude $a$ ({of_amplitude})", ylabel=f"{attrs['long_name']}{unit}")
    return ax


def draw_weights(
    ax: Axes, weighed: xr.Dataset, quantity: str, *, factor: float = 1.0, zeros: bool = True
) -> None:
    """Draw a variable of weights times a factor for each force, with a band; `zeros`: also absent forces."""
    a = weighed.amplitude.values
    for symbol, series in zip(weighed.force.values.tolist(), cycle(style.SERIES)):
        names = quantity, f"{quantity}_standard_error"
        value, error = (factor * weighed[name].sel(force=symbol).values for name in names)
        if zeros or np.any(np.abs(value) > 0.0):
            ax.plot(a, value, label=style.in_latex(symbol), **style.line(series))
            band = {"color": series["color"], "alpha": 0.2, "linewidth": 0}
            ax.fill_between(a, value - error, value + error, **band)
    ax.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
    ax.set_xlim(a.min(), a.max())
    ax.legend(ncols=6, **LEGEND)


def _half_sines(ax: Axes, decay: xr.Dataset, half_periods: xr.Dataset) -> None:
    """Draw half-sines on a decay, and the extrema and times computed from three of them at t_i."""
    t = half_periods.extremum_time.values
    b = (half_periods.sign * half_periods.extremum).values
    # The first and last half period lack a neighbour and use the frequency of the next one.
    w = np.pad(half_periods.frequency.values, 1, mode="edge")
    low, high = _ends(decay)
    whole = np.flatnonzero((t - 0.5 * np.pi / w > low) & (t + 0.5 * np.pi / w < high))
    phase = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 40)
    arcs = t[whole, None] + phase / w[whole, None], b[whole, None] * np.cos(phase)
    # The arcs are not connected: each is a separate fit.
    broken = [np.pad(arc, ((0, 0), (0, 1)), constant_values=np.nan).ravel() for arc in arcs]
    ax.plot(*broken, label="half-sines", **style.line(style.SERIES[1]))
    points = style.mark(style.SERIES[0] | {"marker": "o"})
    ax.plot(t[whole], b[whole], label=r"$\pm b_i$ at $t_i$", linestyle="", **points)
    if len(whole) >= 3:
        _construction(ax, t[whole[:3]], b[whole[:3]])
    ax.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)


def _construction(ax: Axes, t: NDArray[np.float64], b: NDArray[np.float64]) -> None:
    """Draw the chord of two extrema a period apart: its middle is a_i, its slope that of the amplitude."""
    side = np.sign(b[0])
    middle = 0.5 * (b[0] + b[2])
    outside = 1.15 * b[1]
    ax.plot(t[[0, 2]], b[[0, 2]], color="black", linewidth=0.8)
    ax.plot(t[1], middle, "o", color="black", markersize=3.5)
    vertical = ("bottom", "top") if side > 0 else ("top", "bottom")
    text: dict[str, Any] = {"textcoords": "offset points", "ha": "center"}
    ax.annotate(r"$a_i$, slope $\dot a_i$", (t[1], middle), (0, 5 * side), va=vertical[0], **text)
    for end in (0, 2):
        ax.plot([t[end], t[end]], [b[end], outside], color="0.5", linewidth=0.6, linestyle=":")
    arrow = {"arrowstyle": "<->", "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (t[0], outside), (t[2], outside), arrowprops=arrow)
    ax.annotate(r"$2\pi/\omega_i$", (t[1], outside), (0, -4 * side), va=vertical[1], **text)
    room = 1.4 * np.abs(b).max()
    ax.set_ylim(-room, room)


def _ends(record: xr.Dataset) -> tuple[float, float]:
    return float(record.time[0]), float(record.time[-1])
