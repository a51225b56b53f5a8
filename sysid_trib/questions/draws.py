"""Draws of an identification's parameters: their posterior, and simultaneous bands of the model's curves."""

import itertools
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import scipy
import xarray as xr
from scipy.special import logsumexp, softmax

from sysid_trib.arrays import Array
from sysid_trib.cycles.averaged_motion import averaged_rates, predict_envelope
from sysid_trib.cycles.smooth_curve import BAND_PROBABILITY, simultaneous_factor
from sysid_trib.errors import DecayError, SysidTribError, Tell, UsageError, silent
from sysid_trib.motion_fit.least_squares import Fit, covariance_root
from sysid_trib.motion_fit.parameters import PER_RUN
from sysid_trib.questions.profiles import free_likelihood
from sysid_trib.records.decay import Decays
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import described
from sysid_trib.simulation.model import FREQUENCY

# Degrees of freedom of the proposal's parts, whose tails are heavier than the posterior's; draws of the two
# rounds that add a part each, and the least of the last; the fraction of draws from the part added last.
PROPOSAL_TAILS, FIRST_DRAWS, LEAST_DRAWS, NEW_PART = 10.0, (600, 600), 2000, 0.3
# The first step along a shape parameter, in errors, the growth of the next, the deviance at which the last is
# made, and how many there are each way.
SHAPE_STEP, SHAPE_GROWTH, FARTHEST_DEVIANCE, MOST_SHAPE_STEPS = 0.5, 1.15, 16.0, 30
# Draws of a band's factor, and points of the curves that are no motion.
CURVE_DRAWS, CURVE_GRID = 4000, 60
MODEL_CURVES = ("angle", "envelope", "frequency", "damping_ratio")
# Centre and covariance of the free parameters in a part of the proposal, a multivariate t.
ProposalPart: TypeAlias = tuple[Array, Array]


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
        values, log_likelihood, log_parts = _drawn(likelihood, parts, masses, count, rng)
        density = logsumexp(log_parts, axis=0, b=masses[:, None])
        weight = softmax(log_likelihood - density)
        # Roots: parts that hold little of the posterior are tried more often than they count.
        roots = np.sqrt(masses * (np.exp(log_parts - density) @ weight))
        masses = np.append((1.0 - NEW_PART) * roots / roots.sum(), NEW_PART)
        parts.append((weight @ values, np.cov(values.T, aweights=weight)))
    # Systematic drawing by the weights, in an order that is none.
    positions = (np.arange(draws * chains) + rng.uniform()) / (draws * chains)
    chosen = rng.permutation(np.minimum(np.searchsorted(np.cumsum(weight), positions), count - 1))
    kept = np.array([likelihood.parameters.expand(free) for free in values[chosen]])
    lp = described("posterior", {"lp": log_likelihood[chosen].reshape(chains, draws)})
    # Shape of the generalised Pareto distribution of the largest weights.
    tail, ordered = int(min(0.2 * count, 3.0 * np.sqrt(count))), np.sort(weight)
    pareto_k = scipy.stats.genpareto.fit((ordered[-tail:] - ordered[-tail - 1]) / ordered[-1], floc=0.0)[0]
    attrs = {"effective_sample_size": 1.0 / float(np.sum(weight**2)), "pareto_k": float(pareto_k)}
    drawn = _dataset(likelihood, kept.reshape(chains, draws, -1)).assign_attrs(attrs)
    return xr.DataTree.from_dict({"posterior": drawn, "sample_stats": xr.Dataset(lp, attrs=attrs)})


def _parts(likelihood: Fit) -> list[ProposalPart]:
    """The proposal: parts about the best fit, and about those with a shape parameter held, far enough out."""
    parameters = likelihood.parameters
    free = parameters.free
    parts = [(likelihood.values[free], likelihood.covariance[np.ix_(free, free)])]
    shapes = [name for name in parameters.fit_shapes if parameters.index(name) in free]
    for name, sign in itertools.product(shapes, (-1.0, 1.0)):
        place, fit = parameters.index(name), likelihood
        low, high = (limit[place] for limit in parameters.limits)
        step = sign * SHAPE_STEP * np.sqrt(likelihood.covariance[place, place])
        for _ in range(MOST_SHAPE_STEPS):
            held, before = {name: fit.values[place] + step}, fit.values
            if not low < held[name] < high or likelihood.deviance_of(fit) > FARTHEST_DEVIANCE:
                break
            fit, step = likelihood.holding(held, before), SHAPE_GROWTH * step
            # The others given the shape, which is as wide as the step to it.
            given = fit.covariance + np.outer(fit.values - before, fit.values - before)
            parts.append((fit.values[free], given[np.ix_(free, free)]))
    return parts


def _drawn(
    likelihood: Fit,
    parts: Sequence[ProposalPart],
    masses: Array,
    count: int,
    rng: np.random.Generator,
) -> tuple[Array, Array, Array]:
    """Draws from a mixture of parts, so often from each: (draw, free); their log likelihoods, (draw,).

    And the logarithms of the densities of the parts there, (part, draw).
    """
    parameters, size = likelihood.parameters, np.sqrt(np.diag(parts[0][1]))
    low, high = (limit[parameters.free] for limit in parameters.limits)
    proposals = [
        scipy.stats.multivariate_t(
            centre / size, covariance / np.outer(size, size), PROPOSAL_TAILS, allow_singular=True
        )
        for centre, covariance in parts
    ]
    pairs = zip(proposals, rng.multinomial(count, masses), strict=True)
    units = np.concatenate(
        [np.reshape(part.rvs(several, random_state=rng), (several, len(size))) for part, several in pairs]
    )
    values, log_likelihood = size * units, np.full(count, -np.inf)
    for at in np.flatnonzero(np.all((values >= low) & (values <= high), axis=1)):
        log_likelihood[at] = -0.5 * likelihood.deviance(parameters.expand(values[at]))
    return values, log_likelihood, np.array([part.logpdf(units) for part in proposals])


