"""Envelope, frequency and phase of a model's free decay, by averaging."""

from collections.abc import Iterator
from math import floor, log2

import numpy as np
import xarray as xr
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike
from scipy.integrate import quad, solve_ivp

from sysid_trib.arrays import Array
from sysid_trib.cycles.signatures import CANCELLATION, ROUNDING_ERROR, averages
from sysid_trib.errors import SimulationError
from sysid_trib.forces.force import Force
from sysid_trib.results.variables import variable
from sysid_trib.simulation.model import Model

LARGEST_ENVELOPE = 1e3
ENVELOPE_TOLERANCE = 1e-11
CHEBYSHEV_NODES = 16

OctavePart = tuple[float, float, Array]


def predict_envelope(model: Model, time: ArrayLike, amplitude: float) -> xr.Dataset:
    """Predict envelope, frequency and phase of a free decay by the averaged equations.

    Parameters
    ----------
    model : Model
        Forces with coefficients; first order in them. Sensor terms are left out.
    time : (time,) array of float, s
        Increasing; `t` in a formula counts from the first.
    amplitude : float, rad
        At time[0].

    Returns
    -------
    Dataset
        `amplitude(time)` (rad), `frequency(time)` (rad/s), `phase(time)` (rad, zero at time[0], so that
        theta = a cos phase) and the scalar `arrest_time` (s, on the clock of `time`; NaN if the decay has no
        end). After the arrest the amplitude is zero, frequency and phase are NaN. An arrest after the last
        time is given too, unless a formula holds `t`.

    Raises
    ------
    SimulationError
        Time that does not increase, an amplitude that is not positive or grows without bound.

    Notes
    -----
    da/dt = w sum of coefficient * <h sin phi>, dphase/dt = w (1 + sum of coefficient * <h cos phi> / a)
    (Le Bot et al. 2019, Appendix).
    """
    time = np.atleast_1d(np.asarray(time, dtype=float))
    if time.ndim != 1 or not np.all(np.isfinite(time)) or np.any(np.diff(time) <= 0):
        raise SimulationError(
            "The times of a prediction must be finite and increase; sort them, drop repeats."
        )
    if not 0 < amplitude <= LARGEST_ENVELOPE:
        raise SimulationError(
            f"The first amplitude must be an angle from 0 to {LARGEST_ENVELOPE:g} rad, not {amplitude}."
        )
    averaged = Averaged(model)
    a, phase, arrest = _decay(averaged, time - time[0], float(amplitude))
    moving = a > 0
    frequency = averaged.rates(np.where(moving, a, amplitude), time - time[0])[1]
    data = {
        "amplitude": variable("time", a, "amplitude of the motion", "rad"),
        "frequency": variable("time", np.where(moving, frequency, np.nan), "angular frequency", "rad/s"),
        "phase": variable("time", np.where(moving, phase, np.nan), "phase since the first time", "rad"),
        "arrest_time": variable((), time[0] + arrest, "time of arrest", "s"),
    }
    return xr.Dataset(data, {"time": ("time", time, {"units": "s"})})


class Averaged:
    """The averaged equations of a model: powers of the amplitude, the rest tabulated as it is needed."""

    def __init__(self, model: Model) -> None:
        self.model = model
        powers = [force for force in model.forces if force.degree is not None]
        # Degrees of the homogeneous forces, and their weighted (sine, cosine) at a = 1.
        self.degrees = np.array([force.degree for force in powers], dtype=float)
        self.unit = np.array([self._weighted(f, np.ones(1))[:, 0] for f in powers]).reshape(-1, 2)
        # Forces that are tabulated, and those whose signature changes in time.
        self.others = [f for f in model.forces if f.degree is None and not f.holds_time]
        self.drifting = [force for force in model.forces if force.holds_time]
        self.octaves: dict[int, list[OctavePart]] = {}

    def rates(self, a: ArrayLike, time: ArrayLike = 0.0) -> tuple[Array, Array]:
        """da/dt (rad/s) and frequency (rad/s) at amplitudes `a` > 0 (rad) and times (s)."""
        a = np.asarray(a, dtype=float)
        sums = np.power.outer(a, self.degrees) @ self.unit
        if self.others:
            sums = sums + self._tabulated(np.atleast_1d(a)).reshape(sums.shape)
        for force in self.drifting:
            sums = sums + self._weighted(force, np.atleast_1d(a), time).T.reshape(sums.shape)
        w = self.model.reference_frequency
        return w * sums[..., 0], w * (1.0 + sums[..., 1] / a)

    def _weighted(self, force: Force, a: Array, time: ArrayLike = 0.0) -> Array:
        pair = np.stack(averages(force, a, self.model.shapes, time))
        return self.model.coefficients[force.symbol] * pair

    def _tabulated(self, a: Array) -> Array:
        """Sums over the forces without a power law, (amplitude, 2), by Chebyshev interpolation in log2 a."""
        at = np.log2(a)
        sums = np.empty((a.size, 2))
        for octave in np.unique(np.floor(at)):
            if int(octave) not in self.octaves:
                self.octaves[int(octave)] = list(self._panels(octave, octave + 1.0))
            for low, high, series in self.octaves[int(octave)]:
                inside = (at >= low) & (at < high)
                if inside.any():
                    sums[inside] = chebyshev.chebval(2.0 * (at[inside] - low) / (high - low) - 1.0, series).T
        return sums

    def _panels(self, low: float, high: float, before: float = np.inf) -> Iterator[OctavePart]:
        """Series for a part of an octave, halved until its last coefficients no longer count.

        `before` is their size in the part that was halved: rounding does not get smaller.
        """
        nodes = chebyshev.chebpts1(CHEBYSHEV_NODES)
        a = 2.0 ** (low + 0.5 * (nodes + 1.0) * (high - low))
        values = np.sum([self._weighted(force, a) for force in self.others], axis=0).T
        series = np.asarray(chebyshev.chebfit(nodes, values, CHEBYSHEV_NODES - 1))
        # Compared with the spring's a, what a formula such as sin(x) - x loses to rounding is nothing.
        size = max(np.abs(series).max(initial=1e-300), CANCELLATION / ENVELOPE_TOLERANCE * 2.0**high)
        last = np.abs(series[-3:]).max() / size
        # Of an octave: a signature with a kink, as where a slip begins, is halved no further.
        if last < ENVELOPE_TOLERANCE or high - low < 0.01 or 0.5 * before < last < ROUNDING_ERROR:
            yield low, high, series
        else:
            middle = 0.5 * (low + high)
            yield from self._panels(low, middle, last)
            yield from self._panels(middle, high, last)


