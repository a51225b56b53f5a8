"""Steps of a motion whose speed is not known exactly: their mean over the normal law of the speed.

Where a force switches with the speed, the step about one path holds one branch, though either may be the
true one; of a body that friction nearly holds it claims that nothing moves it. The best linear step over the
law of the state has the mean of the ends and, as they are continuous in the state, the mean of their
derivatives (Stein 1981): statistical linearisation (Gelb 1974; Garcia-Fernandez, Svensson and Sarkka 2017).
"""

from dataclasses import fields

import numpy as np
from scipy.special import ndtri

from sysid_trib.arrays import Array
from sysid_trib.simulation.equations import Motion
from sysid_trib.simulation.integrate import FREQUENCY
from sysid_trib.simulation.model import Model
from sysid_trib.state_space.intervals import steps_over
from sysid_trib.state_space.steps import Steps

# Speeds of equal probability that stand for the normal law.
SPEEDS = 8
_QUANTILES = ndtri((np.arange(SPEEDS) + 0.5) / SPEEDS)
NORMAL = _QUANTILES / np.sqrt(np.mean(_QUANTILES**2))
# A speed so many standard errors from zero has one sign.
ONE_SIGN = 4.0


def expected_steps(
    model: Model,
    time: Array,
    states: Array,
    rate_error: Array | float,
    names: tuple[str, ...] = (),
    *,
    frequency: bool = False,
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
    names : tuple of str
        Coefficients and shape parameters by which the end is derived.
    frequency : bool
        Whether it is derived by the reference frequency too, which comes last.

    Returns
    -------
    Steps

    Raises
    ------
    SimulationError
        The motion diverges between two samples, or switches without end.
    """
    w = model.reference_frequency
    by = (*names, FREQUENCY) if frequency else names
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

    def averaged(certain: Array, drawn: Array) -> Array:
        whole = certain.copy()
        whole[unsure] = np.mean(drawn.reshape(SPEEDS, len(unsure), *drawn.shape[1:]), axis=0)
        return whole

    parts = [field_.name for field_ in fields(Steps)]
    return Steps(**{name: averaged(getattr(steps, name), getattr(drawn, name)) for name in parts})
