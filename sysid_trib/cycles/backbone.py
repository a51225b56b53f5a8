"""Frequency and damping ratio against amplitude, from a free decay and without a model, with bands."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import scipy.sparse as sp
import xarray as xr
from scipy.interpolate import PchipInterpolator
from scipy.special import ndtri

from sysid_trib import records
from sysid_trib.arrays import Array, Variables, variable, with_error
from sysid_trib.cycles.smooth_curve import WALKS, CurveRows, SmoothCurve, smooth_curve
from sysid_trib.errors import DecayError
from sysid_trib.records import half_sines, signal
from sysid_trib.records.runs import RecordLike
from sysid_trib.results.variables import CONFIDENCE

WHOLE_TURN = 2.0 * np.pi
# A period extends from extremum to extremum, averaged over both sides: a moving zero makes one side fall
# faster and the other more slowly. With few half periods only one side is used.
BOTH_SIDES, ONE_SIDE = (0.5, 0.5, -0.5, -0.5), (1.0, 0.0, -1.0)
LEAST_RELATIVE_NOISE = 1e-10
# Second-order effect of damping on the frequency of a free decay, and of whole periods on the damping ratio:
# up to this multiple of the damping ratio squared. First-order averages do not contain it.
SECOND_ORDER = {"damping_ratio": 2.0, "frequency": 1.0}


class Smoothed(NamedTuple):
    """A backbone, and the weights of its periods in each curve, (amplitude, period)."""

    curves: xr.Dataset
    weights: dict[str, Array]


def period_rows(
    measured: xr.Dataset, slopes: dict[str, Array] | None = None
) -> tuple[Array, dict[str, CurveRows]]:
    """Return rows of an envelope, a half period apart, without the differences between the two sides.

    Parameters
    ----------
    measured : Dataset
        Result of `envelope` with at least four half periods.
    slopes : mapping of str to (row,) array, optional
        Derivatives of both curves by the log amplitude: an error of the amplitude shifts a row along its
        curve.

    Returns
    -------
    log_amplitude : (row,) array of float
        Log amplitude of the geometric mean of the extrema at the ends of each period.
    rows : dict of str to CurveRows
        ``damping_ratio``, the logarithmic decrement over 2 pi, and ``frequency`` (rad/s).
    """
    b, t = measured.extremum.values, measured.extremum_time.values
    # The first and last half-sine take their frequency from their neighbours. Leave them out if there are
    # enough others.
    ends = 1 if len(b) >= 9 else 0
    change = np.array(BOTH_SIDES if ends else ONE_SIDE)
    fall, middle, later = (
        _sliding(weights, len(b), ends)
        # An impulse before an extremum moves it and all later ones.
        for weights in (change, np.abs(change) / 2.0, np.append(0.0, np.cumsum(change[::-1])[-2::-1]))
    )
    damping, frequency = fall @ np.log(b) / WHOLE_TURN, -WHOLE_TURN / (fall @ t)
    # The scatter of the extrema is estimated here, so use only their errors due to the samples' white noise.
    relative = _errors(measured, "extremum", "scatter_of_extrema") / b
    late = _errors(measured, "extremum_time", "scatter_of_times")
    lasting, passing = half_sines.half_period_responses(measured)
    per_turn, per_time = np.full(len(damping), 1.0 / WHOLE_TURN), frequency**2 / WHOLE_TURN
    rows = dict[str, CurveRows]()
    for name, value, scale, by, error, part in (
        ("damping_ratio", damping, per_turn, 1.0 / b, relative * b, slice(0, len(b))),
        ("frequency", frequency, per_time, np.ones_like(b), late, slice(len(b), 2 * len(b))),
    ):
        of_rows = sp.diags(scale) @ fall @ sp.diags(by * error)
        along = -sp.diags(slopes[name] if slopes else np.zeros_like(value)) @ middle @ sp.diags(relative)
        second = sp.diags(SECOND_ORDER[name] * damping**2 * value)
        noises = [of_rows + along, second] if name == "damping_ratio" else [of_rows, along, second]
        walk = sp.diags(scale) @ (fall @ sp.diags(by) @ passing[part] + later @ sp.diags(by) @ lasting[part])
        rows[name] = CurveRows(value, sp.hstack(noises, format="csr"), walk)
    return middle @ np.log(b), rows


def _sliding(weights: Array, count: int, ends: int) -> sp.csr_matrix:
    """Return weighted sums of neighbouring extrema, (row, extremum), without `ends` rows at each end."""
    rows = count - len(weights) + 1 - 2 * ends
    return sum(w * sp.eye(rows, count, k=ends + at, format="csr") for at, w in enumerate(weights))


def _errors(measured: xr.Dataset, name: str, scatter: str) -> Array:
    """Return the standard errors due to the white noise of the samples, at least rounding."""
    error = measured[f"{name}_standard_error"].values / measured.attrs.get(scatter, 1.0)
    b = measured.extremum.values
    size = b if name == "extremum" else 1.0 / measured.frequency.values.max()
    return np.asarray(np.maximum(error, LEAST_RELATIVE_NOISE * size))


CURVES = {"frequency": ("angular frequency", "rad/s"), "damping_ratio": ("damping ratio", "1")}
CURVE_POINTS, FEWEST_HALF_PERIODS = 80, 5
# Number of rounds after the first; each uses the bends and slopes of the round before.
ROUNDS = 2
QUANTILES, FINE = 17, 801
# Weights of extrema on both sides: they remove the difference between the sides and keep a parabola
# unchanged.
LEVEL_WEIGHTS = np.array([-1.0, 4.0, 10.0, 4.0, -1.0]) / 16.0


def backbone(decay: RecordLike) -> xr.Dataset:
    """Return the frequency and damping ratio of a free decay against its amplitude, without a model.

    Parameters
    ----------
    decay : record
        ``angle(time)`` about its equilibrium, as `free_decay` returns it, or ``(t, angle)``.

    Returns
    -------
    Dataset
        Over ``amplitude`` (in the unit of the decay, increasing): ``frequency`` (rad/s), ``damping_ratio``,
        and the forces averaged over a cycle, in the unit of the decay: ``dissipative_force`` =
        damping ratio * amplitude, ``elastic_force`` = (frequency/``smallest_amplitude_frequency`` - 1) *
        amplitude. Over ``time``: ``amplitude_over_time``. Each has a ``..._standard_error``, and ``..._low``
        and ``..._high``, the ends of a band that contains the whole curve in 95 % of records. Over
        ``period``, the values of single periods: ``period_amplitude``, ``period_frequency``,
        ``period_damping_ratio``.

    Raises
    ------
    DecayError
        The decay has fewer than five whole half periods.

    Notes
    -----
    For the period about each half period, between extrema of half-sines (see `envelope`), the values are the
    logarithmic decrement over 2 pi and 2 pi over the duration, at the geometric mean of both extrema. Even
    forces, the sensor's zero and its harmonics do not change these values to first order. The noise is that
    of the sensor plus a random walk of amplitude and phase, as a white random force causes it; restricted
    likelihood estimates the size of each (see `smooth_curve`). The bands include the second-order effect of
    damping, which first-order averages neglect: relative to the frequency the damping ratio squared, and
    relative to the damping ratio twice its square.

    Examples
    --------
    Quadratic friction raises the damping ratio with the amplitude.

    >>> import sysid_trib as st
    >>> curves = st.backbone(st.records.paper_twin())
    >>> curves.damping_ratio.interp(amplitude=[0.05, 0.2]).round(4).values.tolist()
    [0.0103, 0.0133]
    """
    return smoothed_backbone(records.one_record(decay, "backbone")).curves


def smoothed_backbone(decay: xr.Dataset) -> Smoothed:
    """Return the `backbone` of a decay, and the weights of its periods in it.

    If the signal was integrated (`one_mode`), integration has coloured its noise. Then the curves are fitted
    to the measured signal, and the frequency converts its amplitudes to those of the displacement.
    """
    integrations = int(decay.attrs["integrations"]) if decay.attrs.get(signal.NOISE_IS_WHITE_IN) else 0
    measured = half_sines.envelope(_as_measured(decay) if integrations else decay)
    if measured.sizes["half_period"] < FEWEST_HALF_PERIODS:
        source, count = decay.attrs.get("source", "decay"), measured.sizes["half_period"]
        raise DecayError(
            f"{source}: {count} whole half periods; a backbone needs {FEWEST_HALF_PERIODS}: record longer."
        )
    u, rows = period_rows(measured)
    position, log_amplitude = _coordinate(u)
    points = np.linspace(0.0, 1.0, CURVE_POINTS)
    curves: dict[str, SmoothCurve] = {}
    for turn in range(ROUNDS + 1):
        if curves:
            slopes = {
                name: np.interp(u, log_amplitude, np.gradient(curve.mean, log_amplitude))
                for name, curve in curves.items()
            }
            _, rows = period_rows(measured, slopes)
        bends = {name: curve.bends for name, curve in curves.items()}
        walks = WALKS if turn == ROUNDS else WALKS[::2]
        curves = {n: smooth_curve(rows[n], position, points, bends.get(n), walks) for n in CURVES}
    unit = signal.unit_of_signal(decay)
    weights = {name: curve.weights for name, curve in curves.items()}
    integrated = _Integrated(log_amplitude, curves["frequency"].mean, integrations)
    data = _over_time(measured, curves["damping_ratio"].noise, unit, integrated)
    if integrations:
        of_measured = str(decay["measured"].attrs.get("units", ""))
        text = f"amplitude of the {decay.attrs.get('signal', 'signal')} as measured"
        data["measured_amplitude"] = variable("amplitude", np.exp(log_amplitude), text, of_measured)
        curves["damping_ratio"] = integrated.damping(curves["damping_ratio"])
    amplitude = integrated.amplitude(log_amplitude)
    data |= _over_amplitude(curves, amplitude, unit)
    data["period_amplitude"] = variable("period", integrated.amplitude(u), "amplitude of a period", unit)
    for name, (long_name, units) in CURVES.items():
        value = rows[name].target * (integrated.factor_at(u) if name == "damping_ratio" else 1.0)
        data[f"period_{name}"] = variable("period", value, f"{long_name} of a period", units)
    coords = {"amplitude": variable("amplitude", amplitude, "amplitude", unit)}
    return Smoothed(xr.Dataset(data, coords, dict(decay.attrs)), weights)


def _as_measured(decay: xr.Dataset) -> xr.Dataset:
    """Return the decay of the measured signal, in the unit of that signal."""
    measured = decay["measured"]
    angle = ("time", measured.values, dict(measured.attrs))
    return xr.Dataset(
        {"angle": angle}, {"time": ("time", measured.measured_time.values)}, {"source": "decay"}
    )


@dataclass(frozen=True)
class _Integrated:
    """Conversion of amplitudes of a rate or acceleration to those of the displacement, by the frequency.

    Attributes
    ----------
    log_amplitude, frequency : (amplitude,) array of float
        Log amplitude of the measured signal, and frequency in rad/s.
    integrations : int
        Number of integrations; 0 changes nothing.
    """

    log_amplitude: Array
    frequency: Array
    integrations: int

    def amplitude(self, log_amplitude: Array) -> Array:
        """Return amplitudes of the displacement at log amplitudes of the measured signal."""
        frequency = np.interp(log_amplitude, self.log_amplitude, self.frequency)
        return np.asarray(np.exp(log_amplitude) / frequency**self.integrations)

    def factor_at(self, log_amplitude: Array) -> Array:
        """Return the decrement of the displacement over that of the measured signal, at log amplitudes."""
        slope = np.gradient(np.log(self.frequency), self.log_amplitude)
        return 1.0 - self.integrations * np.interp(log_amplitude, self.log_amplitude, slope)

    def damping(self, curve: SmoothCurve) -> SmoothCurve:
        """Return the damping ratio of the displacement from that of the measured signal."""
        factor = self.factor_at(self.log_amplitude)
        return replace(curve, mean=factor * curve.mean, standard_error=factor * curve.standard_error)


def left_open(name: str, value: Array, damping_ratio: Array) -> Array:
    """Return the second-order error of averaging of a curve, from the damping ratio."""
    return np.asarray(SECOND_ORDER[name] * np.abs(damping_ratio) ** 2 * np.abs(value))


def half_width(backbone: xr.Dataset, name: str) -> Array:
    """Return the half width of the simultaneous 95 % band of a curve, (amplitude,)."""
    return np.asarray((backbone[f"{name}_high"] - backbone[name]).values)


def _coordinate(u: Array) -> tuple[Array, Array]:
    """Return the positions of log amplitudes from 0 to 1, and the log amplitudes of evenly spaced points.

    Half by the log amplitude, half by the number of periods below it: the grid is fine where the record has
    periods.
    """
    part = np.linspace(0.0, 1.0, QUANTILES)
    low, width = u.min(), max(float(np.ptp(u)), 1e-9)
    below = PchipInterpolator(np.quantile(u, part) + 1e-12 * width * np.arange(QUANTILES), part)
    fine = low + np.linspace(0.0, width, FINE)
    along = 0.5 * (np.clip(below(fine), 0.0, 1.0) + np.linspace(0.0, 1.0, FINE))
    return np.interp(u, fine, along), np.interp(np.linspace(0.0, 1.0, CURVE_POINTS), along, fine)


def _over_amplitude(curves: Mapping[str, SmoothCurve], amplitude: Array, unit: str) -> Variables:
    """Return the curves with their bands, and the averaged forces."""
    variables: Variables = {}
    values: dict[str, tuple[Array, Array, Array]] = {}
    for name, (long_name, units) in CURVES.items():
        curve = curves[name]
        further = left_open(name, curve.mean, curves["damping_ratio"].mean)
        half = curve.factor * curve.standard_error + further
        values[name] = curve.mean, np.hypot(curve.standard_error, further), half
        variables |= _banded(name, "amplitude", values[name], long_name, units)
    smallest = values["frequency"][0][0]
    for name, of, scale, least in (
        ("dissipative_force", "damping_ratio", amplitude, 0.0),
        ("elastic_force", "frequency", amplitude / smallest, smallest),
    ):
        value, error, half = values[of]
        scaled = (scale * (value - least), scale * error, scale * half)
        long_name = f"{name.replace('_', ' ')} averaged over a cycle"
        variables |= _banded(name, "amplitude", scaled, long_name, unit)
    at = variable((), smallest, "angular frequency at the smallest amplitude", "rad/s")
    return variables | {"smallest_amplitude_frequency": at}


def _over_time(measured: xr.Dataset, noise: float, unit: str, integrated: _Integrated) -> Variables:
    """Return the amplitude at the extrema without two at either end; `noise` scales their errors."""
    log_b = np.log(measured.extremum.values)
    relative = measured.extremum_standard_error.values / measured.extremum.values
    relative = relative / measured.attrs["scatter_of_extrema"] * noise
    amplitude = integrated.amplitude(np.convolve(log_b, LEVEL_WEIGHTS, "valid"))
    error = amplitude * np.sqrt(np.convolve(relative**2, LEVEL_WEIGHTS**2, "valid"))
    half = -ndtri(0.5 * (1.0 - CONFIDENCE ** (1.0 / len(amplitude)))) * error
    time = variable("time", measured.extremum_time.values[2:-2], "time", "s")
    name = "amplitude_over_time"
    return _banded(name, "time", (amplitude, error, half), "amplitude over time", unit) | {"time": time}


def _banded(
    name: str, dim: str, value_error_half: tuple[Array, Array, Array], long_name: str, units: str
) -> Variables:
    """Return a curve with its standard error, and both ends of its simultaneous band."""
    value, error, half = value_error_half
    variables = with_error(name, dim, (value, error), long_name, units)
    for end, scaled in (("low", value - half), ("high", value + half)):
        text = f"{end} end of the 95 % band of the whole {long_name}"
        variables[f"{name}_{end}"] = variable(dim, scaled, text, units)
    return variables
