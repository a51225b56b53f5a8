"""Name the missing effect: candidates fitted in full with the model."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import chi2

from sysid_trib.discrepancy.baseline import Baseline, fit, with_noise
from sysid_trib.discrepancy.chord import chord
from sysid_trib.discrepancy.evidence import price_of
from sysid_trib.discrepancy.frequencies import is_searched
from sysid_trib.discrepancy.probes import Probe
from sysid_trib.discrepancy.scores import Scores
from sysid_trib.errors import SysidTribError
from sysid_trib.forces import Force, ForceLibrary
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.fitting import rms
from sysid_trib.methods.motions import Problem
from sysid_trib.runs import one_or_all

Array = NDArray[np.float64]

# A gap beyond this part of the swing is too large for a score to say which force is missing, or how strong.
LARGE = 0.02
# Forces then tried by fits: what is quick to simulate, so many.
TRIALS = 6
# Part of the squared score that a fit must bring.
PROMISED = 0.8
EVALUATIONS = 12


@dataclass(frozen=True)
class Refit:
    """A candidate fitted with the model: problem, unknowns, chi-square (inf if the fit failed)."""

    probe: Probe
    problem: Problem
    unknown: Array
    chi_square: float

    @property
    def force(self) -> Force:
        """The candidate."""
        return self.probe.force

    @property
    def cost(self) -> float:
        """Chi-square, with the price of the candidate's shape parameters."""
        return self.chi_square + price_of(self.force)


@dataclass(frozen=True)
class Hint:
    """What the scores say of a candidate: its probe, coefficient, and response (sample,)."""

    probe: Probe
    coefficient: float
    response: Array


def refit(
    baseline: Baseline, hint: Hint, runs: Sequence[xr.Dataset], hopeless: float, *, far: bool = False
) -> Refit:
    """One candidate fitted with the model, from what the score says or, if that is far, from regression.

    `hopeless` : a chi-square above which, after a few steps from what the score says, the fit is not brought
        to its end.
    """
    probe = hint.probe
    problem = with_noise(with_force(baseline.problem, probe.force), baseline.noises)
    unknown = with_values(baseline, hint)
    try:
        if not far:
            unknown, chi_square, settled = chord(problem, unknown, _with_column(baseline, hint))
            if settled or chi_square > hopeless:
                return Refit(probe, problem, unknown, chi_square)
        elif probe.force.kind == "force":
            starts = [unknown, *_by_regression(problem, probe, runs)]
            unknown = min(starts, key=lambda start: rms(problem.white_residual(start)))
        found = fit(problem, unknown, baseline.noises, evaluations=EVALUATIONS)
        return Refit(probe, problem, found.unknown, found.chi_square)
    except (SysidTribError, np.linalg.LinAlgError, ValueError):
        return Refit(probe, problem, unknown, np.inf)


def _with_column(baseline: Baseline, hint: Hint) -> Array:
    """The table of sensitivities with the candidate's response, nan for its shapes."""
    count, named = len(baseline.problem.library), len(baseline.problem.names)
    table = baseline.table
    shapes = np.full((len(table), len(hint.probe.shapes)), np.nan)
    parts = [table[:, :count], hint.response[:, None], table[:, count:named], shapes, table[:, named:]]
    return np.concatenate(parts, axis=1)


def is_large(baseline: Baseline) -> bool:
    """Whether the gap is too large for scores."""
    gap = np.concatenate(baseline.problem.residuals(baseline.unknown))
    return rms(gap) > LARGE * rms(np.concatenate([record.angle for record in baseline.problem.records]))


def best_candidates(baseline: Baseline, found: Scores, runs: Sequence[xr.Dataset]) -> list[Refit]:
    """Candidates fitted with the model, the one that explains most first; fits that failed are the last.

    By the scores; where the gap is too large for them, by fits of those that are quick to simulate. A twin
    that explains more is found later (`twins`).
    """
    ranked = sorted(found.best(), key=lambda at: price_of(found.probes[at].force) - found.z[at] ** 2)
    done: list[Refit] = []
    if is_large(baseline):
        tried = [at for at in ranked if _is_plain(found.probes[at].force)][:TRIALS] or ranked[:1]
        done = [_refitted(baseline, found, at, runs) for at in tried]
        return sorted(done, key=lambda one: one.cost)
    for at in ranked[:TRIALS]:
        done = sorted([*done, _refitted(baseline, found, at, runs)], key=lambda one: one.cost)
        best = done[0]
        # A fit that brings what its score promises is not followed by a better one.
        if baseline.chi_square - best.cost > PROMISED * found.z[at] ** 2 - price_of(best.force):
            break
    return done


