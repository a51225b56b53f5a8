"""Coloured noise of the sensor as further states of a motion."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from sysid_trib.arrays import Array


@dataclass(frozen=True)
class SensorNoise:
    """Autoregressive noise of the sensor as further states: its last values, in units of its innovations.

    White noise has none.

    Attributes
    ----------
    filter_ : (order + 1,) array of float
        Whitens it.
    """

    filter_: Array

    @property
    def order(self) -> int:
        """Number of states."""
        return len(self.filter_) - 1

    @property
    def shown(self) -> Array:
        """What the sensor shows of the states, (order,)."""
        return np.eye(1, self.order)[0]

    @property
    def transition(self) -> Array:
        """Companion matrix (order, order)."""
        return np.concatenate([-self.filter_[None, 1:], np.eye(self.order)[:-1]])[: self.order]

    @property
    def driven(self) -> Array:
        """Covariance that each step adds, (order, order)."""
        return np.outer(self.shown, self.shown)

    @property
    def first(self) -> Array:
        """Covariance at the first sample: the stationary one, (order, order)."""
        if not self.order:
            return self.driven
        return np.asarray(solve_discrete_lyapunov(self.transition, self.driven))

    def behind(self, vectors: Array, further: Array) -> Array:
        """Vectors of states (..., state), with entries of these states behind them."""
        return np.concatenate([vectors, np.broadcast_to(further, (*vectors.shape[:-1], self.order))], axis=-1)

    def beside(self, matrices: Array, further: Array) -> Array:
        """Matrices of states (..., state, state), with a block of these states."""
        if not self.order:
            return matrices
        size = matrices.shape[-1]
        whole = np.zeros((*matrices.shape[:-2], size + self.order, size + self.order))
        whole[..., :size, :size] = matrices
        whole[..., size:, size:] = further
        return whole
