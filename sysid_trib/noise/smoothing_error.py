"""How well the speed of a motion is known that is pushed at random and seen by a noisy sensor."""

import numpy as np

from sysid_trib.noise.variance_ratio import VarianceRatio


def smoothed_rate_error(ratio: VarianceRatio, step: float) -> float:
    """Standard error of v = theta'/w of the smoothed motion, inside of a record.

    Parameters
    ----------
    ratio : VarianceRatio
        Growth q of the variance of v a unit of tau, over the variance of the sensor's noise in a sample.
    step : float
        Between two samples, in tau.

    Returns
    -------
    float, rad
        Zero without a random force.

    Notes
    -----
    Of an oscillator in white acceleration of (two-sided) spectral density q, in white noise of density
    r = variance * step, the best smoother leaves in x the spectral density 1/((1 - k^2)^2/q + 1/r)
    (Wiener 1949), k the frequency. The integral of k^2 times that over dk/(2 pi) is
    q / (2 sqrt(2 (sqrt(1 + q/r) - 1))): sqrt(q r)/2 where q is small.
    """
    by_sample = ratio.ratio / step
    if by_sample == 0.0:
        return 0.0
    # sqrt(1 + z) - 1 without cancellation.
    excess = by_sample / (np.sqrt(1.0 + by_sample) + 1.0)
    return float(np.sqrt(ratio.ratio * ratio.variance / (2.0 * np.sqrt(2.0 * excess))))
