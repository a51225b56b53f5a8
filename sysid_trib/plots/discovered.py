"""Figures of a discovery: the gap before and after, and where in a cycle it asks for a force."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.decays.half_sines import envelope as half_sine_envelope
from sysid_trib.errors import SysidTribError
from sysid_trib.plots.style import LEGEND, LINES, axes, half_periods, logarithmic_amplitude, thinning
from sysid_trib.results.per_run import noise_of_run, record_groups

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh
    from matplotlib.figure import Figure

MODELS = dict(zip(("before", "after"), LINES, strict=True))
# Cells of fewer samples say nothing; colours end where so many percent of the cells lie within.
FEW = 5
WITHIN = 98.0
# A dot marks cells of so many standard errors.
BEYOND = 3.0


def discovery(tree: xr.DataTree, run: int = 0) -> "Figure":
    """Record, what the models before and after leave of it, envelope, and frequency against amplitude.

    Parameters
    ----------
    tree : result of `discover`.
    run : which of several runs, from 0.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 8.8), layout="constrained")
    panels = figure.subplot_mosaic("AA;BB;CC;DE", height_ratios=[1.2, 0.8, 0.8, 1.2])
    _record(tree, panels["A"], run)
    for place, model in (("B", "before"), ("C", "after")):
        _residual(tree, panels[place], run, model)
        panels[place].sharex(panels["A"])
    for place in "AB":
        panels[place].set_xlabel("")
        panels[place].tick_params(labelbottom=False)
    _envelope(tree, panels["D"], run)
    _frequency(tree, panels["E"], run)
    for label, panel in zip("abcde", panels.values(), strict=True):
        panel.set_title(f"({label})", loc="left", fontsize=9)
    return figure


