"""A record about a path, linear in states and parameters, and further accelerations as columns."""

from dataclasses import replace

import numpy as np
from numpy.polynomial import Legendre, Polynomial, legendre

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.motion_fit.kalman import LinearModel
from sysid_trib.records.smoothing import smooth
from sysid_trib.simulation.internal_states import states_along
from sysid_trib.simulation.model import FREQUENCY, Model, Motion, sensor_error
from sysid_trib.simulation.motions import SimulatedMotion
from sysid_trib.simulation.steps import expected_steps
from sysid_trib.simulation.trajectory import trajectory


def spline_path(model: Model, time: Array, angle: Array) -> Array:
    """Return states along the least-squares spline through a record, (sample, state), as the first path.

    Each piece between gaps has its own spline.
    """
    tau = model.reference_frequency * (time - time[0])
    x, v = _smooth_pieces(tau, angle)
    columns, motion = [x, v], Motion(model.forces)
    hidden: dict[str, Array] = {}
    for force in model.forces:
        own = {name: value for name, value in model.shapes.items() if name.partition(".")[0] == force.symbol}
        hidden_of = states_along(force, tau, x, v, own, time=time - time[0])
        hidden |= {f"{force.symbol}.{name}": values for name, values in hidden_of.items()}
    return np.stack([*columns, *(hidden[name] for name in motion.hidden)], axis=1)


def _smooth_pieces(tau: Array, angle: Array) -> tuple[Array, Array]:
    """Return the smoothed x and v = dx/dtau of a record, piece by piece between its gaps, (sample,) each."""
    steps = np.diff(tau)
    # A step longer than this multiple of the median step is a gap, over which no spline is fitted.
    gaps = np.flatnonzero(steps > 2.5 * np.median(steps)) + 1
    x, v = angle.copy(), np.zeros_like(angle)
    for at in np.split(np.arange(len(tau)), gaps):
        try:
            x[at], v[at], _, _ = smooth(tau[at], angle[at])
        except (DecayError, ValueError):
            # With too few samples for a spline, fit a parabola: the iteration can start from it.
            parabola = Polynomial.fit(tau[at], angle[at], min(2, len(at) - 1))
            x[at], v[at] = parabola(tau[at]), parabola.deriv()(tau[at])
    return x, v


def linearised_along(model: Model, time: Array, motion: SimulatedMotion) -> LinearModel:
    """Linearise a motion of a model about itself, with columns for its start and the sensor's zero."""
    path = np.stack(
        [motion.position, motion.rate / model.reference_frequency, *motion.hidden.values()], axis=1
    )
    at_start = np.array([motion.position[0], motion.rate[0], 0.0])
    return linearised_about(model, (time, motion.angle), path, at_start)


def whitened(model: Model, time: Array, start: tuple[float, float], ratio: float, columns: Array) -> Array:
    """Return differences of a motion, (sample, column), as normalised innovations if a random force acts.

    Parameters
    ----------
    model, time, start
        Model, times (s), and start angle and rate (rad, rad/s) of the motion on which the random force acts.
    ratio : float
        Ratio of the random force's `RandomForce.per_tau` to the variance of a sample's noise; 0 for no random
        force.
    columns : (sample, column) array of float
        Differences of the sensor's reading from the motion, which the Kalman filter about the motion makes
        white.
    """
    if not ratio:
        return columns
    linear = linearised_along(model, time, trajectory(model, time, *start))
    steps, size = linear.path.shape[0] - 1, linear.path.shape[1]
    nothing = np.zeros((steps + 1, size, columns.shape[1]))
    shown = replace(linear, observed_parameters=columns, start=nothing[0], by_column=nothing[1:])
    return shown.rows(ratio).design


