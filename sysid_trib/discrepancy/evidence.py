"""One evidence of a fitted model, by which it is named, exchanged, shortened and ranked."""

from collections.abc import Sequence

import numpy as np
from scipy.special import log_ndtr

from sysid_trib.arrays import Array, Mask
from sysid_trib.forces.force import Force
from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.likelihood_fit.trials import reference_power


def evidence(model: FittedModel, effects: Sequence[str]) -> float:
    """Minus twice the logarithm of the evidence of a model, for its effects beside those of the start.

    Parameters
    ----------
    model : FittedModel
    effects : sequence of str
        Symbols beside the start model's.

    Notes
    -----
    Laplace's approximation (MacKay 1992; Kass and Raftery 1995). The prior of a coefficient holds the
    information of one row (unit information), which makes its factor the number of rows; where physics fixes
    its sign, the prior is on that half line alone; where physics knows it, being off is paid for by what
    holding it there would raise the deviance. Shapes are as likely anywhere in their range, or in its
    logarithm where that spans a decade: their factor is the part of the range that the record leaves, which
    is not more than all of it; of one at an end of its range the part inside of it.
    """
    total = model.deviance
    for symbol in effects:
        at, *shapes = model.columns_of(symbol)
        total += least_penalty(model, [model.trials[at].force]) + errors_off(model, symbol) ** 2
        if shapes:
            covariance = model.likelihood.covariance[np.ix_(shapes, shapes)]
            within = np.linalg.pinv(2.0 * np.pi * covariance, hermitian=True)
            total += float(np.linalg.slogdet(np.eye(len(shapes)) + within)[1])
            total += sum(_at_end(*model.at_ends[shape]) for shape in shapes if shape in model.at_ends)
    return float(total)


def errors_off(model: FittedModel, symbol: str) -> float:
    """By how many of its errors a coefficient differs from the one that physics knows; 0 where it knows none.

    Both refer to the model's own frequency, from which that of its paths may be far.
    """
    at, count = model.columns_of(symbol)[0], len(model.trials)
    force, squared = model.trials[at].force, 1.0 + model.stiffness
    if force.coefficient is None or squared <= 0.0:
        return 0.0
    half = 0.5 * reference_power(force)
    referred, slope = model.coefficients[at] * squared**half, np.zeros(model.columns)
    slope[at] = squared**half
    if model.frequency_free:
        slope[count] = referred * half / squared
    error = float(np.sqrt(slope @ model.likelihood.covariance @ slope))
    return abs(float(referred) - force.coefficient) / error if error > 0.0 else 0.0


def _at_end(beyond_end: float, error: float) -> float:
    """Minus twice the logarithm of the part of its range that a record leaves to a shape at an end of it.

    That of a Gaussian likelihood whose middle is outside, over what it is at the end.
    """
    if not 0.0 < error < np.inf:
        return 0.0
    near, far = log_ndtr(-beyond_end / error), log_ndtr(-(1.0 + beyond_end) / error)
    inside = near + np.log1p(-np.exp(far - near))
    return float(
        -2.0 * (np.log(error) + 0.5 * np.log(2.0 * np.pi) + 0.5 * (beyond_end / error) ** 2 + inside)
    )


def least_penalty(model: FittedModel, forces: Sequence[Force]) -> float:
    """What so many effects add to the evidence of a model of the same rows, their shapes aside."""
    rows = sum(rows.path.form.rows for rows in model.rows)
    return float(sum(np.log(rows) - 2.0 * np.log(2.0) * force.passive for force in forces))


def probabilities(costs: Sequence[float]) -> Array:
    """Probability of each model, (model,), if one of them is the truth and all were as likely before.

    `costs` : (model,) minus twice the logarithm of the evidence of each, up to a common constant.
    """
    values = np.asarray(costs, dtype=float)
    weight = np.exp(-0.5 * (values - values.min()))
    return np.asarray(weight / weight.sum())


def credible(probability: Array, part: float) -> Mask:
    """Which models are in the smallest set that holds the truth with the probability `part`."""
    order = np.argsort(-probability, kind="stable")
    before = np.cumsum(probability[order]) - probability[order]
    inside = np.zeros(len(probability), dtype=bool)
    inside[order] = before < part
    return inside
