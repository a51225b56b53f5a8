"""Draws of an identification's parameters from their posterior, as arviz takes them."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.special import logsumexp, softmax
from scipy.stats import genpareto, multivariate_t

from sysid_trib.arrays import Array
from sysid_trib.errors import Tell, UsageError, silent
from sysid_trib.motion_fit.least_squares import FreeLikelihood
from sysid_trib.motion_fit.parameters import PER_RUN
from sysid_trib.records.decay import Decays
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import PER_FORCE_UNIT, Variables, variable
from sysid_trib.simulation.integrate import FREQUENCY
from sysid_trib.validation.profiles import free_likelihood

# Degrees of freedom of the proposal's parts, whose tails are heavier than the posterior's; draws of the two
# rounds that add a part each, and the least of the last; the fraction of draws from the part added last.
PROPOSAL_TAILS, FIRST_DRAWS, LEAST_DRAWS, NEW_PART = 10.0, (600, 600), 2000, 0.3
# The first step along a shape parameter, in errors, the growth of the next, the deviance at which the last is
# made, and how many there are each way.
SHAPE_STEP, SHAPE_GROWTH, FARTHEST_DEVIANCE, MOST_SHAPE_STEPS = 0.5, 1.15, 16.0, 30


# Centre and covariance of the free parameters in a part of the proposal, a multivariate t.
ProposalPart = tuple[Array, Array]


class WeightedDraws(NamedTuple):
    """Draws of the free parameters, (draw, free), their log likelihoods and weights; each part's share."""

    values: Array
    log_likelihood: Array
    weight: Array
    shares: Array


@in_units_of_the_motion
def posterior(
    decay: Decays,
    result: xr.Dataset,
    *,
    draws: int = 500,
    chains: int = 4,
    seed: int = 0,
    tell: Tell = silent,
) -> xr.DataTree:
    """Draw the parameters of an identification from their posterior, flat priors within their limits.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        The record, or the runs.
    result : Dataset
        An identification of it, whose forces, constraints and fitted shapes are those of the draws.
    draws, chains : int
        So many draws in so many chains; they are independent, chains are there for arviz.
    seed : int
        Of the draws.
    tell : callable
        Called with each round.

    Returns
    -------
    DataTree
        Group `posterior` over `chain` and `draw`: `coefficient(force)`, `shape(shape_parameter)` where shapes
        were fitted, `reference_frequency` (rad/s), and of each `run` `start_angle` (rad), `start_rate`
        (rad/s) and the sensor's `offset` (rad). Group `sample_stats`: `lp`, the logarithm of the likelihood
        over that of the best fit. attrs: `effective_sample_size` of the weights, their `pareto_k`.

    Raises
    ------
    UsageError
        No draws, or no chains.
    DecayError
        A random force pushes the motion, or no motion follows the record.

    Notes
    -----
    The likelihood is that of `profile`. Draws come from a mixture of multivariate t: about the best fit
    (Laplace), and about the best fit at each of some values of a shape parameter, along which the posterior
    need not be an ellipse (Tierney and Kadane 1986). They are weighted by the likelihood over the density of
    the mixture. Two rounds add a part with the mean and covariance of the weighted draws, and weigh the parts
    anew (Cappé et al. 2008); the draws of a third are drawn again by their weights. Beyond a shape of
    0.7 of the generalised Pareto distribution of the largest weights (Vehtari et al. 2024) the draws are not
    to be trusted.
    """
    if min(draws, chains) < 1:
        raise UsageError(f"A posterior has at least one draw and one chain, not {draws} in {chains}.")
    likelihood, rng = free_likelihood(decay, result), np.random.default_rng(seed)
    tell("fits along the shape parameters", 0.0)
    parts = _parts(likelihood)
    masses = np.full(len(parts), 1.0 / len(parts))
    for at, count in enumerate((*FIRST_DRAWS, max(LEAST_DRAWS, draws * chains))):
        tell(f"round {at + 1}", 0.1 + 0.2 * at)
        weighted = _weighted(likelihood, parts, masses, count, rng)
        # Roots: parts that hold little of the posterior are tried more often than they count.
        roots = np.sqrt(weighted.shares)
        masses = np.append((1.0 - NEW_PART) * roots / roots.sum(), NEW_PART)
        covariance = np.cov(weighted.values.T, aweights=weighted.weight)
        parts.append((weighted.weight @ weighted.values, covariance))
    # Systematic drawing by the weights, in an order that is none.
    cumulated = np.cumsum(weighted.weight)
    positions = (np.arange(draws * chains) + rng.uniform()) / (draws * chains)
    chosen = rng.permutation(np.minimum(np.searchsorted(cumulated, positions), count - 1))
    values = np.array([likelihood.parameters.expand(free) for free in weighted.values[chosen]])
    lp = weighted.log_likelihood[chosen].reshape(chains, draws)
    stats = xr.Dataset(
        {"lp": variable(("chain", "draw"), lp, "log likelihood over that of the best fit", "1")}
    )
    size = 1.0 / float(np.sum(weighted.weight**2))
    attrs = {"effective_sample_size": size, "pareto_k": _pareto_k(weighted.weight)}
    groups = {"posterior": _dataset(likelihood, values.reshape(chains, draws, -1)), "sample_stats": stats}
    return xr.DataTree.from_dict({name: group.assign_attrs(attrs) for name, group in groups.items()})


