"""Steps of a motion from sample to sample, exact or expected.

Each interval starts at a state that is given (multiple shooting, Bock 1981), and is followed by the compiled
engine.

Where a force switches with the speed, the step about one path holds one branch, though either may be the
true one; of a body that friction nearly holds it claims that nothing moves it. The best linear step over the
law of the state has the mean of the ends and, as they are continuous in the state, the mean of their
derivatives (Stein 1981): statistical linearisation (Gelb 1974; Garcia-Fernandez, Svensson and Sarkka 2017).
"""

import numpy as np
from scipy.special import ndtri

from sysid_trib.arrays import Array
from sysid_trib.simulation.model import Model, Motion
from sysid_trib.simulation.motions import Steps, steps_of


def steps_over(model: Model, tau: Array, length: Array, states: Array, by: tuple[str, ...] = ()) -> Steps:
    """Exact motion over intervals of any length, with what a random force adds (see `steps_of`).

    Parameters
    ----------
    model : Model
    tau, length : (interval,) array of float
        Beginning and length of each.
    states : (interval, state) array of float
        At the beginnings.
    by : tuple of str
        Parameters by which the ends are derived.

    Raises
    ------
    SimulationError
        The motion diverges within an interval, or switches without end.
    """
    # In tau; longer intervals are followed in parts.
    parts = np.maximum(1, np.ceil(length / 0.5).astype(int))
    whole = steps_of(model, (tau, length / parts), states, by, diffuses=True)
    for done in range(1, int(parts.max(initial=1))):
        at = np.flatnonzero(parts > done)
        part = length[at] / parts[at]
        further = steps_of(model, (tau[at] + done * part, part), whole.end[at], by, diffuses=True)
        before = Steps(*(table[at] for table in vars(whole).values()))
        for table, longer in zip(vars(whole).values(), vars(before.then(further)).values(), strict=True):
            table[at] = longer
    return whole


# Speeds of equal probability that stand for the normal law.
SPEEDS = 8
_QUANTILES = ndtri((np.arange(SPEEDS) + 0.5) / SPEEDS)
NORMAL = _QUANTILES / np.sqrt(np.mean(_QUANTILES**2))
# A speed so many standard errors from zero has one sign.
ONE_SIGN = 4.0


def expected_steps(
    model: Model, time: Array, states: Array, rate_error: Array | float, by: tuple[str, ...] = ()
) -> Steps:
    """The motion over each interval between samples, of which v is known to a standard error alone.

    Parameters
    ----------
    model : Model
        Forces with coefficient zero are followed too.
    time : (sample,) array of float, s
        Increasing, with steps of any length.
    states : (sample, state) array of float
        x, v (rad), internal states and memory at each sample, from which the motion starts anew.
    rate_error : float or (sample,) array of float, rad
        Standard error of v at each sample; 0 where it is known.
    by : tuple of str
        Parameters by which the ends are derived.

    Raises
    ------
    SimulationError
        The motion diverges between two samples, or switches without end.
    """
    w = model.reference_frequency
    tau, length = w * (time[:-1] - time[0]), w * np.diff(time)
    steps = steps_over(model, tau, length, states[:-1], by)
    if not np.any(rate_error) or not any(switch.key == "v" for switch in Motion(model.forces).switches):
        return steps
    v, error = states[:, 1], np.broadcast_to(rate_error, len(states))
    near = np.minimum(np.abs(v[:-1]), np.abs(v[1:])) < ONE_SIGN * error[:-1]
    unsure = np.flatnonzero(near | (v[:-1] * v[1:] <= 0.0))
    begun = np.repeat(states[None, unsure], SPEEDS, axis=0)
    begun[:, :, 1] += np.multiply.outer(NORMAL, error[unsure])
    several = np.tile(unsure, SPEEDS)
    drawn = steps_over(model, tau[several], length[several], begun.reshape(-1, states.shape[1]), by)
    for certain, tables in zip(vars(steps).values(), vars(drawn).values(), strict=True):
        certain[unsure] = np.mean(tables.reshape(SPEEDS, len(unsure), *tables.shape[1:]), axis=0)
    return steps