def _decay(averaged: Averaged, time: Array, amplitude: float) -> tuple[Array, Array, float]:
    """Amplitude, phase at the times, and time of arrest (NaN if none), all from t = 0."""
    end = max(float(time[-1]), 1e-9)
    # Below this part of the first amplitude the signatures are continued by a power of the amplitude.
    least = 1e-9 * amplitude

    def rates(t: float, y: Array) -> tuple[float, float]:
        slope, frequency = averaged.rates(np.maximum(y[0], 0.5 * least), t)
        return float(slope), float(frequency)

    def vanishing(t: float, y: Array) -> float:
        return float(y[0] - least)

    def growing(t: float, y: Array) -> float:
        return float(LARGEST_ENVELOPE * 1.01 - y[0])

    vanishing.terminal = growing.terminal = True  # type: ignore[attr-defined]
    solution = solve_ivp(
        rates,
        (0.0, end),
        (amplitude, 0.0),
        method="DOP853",
        rtol=ENVELOPE_TOLERANCE,
        atol=(ENVELOPE_TOLERANCE * amplitude, 1e-10),
        dense_output=True,
        events=(vanishing, growing),
    )
    if solution.status < 0 or solution.t_events[1].size or not np.all(np.isfinite(solution.y)):
        raise SimulationError("The averaged amplitude grows without bound; some force feeds energy in.")
    last = float(solution.t[-1])
    a, phase = solution.sol(np.minimum(time, last))
    if not solution.t_events[0].size:
        return a, phase, last + _remaining(averaged, float(solution.y[0, -1]), least)
    arrest = last + _tail(averaged, least, last)
    slope, frequency = averaged.rates(least, last)
    after = time > last
    # Without an arrest the last billionth dies out exponentially.
    rest = least * np.exp(slope / least * (time - last)) if np.isnan(arrest) else 0.0
    return np.where(after, rest, a), np.where(after, phase + frequency * (time - last), phase), arrest


def _tail(averaged: Averaged, a: float, time: float) -> float:
    """Time from a very small amplitude to zero (s); NaN if it is never reached.

    da/dt falls with a power of a, and zero is reached only if this is smaller than one.
    """
    slope, half = (float(averaged.rates(x, time)[0]) for x in (a, 0.5 * a))
    if not (slope < 0 and half < 0):
        return np.nan
    power = log2(slope / half)
    return -a / (slope * (1.0 - power)) if power < 0.99 else np.nan


def _remaining(averaged: Averaged, a: float, least: float) -> float:
    """Time from amplitude `a` to the arrest (s), NaN if there is none or if it cannot be foreseen."""
    tail = np.nan if averaged.drifting else _tail(averaged, least, 0.0)
    if np.isnan(tail):
        return np.nan
    octaves = range(floor(log2(least)), floor(log2(a)) + 1)
    grid = np.clip(2.0 ** np.add.outer(octaves, np.arange(8) / 8).ravel(), least, a)
    if np.any(averaged.rates(grid)[0] >= 0):
        return np.nan

    def waiting(log_a: float) -> float:
        x = float(np.exp(log_a))
        return -x / float(averaged.rates(x)[0])

    return float(quad(waiting, np.log(least), np.log(a), epsabs=0.0, epsrel=1e-10, limit=200)[0] + tail)
