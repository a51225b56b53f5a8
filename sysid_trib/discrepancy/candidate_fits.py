"""Name the missing effect: candidates fitted in full with the model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.stats import chi2

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.baseline import Baseline, fit, with_noise
from sysid_trib.discrepancy.candidate_sensitivities import TrialCandidate
from sysid_trib.discrepancy.frequency_parameters import has_frequency_parameter
from sysid_trib.discrepancy.model_probabilities import price_of
from sysid_trib.discrepancy.score_tests import Scores
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.methods.direct import Direct
from sysid_trib.records.runs import one_or_all
from sysid_trib.trajectory_fit.chord import chord
from sysid_trib.trajectory_fit.least_squares import rms
from sysid_trib.trajectory_fit.parameters import FREQUENCY, PER_RUN
from sysid_trib.trajectory_fit.problem import FitProblem

# A gap beyond this part of the swing is too large for a score to say which force is missing, or how strong.
LARGE = 0.02
# Candidates that are fitted to the end.
TRIALS = 5
# Part of the squared score that a fit must bring.
PROMISED = 0.8
EVALUATIONS = 12


@dataclass(frozen=True)
class Refit:
    """A candidate fitted with the model: problem, unknowns, chi-square (inf if the fit failed)."""

    trial: TrialCandidate
    problem: FitProblem
    values: Array
    chi_square: float

    @property
    def force(self) -> Force:
        """The candidate."""
        return self.trial.force

    @property
    def cost(self) -> float:
        """Chi-square, with the price of the candidate's shape parameters."""
        return self.chi_square + price_of(self.force)


@dataclass(frozen=True)
class Hint:
    """What the scores say of a candidate: its trial, coefficient, response (sample,), and score."""

    trial: TrialCandidate
    coefficient: float
    response: Array
    score: float = 0.0

    @property
    def force(self) -> Force:
        """The candidate."""
        return self.trial.force


def refit(baseline: Baseline, hint: Hint, hopeless: float) -> Refit:
    """One candidate fitted with the model, from what the score says.

    `hopeless` : a chi-square above which, after a few steps, the fit is not brought to its end.
    """
    problem = with_noise(with_force(baseline.problem, hint.force), baseline.noises)
    values = with_values(baseline, hint)
    try:
        values, chi_square, settled = chord(problem, values, _with_column(baseline, hint))
        begun = Refit(hint.trial, problem, values, chi_square)
        return begun if settled or chi_square > hopeless else _ended(baseline, begun)
    except (SysidTribError, np.linalg.LinAlgError, ValueError):
        return Refit(hint.trial, problem, values, np.inf)


def _begun(baseline: Baseline, hint: Hint, runs: Sequence[xr.Dataset], *, refine: bool) -> Refit:
    """Where the fit of a candidate begins if the gap is large: by the score, or by regression."""
    force = hint.force
    problem = with_noise(with_force(baseline.problem, force), baseline.noises)
    starts = [with_values(baseline, hint)]
    if force.kind == "force":
        starts += _by_regression(problem, hint.trial, runs, refine)
    squares = [_chi_square(problem, start) for start in starts]
    return Refit(hint.trial, problem, starts[int(np.argmin(squares))], min(squares))


def _chi_square(problem: FitProblem, values: Array) -> float:
    try:
        left = problem.white_residual(values)
    except SysidTribError:
        return np.inf
    return float(left @ left)


def _ended(baseline: Baseline, begun: Refit) -> Refit:
    try:
        found = fit(begun.problem, begun.values, baseline.noises, evaluations=EVALUATIONS)
    except (SysidTribError, np.linalg.LinAlgError, ValueError):
        return replace(begun, chi_square=np.inf)
    return replace(begun, values=found.values, chi_square=found.chi_square)


def _with_column(baseline: Baseline, hint: Hint) -> Array:
    """The table of sensitivities with the candidate's response, nan for its shapes."""
    before = baseline.problem.parameters
    new: dict[str, ArrayLike] = dict.fromkeys(hint.trial.shapes, np.nan)
    new[hint.force.symbol] = hint.response
    return before.insert(hint.force).take(before, baseline.table, new)


def is_large(baseline: Baseline) -> bool:
    """Whether the gap is too large for scores."""
    gap = np.concatenate(baseline.problem.residuals(baseline.values))
    return rms(gap) > LARGE * rms(np.concatenate([record.angle for record in baseline.problem.records]))


