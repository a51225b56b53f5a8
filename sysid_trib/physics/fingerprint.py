"""The fingerprint of partial slip in a six-force model."""

import numpy as np
import xarray as xr
from scipy.stats import norm

from sysid_trib.errors import UsageError
from sysid_trib.physics.model_estimate import model_estimate
from sysid_trib.results.schema import library_of
from sysid_trib.results.significance import significant
from sysid_trib.results.variables import variable, with_error

# nu/delta of a contact that slips from its rim inwards.
SLIP_RATIO = -0.75 * np.pi
# Part of it by which the six forces may miss it: on simulated slip (kappa 0.005 to 0.2, zeta 0.002 and 0.01)
# they give -2.0 to -2.3, because the loops of a decay do not close and epsilon takes its share of nu.
ALLOWED = 0.1
# Below this p-value the ratio is another one.
FINGERPRINT_LEVEL = 0.01
# A ratio tells something if its quadratic friction is so many errors from zero, and it is known this well.
SIGNIFICANT_FRICTION = 3.0
SHARP = 1.0 / 3.0
# Conservative forces of a contact, to leading orders: another one changes the stiffness with amplitude too.
CONTACT_STIFFNESS = ("x", "x*abs(x)", "x**3")


def speaks_of_slip(result: xr.Dataset) -> bool:
    """Whether the ratio nu/delta of an identification can say anything of partial slip.

    Parameters
    ----------
    result : Dataset
        An identification.

    Notes
    -----
    Partial slip is a loop of Masing's kind about a backbone k x - kappa x^2 (see `slip_fingerprint`): it has
    a contact with a stiffness k > 0, takes energy (delta > 0) and softens (nu < 0). So the ratio speaks of
    slip only where the contact's stiffness was measured, beside the frequency without contact; where nu and
    delta are both significant; and where nothing else changes the stiffness with amplitude, as gravity or a
    magnet.
    """
    library = library_of(result)
    roles = [library.role(formula) for formula in ("x", "x*abs(x)", "v*abs(v)")]
    if any(force is None for force in roles):
        return False
    if any(f.character == "conservative" and not any(map(f.matches, CONTACT_STIFFNESS)) for f in library):
        return False
    at = [library.symbols.index(force.symbol) for force in roles if force is not None]
    return bool(np.all(significant(result)[at]) and np.all(result.coefficient.values[at] * [1, -1, 1] > 0.0))


def slip_fingerprint(result: xr.Dataset) -> xr.Dataset:
    """Hold the ratio nu/delta against that of partial slip, -3 pi/4.

    Parameters
    ----------
    result : Dataset
        An identification with the forces of formulas `x*abs(x)` (nu) and `v*abs(v)` (delta).

    Returns
    -------
    Dataset
        `ratio` and its standard error, `slip_ratio` = -3 pi/4, `allowance` (a tenth of it, by which six
        forces miss the ratio of a slipping contact), `z` and `p_value` of the difference with both,
        `significance` of delta (its size over its error). attrs: `verdict`, which is `compatible`, `not
        compatible` or `undecided` (the errors allow anything), and `numerator`, `denominator`, their symbols.

    Raises
    ------
    UsageError
        Not an identification, or one of the two forces is missing.

    Notes
    -----
    A hysteresis of Masing's kind with the backbone k x - kappa x^2 (Mindlin's partial slip to leading order)
    looks like delta = kappa/2 and nu = -3 pi kappa/8. z tests nu + (3 pi/4) delta = 0, which is sound also
    where delta is not significant and the ratio has no symmetric error (Fieller). A nu of another cause, as a
    magnet's, hides the fingerprint.
    """
    estimate = model_estimate(result)
    roles = [estimate.library.role(formula) for formula in ("x*abs(x)", "v*abs(v)")]
    if roles[0] is None or roles[1] is None:
        raise UsageError("The fingerprint of slip needs forces of formulas x*abs(x) and v*abs(v).")
    symbols = [force.symbol for force in roles if force is not None]
    at = [estimate.symbols.index(symbol) for symbol in symbols]
    (nu, delta), covariance = estimate.coefficients[at], estimate.coefficient_covariance[np.ix_(at, at)]
    combination = np.array([1.0, -SLIP_RATIO])
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = nu / delta
        slope = np.array([1.0, -ratio]) / delta
        error = np.sqrt(slope @ covariance @ slope)
        variance = combination @ covariance @ combination + (ALLOWED * SLIP_RATIO * delta) ** 2
        z = (combination @ [nu, delta]) / np.sqrt(variance)
        significance = delta / np.sqrt(covariance[1, 1])
    p_value = 2.0 * norm.sf(abs(z))
    known = abs(significance) >= SIGNIFICANT_FRICTION and error <= SHARP * abs(SLIP_RATIO)
    # Slip takes energy: a quadratic friction that feeds it in is another thing.
    other = p_value < FINGERPRINT_LEVEL or significance <= -SIGNIFICANT_FRICTION
    verdict = "not compatible" if other else "compatible" if known else "undecided"
    numbers = (
        ("slip_ratio", SLIP_RATIO, "ratio of partial slip"),
        ("allowance", ALLOWED * abs(SLIP_RATIO), "error of the ratio as a fingerprint"),
        ("z", z, "difference from partial slip over its error"),
        ("p_value", p_value, "p-value of partial slip"),
        ("significance", abs(significance), f"size of {symbols[1]} over its standard error"),
    )
    data = with_error("ratio", (), (ratio, error), f"{symbols[0]}/{symbols[1]}")
    data |= {name: variable((), float(value), long_name, "1") for name, value, long_name in numbers}
    attrs = {"verdict": verdict, "numerator": symbols[0], "denominator": symbols[1]}
    return xr.Dataset(data, attrs=attrs)
