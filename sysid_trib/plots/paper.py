"""Figures of Le Bot et al. 2019 from results: envelopes, frequency shifts, half-sines, motions, weights."""

from collections.abc import Mapping
from itertools import cycle
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.plots.style import LEGEND, MARKS, SERIES, axes, in_latex, line, mark, thinning

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Room in a legend above the panel.
CLOSE: dict[str, Any] = {"columnspacing": 1.2, "handletextpad": 0.5}
# Points of a half-sine.
ARC = 40


def averaged_decay(motion: xr.Dataset, predicted: xr.Dataset, ax: "Axes | None" = None) -> "Axes":
    """A motion and its averaged envelope (the paper's Fig. 2).

    Parameters
    ----------
    motion : `angle(time)` in rad, of `simulate` or a decay.
    predicted : `amplitude(time)` in rad, of `predict_envelope`.
    """
    ax = axes(ax)
    _curve(ax, motion, {"color": "0.4", "linewidth": 0.8, "label": "motion"})
    for sign, label in ((1.0, "averaged envelope"), (-1.0, "")):
        ax.plot(predicted.time.values, sign * predicted.amplitude.values, label=label, **line(SERIES[0]))
    ax.set(xlabel="time (s)", ylabel=r"angle $\theta$ (rad)", xlim=_ends(motion))
    ax.legend(ncols=2, **LEGEND, **CLOSE)
    return ax


def frequency_shift(
    measured: Mapping[str, xr.Dataset], predicted: Mapping[str, xr.Dataset], ax: "Axes | None" = None
) -> "Axes":
    """Frequency against amplitude: half periods as marks, averaged models as lines (Figs. 3, 4, 5 and 10).

    Parameters
    ----------
    measured : by label, `amplitude(instant)` in rad and `frequency(instant)` in rad/s of `envelope`.
    predicted : by label, `amplitude(time)` and `frequency(time)` of `predict_envelope`; one with the label of
        a measured one has its colour.
    """
    ax = axes(ax)
    styles = dict(zip(dict.fromkeys([*measured, *predicted]), cycle(SERIES)))
    for label, found in measured.items():
        a, w, error = (found[k].values for k in ("amplitude", "frequency", "frequency_standard_error"))
        ax.plot(a, w, label=label, linestyle="", **mark(styles[label]))
        ax.errorbar(a, w, error, fmt="none", ecolor=styles[label]["color"], elinewidth=MARKS["linewidth"])
    for label, found in predicted.items():
        told = "" if label in measured else label
        ax.plot(found.amplitude.values, found.frequency.values, label=told, **line(styles[label]))
    ax.set(xlabel="amplitude $a$ (rad)", ylabel=r"frequency $\omega$ (rad/s)", xlim=(0.0, None))
    ax.legend(ncols=4, **LEGEND, **CLOSE)
    return ax


def half_sines(decay: xr.Dataset, found: xr.Dataset, ax: "Axes | None" = None) -> "Axes":
    """Half-sines on a decay, and what three of them give at t_i (Fig. 6).

    Parameters
    ----------
    decay : `angle(time)` in rad, a few half periods of it: `decay.sel(time=slice(0, 1.5))`.
    found : `envelope` of the whole decay.
    """
    ax = axes(ax)
    ax.plot(decay.time.values, decay.angle.values, ".", color="0.6", markersize=3.5, label="record")
    t, b = found.extremum_time.values, (found.sign * found.extremum).values
    # The first and last half period have no neighbours; they take the frequency of the next.
    w = np.pad(found.frequency.values, 1, mode="edge")
    low, high = _ends(decay)
    whole = np.flatnonzero((t - 0.5 * np.pi / w > low) & (t + 0.5 * np.pi / w < high))
    phase = np.linspace(-0.5 * np.pi, 0.5 * np.pi, ARC)
    gap = np.full(len(whole), np.nan)
    arcs = t[whole, None] + phase / w[whole, None], b[whole, None] * np.cos(phase)
    # A gap between the arcs: each is a fit of its own.
    ax.plot(*(np.column_stack([arc, gap]).ravel() for arc in arcs), label="half-sines", **line(SERIES[1]))
    ax.plot(
        t[whole], b[whole], label=r"$\pm b_i$ at $t_i$", linestyle="", **mark(SERIES[0] | {"marker": "o"})
    )
    if len(whole) >= 3:
        _construction(ax, t[whole[:3]], b[whole[:3]])
    ax.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
    ax.set(xlabel="time (s)", ylabel=r"angle $\theta$ (rad)", xlim=(low, high))
    ax.legend(ncols=3, **LEGEND, **CLOSE)
    return ax


