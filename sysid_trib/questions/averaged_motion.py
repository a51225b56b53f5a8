"""Motion by averaging: the envelope of a free decay, and steady amplitudes where forces balance a drive.

Steady motions: x = a cos phi, phi = W t + theta, r = W/w. To first order, the averages of the forces over
that cycle balance a drive f cos W t (Krylov and Bogoliubov; Nayfeh and Mook 1979, section 4.1):

    a (1 - r^2) + 2 <h cos phi> = f cos theta,    -2 <h sin phi> = -f sin theta.
"""

from collections.abc import Callable, Sequence
from math import floor, log2
from typing import TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import BarycentricInterpolator
from scipy.optimize import elementwise

from sysid_trib.arrays import Array, Index, Mask, variable
from sysid_trib.cycles.signatures import averages, tabulated_averages
from sysid_trib.errors import DecayError, SimulationError
from sysid_trib.forces.force import Force, ShapeValues
from sysid_trib.simulation.model import Model

LARGEST_ENVELOPE = 1e3
ENVELOPE_TOLERANCE = 1e-11
AveragedRates: TypeAlias = Callable[..., tuple[Array, Array]]


def predict_envelope(model: Model, time: ArrayLike, amplitude: float) -> xr.Dataset:
    """Predict envelope, frequency and phase of a free decay by the averaged equations.

    Parameters
    ----------
    model : Model
        Forces with coefficients, taken to first order. Sensor terms are left out.
    time : (time,) array of float, s
        Increasing times; `t` in a formula counts from the first.
    amplitude : float, rad
        Amplitude at time[0].

    Returns
    -------
    Dataset
        `amplitude(time)` (rad), `frequency(time)` (rad/s), `phase(time)` (rad, zero at time[0], so that
        theta = a cos phase) and the scalar `arrest_time` (s, on the clock of `time`; NaN if the decay does
        not end). After the arrest, the amplitude is zero, and frequency and phase are NaN. An arrest after
        the last time is predicted too, unless a formula contains `t`.

    Raises
    ------
    SimulationError
        The times do not increase, or the amplitude is not positive or grows without bound.

    Notes
    -----
    da/dt = w sum of coefficient * <h sin phi>, dphase/dt = w (1 + sum of coefficient * <h cos phi> / a)
    (Le Bot et al. 2019, Appendix).

    Examples
    --------
    Under viscous friction alone the amplitude falls as exp(-zeta w t).

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.01}, reference_frequency=10.0)
    >>> predicted = st.predict_envelope(model, np.linspace(0.0, 10.0, 11), amplitude=0.3)
    >>> predicted.amplitude[-1].round(4).item(), round(0.3 * float(np.exp(-1.0)), 4)
    (0.1104, 0.1104)
    """
    time = np.atleast_1d(np.asarray(time, dtype=float))
    if time.ndim != 1 or not np.all(np.isfinite(time)) or np.any(np.diff(time) <= 0):
        raise SimulationError("Times of a prediction must be finite and increase; sort them, drop repeats.")
    if not 0 < amplitude <= LARGEST_ENVELOPE:
        raise SimulationError(f"The first amplitude is {amplitude}; give one up to {LARGEST_ENVELOPE:g} rad.")
    averaged = averaged_rates(model)
    changes = any(force.holds_time for force in model.forces)
    a, phase, arrest = _decay(averaged, time - time[0], float(amplitude), steady=not changes)
    moving = a > 0
    frequency = averaged(np.where(moving, a, amplitude), time - time[0])[1]
    data = {
        "amplitude": variable("time", a, "amplitude of the motion", "rad"),
        "frequency": variable("time", np.where(moving, frequency, np.nan), "angular frequency", "rad/s"),
        "phase": variable("time", np.where(moving, phase, np.nan), "phase since the first time", "rad"),
        "arrest_time": variable((), time[0] + arrest, "time of arrest", "s"),
    }
    return xr.Dataset(data, {"time": ("time", time, {"units": "s"})})