def best_candidates(baseline: Baseline, found: Scores, runs: Sequence[xr.Dataset]) -> list[Refit]:
    """Candidates fitted with the model, the one that explains most first; fits that failed are the last.

    By the scores; where the gap is too large for them, those that are quick to simulate and whose fits begin
    best. A twin that explains more is found later (`twins`).
    """
    ranked = likeliest(found)
    if is_large(baseline):
        hints = [hint for hint in ranked if _is_plain(hint.force)] or ranked[:1]
        costs = [_begun(baseline, hint, runs, refine=False).cost for hint in hints]
        likely = [hints[i] for i in np.argsort(costs)[:TRIALS]]
        tried = [_ended(baseline, _begun(baseline, hint, runs, refine=True)) for hint in likely]
        return sorted(tried, key=lambda one: one.cost)
    done: list[Refit] = []
    for hint in ranked[:TRIALS]:
        one = refit(baseline, hint, np.inf)
        done = sorted([*done, one], key=lambda one: one.cost)
        best = done[0]
        # A fit that brings what its score promises is not followed by a better one.
        if baseline.chi_square - best.cost > PROMISED * hint.score**2 - price_of(best.force):
            break
    return done


def likeliest(found: Scores) -> list[Hint]:
    """What the scores say of each candidate that can be tested, the one that explains most first."""
    ranked = sorted(found.best(), key=lambda at: price_of(found.trials[at].force) - found.z[at] ** 2)
    return [
        Hint(found.trials[at], float(found.z[at] / found.size[at]), found.moved[:, at], float(found.z[at]))
        for at in ranked
    ]


def _is_plain(force: Force) -> bool:
    """Without a past, which is slow, and without a frequency, which near resonance mimics anything."""
    return force.memoryless and not has_frequency_parameter(force)


def with_force(problem: FitProblem, force: Force) -> FitProblem:
    """The problem with one force more, its shape parameters unknown too."""
    return replace(problem, parameters=problem.parameters.insert(force))


def with_values(baseline: Baseline, hint: Hint) -> Array:
    """First guess with one force more; the others make room for it, as far as small deviations say."""
    size = np.linalg.norm(baseline.table, axis=0)
    scaled = baseline.table / np.where(size > 0.0, size, 1.0)
    wanted = baseline.residual - hint.coefficient * hint.response
    steps = np.linalg.lstsq(scaled, wanted, rcond=1e-10)[0] / np.where(size > 0.0, size, 1.0)
    before = baseline.problem.parameters
    new = {hint.force.symbol: hint.coefficient, **hint.trial.shapes}
    return before.insert(hint.force).take(before, baseline.values + steps, new)


def without_force(baseline: Baseline, symbol: str) -> tuple[FitProblem, Array]:
    """Problem and values without a force."""
    before = baseline.problem.parameters
    after = before.remove([symbol])
    return replace(baseline.problem, parameters=after), after.take(before, baseline.values)


def _by_regression(
    problem: FitProblem, trial: TrialCandidate, runs: Sequence[xr.Dataset], refine: bool
) -> list[Array]:
    """First guess from direct identification, which no phase slip can trap; none if it fails."""
    parameters = problem.parameters
    forces = ForceLibrary("trial", tuple(f for f in parameters.library if f.kind == "force"))
    shapes = {**parameters.shapes, **trial.shapes}
    try:
        method = Direct(parameters.reference_frequency, refine=refine, shapes=shapes, random_force="off")
        found = method.identify(one_or_all(list(runs)), forces)
    except SysidTribError:
        return []
    value = dict(zip(found.force.values.tolist(), found.coefficient.values.tolist(), strict=True))
    value |= {**trial.shapes, FREQUENCY: found.reference_frequency.item()}
    values = parameters.pack(value, np.stack([np.ravel(found[name]) for name in PER_RUN], axis=1))
    return [values] if np.all(np.isfinite(values)) else []


def is_significant(before: Baseline, one: Refit, tests: float, level: float) -> bool:
    """Whether a fitted candidate takes more from the gap than noise would give to the best of the tests."""
    gain = before.chi_square - one.chi_square
    return bool(tests * chi2.sf(gain, 1 + len(one.force.shape)) < level)
