"""Name the missing effect: candidates refitted in full, the best of them, and those that explain as much."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import chi2

from sysid_trib.discrepancy.baseline import Baseline, fit
from sysid_trib.discrepancy.probes import Probe
from sysid_trib.discrepancy.scores import Scores
from sysid_trib.errors import SysidTribError
from sysid_trib.forces import Force, ForceLibrary
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.fitting import rms
from sysid_trib.methods.motions import Problem
from sysid_trib.runs import one_or_all

Array = NDArray[np.float64]

# Candidates within this chi-square of the best explain the record as well (three standard errors).
TIE = 9.0
# What a shape parameter must gain in chi-square to be worth it: of two forces that explain as much, the one
# with fewer parameters is named.
PRICE = 6.0
# Candidates that are refitted: those whose squared score is not far below the largest, so many at most.
MOST = 10
WITHIN = 0.4
# A gap beyond this part of the swing is too large for a score to say how strong an effect is.
LARGE = 0.01


@dataclass(frozen=True)
class Refit:
    """A candidate fitted together with the model.

    `fitted` is None if the fit failed, for the `reason`.
    """

    force: Force
    score: float
    fitted: Baseline | None
    reason: str = ""

    @property
    def cost(self) -> float:
        """Chi-square, with the price of the candidate's shape parameters."""
        return np.inf if self.fitted is None else self.fitted.chi_square + PRICE * len(self.force.shape)

    @property
    def coefficient(self) -> tuple[float, float]:
        """Value and standard error."""
        if self.fitted is None:
            return np.nan, np.nan
        at = self.fitted.problem.library.symbols.index(self.force.symbol)
        return float(self.fitted.unknown[at]), float(np.sqrt(self.fitted.covariance[at, at]))

    @property
    def shapes(self) -> dict[str, float]:
        """Fitted shape parameters."""
        if self.fitted is None:
            return {}
        names, count = self.fitted.problem.fit_shapes, len(self.fitted.problem.library)
        values = self.fitted.unknown[count : count + len(names)].tolist()
        return {k: x for k, x in zip(names, values, strict=True) if k.startswith(f"{self.force.symbol}.")}


def refits(
    baseline: Baseline, found: Scores, runs: Sequence[xr.Dataset], tick: Callable[[], None] = lambda: None
) -> list[Refit]:
    """The candidates that score highest, each fitted in full with the model, the best first."""
    symbols = list(dict.fromkeys(probe.force.symbol for probe in found.probes))
    best = {s: at for s in symbols if (at := found.best_of(s)) is not None}
    ranked = sorted(best.values(), key=lambda at: -abs(found.z[at]))
    if not ranked:
        return []
    least = WITHIN * found.z[ranked[0]] ** 2
    chosen = [
        at for at in ranked[:MOST] if found.z[at] ** 2 >= min(least, found.z[ranked[0]] ** 2 - 3.0 * TIE)
    ]
    done = []
    for at in chosen:
        done.append(refit(baseline, found.probes[at], float(found.z[at]), float(found.size[at]), runs))
        tick()
    return sorted(done, key=lambda one: one.cost)


def refit(baseline: Baseline, probe: Probe, z: float, size: float, runs: Sequence[xr.Dataset]) -> Refit:
    """One candidate fitted with the model, from what the score says or, if that is far, from regression."""
    problem = with_force(baseline.problem, probe.force)
    starts = [with_values(baseline, problem, probe, z / size)]
    gap = np.concatenate(baseline.problem.residuals(baseline.unknown))
    swing = np.concatenate([record.angle for record in problem.records])
    if rms(gap) > LARGE * rms(swing) and probe.force.kind == "force":
        starts += _by_regression(problem, probe, runs)
    try:
        first = min(starts, key=lambda unknown: rms(problem.white_residual(unknown)))
        return Refit(probe.force, z, fit(problem, first, baseline.noises))
    except (SysidTribError, np.linalg.LinAlgError, ValueError) as error:
        return Refit(probe.force, z, None, str(error))


def with_force(problem: Problem, force: Force) -> Problem:
    """The problem with one force more, its shape parameters unknown too."""
    library = replace(problem.library, forces=(*problem.library.forces, force))
    names = tuple(f"{force.symbol}.{name}" for name in force.shape)
    return replace(problem, library=library, fit_shapes=(*problem.fit_shapes, *names))


def without_force(baseline: Baseline, symbol: str) -> tuple[Problem, Array]:
    """Problem and unknowns without a force."""
    problem = baseline.problem
    kept = [force for force in problem.library if force.symbol != symbol]
    shapes = tuple(name for name in problem.fit_shapes if not name.startswith(f"{symbol}."))
    names = list(problem.names)
    stay = [i for i, name in enumerate(names) if name != symbol and not name.startswith(f"{symbol}.")]
    unknown = np.concatenate([baseline.unknown[stay], baseline.unknown[len(names) :]])
    return replace(problem, library=replace(problem.library, forces=tuple(kept)), fit_shapes=shapes), unknown


def with_values(baseline: Baseline, problem: Problem, probe: Probe, coefficient: float) -> Array:
    """First guess of a problem with one force more."""
    count, named = len(baseline.problem.library), len(baseline.problem.names)
    before = baseline.unknown
    shapes = list(probe.shapes.values())
    return np.array([*before[:count], coefficient, *before[count:named], *shapes, *before[named:]])


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
    unknown = np.array(
        [*(value.get(s, 0.0) for s in problem.library.symbols), *fixed, *frequency, *own.ravel()]
    )
    return [unknown] if np.all(np.isfinite(unknown)) else []


def tie_class(done: Sequence[Refit]) -> list[Refit]:
    """The best, and all that explain the record as well."""
    return (
        [one for one in done if one.cost <= done[0].cost + TIE] if done and np.isfinite(done[0].cost) else []
    )


def is_significant(baseline: Baseline, one: Refit, tests: float, level: float) -> bool:
    """Whether a refitted candidate takes more from the gap than noise would give to the best of the tests."""
    if one.fitted is None:
        return False
    gain = baseline.chi_square - one.fitted.chi_square
    return bool(tests * chi2.sf(gain, 1 + len(one.force.shape)) < level)