def _dataset(likelihood: Fit, values: Array) -> xr.Dataset:
    """The group `posterior` from draws of all parameters, (chain, draw, parameter)."""
    parameters = likelihood.parameters
    symbols, shapes = list(parameters.library.symbols), list(parameters.fit_shapes)
    drawn = {"coefficient": values[..., : len(symbols)]}
    if shapes:
        drawn["shape"] = values[..., [parameters.index(name) for name in shapes]]
    if parameters.reference_frequency is None:
        drawn["reference_frequency"] = values[..., parameters.index(FREQUENCY)]
    per_run = values[..., len(parameters.common) :].reshape(*values.shape[:2], -1, len(PER_RUN))
    drawn |= dict(zip(PER_RUN, np.moveaxis(per_run, -1, 0), strict=True))
    coords = {"force": symbols} | ({"shape_parameter": shapes} if shapes else {})
    return xr.Dataset(described("posterior", drawn), coords)


@in_units_of_the_motion
def curve_bands(decay: Decays, result: xr.Dataset, *, run: int = 0, seed: int = 0) -> xr.Dataset:
    """Curves of an identified model with bands that hold each as a whole in 95 % of records.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        The record, or the runs.
    result : Dataset
        An identification of it, whose forces, constraints and shapes are those of the fit.
    run : int
        Which run's motion and envelope.
    seed : int
        Of the draws.

    Returns
    -------
    Dataset
        `angle(time)` as the sensor shows it, `envelope(envelope_time)`, and over `amplitude` the `frequency`
        (rad/s) and the `damping_ratio`, each with its `..._standard_error` and the ends of its band,
        `..._low` and `..._high`; attrs `factor_...`: half width over the standard error.

    Raises
    ------
    UsageError
        There is no such run.
    DecayError
        A random force pushes the motion, no motion follows the record, or a model within the errors has none.

    Notes
    -----
    The fit of the motion, its parameters drawn with their covariance, also the start and the sensor's zero;
    curves follow them by differences of a standard error each way. A band is the curve ± a multiple of its
    pointwise standard error, which 95 % of the drawn curves do not exceed anywhere (sup-t; Montiel Olea and
    Plagborg-Møller 2019). Curves but the motion are averages over a cycle. The bands know the error of the
    noise, not that of the model: of a model that lacks something they hold its own curves, not the system's.
    """
    likelihood = free_likelihood(decay, result)
    records = likelihood.problem.records
    if run not in range(len(records)):
        raise UsageError(f"There is no run {run}; the runs of these records are 0 to {len(records) - 1}.")
    time = records[run].time
    coarse = np.linspace(time[0], time[-1], CURVE_GRID)
    values = likelihood.values
    # One standard error each way along the axes of the covariance: a kink counts as in the mean.
    root = covariance_root(likelihood.covariance)
    steps = root.T[np.any(root != 0.0, axis=0)]
    try:
        best = _curves(likelihood, values, run, coarse, None)
        up, down = (
            [_curves(likelihood, values + sign * step, run, coarse, best[-1]) for step in steps]
            for sign in (1.0, -1.0)
        )
    except SysidTribError as why:
        raise DecayError(f"Within its errors this model need not have a motion: {why}") from None
    coords = {"time": time, "envelope_time": coarse, **described("curve_bands", {"amplitude": best[-1]})}
    made: dict[str, Any] = {}
    attrs = {"confidence": BAND_PROBABILITY}
    normal = np.random.default_rng(seed).standard_normal((CURVE_DRAWS, len(steps)))
    for at, name in enumerate(MODEL_CURVES):
        root = 0.5 * np.array([more[at] - less[at] for more, less in zip(up, down, strict=True)])
        error = np.linalg.norm(root, axis=0)
        unit = root / np.where(error > 0.0, error, np.inf)
        # Draw by draw: a table of all draws of a long record would not fit.
        factor = simultaneous_factor(np.array([[np.max(np.abs(draw @ unit))] for draw in normal]))
        made[name] = best[at], error
        made |= {f"{name}_low": best[at] - factor * error, f"{name}_high": best[at] + factor * error}
        attrs[f"factor_{name}"] = factor
    return xr.Dataset(described("curve_bands", made), coords, attrs)


def _curves(
    likelihood: Fit, values: Array, run: int, time: Array, amplitudes: Array | None
) -> tuple[Array, ...]:
    """The curves of these parameters, in the order of `MODEL_CURVES`, and the amplitudes of the last two."""
    parameters, record = likelihood.parameters, likelihood.problem.records[run]
    model, (angle, rate, _) = parameters.model(values, run), parameters.per_run(values)[run]
    motion = record.angle + record.residual(model, parameters.per_run(values)[run])
    release = float(np.hypot(angle, rate / model.reference_frequency))
    envelope = predict_envelope(model, time, release).amplitude.values
    if amplitudes is None:
        amplitudes = np.geomspace(max(envelope.min(), 1e-2 * release), release, CURVE_GRID)
    change, frequency = averaged_rates(model)(amplitudes)
    return motion, envelope, frequency, -change / (amplitudes * frequency), amplitudes
