"""What a step of the motion from one sample to the next is, beside the state that it ends in."""

from dataclasses import dataclass

from sysid_trib.arrays import Array


@dataclass(frozen=True)
class Steps:
    """Exact motion over each interval between samples, from states that are given at its beginning.

    The state is x, v (rad), then the internal states of the forces, then their memory (`Motion.variables`,
    `Motion.memory`).

    Attributes
    ----------
    end : (step, state) array of float
        State at the end of each interval.
    transition : (step, state, state) array of float
        Derivative of the end by the beginning.
    sensitivity : (step, state, parameter) array of float
        Derivative of the end by the parameters that were asked for, the beginning (x, v, ...) held.
    diffusion : (step, state, state) array of float
        Covariance of the end by a white acceleration that makes the variance of v grow by one a unit of tau.
    """

    end: Array
    transition: Array
    sensitivity: Array
    diffusion: Array