def _is_plain(force: Force) -> bool:
    """Without a past, which is slow, and without a frequency, which near resonance mimics anything."""
    return force.memoryless and not is_searched(force)


def _refitted(baseline: Baseline, found: Scores, at: int, runs: Sequence[xr.Dataset]) -> Refit:
    coefficient = float(found.z[at]) / float(found.size[at])
    hint = Hint(found.probes[at], coefficient, found.moved[:, at])
    return refit(baseline, hint, runs, baseline.chi_square, far=is_large(baseline))


def with_force(problem: Problem, force: Force) -> Problem:
    """The problem with one force more, its shape parameters unknown too."""
    library = replace(problem.library, forces=(*problem.library.forces, force))
    names = tuple(f"{force.symbol}.{name}" for name in force.shape)
    bounds = {**problem.bounds, force.symbol: (0.0, np.inf)} if force.passive else problem.bounds
    return replace(problem, library=library, fit_shapes=(*problem.fit_shapes, *names), bounds=bounds)


def own_columns(baseline: Baseline, symbol: str) -> list[int]:
    """Which unknowns are a force's own: its coefficient, then its shapes."""
    names = baseline.problem.names
    return [i for i, name in enumerate(names) if name == symbol or name.startswith(f"{symbol}.")]


def with_values(baseline: Baseline, hint: Hint) -> Array:
    """First guess with one force more; the others make room for it, as far as small deviations say."""
    size = np.linalg.norm(baseline.table, axis=0)
    scaled = baseline.table / np.where(size > 0.0, size, 1.0)
    wanted = baseline.residual - hint.coefficient * hint.response
    steps = np.linalg.lstsq(scaled, wanted, rcond=1e-10)[0] / np.where(size > 0.0, size, 1.0)
    before = baseline.unknown + steps
    count, named = len(baseline.problem.library), len(baseline.problem.names)
    shapes = list(hint.probe.shapes.values())
    return np.array([*before[:count], hint.coefficient, *before[count:named], *shapes, *before[named:]])


def without_force(baseline: Baseline, symbol: str) -> tuple[Problem, Array]:
    """Problem and unknowns without a force."""
    problem = baseline.problem
    kept = tuple(force for force in problem.library if force.symbol != symbol)
    shapes = tuple(name for name in problem.fit_shapes if not name.startswith(f"{symbol}."))
    names = list(problem.names)
    stay = [i for i in range(len(names)) if i not in own_columns(baseline, symbol)]
    unknown = np.concatenate([baseline.unknown[stay], baseline.unknown[len(names) :]])
    return replace(problem, library=replace(problem.library, forces=kept), fit_shapes=shapes), unknown


def _by_regression(problem: Problem, probe: Probe, runs: Sequence[xr.Dataset]) -> list[Array]:
    """First guess from direct identification, which no phase slip can trap; none if it fails."""
    forces = ForceLibrary("trial", tuple(f for f in problem.library if f.kind == "force"))
    shapes = {**problem.shapes, **probe.shapes}
    try:
        found = Direct(problem.reference_frequency, shapes=shapes).identify(one_or_all(list(runs)), forces)
    except SysidTribError:
        return []
    value = dict(zip(found.force.values.tolist(), found.coefficient.values.tolist(), strict=True))
    fixed = [probe.shapes.get(name, problem.shapes.get(name, np.nan)) for name in problem.fit_shapes]
    frequency = [found.reference_frequency.item()] if problem.free else []
    own = np.stack([np.ravel(found[k]) for k in ("start_angle", "start_rate", "offset")], axis=1)
    coefficients = [value.get(symbol, 0.0) for symbol in problem.library.symbols]
    unknown = np.array([*coefficients, *fixed, *frequency, *own.ravel()])
    return [unknown] if np.all(np.isfinite(unknown)) else []


def is_significant(before: Baseline, one: Refit, tests: float, level: float) -> bool:
    """Whether a fitted candidate takes more from the gap than noise would give to the best of the tests."""
    gain = before.chi_square - one.chi_square
    return bool(tests * chi2.sf(gain, 1 + len(one.force.shape)) < level)
