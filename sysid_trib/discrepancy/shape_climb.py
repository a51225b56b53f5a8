"""Several shape parameters of a candidate, from the best values of their grid to where its column gains most."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.columns_beside import each_beside
from sysid_trib.discrepancy.fitted_model import FittedModel
from sysid_trib.discrepancy.frequency_parameters import has_frequency_parameter
from sysid_trib.discrepancy.likelihood import likelihood
from sysid_trib.discrepancy.physical import is_physical, strengths
from sysid_trib.discrepancy.run_products import has_products
from sysid_trib.discrepancy.shape_grids import neighbours
from sysid_trib.discrepancy.trials import TrialEffect, stepped_shape, trials_of
from sysid_trib.forces.force import Force

# Combinations of the finer grid, over those that are screened: of three shapes two have thrice the values.
FINER = 9
# First step, over the last.
FIRST_STEP = 2.0


def climbed(model: FittedModel, candidates: Iterable[Force]) -> list[TrialEffect]:
    """Candidates of several shapes at the combinations where their columns gain most.

    Notes
    -----
    What is screened has two to four values of each of three shapes, none of which may be near. From each
    combination of a finer grid that is better than those next to it the shapes go one at a time to the best
    of their neighbours, in steps that are halved down to the setting `shape_step` (compass search: Kolda,
    Lewis, Torczon 2003). What gains no more than chance stays.
    """
    settings, frequency = model.settings, model.rows[0].path.frequency
    finer = replace(settings, combinations=FINER * settings.combinations)
    several = [f for f in candidates if len(f.shape) > 1 and not has_frequency_parameter(f)]
    return [top for force in several for top in _tops(model, trials_of([force], (), frequency, finer))]


def _tops(model: FittedModel, grid: list[TrialEffect]) -> list[TrialEffect]:
    """Where the best combinations of a grid lead."""
    gains = _gains(model, grid)
    beaten = {min(pair, key=lambda at: (gains[at], -at)) for *pair, _ in neighbours(grid)}
    first = FIRST_STEP * model.settings.shape_step
    climbs = [
        (float(gains[at]), grid[at], first)
        for at in range(len(grid))
        if at not in beaten and gains[at] > model.settings.outside_of_set
    ]
    tops = list[TrialEffect]()
    while climbs:
        aside = [_aside(trial, step) for _, trial, step in climbs]
        gains_aside = iter(_gains(model, [trial for near in aside for trial in near]).tolist())
        further = []
        for (gain, trial, step), near in zip(climbs, aside, strict=True):
            best, at = max((next(gains_aside), -i) for i in range(len(near)))
            if best > gain + model.settings.least_gain:
                further.append((best, near[-at], step))
            elif step > model.settings.shape_step:
                further.append((gain, trial, 0.5 * step))
            else:
                tops.append(trial)
        climbs = further
    return tops


def _aside(trial: TrialEffect, step: float) -> list[TrialEffect]:
    """The trial with each of its shapes a step lower and higher, in parts of their ranges."""
    near = []
    for name in trial.force.shape:
        key = f"{trial.force.symbol}.{name}"
        for side in (-step, step):
            value = stepped_shape(trial.force, name, trial.shapes[key], side)
            near.append(replace(trial, shapes={**trial.shapes, key: value}))
    return near


def _gains(model: FittedModel, trials: Sequence[TrialEffect]) -> Array:
    """By how much the column of each lowers the deviance; 0 where physics forbids its sign, (trial,)."""
    columns = [rows.coarse_columns(trials) for rows in model.rows]
    good = np.all([has_products(column) for column in columns], axis=0)
    columns = [np.where(good, column, 0.0) for column in columns]
    products = [
        rows.products(np.column_stack([table, column]))
        for rows, table, column in zip(model.rows, model.tables, columns, strict=True)
    ]
    base = range(1, 1 + model.columns)
    whole = likelihood(products, base)
    beside = each_beside(products, base, range(base.stop, base.stop + len(trials)), whole)
    relative_force = strengths(model, columns)
    physical = [
        is_physical(trial.force, c, relative, model.settings.strongest)
        for trial, c, relative in zip(trials, beside.coefficients, relative_force, strict=True)
    ]
    return np.where(good & np.array(physical, dtype=bool), whole.deviance - beside.deviance, 0.0)