def disagreement(tree: xr.DataTree) -> "Figure":
    """The disagreement map before and after, in the same colours; dots: beyond three standard errors.

    Parameters
    ----------
    tree : result of `discover`.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.2, 3.3), layout="constrained")
    first, second = figure.subplots(1, 2, sharex=True, sharey=True)
    for label, panel, model in (("a", first, "before"), ("b", second, "after")):
        mesh = _mapped(tree, panel, after=model == "after")
        panel.set_title(f"({label}) {model}", loc="left", fontsize=9)
    second.set_ylabel("")
    _with_bar(figure, mesh, [first, second])
    return figure


def disagreement_map(tree: xr.DataTree, ax: "Axes | None" = None, *, after: bool = False) -> "Axes":
    """Mean force that the gap asks for over angle and rate, f in theta'' + w^2 theta = -w^2 f (rad).

    Dots mark what is beyond three standard errors of the noise.

    Parameters
    ----------
    tree : result of `discover`.
    after : of the final model, in the colours of the start model.
    """
    ax = axes(ax)
    _with_bar(ax.figure, _mapped(tree, ax, after), ax)
    return ax


def _mapped(tree: xr.DataTree, ax: "Axes", after: bool) -> "QuadMesh":
    from matplotlib.colors import TwoSlopeNorm

    force, error, limit = missing_force(tree, after=after)
    norm = TwoSlopeNorm(0.0, -limit, limit)
    mesh = ax.pcolormesh(
        force.x.values,
        force.v.values,
        force.values.T,
        cmap="RdBu_r",
        norm=norm,
        shading="nearest",
        rasterized=True,
    )
    beyond = np.argwhere(np.abs(force.values) > BEYOND * error.values)
    dots = force.x.values[beyond[:, 0]], force.v.values[beyond[:, 1]]
    ax.plot(*dots, ".", color="black", markersize=2.5, label=f"beyond {BEYOND:g} standard errors")
    ax.legend(**LEGEND)
    ax.set(xlabel=r"angle $\theta$ (rad)", ylabel=r"$\dot\theta/\omega$ (rad)", aspect="equal")
    return mesh


def missing_force(tree: xr.DataTree, *, after: bool) -> tuple[xr.DataArray, xr.DataArray, float]:
    """Force that the gap asks for (over I w^2, mrad, nan of few samples), its error, where colours end."""
    before, found = (tree[name].to_dataset() for name in ("discrepancy", "discrepancy_after"))
    kept = np.abs(before.force.values[before.samples.values >= FEW])
    limit = 1e3 * float(np.percentile(kept[np.isfinite(kept)], WITHIN)) if np.isfinite(kept).any() else 1.0
    shown = found if after else before
    force = (1e3 * shown.force).where(shown.samples >= FEW)
    return force, 1e3 * shown.standard_error, limit


def _with_bar(figure: Any, mesh: "QuadMesh", panels: Any) -> None:
    bar = figure.colorbar(mesh, ax=panels, extend="both", shrink=0.9)
    bar.set_label(r"missing $f$ in $\ddot\theta + \omega^2\theta = -\omega^2 f$ (mrad)")


def _record(tree: xr.DataTree, ax: "Axes", run: int) -> None:
    data = tree[record_groups(tree)[run]].ds
    step = thinning(data.sizes["time"])
    time = data.time.values[::step]
    ax.plot(time, data.angle.values[::step], ".", color="0.6", markersize=2.5, label="record")
    for name, line in MODELS.items():
        moved = data.simulated_angle.sel(model=name).values[::step]
        ax.plot(time, moved, linewidth=0.8, label=f"model {name}", **line)
    ax.set(xlabel="time (s)", ylabel="angle (rad)", xlim=(time[0], time[-1]))
    ax.legend(ncols=3, **LEGEND)


def _residual(tree: xr.DataTree, ax: "Axes", run: int, model: str) -> None:
    data = tree[record_groups(tree)[run]].ds
    step = thinning(data.sizes["time"])
    time = data.time.values[::step]
    gap = (data.angle - data.simulated_angle.sel(model=model)).values[::step]
    noise = 1e3 * noise_of_sample(tree, run)
    band = ax.axhspan(-2 * noise, 2 * noise, color="0.85", zorder=0)
    ax.plot(time, 1e3 * gap, linewidth=0.5, color=MODELS[model]["color"])
    ax.legend([band], ["± 2 noise levels"], **LEGEND)
    ax.set(xlabel="time (s)", ylabel=f"record \N{MINUS SIGN} model\n{model} (mrad)")


def noise_of_sample(tree: xr.DataTree, run: int) -> float:
    """Noise of one sample of a run, rad: an identification has the noise of its innovations."""
    after = tree["after"].to_dataset()
    return float(noise_of_run(after, run) * tree["holdout"].noise.item() / after.noise.item())


def _envelope(tree: xr.DataTree, ax: "Axes", run: int) -> None:
    for name, style, found in _envelopes(tree, run):
        time, a = found.instant_time.values, found.amplitude.values
        if name == "record":
            half_periods(ax, time, a, found.amplitude_standard_error.values)
            low, high = 0.8 * float(np.min(a)), 1.15 * float(np.max(a))
            ax.set_ylim(max(low, 0.2 * float(np.median(a))), high)
        else:
            ax.plot(time, a, linewidth=1.0, **style)
    ax.set(xlabel="time (s)")
    logarithmic_amplitude(ax)


def _frequency(tree: xr.DataTree, ax: "Axes", run: int) -> None:
    for name, style, found in _envelopes(tree, run):
        a, w = found.amplitude.values, found.frequency.values
        if name == "record":
            half_periods(ax, a, w, found.frequency_standard_error.values)
            # A few wild points at the noise floor must not squeeze the course into a line.
            low, high = np.percentile(w, [3, 97])
            ax.set_ylim(low - 0.4 * (high - low), high + 0.4 * (high - low))
            ax.set_xlim(0.0, 1.05 * float(np.max(a)))
        else:
            ax.plot(a, w, linewidth=1.0, **style)
    ax.set(xlabel="amplitude (rad)", ylabel="frequency (rad/s)")


def _envelopes(tree: xr.DataTree, run: int) -> Iterator[tuple[str, dict[str, Any], xr.Dataset]]:
    """The record's and each model's motion through the same half-sine fits, where there are such."""
    data = tree[record_groups(tree)[run]].to_dataset()
    motions: dict[str, Any] = {"record": ({}, data[["angle"]])}
    for name, line in list(MODELS.items())[::-1]:
        motions[name] = (line, xr.Dataset({"angle": data.simulated_angle.sel(model=name, drop=True)}))
    for name, (style, motion) in motions.items():
        try:
            yield name, style, half_sine_envelope(motion)
        except SysidTribError:
            continue
