"""Where models miss the backbone of a record: in damping or in frequency, and at which amplitudes."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
import xarray as xr
from scipy.interpolate import PchipInterpolator

from sysid_trib.arrays import Array
from sysid_trib.cycles.backbone import CURVES, BackboneCurves, PeriodRows, backbone_curves, period_rows
from sysid_trib.errors import SysidTribError
from sysid_trib.records.half_sines import envelope
from sysid_trib.records.signal import unit_of_signal
from sysid_trib.results.schema import model_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import Variables, variable
from sysid_trib.simulation.integrate import FEW_STEPS_A_PERIOD
from sysid_trib.simulation.simulate import trajectory

BAND = 1.0
SHORT = {"frequency": "frequency", "damping_ratio": "damping"}


def lack_of_fit(
    decay: xr.Dataset, results: Mapping[str, xr.Dataset], curves: BackboneCurves | None = None
) -> xr.Dataset:
    """Models' frequency and damping ratio against the backbone of a record.

    Parameters
    ----------
    decay : Dataset
        ``angle(time)`` of one run.
    results : mapping of str to Dataset
        Identifications by name.
    curves : BackboneCurves, optional
        Of `backbone_curves(decay)`, if there are.

    Returns
    -------
    Dataset
        Over ``model`` and ``amplitude`` (of `backbone`): ``frequency`` (rad/s) and ``damping_ratio`` of the
        models, and ``frequency_deviation``, ``damping_ratio_deviation``: model minus record in half widths of
        the simultaneous 95 % band, so that a model is outside beyond 1. nan where a model does not come.

    Raises
    ------
    DecayError
        The record has no backbone.

    Notes
    -----
    The models' motions from a release go through the same half-sines and the same smoothing at the record's
    own amplitudes: what these do to a curve they do to both.
    """
    backbone = curves or backbone_curves(decay)
    both = {
        name: _against(backbone, _model_rows(decay, result, backbone)) for name, result in results.items()
    }
    variables: Variables = {}
    for name, (long_name, units) in CURVES.items():
        values = np.array([pair[name] for pair in both.values()]).reshape(len(both), 2, -1)
        text = f"{long_name} of the model minus that of the record, in half widths of its 95 % band"
        variables[name] = variable(("model", "amplitude"), values[:, 0], f"{long_name} of the model", units)
        variables[f"{name}_deviation"] = variable(("model", "amplitude"), values[:, 1], text, "1")
    amplitude = variable("amplitude", np.exp(backbone.log_amplitude), "amplitude", unit_of_signal(decay))
    return xr.Dataset(variables, {"model": list(both), "amplitude": amplitude})


# A curve, its largest deviation there in half widths of the band, positive where the model is above the
# record; the amplitudes between which that is, infinite beyond the ends of the record's.
Departure: TypeAlias = tuple[str, float, tuple[float, float]]


def departures(lack: xr.Dataset, model: str) -> list[Departure]:
    """Ranges of amplitude in which a model leaves the bands, the farthest first.

    Parameters
    ----------
    lack : Dataset
        Of `lack_of_fit`.
    model : str
        Name of the model there.
    """
    amplitude, those = lack.amplitude.values, []
    for name in CURVES:
        deviation = lack[f"{name}_deviation"].sel(model=model).values
        # Where the model has stopped, it has left.
        outside = ~(np.abs(deviation) <= BAND)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], outside, [False]]).astype(int)))
        for first, end in edges.reshape(-1, 2):
            part = deviation[first:end][np.isfinite(deviation[first:end])]
            farthest = float(part[np.argmax(np.abs(part))]) if len(part) else np.inf
            low = amplitude[first] if first else 0.0
            high = amplitude[end - 1] if end < len(amplitude) else np.inf
            those.append((name, farthest, (low, high)))
    return sorted(those, key=lambda departure: -abs(departure[1]))


def departure_sentence(ranges: Sequence[Departure], unit: str) -> str:
    """Where a model misses the backbone: its farthest departure of each curve, joined by "and"."""
    farthest = {curve: (abs(size), limits) for curve, size, limits in reversed(ranges)}
    ordered = sorted(farthest.items(), key=lambda item: -item[1][0])
    return " and ".join(f"in {SHORT[curve]} {_between(*limits, unit)}" for curve, (_, limits) in ordered)


def _between(low: float, high: float, unit: str) -> str:
    """Between which amplitudes, in words: "from 0.4 rad up"."""
    if low == 0.0:
        return "at all amplitudes" if np.isinf(high) else f"up to {high:.2g} {unit}"
    if np.isinf(high):
        return f"from {low:.2g} {unit} up"
    if f"{low:.2g}" == f"{high:.2g}":
        return f"at {low:.2g} {unit}"
    return f"from {low:.2g} to {high:.2g} {unit}"


def _against(
    backbone: BackboneCurves, model: tuple[Array, Array, Array] | None
) -> dict[str, tuple[Array, Array]]:
    """Each curve of a model, smoothed as the record's, and its deviation in half widths of the band."""
    nothing = np.full(len(backbone.log_amplitude), np.nan)
    if model is None:
        return dict.fromkeys(CURVES, (nothing, nothing))
    against = {}
    for name, of_model in zip(CURVES, model[1:], strict=True):
        curve, u = backbone.by_name[name], backbone.rows.log_amplitude
        there = PchipInterpolator(model[0], of_model, extrapolate=False)(u)
        difference = there - getattr(backbone.rows, name)
        smoothed = curve.weights @ np.where(np.isfinite(difference), difference, 0.0)
        reached = (backbone.log_amplitude >= model[0][0]) & (backbone.log_amplitude <= model[0][-1])
        deviation = np.where(reached, smoothed / (curve.factor * curve.standard_error), np.nan)
        against[name] = (curve.mean + np.where(reached, smoothed, np.nan), deviation)
    return against


def _model_rows(
    decay: xr.Dataset, result: xr.Dataset, backbone: BackboneCurves
) -> tuple[Array, Array, Array] | None:
    """Log amplitudes of a model's motion, increasing, with frequency and damping ratio; None without one."""
    top, low = float(backbone.rows.log_amplitude.max()), float(backbone.rows.log_amplitude.min())
    # A model is released so many half periods above the record: its first ones are left out.
    above = 4.0 * np.pi * max(0.0, float(backbone.by_name["damping_ratio"].mean[-1]))
    largest = float(np.abs(decay.angle.values).max())
    # A model that damps less takes longer to the record's last amplitude: up to so many times its length.
    for times in (1.0, 3.0):
        try:
            rows = _motion_rows(decay, result, float(np.exp(top + above) / largest), times)
        except SysidTribError:
            return None
        u, first = np.unique(rows.log_amplitude + np.log(largest), return_index=True)
        if u[0] <= low:
            break
    return u, rows.frequency[first], rows.damping_ratio[first]


@in_units_of_the_motion
def _motion_rows(decay: xr.Dataset, result: xr.Dataset, release: float, times: float) -> PeriodRows:
    """Periods of the motion from a release; amplitudes in parts of the record's largest signal."""
    time, largest = decay.time.values.astype(float), float(np.abs(decay.angle.values).max())
    step = (time[-1] - time[0]) / (len(time) - 1)
    grid = np.arange(round(times * len(time))) * step
    motion = trajectory(model_of(result), grid, release * largest, 0.0, most_steps=FEW_STEPS_A_PERIOD)
    stop = grid <= motion.stop_time if np.isfinite(motion.stop_time) else np.full(len(grid), True)
    simulated = xr.Dataset({"angle": ("time", motion.angle[stop] / largest)}, {"time": grid[stop]})
    return period_rows(envelope(simulated))