def linearised_about(
    model: Model,
    record: tuple[Array, Array],
    path: Array,
    per_run: Array,
    by: tuple[str, ...] = (),
    rate_error: Array | float = 0.0,
) -> LinearModel:
    """Linearise a record about a path, with columns for parameters, then for the start and the sensor's zero.

    Parameters
    ----------
    model : Model
        Forces and sensor terms at the present parameters.
    record : two (sample,) arrays of float, s and rad
        Time, with steps of any length, and angle.
    path : (sample, state) array of float
        x, v (rad), internal states, memory at each sample.
    per_run : (3,) array of float
        Angle (rad) and rate (rad/s) at the first sample, zero of the sensor (rad).
    by : tuple of str
        Coefficients and shape parameters; the reference frequency may follow as the last name.
    rate_error : float or (sample,) array of float, rad
        Standard error of v on the path: where forces switch with v, steps are averaged over this error.

    Raises
    ------
    SimulationError
        The motion between two samples cannot be computed.
    """
    (time, angle), w, size, count = record, model.reference_frequency, path.shape[1], len(by)
    motion, started = Motion(model.forces), path.copy()
    started[0] = motion.start(model, float(per_run[0]), float(per_run[1]) / w)[0][:size]
    steps = expected_steps(model, time, started, rate_error, by)
    by_column = np.pad(steps.sensitivity, ((0, 0), (0, 0), (0, 3)))
    start = np.zeros((size, count + 3))
    start[0, count], start[1, count + 1] = 1.0, 1.0 / w
    # The rate at the first sample is a parameter; the state is v = rate / w.
    start[1, :count] = [-started[0, 1] / w if name == FREQUENCY else 0.0 for name in by]
    shown, observed, by_sensor = sensor_on(model, time - time[0], started, by)
    observed_parameters = np.pad(by_sensor, ((0, 0), (0, 3)))
    observed_parameters[:, -1] = 1.0
    rest = angle - per_run[2] - shown
    return LinearModel(steps, started, rest, observed, observed_parameters, start, by_column)


def sensor_on(model: Model, elapsed: Array, path: Array, by: tuple[str, ...]) -> tuple[Array, Array, Array]:
    """Return the signal on a path without its zero (sample,), and its derivatives by state and names."""
    error, by_motion, by_names = sensor_error(model, elapsed, path[:, 0], path[:, 1], by)
    observed = np.zeros_like(path)
    observed[:, 0] = 1.0
    observed[:, :2] += by_motion
    return path[:, 0] + error, observed, by_names


# Largest degrees in the amplitude: of the resonant harmonic, and of the others (the mean force is of order
# zero).
RESONANT_DEGREES = 3
OTHER_DEGREES = 2
HARMONICS = (2, 3)
# Fraction of the diffusion of a free step below which friction holds the body, so that no force moves it.
HELD = 1e-9


def trial_forces(linear: LinearModel, tau: Array) -> tuple[Array, Array]:
    """Return harmonics of the phase times polynomials of the amplitude; the resonant one also drifts.

    Parameters
    ----------
    linear : LinearModel
        Linear model about the path, x = a cos(phase), v = -a sin(phase).
    tau : (sample,) array of float
        Instants, reference frequency times time.

    Returns
    -------
    by_column : (step, 2, column) array of float
        Increments of x and v at the end of a step due to each acceleration; the first acceleration is the
        angle.
    on : (column,) array of str
        The variable on which each depends: `angle` for a part in phase with the angle (a stiffness), `speed`
        for a part in phase with the speed (a friction), `time` for a change at the same amplitude.

    Notes
    -----
    A force f(x, v) on a decaying motion is such a series, namely its Fourier series on the cycle; its
    resonant part is the describing function. The force within a step is Simpson's mean, propagated by the
    free oscillator.
    """
    step = np.diff(tau)
    # Start from each sample and leave out the impulse of the step; otherwise the columns would contain the
    # target.
    first, last = _polar(linear.path[:-1]), _polar(linear.steps.end)
    last[0] = first[0] + (last[0] - first[0] + np.pi) % (2.0 * np.pi) - np.pi
    # Use a slow trend of the amplitude over time, because the random walk of the amplitude is due to the
    # random force.
    trend = Legendre.fit(tau[:-1], first[1], 5)
    span = trend(tau).min(), trend(tau).max()

    def at(polar: Array, when: Array) -> tuple[Array, list[str]]:
        return _series(polar, _scaled(trend(when), span), _scaled(when, (tau[0], tau[-1])))

    start, on = at(first, tau[:-1])
    middle, _ = at(0.5 * (first + last), 0.5 * (tau[:-1] + tau[1:]))
    end, _ = at(last, tau[1:])
    weight = step[:, None] / 6.0
    by_x = weight * (np.sin(step)[:, None] * start + 4.0 * np.sin(0.5 * step)[:, None] * middle)
    by_v = weight * (np.cos(step)[:, None] * start + 4.0 * np.cos(0.5 * step)[:, None] * middle + end)
    moves = linear.steps.diffusion[:, 1, 1] > HELD * step
    # Steps longer than this (rad of tau) are gaps; no path is known within them.
    by_column = np.stack([by_x, by_v], axis=1) * (moves & (step < 1.6))[:, None, None]
    return by_column, np.array(on)


