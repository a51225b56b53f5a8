"""Which coefficients differ from zero, alone and together; the Birge ratio of residuals."""

from itertools import combinations

import numpy as np
import xarray as xr
from scipy.stats import chi2

from sysid_trib.arrays import Array, Mask


def birge_ratio(chi_square: float, degrees_of_freedom: int) -> float:
    """Root of the reduced chi-square (Birge 1932); 1 where the model leaves but the noise.

    Parameters
    ----------
    chi_square : float
        Sum of the squared residuals over their standard errors.
    degrees_of_freedom : int
        Number of residuals without that of the parameters.
    """
    return float(np.sqrt(chi_square / max(1, degrees_of_freedom)))


# A coefficient of fewer standard errors may be zero (99.7 % of a Gaussian).
SIGNIFICANT_ERRORS = 3.0
# The same as a probability.
BY_CHANCE = float(chi2.sf(SIGNIFICANT_ERRORS**2, 1))


def significant(result: xr.Dataset) -> Mask:
    """True where a coefficient differs from zero; one that is held is as large as it was given.

    Parameters
    ----------
    result : Dataset
        An identification.

    Returns
    -------
    (force,) array of bool
    """
    size, error = np.abs(result.coefficient.values), result.standard_error.values
    return np.asarray(result.active.values & (size > 0.0) & (size >= SIGNIFICANT_ERRORS * error), dtype=bool)


def determines(result: xr.Dataset) -> bool:
    """True if the record decides anything of the forces: one coefficient, or all together, differ from zero.

    Forces that a record does not separate have errors as large as they are, though it needs one of them.
    """
    return bool(significant(result).any()) or bool(sufficient_forces(result))


def sufficient_forces(result: xr.Dataset) -> list[dict[str, tuple[float, float]]]:
    """The fewest forces that suffice: their coefficients and standard errors by symbol, the likeliest first.

    Parameters
    ----------
    result : Dataset
        An identification.

    Returns
    -------
    list of dict of str to (float, float)
        Nothing where all may be zero together, or where some are held.

    Notes
    -----
    Conditional mean and covariance of those that are kept where the others are zero: the others have no
    significant sum of squares (Wald 1943).
    """
    size, count = result.standard_error.values, result.sizes["force"]
    # All choices among more forces are not gone through.
    if count > 10 or not np.all(result.active.values & (size > 0.0) & np.isfinite(size)):
        return []
    score, correlation = result.coefficient.values / size, result.covariance.values / np.outer(size, size)
    for kept in range(count + 1):
        choices = [np.isin(np.arange(count), choice) for choice in combinations(range(count), kept)]
        squares = [_sum_of_squares(score, correlation, ~choice) for choice in choices]
        allowed = chi2.isf(BY_CHANCE, max(1, count - kept))
        if min(squares) <= allowed:
            break
    likely = [choices[at] for at in np.argsort(squares) if squares[at] <= allowed]
    return [_where_others_are_zero(result, score, correlation, choice) for choice in likely if choice.any()]


def _sum_of_squares(score: Array, correlation: Array, dropped: Mask) -> float:
    """Chi square of coefficients that would be zero."""
    part = score[dropped]
    return float(part @ np.linalg.pinv(correlation[np.ix_(dropped, dropped)]) @ part)


def _where_others_are_zero(
    result: xr.Dataset, score: Array, correlation: Array, kept: Mask
) -> dict[str, tuple[float, float]]:
    gain = correlation[np.ix_(kept, ~kept)] @ np.linalg.pinv(correlation[np.ix_(~kept, ~kept)])
    variance = np.diag(correlation[np.ix_(kept, kept)] - gain @ correlation[np.ix_(~kept, kept)])
    size, symbols = result.standard_error.values[kept], result.force.values[kept].tolist()
    values, errors = size * (score[kept] - gain @ score[~kept]), size * np.sqrt(np.maximum(variance, 0.0))
    return dict(zip(symbols, zip(values.tolist(), errors.tolist(), strict=True), strict=True))
