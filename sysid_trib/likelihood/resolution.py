"""What is too fine for splines and test functions: turns within a sample, a stiffness that varies."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from sysid_trib.arrays import Array
from sysid_trib.likelihood.sensor_noise import covariance_of_local_rows
from sysid_trib.likelihood.weak_form import WeakForm, cholesky_factor, log_determinant, noise_operator


@dataclass(frozen=True)
class FineMotion:
    """A motion from rest whose acceleration is constant within cells.

    Attributes
    ----------
    tau : (cell,) array of float
        Where each begins, increasing; the last has no end.
    acceleration : (cell,) array of float, rad
        Second derivative by tau.
    """

    tau: Array
    acceleration: Array

    @cached_property
    def _at_begin(self) -> tuple[Array, Array]:
        """Motion and its derivative where each cell begins, (cell,) each."""
        steps, bend = np.diff(self.tau), self.acceleration[:-1]
        speed = np.concatenate([[0.0], np.cumsum(bend * steps)])
        place = np.concatenate([[0.0], np.cumsum(speed[:-1] * steps + 0.5 * bend * steps**2)])
        return place, speed

    def value(self, tau: Array, order: int = 0) -> Array:
        """The motion or its derivative, (point,), rad; as it begins before the first cell."""
        if not len(self.tau):
            return np.zeros(len(tau))
        cell = np.clip(np.searchsorted(self.tau, tau, side="right") - 1, 0, None)
        since, bend = tau - self.tau[cell], self.acceleration[cell]
        place, speed = (values[cell] for values in self._at_begin)
        return np.asarray(speed + bend * since if order else place + speed * since + 0.5 * bend * since**2)

    def rescaled(self, part: float) -> "FineMotion":
        """The resolution over a time that runs faster by `part`."""
        return FineMotion(part * self.tau, self.acceleration / part**2)


NO_FINE_MOTION = FineMotion(np.empty(0), np.empty(0))


def fine_motion(tau: Array, acceleration: Array) -> FineMotion:
    """Motion of accelerations that are the means of cells about points, (point,) each."""
    return FineMotion(np.concatenate([tau[:1], 0.5 * (tau[1:] + tau[:-1])]), acceleration)


def unresolved(
    form: WeakForm, tau: Array, stiffness: Array, damping: Array, operator: sp.csr_matrix
) -> float:
    """By how much the logarithm of the determinant of the rows' white noise is too large.

    Parameters
    ----------
    form : WeakForm
    tau : (point,) array of float
    stiffness, damping : (point,) array of float
        Of small deviations.
    operator : (row, sample) sparse array of float
        Of these.

    Returns
    -------
    float
        0 where the stiffness is constant, or is resolved.

    Notes
    -----
    A slow modulation of the swing leaves nearly nothing in the rows, so that a small random force shows.
    Smooth test functions cannot follow a stiffness that jumps; then something is left, and it takes more of a
    random force to show. But the determinant of the equation of small deviations is known: it goes as that of
    the Gram matrix of its free motions with unit starts (Gelfand and Yaglom 1960; Forman 1987). So it is
    compared with that of the mean stiffness and damping, which are resolved.
    """
    even = np.linspace(tau[0], tau[-1], len(tau))
    k, d = (np.interp(even, tau, values) for values in (stiffness, damping))
    means = [np.full_like(values, np.mean(values)) for values in (k, d)]
    samples = operator.shape[1]
    constant = noise_operator(form, *(np.full(samples, mean[0]) for mean in means))
    with np.errstate(all="ignore"):
        # A motion that grows beyond all numbers says nothing.
        free = _log_determinant_of_free_motions(even, k, d) - _log_determinant_of_free_motions(even, *means)
    noise, resolved = (
        log_determinant(cholesky_factor(covariance_of_local_rows(rows))) for rows in (operator, constant)
    )
    excess = noise - resolved - free
    return max(0.0, excess) if np.isfinite(excess) else 0.0


def _log_determinant_of_free_motions(tau: Array, stiffness: Array, damping: Array) -> float:
    """Log determinant of the Gram matrix of the free motions with unit angle and unit rate."""
    step, count = tau[1] - tau[0], len(tau)
    half = 0.5 * step * damping
    # Central differences, each angle from the two before it: a lower triangular band.
    band = np.zeros((3, count))
    band[0, :2], band[0, 2:] = 1.0, 1.0 + half[1:-1]
    band[1, 1:-1], band[2, :-2] = step**2 * stiffness[1:-1] - 2.0, 1.0 - half[1:-1]
    start = np.zeros((count, 2))
    start[0] = 1.0, 0.0
    start[1] = 1.0 - 0.5 * step**2 * stiffness[0], step * (1.0 - half[0])
    try:
        motions = scipy.linalg.solve_banded((2, 0), band, start, check_finite=False)
    except np.linalg.LinAlgError:
        # What drives so strongly that steps do not follow it has no free motions to speak of.
        return float("nan")
    return float(np.linalg.slogdet(motions.T @ motions)[1])
