"""The motion from each sample to the next, exact and with its derivatives.

Each interval starts at a state that is given (multiple shooting, Bock 1981), and is followed by the compiled
engine. What a random force adds is the covariance of impulses within the interval, carried to its end by the
same derivatives, at Gauss's points.
"""

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.shooting import ends_of
from sysid_trib.state_space.steps import Steps

# In tau; longer intervals are followed in parts.
LONGEST_INTERVAL = 0.5
GAUSS_POINTS, GAUSS_WEIGHTS = (0.5 * part for part in np.polynomial.legendre.leggauss(3))
GAUSS_POINTS = GAUSS_POINTS + 0.5


def steps_over(model: Model, tau: Array, length: Array, states: Array, by: tuple[str, ...] = ()) -> Steps:
    """Exact motion over any intervals.

    Parameters
    ----------
    model : Model
    tau, length : (interval,) array of float
        Beginning and length of each.
    states : (interval, state) array of float
        At the beginnings.
    by : tuple of str
        Parameters by which the ends are derived.

    Returns
    -------
    Steps

    Raises
    ------
    SimulationError
        The motion diverges within an interval, or switches without end.
    """
    parts = np.maximum(1, np.ceil(length / LONGEST_INTERVAL).astype(int))
    whole = _followed(model, tau, length / parts, states, by)
    for done in range(1, int(parts.max(initial=1))):
        at = np.flatnonzero(parts > done)
        part = length[at] / parts[at]
        further = _followed(model, tau[at] + done * part, part, whole.end[at], by)
        onward = further.transition
        whole.end[at] = further.end
        whole.transition[at] = onward @ whole.transition[at]
        whole.sensitivity[at] = onward @ whole.sensitivity[at] + further.sensitivity
        whole.diffusion[at] = onward @ whole.diffusion[at] @ onward.swapaxes(1, 2) + further.diffusion
    return whole


def _followed(model: Model, tau: Array, length: Array, states: Array, by: tuple[str, ...]) -> Steps:
    """The same of short intervals, one after the other."""
    ends = ends_of(model, (tau, length), states, by, (GAUSS_POINTS, np.sqrt(GAUSS_WEIGHTS)))
    pushed = ends.impulses * np.sqrt(length)[:, None, None]
    return Steps(ends.end, ends.transition, ends.sensitivity, pushed @ pushed.swapaxes(1, 2))
