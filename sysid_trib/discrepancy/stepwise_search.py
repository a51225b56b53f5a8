"""The search: score, name, add, scan again; then hold every name against its twins."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
import xarray as xr
from scipy.stats import chi2

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.baseline import (
    Baseline,
    fit,
    fit_records,
    orthonormal_basis,
    project_out,
    refit_in_residual_noise,
)
from sysid_trib.discrepancy.candidate_fits import best_candidates, is_large, is_significant, without_force
from sysid_trib.discrepancy.candidate_sensitivities import ReferenceMotion
from sysid_trib.discrepancy.collinearity import collinear_effects
from sysid_trib.discrepancy.competing_models import SWAP, Twin, cost_of, twins
from sysid_trib.discrepancy.model_probabilities import narrowness
from sysid_trib.discrepancy.omnibus_test import OmnibusTest, omnibus
from sysid_trib.discrepancy.replacement import alone, simpler
from sysid_trib.discrepancy.score_tests import Scores, scores
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.direct import Direct
from sysid_trib.noise.residual_noise import NoiseModel, modulated_harmonics
from sysid_trib.records.runs import one_or_all
from sysid_trib.trajectory_fit.parameters import FREQUENCY, PER_RUN, Parameters
from sysid_trib.trajectory_fit.problem import FitProblem

# A model and the effects added to it.
State: TypeAlias = tuple[Baseline, tuple[str, ...]]

# Family-wise level of error of a name.
LEVEL = 0.01
# Rounds of holding names against their twins.
ROUNDS = 4
# A score of so small a probability stands for something even if no candidate that scores it fits.
DOUBTLESS = 1e-6


@dataclass(frozen=True)
class SelectionStep:
    """What a model leaves: the candidates' scores and the test that knows none."""

    before: Baseline
    references: list[ReferenceMotion]
    found: Scores
    generic: OmnibusTest


@dataclass(frozen=True)
class Search:
    """The whole search.

    Attributes
    ----------
    selection_steps : one before each addition, and the last of the final model.
    final : the final model.
    added : its effects, in the order of their addition.
    ties : of each effect, the candidates that explain as much in its place, itself first.
    failed : candidates tried for a step whose fits failed.
    """

    selection_steps: list[SelectionStep]
    final: Baseline
    added: tuple[str, ...]
    ties: dict[str, list[Twin]] = field(default_factory=dict)
    failed: tuple[str, ...] = ()


def first_baseline(runs: Sequence[xr.Dataset], forces: ForceLibrary, frequency: float | None) -> Baseline:
    """The start model fitted to the runs, with the noise of each."""
    decay = one_or_all(list(runs))
    quick = Direct(frequency, random_force="off").identify(decay, forces)
    parameters = Parameters(forces, frequency, runs=len(runs))
    problem = FitProblem(parameters, fit_records(runs))
    common = dict(zip(forces.symbols, quick.coefficient.values.tolist(), strict=True))
    common[FREQUENCY] = quick.reference_frequency.item()
    values = parameters.pack(common, np.stack([np.ravel(quick[name]) for name in PER_RUN], axis=1))
    noises = [NoiseModel(quick.noise.item(), np.ones(1))] * len(runs)
    bases = [modulated_harmonics(run) for run in runs]
    first = fit(problem, values, noises, far=True)
    second = refit_in_residual_noise(problem, first.values, bases)
    return refit_in_residual_noise(problem, second.values, bases)


def search(
    runs: Sequence[xr.Dataset],
    baseline: Baseline,
    candidates: ForceLibrary,
    *,
    max_effects: int = 4,
    level: float = LEVEL,
    seed: int = 0,
    tell: Callable[[str], None] = lambda text: None,
) -> Search:
    """Add effects to a model until the record asks for none, then see what can be said more simply.

    Several effects are replaced by one or two that cost less, one that the others make needless is taken
    out, each is replaced by a twin that costs less, and all by one fitted from the start that costs less;
    after a change the record is scanned again.
    """
    bases = baseline.noise_bases
    selection_steps: list[SelectionStep] = []
    state: State = (baseline, ())
    ties: dict[str, list[Twin]] = {}
    failed: list[str] = []
    for _ in range(ROUNDS):
        while True:
            tell(f"selection step {len(selection_steps) + 1}")
            selection_steps.append(_scanned(*state, candidates, seed))
            more = _next(selection_steps[-1], runs, level, max_effects - len(state[1]), failed)
            longer = _stepped(more, bases, state[1])
            if not longer:
                break
            state = longer
        tell("competing effects")
        ties = {}
        fewer = simpler(*state, selection_steps[-1].found) if len(state[1]) > 1 else None
        changed = (
            _stepped(fewer, bases)
            or _without_needless(state, bases, level)
            or _exchanged(selection_steps[-1], state, bases, ties)
            or _stepped(alone(*state, selection_steps[0].before, selection_steps[0].found), bases)
        )
        if not changed:
            break
        state = changed
    baseline, added = state
    if selection_steps[-1].before is not baseline:
        selection_steps.append(_scanned(baseline, added, candidates, seed))
    last = selection_steps[-1]
    ties |= {s: twins(baseline, s, last.found, last.references) for s in added if s not in ties}
    return Search(selection_steps, baseline, _by_weight(baseline, added), ties, tuple(dict.fromkeys(failed)))


