"""Predicted motions: innovations and bands, the forced response, the information of a next run."""

from typing import Any

import numpy as np
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sysid_trib.plots import style
from sysid_trib.plots.figure import FULL_WIDTH, LEGEND, new_figure, shows
from sysid_trib.plots.over_time import curve
from sysid_trib.plots.style import BAR_WIDTH, BLUE, GREY, INK, ORANGE
from sysid_trib.results.variables import CONFIDENCE, HALF_INTERVAL, signal_units, small_units

BAND_NAME, BAND_COLOR = f"{100.0 * CONFIDENCE:g} % band", "0.85"
SWEEP_LINES: dict[str, dict[str, Any]] = {
    "down": {"color": BLUE, "linestyle": "-"},
    "up": {"color": ORANGE, "linestyle": "--"},
    "unstable": {"color": GREY, "linestyle": ":"},
}
SIMULATED: dict[str, Any] = style.OPEN_MARKS | {"color": INK, "marker": "o", "linestyle": "", "zorder": 4}


@shows("cross_check", block="Random force", groups=("innovations", "prediction_bands"))
def innovations(data: xr.Dataset, bands: xr.Dataset | None = None, *, width: float = FULL_WIDTH) -> Figure:
    """Errors of one-step predictions, and their autocorrelation with the band of white noise.

    Below, the smoothed random force over time, and the record minus its predictions, which start at several
    instants, with 95 % bands.

    Parameters
    ----------
    data : xr.Dataset
        Result of `innovations`.
    bands : xr.Dataset, optional
        Result of `prediction_bands`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import sysid_trib as st
    >>> decay = st.free_decay(st.records.paper_twin())
    >>> errors = st.validation.innovations(decay, st.identify(decay, method="direct"))
    >>> figure = st.plots.innovations(errors)
    >>> [ax.get_ylabel() for ax in figure.axes]
    ['innovation (mrad)', 'autocorrelation', 'random force (rad/s²)']
    """
    # Innovations, autocorrelation, random force, predictions.
    heights = (2.3, 1.8, 2.1, 2.3)[: 3 + (bands is not None)]
    figure = new_figure(width, sum(heights))
    panels = figure.subplots(len(heights), 1, height_ratios=heights)
    _in_time(panels[0], data)
    _autocorrelation(panels[1], data)
    _random_force(panels[2], data)
    if bands is not None:
        _prediction_bands(panels[3], bands)
    style.letter(panels)
    return figure


def _prediction_bands(ax: Axes, data: xr.Dataset) -> None:
    factor, unit = small_units(signal_units(data))
    error = factor * HALF_INTERVAL * data.predicted_standard_error
    missed = factor * (data.measured - data.predicted)
    for at in range(data.sizes["origin"]):
        time, width = data.time_ahead.values[at], error.values[at]
        band = ax.fill_between(time, -width, width, color=BAND_COLOR, linewidth=0)
        look: dict[str, Any] = {"color": ORANGE, "marker": ".", "markersize": 2, "linewidth": 0.8}
        (line,) = ax.plot(time, missed.values[at], **look)
        ax.axvline(float(data.origin[at]), color=INK, linewidth=BAR_WIDTH, linestyle=":")
    ax.axhline(0.0, color=INK, linewidth=BAR_WIDTH, zorder=1)
    ax.set(xlabel="time (s)", ylabel=f"record \N{MINUS SIGN} prediction ({unit})")
    ax.legend([line, band], ["record", f"{BAND_NAME} of the prediction"], ncols=2, **LEGEND)


def _random_force(ax: Axes, data: xr.Dataset) -> None:
    """Draw the smoothed random force over time, with its band."""
    force, error = data.random_force.values, HALF_INTERVAL * data.random_force_standard_error.values
    # First samples of the intervals of constant force, which define the whole curve, and the last sample.
    first = np.append(np.flatnonzero(np.diff(force, prepend=np.nan) != 0.0), len(force) - 1)
    time, force, error = data.time.values[first], force[first], error[first]
    look: dict[str, Any] = {"step": "post", "color": BAND_COLOR, "linewidth": 0}
    band = ax.fill_between(time, force - error, force + error, **look)
    (line,) = ax.step(time, force, where="post", color=BLUE, linewidth=0.8)
    ax.axhline(0.0, color=INK, linewidth=BAR_WIDTH, zorder=1)
    ax.set(xlabel="time (s)", ylabel=f"random force ({signal_units(data)}/s²)", xlim=(time[0], time[-1]))
    ax.legend([line, band], [f"mean over {float(data.averaging_time):.2g} s", BAND_NAME], ncols=2, **LEGEND)


def _in_time(ax: Axes, data: xr.Dataset) -> None:
    factor, unit = small_units(signal_units(data))
    time, innovation = data.time.values, factor * data.innovation.values
    width = factor * HALF_INTERVAL * data.innovation_standard_deviation.values
    band = ax.fill_between(time, -width, width, color=BAND_COLOR, linewidth=0)
    curve(ax, time, innovation, {"color": BLUE, "marker": ".", "markersize": 1.5, "linestyle": ""})
    # The first samples determine the start: their band is wider than all later ones.
    largest = 1.1 * max(np.abs(innovation).max(), float(np.median(width)))
    ax.set(xlabel="time (s)", ylabel=f"innovation ({unit})")
    ax.set(xlim=(time[0], time[-1]), ylim=(-largest, largest))
    ax.legend([band], [BAND_NAME], **LEGEND)


