"""Score tests: how strongly what a model leaves asks for each candidate, corrected for their number."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.signal import find_peaks
from scipy.stats import norm

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.baseline import Baseline, project_out
from sysid_trib.discrepancy.candidate_sensitivities import (
    ReferenceMotion,
    TrialCandidate,
    moved_by,
    trials_of,
)
from sysid_trib.discrepancy.frequency_parameters import has_frequency_parameter
from sysid_trib.forces.force import ForceLibrary

# A response of which less than this part is outside of what the model's unknowns can move is not testable.
TESTABLE = 1e-5
SAME = "not testable on this record: parameters of the model have the same effect"
# A force beyond this part of the restoring force is not small: scores say nothing of it.
STRONGEST = 0.5
# Draws of the largest score of noise.
DRAWS = 4000
# Rounds in which the grid is made finer, from which score on, and for which forces (part of the highest).
FINER = 2
HIGH = 5.0
NEAR = 0.6
# Lines of the residual's spectrum at which a periodic force is tried.
LINES = 3


@dataclass(frozen=True)
class Scores:
    """Each trial held against what the model leaves.

    Attributes
    ----------
    trials : (trial,); reasons : why a trial cannot be tested, else empty.
    z : (trial,) score; size : (trial,) its response outside of the model's, in units of the noise: the
        error of its coefficient is 1/size; share : (trial,) the part of its response that is outside.
    strength : (trial,) its RMS force over the RMS angle, with a coefficient of 1.
    moved : (sample, trial) whitened responses; directions : those outside of the model's, of unit length.
    tests : number of independent tests; p_values : (trial,) of a larger score by chance in any of them.
    """

    trials: list[TrialCandidate]
    reasons: list[str]
    z: Array
    size: Array
    share: Array
    strength: Array
    moved: Array
    directions: Array
    tests: float
    p_values: Array

    def can_be(self, at: int, coefficient: float, *, instead: bool = False) -> bool:
        """Whether a trial can be tested, and with this coefficient stays below the restoring force.

        A passive one must not drive the motion.
        `instead` : in place of a force of the model, where beside it it may be the same.
        """
        good = self.reasons[at] in (("", SAME) if instead else ("",))
        drives = self.trials[at].force.passive and coefficient < 0.0
        return good and not drives and abs(coefficient) * float(self.strength[at]) < STRONGEST

    def best(self) -> list[int]:
        """The trial of each force that scores highest, forces that cannot be tested left out, best first."""
        found: dict[str, int] = {}
        for at in np.argsort(-np.abs(self.z)).tolist():
            if self.can_be(at, float(self.z[at] / max(self.size[at], 1e-300))):
                found.setdefault(self.trials[at].force.symbol, at)
        return list(found.values())


def scores(
    baseline: Baseline, candidates: ForceLibrary, references: Sequence[ReferenceMotion], seed: int = 0
) -> Scores:
    """Score every candidate at a grid of its shape parameters, finer where a score is high.

    Notes
    -----
    z = <r, g'>/|g'| with the residual r in units of the noise, and g' the part of the response that the
    model's own unknowns cannot move. The p-value is corrected for the number of tests: the largest of as many
    scores of noise, correlated as these are.
    """
    space = baseline.column_space
    residual = project_out(baseline.residual, space)
    if not len(candidates):
        none, nothing = np.zeros(0), np.zeros((len(residual), 0))
        return Scores([], [], none, none, none, none, nothing, nothing, 1.0, none)
    frequencies, looked = _lines(baseline, residual)
    found = _scored(
        baseline,
        trials_of(candidates, frequencies, references[0].model.reference_frequency),
        references,
        space,
        residual,
    )
    for _ in range(FINER):
        highest = float(np.max(np.abs(found.z), initial=0.0))
        promising = [at for at in found.best() if highest > HIGH and abs(found.z[at]) > NEAR * highest]
        found = finer(found, promising, baseline, references)
    good = np.array([not reason for reason in found.reasons])
    tests = independent_tests(found.directions[:, good], seed)
    searched = np.array([has_frequency_parameter(trial.force) for trial in found.trials])
    # A line may lie between two frequencies, with any phase: some 2.5 chances each, of two degrees.
    lines = 2.5 * looked * np.exp(-0.5 * found.z**2)
    chance = 2.0 * norm.sf(np.abs(found.z)) * tests + np.where(searched, lines, 0.0)
    return replace(found, tests=tests, p_values=np.where(good, np.minimum(1.0, chance), 1.0))


def _scored(
    baseline: Baseline,
    trials: list[TrialCandidate],
    references: Sequence[ReferenceMotion],
    space: Array,
    residual: Array,
) -> Scores:
    each = [moved_by(course, trials) for course in references]
    moved = baseline.problem.white([one.angle for one in each])
    whole = np.linalg.norm(moved, axis=0)
    # Twice: what is left of a response that is nearly all inside is rounding else.
    outside = project_out(project_out(moved, space), space)
    size = np.linalg.norm(outside, axis=0)
    share = np.divide(size, whole, out=np.zeros_like(size), where=whole > 0.0)
    reasons = [next((r for one in each if (r := one.reasons[at])), "") for at in range(len(trials))]
    for at in np.flatnonzero(share < TESTABLE):
        reasons[at] = reasons[at] or SAME
    good = np.array([not reason for reason in reasons])
    directions = np.where(good, outside / np.where(size > 0.0, size, 1.0), 0.0)
    strength = np.max([one.strength for one in each], axis=0)
    none = np.ones(len(trials))
    return Scores(
        trials, reasons, directions.T @ residual, size, share, strength, moved, directions, 1.0, none
    )


def finer(
    found: Scores, chosen: Sequence[int], baseline: Baseline, references: Sequence[ReferenceMotion]
) -> Scores:
    """The scores with trials halfway from the chosen ones to their neighbours on the grid of shapes."""
    more = []
    for at in chosen:
        trial = found.trials[at]
        for name, value in trial.shapes.items():
            tried = sorted({p.shapes[name] for p in found.trials if p.force.symbol == trial.force.symbol})
            place = tried.index(value)
            for other in (*tried[max(0, place - 1) : place], *tried[place + 1 : place + 2]):
                both = value * other
                middle = np.sqrt(both) if value > 0.0 and other > 0.0 else 0.5 * (value + other)
                more.append(TrialCandidate(trial.force, {**trial.shapes, name: float(middle)}))
    if not more:
        return found
    space = baseline.column_space
    residual = project_out(baseline.residual, space)
    return _joined(found, _scored(baseline, more, references, space, residual))


def _joined(first: Scores, second: Scores) -> Scores:
    def both(name: str) -> Any:
        one, other = getattr(first, name), getattr(second, name)
        return one + other if isinstance(one, list) else np.concatenate([one, other], axis=-1)

    names = ("trials", "reasons", "z", "size", "share", "strength", "moved", "directions", "p_values")
    return replace(first, **{name: both(name) for name in names})


def independent_tests(directions: Array, seed: int = 0, level: float = 0.01) -> float:
    """Number of independent tests whose largest score is as large as that of these correlated ones.

    The level-quantile of the largest |z| of noise, by drawing; then Bonferroni's number for it.
    """
    if directions.shape[1] == 0:
        return 1.0
    covariance = directions.T @ directions
    values, axes = np.linalg.eigh(covariance)
    factor = axes * np.sqrt(np.clip(values, 0.0, None))
    draws = np.random.default_rng(seed).standard_normal((DRAWS, len(values))) @ factor.T
    largest = np.quantile(np.max(np.abs(draws), axis=1), 1.0 - level)
    return max(1.0, level / (2.0 * float(norm.sf(largest))))


def _lines(baseline: Baseline, residual: Array) -> tuple[list[float], int]:
    """Frequencies (rad/s) of the strongest lines in what is left, and how many were looked at."""
    found: list[tuple[float, float]] = []
    looked = 0
    for record, part in zip(baseline.problem.records, baseline.split_by_run(residual), strict=True):
        count = len(part)
        step = float(np.median(np.diff(record.time)))
        # Zeros after the end: a line between two frequencies loses nothing.
        power = np.abs(np.fft.rfft(part * np.hanning(count), 4 * count)) ** 2
        frequency = 2.0 * np.pi * np.fft.rfftfreq(4 * count, step)
        peaks, _ = find_peaks(power, distance=8)
        strongest = peaks[np.argsort(power[peaks])[::-1][:LINES]]
        found += [(float(power[at]), float(frequency[at])) for at in strongest if at]
        looked += count // 2
    return [w for _, w in sorted(found, reverse=True)[:LINES]], looked
