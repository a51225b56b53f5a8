"""Figures of Le Bot et al. 2019: motions, envelopes, frequency shifts, half-sines, weights."""

from collections.abc import Mapping
from itertools import cycle
from typing import Any, Literal

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from numpy.typing import NDArray

from sysid_trib.plots import style
from sysid_trib.plots.motion_panels import RECORD_POINTS, curve
from sysid_trib.results.variables import signal_label, signal_symbol, signal_units

# Points of a half-sine.
ARC_POINTS = 40


def frequency_shift(
    measured: Mapping[str, xr.Dataset], predicted: Mapping[str, xr.Dataset], ax: Axes | None = None
) -> Axes:
    """Frequency against amplitude: half periods as marks, averaged models as lines (Figs. 3, 4, 5 and 10).

    Parameters
    ----------
    measured : mapping of str to xr.Dataset
        By label, `amplitude(instant)` in rad and `frequency(instant)` in rad/s of `envelope`.
    predicted : mapping of str to xr.Dataset
        By label, `amplitude(time)` and `frequency(time)` of `predict_envelope`. A model with the label of
        a measurement has its colour.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.
    """
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
    ax.legend(ncols=4, **style.LEGEND)
    return ax


def motions(
    record: xr.Dataset,
    models: Mapping[str, xr.Dataset] | None = None,
    ax: Axes | None = None,
    *,
    half_periods: xr.Dataset | None = None,
) -> Axes:
    """A record, and the motions or the averaged envelopes of models, or its half-sines (Figs. 2, 6 and 7).

    Parameters
    ----------
    record : xr.Dataset
        `angle(time)` in rad.
    models : mapping of str to xr.Dataset
        By label, `angle(time)` of `simulate`, or `amplitude(time)` of `predict_envelope`.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.
    half_periods : xr.Dataset, optional
        `envelope` of the whole decay: half-sines are drawn on the record, a few half periods of it
        (`decay.sel(time=slice(0, 1.5))`), and what three of them give at t_i.
    """
    ax = style.axes(ax)
    curve(ax, record.time.values, record.angle.values, RECORD_POINTS)
    if half_periods is not None:
        _half_sines(ax, record, half_periods)
    for (label, motion), series in zip((models or {}).items(), cycle(style.SERIES)):
        look = style.line(series) | {"label": label, "linewidth": 0.9}
        if "angle" in motion:
            curve(ax, motion.time.values, motion.angle.values, look)
            continue
        for sign in (1.0, -1.0):
            curve(ax, motion.time.values, sign * motion.amplitude.values, look)
            look |= {"label": ""}
    ax.set(xlabel="time (s)", ylabel=_signal(record), xlim=_ends(record))
    ax.legend(ncols=4, **style.LEGEND)
    return ax


def weights(
    weighed: xr.Dataset,
    quantity: Literal["peak_force", "decay", "frequency_shift", "decay_share", "frequency_share"],
    ax: Axes | None = None,
) -> Axes:
    """How much each force weighs against amplitude, with bands of one standard error (Figs. 8 and 9).

    Parameters
    ----------
    weighed : xr.Dataset
        `weights` over a row of amplitudes; choose forces with `.sel(force=[...])`.
    quantity : str
        Which of its variables.
    ax : matplotlib.axes.Axes, optional
        Axes to draw on.
    """
    ax, attrs = style.axes(ax), weighed[quantity].attrs
    unit = "" if attrs["units"] == "1" else f" ({attrs['units']})"
    draw_weights(ax, weighed, quantity)
    of_amplitude = weighed.amplitude.attrs.get("units", "rad")
    ax.set(xlabel=f"amplitude $a$ ({of_amplitude})", ylabel=f"{attrs['long_name']}{unit}")
    return ax


def draw_weights(
    ax: Axes, weighed: xr.Dataset, quantity: str, *, factor: float = 1.0, zeros: bool = True
) -> None:
    """A variable of weights times a factor for each force, with a band; `zeros`: also where it has none."""
    a = weighed.amplitude.values
    for symbol, series in zip(weighed.force.values.tolist(), cycle(style.SERIES)):
        names = quantity, f"{quantity}_standard_error"
        value, error = (factor * weighed[name].sel(force=symbol).values for name in names)
        if zeros or np.any(np.abs(value) > 0.0):
            style.line_with_band(ax, a, value, error, series, style.in_latex(symbol))
    ax.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
    ax.set_xlim(a.min(), a.max())
    ax.legend(ncols=6, **style.LEGEND)


def _half_sines(ax: Axes, decay: xr.Dataset, half_periods: xr.Dataset) -> None:
    """Half-sines on a decay, and what three of them give at t_i."""
    t, b = half_periods.extremum_time.values, (half_periods.sign * half_periods.extremum).values
    # The first and last half period have no neighbours; they take the frequency of the next.
    w = np.pad(half_periods.frequency.values, 1, mode="edge")
    low, high = _ends(decay)
    whole = np.flatnonzero((t - 0.5 * np.pi / w > low) & (t + 0.5 * np.pi / w < high))
    phase = np.linspace(-0.5 * np.pi, 0.5 * np.pi, ARC_POINTS)
    arcs = t[whole, None] + phase / w[whole, None], b[whole, None] * np.cos(phase)
    # Arcs do not join: each is a fit of its own.
    broken = [np.pad(arc, ((0, 0), (0, 1)), constant_values=np.nan).ravel() for arc in arcs]
    ax.plot(*broken, label="half-sines", **style.line(style.SERIES[1]))
    points = style.mark(style.SERIES[0] | {"marker": "o"})
    ax.plot(t[whole], b[whole], label=r"$\pm b_i$ at $t_i$", linestyle="", **points)
    if len(whole) >= 3:
        _construction(ax, t[whole[:3]], b[whole[:3]])
    ax.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)


def _construction(ax: Axes, t: NDArray[np.float64], b: NDArray[np.float64]) -> None:
    """The chord of two extrema a period apart: its middle is a_i, its slope that of the amplitude."""
    side, middle = np.sign(b[0]), 0.5 * (b[0] + b[2])
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


def _signal(record: xr.Dataset) -> str:
    """Label of the axis of a record's signal, with its symbol."""
    units = signal_units(record)
    name, unit = signal_label(units).split(" ", 1)
    return f"{name} ${signal_symbol(units)}$ {unit}"


def _ends(record: xr.Dataset) -> tuple[float, float]:
    return float(record.time[0]), float(record.time[-1])