def _stepped(
    model: tuple[FitProblem, Array, tuple[str, ...]] | None,
    bases: Sequence[Array],
    before: tuple[str, ...] = (),
) -> State | None:
    """The model, if there is one, in the noise that it leaves; None if its motions cannot be followed."""
    if model is None:
        return None
    problem, values, symbols = model
    after = refit_in_residual_noise(problem, values, bases)
    try:
        after.references  # noqa: B018, followed here once, and kept
    except SysidTribError:
        return None
    return after, (*before, *symbols)


def _exchanged(
    scan: SelectionStep,
    state: State,
    bases: Sequence[Array],
    ties: dict[str, list[Twin]],
) -> State | None:
    """The model with a better twin in place of an effect, if there is one; `ties` is filled on the way."""
    baseline, added = state
    for symbol in added:
        ties[symbol] = twins(baseline, symbol, scan.found, scan.references)
        least = cost_of(baseline, symbol) - SWAP
        for at, twin in enumerate(ties[symbol]):
            if twin.refit is None or twin.cost >= least:
                continue
            names = tuple(twin.force.symbol if s == symbol else s for s in added)
            swapped = _stepped((twin.refit.problem, twin.refit.values, names), bases)
            if swapped is None:
                continue
            # By the measure of the effect itself: else two could take each other's place without end.
            cost = twin.refit.chi_square + narrowness(swapped[0], twin.force)
            if cost < least:
                return swapped
            ties[symbol][at] = replace(twin, cost=cost)
    return None


def _without_needless(state: State, bases: Sequence[Array], level: float) -> State | None:
    """The model without an effect that the others make needless, if there is one."""
    baseline, added = state
    needless = _pruned(baseline, added, level)
    if needless is None:
        return None
    problem, values = without_force(baseline, needless)
    alone = fit(problem, values, baseline.noises, far=True)
    return _stepped((problem, alone.values, tuple(s for s in added if s != needless)), bases)


def _by_weight(baseline: Baseline, added: Sequence[str]) -> tuple[str, ...]:
    """The effects in the order in which each explains most of what those before it leave."""
    parameters = baseline.problem.parameters
    space = orthonormal_basis(parameters.remove(added).take(parameters, baseline.table))
    index = {symbol: parameters.index(symbol) for symbol in added}
    parts = {s: baseline.table[:, i] * baseline.values[i] for s, i in index.items()}
    parts = {s: project_out(part, space) for s, part in parts.items()}
    left = baseline.residual + sum(parts.values(), np.zeros_like(baseline.residual))
    ordered: list[str] = []
    while len(ordered) < len(added):
        rest = [s for s in added if s not in ordered]
        taken = {s: float(parts[s] @ left) / max(float(np.linalg.norm(parts[s])), 1e-300) for s in rest}
        ordered.append(max(rest, key=lambda s: abs(taken[s])))
        direction = parts[ordered[-1]] / max(float(np.linalg.norm(parts[ordered[-1]])), 1e-300)
        left = left - direction * float(direction @ left)
    return tuple(ordered)


def _scanned(baseline: Baseline, added: Sequence[str], candidates: ForceLibrary, seed: int) -> SelectionStep:
    references = baseline.references
    others = replace(candidates, forces=tuple(f for f in candidates if f.symbol not in added))
    return SelectionStep(
        baseline,
        references,
        scores(baseline, others, references, seed),
        omnibus(baseline, references),
    )


def _next(
    scan: SelectionStep, runs: Sequence[xr.Dataset], level: float, most: int, failed: list[str]
) -> tuple[FitProblem, Array, tuple[str, ...]] | None:
    """The model with the effect to add, or two that explain more together, if they are significant.

    `failed` takes the symbols of candidates whose fits failed.
    """
    found = scan.found
    if most < 1 or not len(found.p_values) or found.p_values.min() >= level:
        return None
    pair = simpler(scan.before, (), found) if most > 1 and not is_large(scan.before) else None
    if pair is not None and len(pair[2]) > 1:
        return pair
    tried = best_candidates(scan.before, found, runs)
    failed += [one.force.symbol for one in tried if not np.isfinite(one.chi_square)]
    if not tried or not is_significant(scan.before, tried[0], found.tests, level):
        return None
    one = tried[0]
    return one.problem, one.values, (one.force.symbol,)


def _pruned(baseline: Baseline, added: Sequence[str], level: float) -> str | None:
    """The added effect that the others make needless, if there is one."""
    errors = np.sqrt(np.diag(baseline.covariance))
    parameters = baseline.problem.parameters
    weakest, least = None, float(chi2.isf(level / 10.0, 1))
    for symbol in added:
        at = parameters.index(symbol)
        score = float((baseline.values[at] / errors[at]) ** 2)
        if len(added) > 1 and score < least and not parameters.library[symbol].shape:
            weakest, least = symbol, score
    return weakest


def verdict_of(found: Search, level: float = LEVEL) -> str:
    """`explained`, `unknown effect` or `nothing missing`."""
    last = found.selection_steps[-1]
    # Names that lean on each other may imitate one that is not in the library.
    if collinear_effects(found.final, found.added):
        return "unknown effect"
    # A score that no fit bears out is no effect, unless it is beyond doubt.
    flagged = len(last.found.p_values) and last.found.p_values.min() < DOUBTLESS
    if last.generic.p_value < level or flagged:
        return "unknown effect"
    return "explained" if found.added else "nothing missing"
