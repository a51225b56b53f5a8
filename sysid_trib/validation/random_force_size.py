"""Whether the size of a random force depends on amplitude, speed or time."""

import numpy as np
from scipy.stats import f as f_distribution, t as t_distribution

from sysid_trib.arrays import Array
from sysid_trib.validation.likelihood_gain import TrialModel, orthonormal

SIZE_ON = ("amplitude", "speed", "time")


def size_p_values(trial: TrialModel, ratio: float, tau: Array) -> dict[str, float]:
    """P-values of a random force whose size depends on nothing, by what it may depend on, and of `any`.

    Parameters
    ----------
    trial : TrialModel
        With records of noise alone at the ratio.
    ratio : float
        Of the two variances.
    tau : (sample,) array of float
        Instants, reference frequency times time.

    Notes
    -----
    The statistic is the mean of amplitude, speed over amplitude, or time, over the steps, each weighted by
    the squared smoothed disturbance r' Q r (Durbin and Koopman 2012, 4.5); together they make Hotelling's
    T^2.
    """
    weights = _disturbances(trial, ratio)
    path = trial.linear.path
    amplitude = np.hypot(path[:, 0], path[:, 1])
    on = np.stack([amplitude, np.abs(path[:, 1]) / np.maximum(amplitude, 1e-300), tau])
    on = 0.5 * (on[:, :-1] + on[:, 1:])
    on = (on - on.mean(axis=1, keepdims=True)) / np.maximum(on.std(axis=1, keepdims=True), 1e-300)
    means = on @ weights / np.sum(weights, axis=0)
    measured, null = means[:, 0], means[:, 1:]
    draws = null.shape[1]
    excess = measured - null.mean(axis=1)
    # Mean and covariance are those of `draws` records: the measured one differs from them by a bit more.
    covariance = (1.0 + 1.0 / draws) * np.cov(null)
    z = excess / np.sqrt(np.diag(covariance))
    p_values = 2.0 * t_distribution.sf(np.abs(z), draws - 1)
    size = len(excess)
    squared = float(excess @ np.linalg.pinv(covariance) @ excess)
    joint = f_distribution.sf(squared * (draws - size) / (size * (draws - 1)), size, draws - size)
    return {**dict(zip(SIZE_ON, p_values.tolist(), strict=True)), "any": float(joint)}


def _disturbances(trial: TrialModel, ratio: float) -> Array:
    """Squared smoothed disturbances of the steps, the measured record first: (step, 1 + draw)."""
    nuisances, _, records, _ = trial.white(ratio)
    basis = orthonormal(nuisances)
    white = records - basis @ (basis.T @ records)
    linear = trial.linear
    gain, variance = linear.gains(ratio)
    observed, _ = linear.with_sensor_states
    source = observed[:, :, None] * (white / np.sqrt(variance)[:, None])[:, None, :]
    # The states of coloured noise are no motion.
    smoothed = linear.recursion(gain, source, backward=True)[1:, : linear.path.shape[1]]
    return np.asarray(np.einsum("kad,kab,kbd->kd", smoothed, linear.steps.diffusion, smoothed, optimize=True))
