"""How probable candidates are in each other's place: how well each explains, and how narrowly set."""

from collections.abc import Sequence

import numpy as np
from scipy.integrate import trapezoid
from scipy.interpolate import Akima1DInterpolator

from sysid_trib.arrays import Array, Mask
from sysid_trib.discrepancy.baseline import Baseline
from sysid_trib.discrepancy.candidate_sensitivities import TrialCandidate, is_wide
from sysid_trib.discrepancy.frequency_parameters import has_frequency_parameter, is_frequency_parameter
from sysid_trib.forces.force import Force

# A tie class holds the truth with this probability, if it is among the candidates and all were as likely.
CREDIBLE = 0.95
# Of two candidates, one whose chi-square is higher by this is outside of the class.
APART = 2.0 * float(np.log(CREDIBLE / (1.0 - CREDIBLE)))
# What a shape parameter must gain in chi-square before it is fitted; a frequency is found among hundreds.
PRICE = 10.0
PRICE_OF_FREQUENCY = 20.0
# The chi-square over a shape is followed at so many of its values.
POINTS = 2000


def price_of(force: Force) -> float:
    """What a candidate's shapes must gain in chi-square to be worth a trial."""
    return sum(PRICE_OF_FREQUENCY if is_frequency_parameter(force, name) else PRICE for name in force.shape)


def probabilities(costs: Sequence[float]) -> Array:
    """Probability of each candidate, if one of them is the truth and all were as likely before.

    `costs` : (candidate,) -2 ln of the evidence for each, up to a common constant.
    """
    cost = np.asarray(costs, dtype=float)
    weight = np.exp(-0.5 * (cost - cost.min()))
    return np.asarray(weight / weight.sum())


def credible(probability: Array) -> Mask:
    """Which candidates are in the smallest set that holds the truth with the probability `CREDIBLE`."""
    order = np.argsort(-probability, kind="stable")
    before = np.cumsum(probability[order]) - probability[order]
    inside = np.zeros(len(probability), dtype=bool)
    inside[order] = before < CREDIBLE
    return inside


def over_shapes(trials: Sequence[TrialCandidate], left: Array) -> tuple[float, float]:
    """Least chi-square of one force over its shapes, and the price of having to set them.

    Parameters
    ----------
    trials : of one force; left : (trial,) the chi-square that each leaves.

    Notes
    -----
    The price is -2 ln of the mean of exp(-chi^2/2) over all shapes, above the least: the Occam factor of
    MacKay (1992). Shapes are as likely anywhere in their range, or in its logarithm where it spans a decade.
    """
    force = trials[0].force
    if not force.shape or has_frequency_parameter(force):
        return float(left.min()), price_of(force)
    if len(force.shape) > 1 or len(trials) < 3:
        least = float(left.min())
        return least, -2.0 * float(np.log(np.mean(np.exp(-0.5 * (left - least)))))
    ((name, shape),) = force.shape.items()
    values = np.array([trial.shapes[f"{force.symbol}.{name}"] for trial in trials])
    scale = np.log(values) if is_wide(shape) else values
    order = np.argsort(scale)
    fine = np.linspace(scale.min(), scale.max(), POINTS)
    along = Akima1DInterpolator(scale[order], left[order], method="makima")(fine)
    least = min(float(along.min()), float(left.min()))
    mean = trapezoid(np.exp(-0.5 * (along - least)), fine) / np.ptp(fine)
    return least, -2.0 * float(np.log(max(mean, 1e-12)))


def narrowness(fitted: Baseline, force: Force) -> float:
    """The price of an effect's own shapes, from their covariance in parts of their ranges (Laplace's method).

    A direction in which the shapes are not determined costs nothing.
    """
    if not force.shape or has_frequency_parameter(force):
        return price_of(force)
    parameters = fitted.problem.parameters
    names = [f"{force.symbol}.{name}" for name in force.shape]
    values = [fitted.values[parameters.index(name)] for name in names]
    spans = [
        abs(float(value)) * np.log(shape.high / shape.low) if is_wide(shape) else shape.high - shape.low
        for value, shape in zip(values, force.shape.values(), strict=True)
    ]
    parts = parameters.covariance_of(fitted.covariance, names) / np.outer(spans, spans)
    # A uniform distribution has a twelfth of its squared range as variance.
    _, price = np.linalg.slogdet(np.eye(len(names)) + np.linalg.pinv(12.0 * parts))
    return float(price)