def motions(record: xr.Dataset, models: Mapping[str, xr.Dataset], ax: "Axes | None" = None) -> "Axes":
    """A record and the motions of models (Fig. 7).

    Parameters
    ----------
    record : `angle(time)` in rad.
    models : by label, `angle(time)` of `simulate`.
    """
    ax = axes(ax)
    step = thinning(record.sizes["time"])
    time, angle = (record[name].values[::step] for name in ("time", "angle"))
    ax.plot(time, angle, ".", color="0.6", markersize=2.5, label="record")
    for (label, motion), series in zip(models.items(), cycle(SERIES)):
        _curve(ax, motion, line(series) | {"label": label, "linewidth": 0.9})
    ax.set(xlabel="time (s)", ylabel=r"angle $\theta$ (rad)", xlim=_ends(record))
    ax.legend(ncols=4, **LEGEND, **CLOSE)
    return ax


def weights(
    found: xr.Dataset,
    quantity: Literal["peak_force", "decay", "frequency_shift", "decay_share", "frequency_share"],
    ax: "Axes | None" = None,
) -> "Axes":
    """How much each force weighs against amplitude, with bands of one standard error (Figs. 8 and 9).

    Parameters
    ----------
    found : `weights` over a row of amplitudes; choose forces with `.sel(force=[...])`.
    quantity : which of its variables.
    """
    ax = axes(ax)
    a = found.amplitude.values
    for symbol, series in zip(found.force.values.tolist(), cycle(SERIES)):
        value, error = (found[k].sel(force=symbol).values for k in (quantity, f"{quantity}_standard_error"))
        ax.plot(a, value, label=in_latex(symbol), **line(series))
        ax.fill_between(a, value - error, value + error, color=series["color"], alpha=0.25, linewidth=0)
    told = found[quantity].attrs
    unit = "" if told["units"] == "1" else f" ({told['units']})"
    ax.axhline(0.0, color="0.8", linewidth=0.6, zorder=0)
    ax.set(xlabel="amplitude $a$ (rad)", ylabel=f"{told['long_name']}{unit}", xlim=(a.min(), a.max()))
    ax.legend(ncols=6, **LEGEND, **CLOSE)
    return ax


def _construction(ax: "Axes", t: NDArray[np.float64], b: NDArray[np.float64]) -> None:
    """The chord of two extrema a period apart: its middle is a_i, its slope that of the amplitude."""
    side, middle = np.sign(b[0]), 0.5 * (b[0] + b[2])
    beyond = 1.15 * b[1]
    ax.plot(t[[0, 2]], b[[0, 2]], color="black", linewidth=0.8)
    ax.plot(t[1], middle, "o", color="black", markersize=3.5)
    told: dict[str, Any] = {
        "textcoords": "offset points",
        "ha": "center",
        "va": "bottom" if side > 0 else "top",
    }
    ax.annotate(r"$a_i$, slope $\dot a_i$", (t[1], middle), (0, 5 * side), **told)
    for end in (0, 2):
        ax.plot([t[end], t[end]], [b[end], beyond], color="0.5", linewidth=0.6, linestyle=":")
    arrow = {"arrowstyle": "<->", "linewidth": 0.8, "shrinkA": 0, "shrinkB": 0}
    ax.annotate("", (t[0], beyond), (t[2], beyond), arrowprops=arrow)
    ax.annotate(
        r"$2\pi/\omega_i$", (t[1], beyond), (0, -4 * side), **told | {"va": "top" if side > 0 else "bottom"}
    )
    room = 1.4 * np.abs(b).max()
    ax.set_ylim(-room, room)


def _curve(ax: "Axes", motion: xr.Dataset, style: Mapping[str, Any]) -> None:
    step = thinning(motion.sizes["time"])
    ax.plot(motion.time.values[::step], motion.angle.values[::step], **style)


def _ends(record: xr.Dataset) -> tuple[float, float]:
    return float(record.time[0]), float(record.time[-1])
