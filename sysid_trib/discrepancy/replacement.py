"""Steps taken back: one or two candidates that explain as much as several effects added one by one."""

import itertools
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.baseline import Baseline, orthonormal_basis, project_out, with_noise
from sysid_trib.discrepancy.candidate_fits import likeliest, refit
from sysid_trib.discrepancy.candidate_sensitivities import TrialCandidate
from sysid_trib.discrepancy.competing_models import SWAP
from sysid_trib.discrepancy.model_probabilities import price_of
from sysid_trib.discrepancy.score_tests import Scores
from sysid_trib.trajectory_fit.chord import chord
from sysid_trib.trajectory_fit.problem import FitProblem

# What one effect more must gain in chi-square: the best of some sixty gains half of this by chance.
PRICE_OF_EFFECT = 18.0
# Replacements that are fitted.
TRIALS = 4
# Their predicted chi-square may be above the present one by this part of what the effects explain.
SLACK = 0.003
# Candidates that are tried alone, beside several effects or one of so high a score.
ALONE = 12
STRONG = 100.0


def simpler(
    fitted: Baseline, added: Sequence[str], found: Scores
) -> tuple[FitProblem, Array, tuple[str, ...]] | None:
    """One or two candidates in place of all effects added, or of none; None if no such model costs less.

    `found` : scores about the motion of the fitted model; its own effects are not among them.

    Notes
    -----
    Predicted from small deviations: with y what the effects and the residual are together, outside of what
    the start model's unknowns can move, candidates of directions U leave |y|^2 - |P_U y|^2.
    """
    parameters = fitted.problem.parameters
    coefficients = [parameters.index(symbol) for symbol in added]
    space = orthonormal_basis(parameters.remove(added).take(parameters, fitted.table))
    whole = fitted.residual + fitted.table[:, coefficients] @ fitted.values[coefficients]
    y = project_out(whole, space)
    at, directions, along = _best_of_each(fitted, added, found, space, y)
    own = fitted.chi_square + _price(fitted.problem, added)
    limit = own + SLACK * max(0.0, float(y @ y) - fitted.chi_square)
    trials: list[list[int]] = []
    for cost, chosen in _ranked(directions, along, float(y @ y), [found.trials[i] for i in at]):
        if cost > limit or len(trials) == TRIALS:
            break
        trials.append([at[j] for j in chosen])
    best: tuple[float, FitProblem, Array, tuple[str, ...]] | None = None
    for members in trials:
        problem, values, chi_square = _replaced(fitted, added, found, members, whole)
        symbols = tuple(found.trials[i].force.symbol for i in members)
        cost = chi_square + _price(problem, symbols)
        if best is None or cost < best[0]:
            best = (cost, problem, values, symbols)
    return best[1:] if best is not None and best[0] < own - SWAP else None


def alone(
    fitted: Baseline, added: Sequence[str], start: Baseline, found: Scores
) -> tuple[FitProblem, Array, tuple[str, ...]] | None:
    """One candidate in place of all effects added, fitted from the start model; None if none costs less.

    Where effects are strong, small deviations from a motion that others have bent do not show it.
    `start`, `found` : the start model, and the scores about its motion.
    """
    # A single effect's shapes are no reason to leave it: how much they cost, its twins tell better.
    own = fitted.chi_square + (_price(fitted.problem, added) if len(added) > 1 else PRICE_OF_EFFECT)
    if not added or (len(added) == 1 and start.chi_square - own < STRONG**2):
        return None
    # Chi-squares compare in the same noise.
    start = replace(start, noises=fitted.noises)
    others = [hint for hint in likeliest(found) if added != (hint.force.symbol,)]
    tried = [refit(start, hint, own) for hint in others[:ALONE]]
    best = min(tried, key=lambda one: one.cost, default=None)
    if best is None or best.cost + PRICE_OF_EFFECT > own - SWAP:
        return None
    return best.problem, best.values, (best.force.symbol,)


def _price(problem: FitProblem, symbols: Sequence[str]) -> float:
    return sum(PRICE_OF_EFFECT + price_of(problem.parameters.library[symbol]) for symbol in symbols)


def _best_of_each(
    fitted: Baseline, added: Sequence[str], found: Scores, space: Array, y: Array
) -> tuple[list[int], Array, Array]:
    """The trial of each force, and of each effect of the model, that goes furthest along y."""
    outside = project_out(found.moved, space)
    size = np.linalg.norm(outside, axis=0)
    directions = outside / np.where(size > 0.0, size, 1.0)
    along = directions.T @ y
    best: dict[str, int] = {}
    for i in np.argsort(-np.abs(along)).tolist():
        if found.can_be(i, float(along[i] / max(size[i], 1e-300)), instead=True):
            best.setdefault(found.trials[i].force.symbol, i)
    at = list(best.values())
    return at, directions[:, at], along[at]


def _ranked(
    directions: Array, along: Array, total: float, trials: Sequence[TrialCandidate]
) -> list[tuple[float, tuple[int, ...]]]:
    """Predicted cost of every candidate and every pair, the least first."""
    cosine = directions.T @ directions
    price = np.array([PRICE_OF_EFFECT + price_of(trial.force) for trial in trials])
    ranked: list[tuple[float, tuple[int, ...]]] = [
        (total - float(along[j]) ** 2 + float(price[j]), (j,)) for j in range(len(trials))
    ]
    for i, j in itertools.combinations(range(len(trials)), 2):
        share = 1.0 - float(cosine[i, j]) ** 2
        if share < 1e-6:
            continue
        taken = along[i] ** 2 + along[j] ** 2 - 2.0 * cosine[i, j] * along[i] * along[j]
        ranked.append((total - float(taken) / share + float(price[i] + price[j]), (i, j)))
    return sorted(ranked)


def _replaced(
    fitted: Baseline, added: Sequence[str], found: Scores, members: Sequence[int], whole: Array
) -> tuple[FitProblem, Array, float]:
    """The start model with these trials in place of the effects, fitted nearby."""
    before = fitted.problem.parameters
    kept = before.remove(added)
    parameters, trials = kept, [found.trials[i] for i in members]
    for trial in trials:
        parameters = parameters.insert(trial.force)
    problem = with_noise(replace(fitted.problem, parameters=parameters), fitted.noises)
    values, table = kept.take(before, fitted.values), kept.take(before, fitted.table)
    responses = found.moved[:, list(members)]
    columns = np.concatenate([responses, table], axis=1)
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    steps = np.linalg.lstsq(columns / size, whole, rcond=1e-10)[0] / size
    symbols = [trial.force.symbol for trial in trials]
    shapes = {name: value for trial in trials for name, value in trial.shapes.items()}
    first = {**dict(zip(symbols, steps, strict=False)), **shapes}
    start = parameters.take(kept, values + steps[len(members) :], first)
    moved = {**dict(zip(symbols, responses.T, strict=True)), **dict.fromkeys(shapes, np.nan)}
    values, chi_square, _ = chord(problem, start, parameters.take(kept, table, moved))
    return problem, values, chi_square