def _parts(likelihood: FreeLikelihood) -> list[ProposalPart]:
    """The proposal: parts about the best fit, and about those with a shape parameter held, far enough out."""
    parameters, best = likelihood.parameters, likelihood.best
    free = parameters.free
    parts = [(best.values[free], likelihood.covariance[np.ix_(free, free)])]
    shapes = [name for name in parameters.fit_shapes if parameters.index(name) in free]
    for name, sign in itertools.product(shapes, (-1.0, 1.0)):
        place, fit = parameters.index(name), best
        low, high = (limit[place] for limit in parameters.limits)
        step = sign * SHAPE_STEP * np.sqrt(likelihood.covariance[place, place])
        for _ in range(MOST_SHAPE_STEPS):
            held, before = {name: fit.values[place] + step}, fit.values
            if not low < held[name] < high or likelihood.deviance_of(fit) > FARTHEST_DEVIANCE:
                break
            fit, step = likelihood.holding(held, before), SHAPE_GROWTH * step
            # The others given the shape, which is as wide as the step to it.
            given = parameters.fix(held).covariance(fit.sensitivity, fit.values)
            given += np.outer(fit.values - before, fit.values - before)
            parts.append((fit.values[free], given[np.ix_(free, free)]))
    return parts


def _weighted(
    likelihood: FreeLikelihood,
    parts: Sequence[ProposalPart],
    masses: Array,
    count: int,
    rng: np.random.Generator,
) -> WeightedDraws:
    """Draws from a mixture of parts, so often from each, weighted by the likelihood over its density."""
    parameters, size = likelihood.parameters, np.sqrt(np.diag(parts[0][1]))
    low, high = (limit[parameters.free] for limit in parameters.limits)
    proposals = [
        multivariate_t(centre / size, covariance / np.outer(size, size), PROPOSAL_TAILS, allow_singular=True)
        for centre, covariance in parts
    ]
    pairs = zip(proposals, rng.multinomial(count, masses), strict=True)
    units = np.concatenate(
        [np.reshape(part.rvs(several, random_state=rng), (several, len(size))) for part, several in pairs]
    )
    log_parts = np.array([part.logpdf(units) for part in proposals])
    density = logsumexp(log_parts, axis=0, b=masses[:, None])
    values = size * units
    log_likelihood = np.full(count, -np.inf)
    for at in np.flatnonzero(np.all((values >= low) & (values <= high), axis=1)):
        log_likelihood[at] = -0.5 * likelihood.deviance(parameters.expand(values[at]))
    weight = softmax(log_likelihood - density)
    return WeightedDraws(values, log_likelihood, weight, masses * (np.exp(log_parts - density) @ weight))


def _pareto_k(weight: Array) -> float:
    """Shape of the generalised Pareto distribution of the largest weights."""
    tail = int(min(0.2 * len(weight), 3.0 * np.sqrt(len(weight))))
    ordered = np.sort(weight)
    return float(genpareto.fit((ordered[-tail:] - ordered[-tail - 1]) / ordered[-1], floc=0.0)[0])


def _dataset(likelihood: FreeLikelihood, values: Array) -> xr.Dataset:
    """The group `posterior` from draws of all parameters, (chain, draw, parameter)."""
    parameters, dims = likelihood.parameters, ("chain", "draw")
    symbols, shapes = list(parameters.library.symbols), list(parameters.fit_shapes)
    places = [parameters.index(name) for name in shapes]
    variables: Variables = {
        "coefficient": variable((*dims, "force"), values[..., : len(symbols)], "coefficient", PER_FORCE_UNIT)
    }
    if shapes:
        words = "shape parameter"
        variables["shape"] = variable((*dims, "shape_parameter"), values[..., places], words, "of the force")
    if parameters.reference_frequency is None:
        of_frequency = values[..., parameters.index(FREQUENCY)]
        variables["reference_frequency"] = variable(dims, of_frequency, "reference frequency w", "rad/s")
    runs = np.moveaxis(
        values[..., len(parameters.common) :].reshape(*values.shape[:2], -1, len(PER_RUN)), -1, 0
    )
    for name, of_runs, units in zip(PER_RUN, runs, ("rad", "rad/s", "rad"), strict=True):
        variables[name] = variable((*dims, "run"), of_runs, name.replace("_", " "), units)
    return xr.Dataset(variables, {"force": symbols} | ({"shape_parameter": shapes} if shapes else {}))