def _polar(states: Array) -> Array:
    """Return the phase and amplitude of states, (2, state)."""
    return np.stack([np.arctan2(-states[:, 1], states[:, 0]), np.hypot(states[:, 0], states[:, 1])])


def _series(polar: Array, size: Array, elapsed: Array) -> tuple[Array, list[str]]:
    """Return the accelerations at some instants, (instant, column), and the variable each depends on.

    `polar` contains phase and amplitude; `size` and `elapsed` are amplitude and time scaled from -1 to 1.
    """
    phase, amplitude = polar
    degrees = legendre.legvander(size, RESONANT_DEGREES - 1).T
    cosine, sine = amplitude * np.cos(phase), amplitude * np.sin(phase)
    columns = [(part * degree, on) for degree in degrees for part, on in ((cosine, "angle"), (sine, "speed"))]
    columns += [(part * elapsed, "time") for part in (cosine, sine)]
    for degree in degrees[:OTHER_DEGREES]:
        columns.append((degree, "angle"))
        for m in HARMONICS:
            columns += [(degree * np.cos(m * phase), "angle"), (degree * np.sin(m * phase), "speed")]
    values, on = zip(*columns, strict=True)
    return np.stack(values, axis=1), list(on)


def _scaled(values: Array, limits: tuple[float, float]) -> Array:
    """Scale values from -1 at the lower limit to 1 at the upper."""
    low, high = limits
    return (2.0 * values - low - high) / max(high - low, 1e-12 * max(1.0, abs(high)))


def random_walk_about(linear: LinearModel, per_tau: float, normal: np.random.Generator, draws: int) -> Array:
    """Draw the contribution of a random force to a record about its path, (sample, draw), rad.

    Parameters
    ----------
    linear : LinearModel
    per_tau : float, rad^2
        Growth of the variance of v per unit of tau (see `RandomForce.per_tau`).
    normal : Generator
    draws : int

    Notes
    -----
    Deviations obey z[k+1] = F[k] z[k] + e[k] with the transitions F of the exact steps and the covariance
    per_tau D[k] of e[k]. This linear model of the filter is computed once for all draws.
    """
    variance, axes = np.linalg.eigh(per_tau * linear.steps.diffusion)
    # While friction holds the body, the variance is zero; rounding can make it negative.
    root = axes * np.sqrt(np.maximum(variance, 0.0))[:, None, :]
    samples, size = linear.path.shape
    source = np.zeros((samples, size, draws))
    source[1:] = root @ normal.standard_normal((samples - 1, size, draws))
    deviations = linear.recursion(np.zeros((samples, size)), source)
    return np.asarray(np.einsum("na,nad->nd", linear.observed, deviations))