def _autocorrelation(ax: Axes, data: xr.Dataset) -> None:
    width = HALF_INTERVAL / np.sqrt(data.sizes["time"])
    band = ax.axhspan(-width, width, color=BAND_COLOR, zorder=0)
    look: dict[str, Any] = {"linefmt": BLUE, "markerfmt": "o", "basefmt": " "}
    marks = ax.stem(data.lag.values, data.autocorrelation.values, **look)
    marks.markerline.set(markersize=3.5, color=BLUE)
    marks.stemlines.set_linewidth(1.0)
    ax.axhline(0.0, color=INK, linewidth=BAR_WIDTH)
    largest = max(1.2 * float(np.abs(data.autocorrelation).max()), 2.0 * width)
    ax.set(xlabel="lag (samples)", ylabel="autocorrelation", ylim=(-largest, largest))
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.legend([band], [f"{BAND_NAME} of white noise"], **LEGEND)


@shows("response")
def response(data: xr.Dataset, *, width: float = FULL_WIDTH) -> Figure:
    """Amplitude with its 95 % band, and phase, against frequency; marks are simulated motions.

    Parameters
    ----------
    data : Dataset
        Result of `forced_response`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> response = st.forced_response(result, drive=0.003, frequencies=np.linspace(9.0, 10.5, 61))
    >>> [ax.get_xlabel() for ax in st.plots.response(response).axes]
    ['frequency (rad/s)', 'frequency (rad/s)']
    """
    figure, panels = style.grid(2, 2, width, row_height=2.8)
    amplitude, phase = panels
    w, unit = data.frequency.values, data.amplitude.attrs["units"]
    for sweep, look in SWEEP_LINES.items():
        motions = data.sel(sweep=sweep)
        if not motions.amplitude.notnull().any():
            continue
        ends = motions.amplitude_low.values, motions.amplitude_high.values
        amplitude.fill_between(w, *ends, color=look["color"], alpha=0.2, linewidth=0)
        label = "unstable" if sweep == "unstable" else f"sweep {sweep}"
        amplitude.plot(w, motions.amplitude, linewidth=1.0, label=label, **look)
        phase.plot(w, np.unwrap(np.nan_to_num(motions.phase)) + 0.0 * motions.phase, linewidth=1.0, **look)
    amplitude.plot(data.check_frequency, data.simulated_amplitude, label="simulated", **SIMULATED)
    amplitude.set(
        xlabel="frequency (rad/s)", ylabel=f"amplitude ({style.unit_label(unit)})", ylim=(0.0, None)
    )
    phase.set(xlabel="frequency (rad/s)", ylabel="phase (rad)")
    amplitude.legend(**LEGEND, ncols=2)
    style.letter(panels)
    return figure


@shows("plan")
def plan(data: xr.Dataset, *, width: float = FULL_WIDTH) -> Figure:
    """Expected entropy of the models, and errors, after each run, against its release.

    A horizontal line shows the required error. Without one, and with a single model, the figure shows the
    largest ratio of an error to its smallest value. With several models, the last panel shows the log
    likelihood ratio of two of them over time.

    Parameters
    ----------
    data : Dataset
        Result of `validation.plan`.
    width : float, inch
        Width of the figure; a column of a journal is 88 mm (3.46) wide.

    Examples
    --------
    >>> import sysid_trib as st
    >>> runs = st.plan(st.identify(st.records.paper_twin()), wanted={"epsilon": 0.002})
    >>> [ax.get_xlabel() for ax in st.plots.plan(runs).axes]
    ['release (rad)']
    """
    drawn = {"remaining entropy (nat)": data.entropy} if "parting" in data else {}
    wanted = data.wanted.to_series().dropna().to_dict()
    limits = {f"error of {style.in_latex(symbol)}": error for symbol, error in wanted.items()}
    errors = [data.standard_error.sel(force=symbol) for symbol in wanted]
    drawn |= dict(zip(limits, errors, strict=True))
    if not drawn:
        drawn["largest error / smallest"] = (data.standard_error / data.standard_error.min("run")).max(
            "force"
        )
    figure, panels = style.grid(len(drawn) + ("parting" in data), 2, width, row_height=2.4)
    for panel, (name, values) in zip(panels, drawn.items(), strict=False):
        _against_release(panel, data.assign(shown=values))
        panel.set_ylabel(name)
        if name in limits:
            style.threshold(panel, limits[name], f"wanted: {limits[name]:g}")
            panel.set_yscale("log")
            style.logarithmic_ticks(panel.yaxis, *panel.get_ylim())
    panels[0].legend(**LEGEND, ncols=3)
    titles = [""] * len(panels)
    if "parting" in data:
        odds = np.log(data.attrs["odds"])
        top = 1.15 * max(odds, float(data.parting.max()))
        panels[-1].plot(data.time, data.parting, color=INK, linewidth=1.0)
        panels[-1].set(xlabel="time (s)", ylabel="log likelihood ratio", ylim=(0.0, top))
        style.threshold(panels[-1], odds, f"odds of {data.attrs['odds']:g} to 1")
        titles[-1] = " or ".join(data.parting.attrs["models"])
    if len(panels) > 1:
        style.letter(panels, titles)
    return figure


def _against_release(ax: Axes, data: xr.Dataset) -> None:
    """Draw the shown quantity of each run, one line per duration, and a ring around the best run."""
    durations = np.unique(data.duration.values)
    for at, length in enumerate(durations):
        rows = data.isel(run=np.flatnonzero(data.duration.values == length)).sortby("amplitude")
        shade = str(0.75 * (1.0 - (at + 1) / len(durations)))
        ax.plot(rows.amplitude, rows.shown, color=shade, marker="o", markersize=3, label=f"{length:.3g} s")
    ring: dict[str, Any] = {"color": ORANGE, "marker": "o", "fillstyle": "none", "linestyle": ""}
    ax.plot(data.amplitude[0], data.shown[0], **ring, markersize=7, label="best")
    ax.set_xlabel(f"release ({data.amplitude.attrs['units']})")