def averaged_rates(model: Model) -> AveragedRates:
    """Return the averaged equations: da/dt (rad/s) and frequency (rad/s) at a > 0 (rad) and times (s)."""
    powers = [force for force in model.forces if force.degree is not None]
    others = [force for force in model.forces if force.degree is None]
    # Degrees of the homogeneous forces, and their weighted (sine, cosine) at a = 1.
    degrees = np.array([force.degree for force in powers], dtype=float)
    unit = np.array([model.coefficients[f.symbol] * np.ravel(averages(f, np.ones(1))) for f in powers])
    unit, w = unit.reshape(-1, 2), model.reference_frequency

    def rates(a: ArrayLike, time: ArrayLike = 0.0) -> tuple[Array, Array]:
        a = np.asarray(a, dtype=float)
        sums = np.power.outer(a, degrees) @ unit
        for force in others:
            pair = np.stack(tabulated_averages(force, np.atleast_1d(a), model.shapes, time), axis=-1)
            sums = sums + model.coefficients[force.symbol] * pair.reshape(sums.shape)
        return w * sums[..., 0], w * (1.0 + sums[..., 1] / a)

    return rates


def _decay(
    averaged: AveragedRates, time: Array, amplitude: float, *, steady: bool
) -> tuple[Array, Array, float]:
    """Return the amplitude, phase at the times, and time of arrest (NaN if none), all from t = 0."""
    end = max(float(time[-1]), 1e-9)
    # Below this fraction of the first amplitude, a power of the amplitude extrapolates the signatures.
    least = 1e-9 * amplitude

    def rates(t: float, y: Array) -> tuple[float, float]:
        slope, frequency = averaged(np.maximum(y[0], 0.5 * least), t)
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
        return a, phase, last + (_remaining(averaged, float(solution.y[0, -1]), least) if steady else np.nan)
    arrest = last + _tail(averaged, least, last)
    slope, frequency = averaged(least, last)
    after = time > last
    # Without an arrest, the last billionth decays exponentially.
    rest = least * np.exp(slope / least * (time - last)) if np.isnan(arrest) else 0.0
    return np.where(after, rest, a), np.where(after, phase + frequency * (time - last), phase), arrest


def _tail(averaged: AveragedRates, a: float, time: float) -> float:
    """Return the time from a very small amplitude to zero (s); NaN if it is infinite.

    da/dt decreases with a power of a; the amplitude reaches zero only if this power is smaller than one.
    """
    slope, half = (float(averaged(x, time)[0]) for x in (a, 0.5 * a))
    if not (slope < 0 and half < 0):
        return np.nan
    power = log2(slope / half)
    return -a / (slope * (1.0 - power)) if power < 0.99 else np.nan


def _remaining(averaged: AveragedRates, a: float, least: float) -> float:
    """Return the time from amplitude `a` to the arrest (s); NaN without an arrest or a prediction of it."""
    tail = _tail(averaged, least, 0.0)
    if np.isnan(tail):
        return np.nan
    octaves = range(floor(log2(least)), floor(log2(a)) + 1)
    grid = np.clip(2.0 ** np.add.outer(octaves, np.arange(8) / 8).ravel(), least, a)
    if np.any(averaged(grid)[0] >= 0):
        return np.nan

    def waiting(log_a: float) -> float:
        x = float(np.exp(log_a))
        return -x / float(averaged(x)[0])

    return float(quad(waiting, np.log(least), np.log(a), epsabs=0.0, epsrel=1e-10, limit=200)[0] + tail)


# Number of amplitudes at which a balance is searched; the least amplitude is this fraction of the static
# deflection.
AMPLITUDES_TRIED, LEAST_TRIED = 400, 1e-3
# Number of frequencies at which a force is averaged if its dependence on the frequency is not a power law,
# with a polynomial between them.
NODES = 5
# Relative step of the amplitude for slopes.
SLOPE_PART = 1e-6
# 2 <h sin phi> and 2 <h cos phi> of each force at amplitudes, (force, 2, frequency, amplitude), or at one
# frequency index per amplitude, (force, 2, amplitude).
DescribedAt: TypeAlias = Callable[..., Array]


def describing_functions(forces: Sequence[Force], shapes: ShapeValues, ratio: Array) -> DescribedAt:
    """Return the describing functions of forces at ratios W/w of frequencies, (frequency,), increasing."""
    # Forces with a value at some of the ratios, and their weights at each ratio, (frequency, node).
    parts: list[tuple[list[Force], Array]] = []
    for force in forces:
        power = force.speed_degree if force.memoryless else None
        if power is not None:
            parts.append(([force], ratio[:, None] ** power))
            continue
        middle, half = float(np.mean(ratio[[0, -1]])), 0.5 * float(np.ptp(ratio))
        nodes, weights = np.array([middle]), np.ones((len(ratio), 1))
        if half:
            nodes = middle + half * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
            weights = np.asarray(BarycentricInterpolator(nodes, np.eye(NODES))(ratio))
        # The node's cycle is faster: its v is this multiple of the reference cycle's v.
        parts.append(([force.with_instead("v", f"{node!r}*v", node) for node in nodes.tolist()], weights))

    def described(amplitude: Array, frequency: Index | None = None) -> Array:
        sums = []
        for nodes, weights in parts:
            means = np.array([tabulated_averages(force, amplitude, shapes) for force in nodes])
            if frequency is None:
                sums.append(2.0 * np.einsum("fn,nka->kfa", weights, means))
            else:
                sums.append(2.0 * np.einsum("an,nka->ka", weights[frequency], means))
        return np.array(sums)

    return described


