"""Several shape parameters of a candidate, from a grid to the values at which its column gains most."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.forces.force import Force
from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.likelihood_fit.frequency_parameters import has_frequency_parameter
from sysid_trib.likelihood_fit.likelihood import likelihood
from sysid_trib.likelihood_fit.run_products import has_products
from sysid_trib.likelihood_fit.trials import TrialEffect, stepped_shape, trials_of
from sysid_trib.screening.columns_beside import each_beside
from sysid_trib.screening.physical import are_physical, strengths
from sysid_trib.screening.shape_grids import neighbours

# Combinations of the finer grid, over those that are screened: of three shapes two have thrice the values.
FINER = 9
# Others that a fit starts from where that from the best fails.
STARTS = 3
# First step, over the last.
FIRST_STEP = 2.0


class Climb(NamedTuple):
    """What a trial gains, and the step of its shapes that is tried next, in parts of their ranges."""

    gain: float
    trial: TrialEffect
    step: float


def climbed(
    model: FittedModel, candidates: Iterable[Force], effects: Sequence[str] = ()
) -> list[TrialEffect]:
    """Candidates of several shapes, each at the combination where its column gains most.

    Parameters
    ----------
    model : FittedModel
    candidates : iterable of Force
    effects : sequence of str
        Of the model: a candidate of the family of some stands in the place of these.

    Notes
    -----
    What is screened has two to four values of each of three shapes, none of which may be near. From each
    combination of a finer grid that is not worse than those next to it the shapes go one at a time to the
    best of their neighbours, in steps that are halved down to the setting `shape_step` (compass search:
    Kolda, Lewis, Torczon 2003). What gains no more than chance stays, and what gains far less than the
    effects in whose place it is.
    """
    settings, frequency = model.settings, model.rows[0].path.frequency
    finer = replace(settings, combinations=FINER * settings.combinations)
    several = [f for f in candidates if len(f.shape) > 1 and not has_frequency_parameter(f)]
    family = {t.force.symbol: t.force.family for t in model.trials if t.force.symbol in effects}
    tops = list[TrialEffect]()
    for force in several:
        gone = [symbol for symbol in family if family[symbol] == force.family]
        ends = _ends(model, trials_of([force], (), frequency, finer), gone)
        tops += [replace(ends[0], starts=tuple(ends[1 : 1 + STARTS]))] if ends else []
    return tops


def _ends(model: FittedModel, grid: list[TrialEffect], gone: Sequence[str]) -> list[TrialEffect]:
    """Combinations to which the best of a grid lead, best first; none where none gains more than chance.

    Nor where all are far worse than the effects in whose place they are.
    """
    gains, settings = _gains(model, grid, gone), model.settings
    if gone and np.max(gains) < (1.0 - settings.kin) * _gain_of(model, gone):
        return []
    pairs = [sorted(pair, key=lambda at: gains[at]) for *pair, _ in neighbours(grid)]
    # Of two that are alike either may lead further: where a shape hardly matters yet.
    beaten = {worse for worse, better in pairs if gains[better] > gains[worse] + settings.least_gain}
    least = max(settings.outside_of_set, (1.0 - settings.kin) * float(np.max(gains)))
    promising = [at for at in np.flatnonzero(gains > least).tolist() if at not in beaten]
    climbs = [Climb(float(gains[at]), grid[at], FIRST_STEP * settings.shape_step) for at in promising]
    ends = list[Climb]()
    while climbs:
        aside = [_aside(climb.trial, climb.step) for climb in climbs]
        gains_aside = iter(_gains(model, [trial for near in aside for trial in near], gone).tolist())
        further = []
        for climb, near in zip(climbs, aside, strict=True):
            best, trial = max(((next(gains_aside), trial) for trial in near), key=lambda scored: scored[0])
            if best > climb.gain + settings.least_gain:
                further.append(Climb(best, trial, climb.step))
            elif climb.step > settings.shape_step:
                further.append(climb._replace(step=0.5 * climb.step))
            elif climb not in ends:
                ends.append(climb)
        climbs = [climb for at, climb in enumerate(further) if climb not in further[:at]]
    return [climb.trial for climb in sorted(ends, key=lambda climb: -climb.gain)]


def _aside(trial: TrialEffect, step: float) -> list[TrialEffect]:
    """The trial with each of its shapes a step lower and higher, in parts of their ranges."""
    near = []
    for name in trial.force.shape:
        key = f"{trial.force.symbol}.{name}"
        for side in (-step, step):
            value = stepped_shape(trial.force, name, trial.shapes[key], side)
            near.append(replace(trial, shapes={**trial.shapes, key: value}))
    return near


def _gain_of(model: FittedModel, effects: Sequence[str]) -> float:
    """By how much effects of the model lower its deviance, along its path."""
    products = [rows.products(table) for rows, table in zip(model.rows, model.tables, strict=True)]
    whole = likelihood(products, range(1, 1 + model.columns))
    return likelihood(products, model.columns_without(effects)).deviance - whole.deviance


def _gains(model: FittedModel, trials: Sequence[TrialEffect], gone: Sequence[str]) -> Array:
    """By how much the column of each, in the place of effects, lowers the deviance, (trial,).

    0 where physics forbids its sign.
    """
    columns = [rows.coarse_columns(trials) for rows in model.rows]
    good = np.all([has_products(column) for column in columns], axis=0)
    columns = [np.where(good, column, 0.0) for column in columns]
    products = [
        rows.products(np.column_stack([table, column]))
        for rows, table, column in zip(model.rows, model.tables, columns, strict=True)
    ]
    base, first = model.columns_without(gone), 1 + model.columns
    whole = likelihood(products, base)
    beside = each_beside(products, base, range(first, first + len(trials)), whole)
    strongest = model.settings.strongest
    physical = are_physical(trials, beside.coefficients, strengths(model, columns), strongest)
    return np.where(good & physical, whole.deviance - beside.deviance, 0.0)
