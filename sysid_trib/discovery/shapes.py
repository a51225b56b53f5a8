"""Shape parameters of candidates: a sufficiently fine grid, and their optimisation from there."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discovery import single_columns as single
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.likelihood import likelihood
from sysid_trib.discovery.engine.shape_parameters import (
    has_frequency_parameter,
    is_frequency_parameter,
    is_phase,
)
from sysid_trib.discovery.engine.trials import TrialEffect, trials_of
from sysid_trib.forces.force import Force


def refined(
    model: FittedModel, trials: Sequence[TrialEffect]
) -> tuple[list[TrialEffect], list[Array], Array]:
    """Return trials on a refined grid of shape values, and columns of each run.

    Also return the root of the gain of each in the model's own noises, with the sign of its coefficient,
    (trial,).

    Notes
    -----
    Let c be the correlation of two neighbouring columns, given the model and in its noise. A column halfway
    between has the correlation ((1 + c) / 2)^(1/2) with either, so the grid misses a fraction (1 - c) / 2 of
    its gain. The setting `tolerance` limits this fraction. Candidates with several shapes are optimised
    instead (`climbed`).
    """
    every, new, added = list[TrialEffect](), list(trials), dict[str, int]()
    alike, most = 1.0 - 2.0 * model.settings.tolerance, 2 * model.settings.shape_values
    base = single.base_of(model)
    tables = [np.empty((rows.path.form.rows, 0)) for rows in model.rows]
    outside, part = np.empty((len(base), 0)), np.empty(0)
    # The grid, and at most four rounds in which its cells are halved.
    for _ in range(1 + 4):
        columns = [rows.coarse_columns(new) for rows in model.rows]
        tables = [np.column_stack(pair) for pair in zip(tables, columns, strict=True)]
        further, parts = single.outside_of(model, columns, base)
        unit = further / np.maximum(np.linalg.norm(further, axis=0), 1e-300)
        outside, part = np.column_stack([outside, unit]), np.append(part, parts)
        every += new
        pairs = [
            (float(outside[:, at] @ outside[:, other]), trial)
            for at, other, trial in neighbours(every)
            if len(trial.shapes) == 1 and max(part[at], part[other]) >= model.settings.testable
        ]
        new = []
        for correlation, trial in sorted(pairs, key=lambda pair: pair[0]):
            symbol = trial.force.symbol
            if correlation < alike and added.get(symbol, 0) < most:
                added[symbol] = added.get(symbol, 0) + 1
                new.append(trial)
        if not new:
            break
    return every, tables, outside.T @ np.concatenate(model.white_residuals())


def neighbours(trials: Sequence[TrialEffect]) -> Iterator[tuple[int, int, TrialEffect]]:
    """Yield neighbouring trials in one shape parameter, by their indices, and the trial halfway between."""
    lines: dict[tuple[str, str, tuple[tuple[str, float], ...]], list[tuple[float, int]]] = {}
    for at, trial in enumerate(trials):
        force = trial.force
        if any(is_frequency_parameter(force, name) for name in force.shape):
            continue
        for name in (name for name in force.shape if not is_phase(force, name)):
            key = f"{force.symbol}.{name}"
            others = tuple(sorted((k, value) for k, value in trial.shapes.items() if k != key))
            lines.setdefault((key, name, others), []).append((trial.part(name), at))
    for (_, name, _), line in lines.items():
        line.sort()
        for (low, at), (high, other) in pairwise(line):
            yield at, other, trials[at].stepped(name, 0.5 * (high - low))


# Factor of the number of combinations in the finer grid: two of three shapes have three times the values.
FINER = 9
# Number of other starts of a fit, tried if the fit from the best start fails.
STARTS = 3


def climbed(model: FittedModel, candidates: Iterable[Force]) -> list[TrialEffect]:
    """Return the candidates with several shapes, each at the combination where its column gains most.

    A candidate of the same family as effects of the model replaces these effects.

    Notes
    -----
    Screening has two to four values of each of three shapes, and none may be close to the best. The
    optimisation starts from each combination of a finer grid that is not worse than its neighbours. The
    shapes move one at a time to the best neighbour, in steps that are halved down to the setting `shape_step`
    (compass search: Kolda, Lewis, Torczon 2003). Candidates stay unchanged if their gain is not significant,
    or far below that of the effects they would replace.
    """
    settings, frequency = model.settings, model.rows[0].path.frequency
    finer = replace(settings, combinations=FINER * settings.combinations)
    several = [f for f in candidates if len(f.shape) > 1 and not has_frequency_parameter(f)]
    effects = [trial.force for trial in model.trials if trial.added]
    tops = list[TrialEffect]()
    for force in several:
        gone = [effect.symbol for effect in effects if effect.family == force.family]
        ends = _ends(model, trials_of([force], (), frequency, finer), gone)
        tops += [replace(ends[0], starts=tuple(ends[1 : 1 + STARTS]))] if ends else []
    return tops


def _ends(model: FittedModel, grid: list[TrialEffect], gone: Sequence[str]) -> list[TrialEffect]:
    """Return the combinations reached from the best of a grid, best first; none if none is significant.

    Skip the exchange if every candidate fits much worse than the effect it would replace.
    """
    (gains, of_gone), settings = _gains(model, grid, gone), model.settings
    if np.max(gains) < (1.0 - settings.family_tolerance) * of_gone:
        return []
    pairs = [sorted(pair, key=lambda at: gains[at]) for *pair, _ in neighbours(grid)]
    # Keep both of two similar starts: either may lead further if a shape has little effect so far.
    beaten = {worse for worse, better in pairs if gains[better] > gains[worse] + settings.least_gain}
    least = max(settings.outside_of_set, (1.0 - settings.family_tolerance) * float(np.max(gains)))
    promising = [at for at in np.flatnonzero(gains > least).tolist() if at not in beaten]
    # Gain of a trial, the trial, and the next step of its shapes as a fraction of their ranges. The first
    # step is twice the last one.
    climbs = [(float(gains[at]), grid[at], 2.0 * settings.shape_step) for at in promising]
    ends = list[tuple[float, TrialEffect, float]]()
    while climbs:
        # Trials with one shape a step lower or higher.
        aside = [
            [trial.stepped(name, side) for name in trial.force.shape for side in (-step, step)]
            for _, trial, step in climbs
        ]
        gains_aside = iter(_gains(model, [trial for near in aside for trial in near], gone)[0].tolist())
        further = []
        for climb, near in zip(climbs, aside, strict=True):
            gain, trial, step = climb
            best, nearby = max(((next(gains_aside), other) for other in near), key=lambda scored: scored[0])
            if best > gain + settings.least_gain:
                further.append((best, nearby, step))
            elif step > settings.shape_step:
                further.append((gain, trial, 0.5 * step))
            elif climb not in ends:
                ends.append(climb)
        climbs = [climb for at, climb in enumerate(further) if climb not in further[:at]]
    return [trial for _, trial, _ in sorted(ends, key=lambda climb: -climb[0])]


def _gains(model: FittedModel, trials: Sequence[TrialEffect], gone: Sequence[str]) -> tuple[Array, float]:
    """Return the decrease of the deviance by each column in place of effects, (trial,), and by these effects.

    The decrease is 0 if physics forbids the sign of the coefficient.
    """
    good, columns = single.where_finite([rows.coarse_columns(trials) for rows in model.rows])
    products = single.products_with(model, columns)
    base, first = model.columns_without(gone), 1 + model.columns
    bare = likelihood(products, base)
    deviance, coefficients, _, _ = single.each_column(products, base, range(first, first + len(trials)), bare)
    physical = single.are_physical(model, trials, coefficients, columns)
    of_gone = bare.deviance - likelihood(products, range(1, first)).deviance if gone else 0.0
    return np.where(good & physical, bare.deviance - deviance, 0.0), of_gone
