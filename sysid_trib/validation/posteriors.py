"""Draws of an identification's parameters from their posterior, as arviz takes them."""

from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.stats import genpareto, multivariate_t

from sysid_trib.arrays import Array
from sysid_trib.errors import Tell, silent
from sysid_trib.motion_fit.least_squares import FreeLikelihood
from sysid_trib.motion_fit.parameters import PER_RUN
from sysid_trib.records.decay import Decays
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import PER_FORCE_UNIT, Variables, variable
from sysid_trib.simulation.integrate import FREQUENCY
from sysid_trib.validation.profiles import free_likelihood

# Degrees of freedom of the proposal, whose tails are heavier than the posterior's, and rounds in which its
# mean and covariance follow the weighted draws of the one before, so many in each.
PROPOSAL_TAILS, PROPOSALS, DRAWS_A_PROPOSAL = 5.0, 3, 600


class WeightedDraws(NamedTuple):
    """Draws of the free parameters, (draw, free), with the logarithms of their likelihood and weights."""

    values: Array
    log_likelihood: Array
    log_weight: Array

    @property
    def weight(self) -> Array:
        """Normalised."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return np.asarray(weight / weight.sum())


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
    DecayError
        A random force pushes the motion, or no motion follows the record.

    Notes
    -----
    The likelihood is that of `profile`. Draws come from a multivariate t about the best fit (Laplace), are
    weighted by the likelihood over its density, which is fitted to the weighted draws in two further rounds
    (Cappé et al. 2004), and are drawn again by their weights. Beyond a shape of 0.7 of the generalised Pareto
    distribution of the largest weights (Vehtari et al. 2024) the draws are not to be trusted.
    """
    likelihood, rng = free_likelihood(decay, result), np.random.default_rng(seed)
    free = likelihood.parameters.free
    centre, covariance = likelihood.best.values[free], likelihood.covariance[np.ix_(free, free)]
    for at in range(PROPOSALS):
        tell(f"round {at + 1}", at / PROPOSALS)
        count = max(DRAWS_A_PROPOSAL, draws * chains if at == PROPOSALS - 1 else 0)
        weighted = _weighted(likelihood, centre, covariance, count, rng)
        centre = weighted.weight @ weighted.values
        covariance = np.cov(weighted.values.T, aweights=weighted.weight)
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


def _weighted(
    likelihood: FreeLikelihood, centre: Array, covariance: Array, count: int, rng: np.random.Generator
) -> WeightedDraws:
    """Draws from a multivariate t with this centre and covariance, weighted by the likelihood."""
    parameters, size = likelihood.parameters, np.sqrt(np.diag(covariance))
    low, high = (limit[parameters.free] for limit in parameters.limits)
    proposal = multivariate_t(None, covariance / np.outer(size, size), PROPOSAL_TAILS, allow_singular=True)
    units = proposal.rvs(count, random_state=rng)
    values = centre + size * units
    inside = np.all((values >= low) & (values <= high), axis=1)
    log_likelihood = np.full(count, -np.inf)
    for at in np.flatnonzero(inside):
        log_likelihood[at] = -0.5 * likelihood.deviance(parameters.expand(values[at]))
    return WeightedDraws(values, log_likelihood, log_likelihood - proposal.logpdf(units))


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