def balance_grid(described: DescribedAt, coefficients: Array, ratio: Array, drive: Array) -> Array:
    """Return amplitudes that bracket every balance, (amplitude,), from the drive (frequency,).

    Raises
    ------
    DecayError
        No dissipative force limits the response.
    """
    top = 4.0 * float(np.max(drive))
    for _ in range(40):
        sine, cosine = np.einsum("i,ikfa->kfa", coefficients, described(np.array([top])))[:, :, 0]
        along = top * (1.0 - ratio**2) + cosine
        if np.all(np.abs(sine) > drive) or np.all(np.hypot(along, sine) > 4.0 * drive):
            return np.geomspace(LEAST_TRIED * float(np.min(drive)), top, AMPLITUDES_TRIED)
        top *= 2.0
    raise DecayError("Without damping this response is unbounded; add a dissipative force to the model.")


def balances(
    described: DescribedAt, coefficients: Array, ratio: Array, drive: Array, amplitude: Array
) -> tuple[Index, Array, Array, Mask, Array]:
    """Return the steady motions, by coefficients (force,), a complex drive (frequency,) and a `balance_grid`.

    Returns
    -------
    frequency, amplitude, phase, stable, by_lines : (motion,) arrays
        Index of the frequency, amplitude, theta (rad), whether the motion is stable, and the amplitude by
        linear interpolation on the grid.
    """
    over_grid = excess(described(amplitude), coefficients, ratio, drive, amplitude)
    frequency, by_lines = crossings(over_grid, amplitude)

    def sums(a: Array, row: Index = frequency) -> tuple[Array, Array]:
        sine, cosine = np.einsum("i,ika->ka", coefficients, described(a, row))
        return sine, a * (1.0 - ratio[row] ** 2) + cosine

    def surplus(a: Array, row: Array) -> Array:
        sine, along = sums(a, row.astype(int))
        return np.asarray(along**2 + sine**2 - np.abs(drive[row.astype(int)]) ** 2)

    at = np.searchsorted(amplitude, by_lines)
    between = amplitude[at - 1], amplitude[at]
    a = np.asarray(elementwise.find_root(surplus, between, args=(frequency.astype(float),)).x)
    sine, along = sums(a)
    below, above = (np.array(sums(a * (1.0 + side * SLOPE_PART))) for side in (-1.0, 1.0))
    rise = np.sum(above**2 - below**2, axis=0) / (2.0 * SLOPE_PART * a)
    fall = (above - below)[0] / (2.0 * SLOPE_PART * a)
    # Stability by the averaged equations: a positive determinant, and damping of small deviations.
    stable = (rise > 0.0) & (fall + sine / a < 0.0)
    phase = np.angle(drive[frequency] * np.exp(-1j * np.angle(along - 1j * sine)))
    return frequency, a, phase, stable, by_lines


def excess(sums: Array, coefficients: Array, ratio: Array, drive: Array, amplitude: Array) -> Array:
    """Return the square of the forces minus that of the drive, (frequency, amplitude)."""
    sine, cosine = np.einsum("i,ikfa->kfa", coefficients, sums)
    along = amplitude * (1.0 - ratio[:, None] ** 2) + cosine
    return np.asarray(along**2 + sine**2 - np.abs(drive[:, None]) ** 2)


def crossings(values: Array, amplitude: Array) -> tuple[Index, Array]:
    """Return rows and amplitudes where values (row, amplitude) change sign, by linear interpolation."""
    row, at = np.nonzero(np.signbit(values[:, :-1]) != np.signbit(values[:, 1:]))
    low, high = values[row, at], values[row, at + 1]
    return row, amplitude[at] + (amplitude[at + 1] - amplitude[at]) * low / (low - high)
