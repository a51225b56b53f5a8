"""The search: score, refit, name, add, and scan again until nothing more is asked for."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.discrepancy.baseline import Baseline, fit, records_of, refreshed
from sysid_trib.discrepancy.naming import Refit, is_significant, refits, tie_class
from sysid_trib.discrepancy.noise import Noise, oscillations
from sysid_trib.discrepancy.omnibus import Omnibus, omnibus
from sysid_trib.discrepancy.scores import Scores, scores
from sysid_trib.forces import ForceLibrary
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.motions import Problem
from sysid_trib.runs import one_or_all

Array = NDArray[np.float64]

# Family-wise level of error of a name.
LEVEL = 0.01


@dataclass(frozen=True)
class Step:
    """One scan of the candidates: what the model left, what was asked for, what was added (or None)."""

    before: Baseline
    found: Scores
    generic: Omnibus
    refits: list[Refit]
    added: Refit | None

    @property
    def ties(self) -> list[Refit]:
        """Candidates that explain as much as the one added, itself first."""
        return tie_class(self.refits)


def first_baseline(runs: Sequence[xr.Dataset], forces: ForceLibrary, frequency: float | None) -> Baseline:
    """The start model fitted to the runs, with the noise of each."""
    decay = one_or_all(list(runs))
    quick = Direct(frequency).identify(decay, forces)
    problem = Problem(forces, records_of(runs), frequency, (), {})
    own = np.stack([np.ravel(quick[k]) for k in ("start_angle", "start_rate", "offset")], axis=1)
    free = [quick.reference_frequency.item()] if frequency is None else []
    unknown = np.array([*quick.coefficient.values, *free, *own.ravel()])
    noises = [Noise(quick.noise.item(), np.ones(1))] * len(runs)
    bases = [oscillations(run) for run in runs]
    return refreshed(refreshed(fit(problem, unknown, noises), bases), bases)


def search(
    runs: Sequence[xr.Dataset],
    baseline: Baseline,
    candidates: ForceLibrary,
    *,
    max_effects: int = 4,
    level: float = LEVEL,
    seed: int = 0,
    told: Callable[[str], None] = lambda text: None,
) -> list[Step]:
    """Add effects to a model until the record asks for none; the last step adds nothing."""
    bases = [oscillations(run) for run in runs]
    steps: list[Step] = []
    while True:
        told(f"scan {len(steps) + 1}")
        step = _scanned(runs, baseline, candidates, level, seed, told)
        if step.added is None or step.added.fitted is None or len(steps) == max_effects:
            steps.append(replace(step, added=None))
            return steps
        steps.append(step)
        baseline = refreshed(step.added.fitted, bases)
        candidates = _others(candidates, step.added.force.symbol)


def _scanned(
    runs: Sequence[xr.Dataset],
    baseline: Baseline,
    candidates: ForceLibrary,
    level: float,
    seed: int,
    told: Callable[[str], None],
) -> Step:
    courses = baseline.courses()
    found = scores(baseline, candidates, courses, seed)
    generic = omnibus(baseline, courses)
    if not len(found.p_values) or found.p_values.min() >= level:
        return Step(baseline, found, generic, [], None)
    done = refits(baseline, found, runs)
    named = done[0] if done and is_significant(baseline, done[0], found.tests, level) else None
    return Step(baseline, found, generic, done, named)


def _others(candidates: ForceLibrary, symbol: str) -> ForceLibrary:
    return replace(candidates, forces=tuple(f for f in candidates if f.symbol != symbol))


def verdict_of(steps: Sequence[Step], level: float = LEVEL) -> str:
    """`explained`, `unknown effect` or `nothing missing`."""
    last = steps[-1]
    if last.generic.p_value < level or (len(last.found.p_values) and last.found.p_values.min() < level):
        return "unknown effect"
    return "explained" if len(steps) > 1 else "nothing missing"
