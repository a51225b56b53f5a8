"""Grids of shape parameters made finer where two neighbours' columns differ, so that nothing lies between."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.likelihood_fit.frequency_parameters import is_frequency_parameter, is_phase
from sysid_trib.likelihood_fit.trials import TrialEffect, from_unit, to_unit
from sysid_trib.screening.white_columns import base_of, outside_of

# Times a cell of a grid is halved at most.
HALVINGS = 4


def refined(
    model: FittedModel, trials: Sequence[TrialEffect], columns: Sequence[Array]
) -> tuple[list[TrialEffect], list[Array], Array]:
    """Trials with values of their shapes between those whose columns are not alike, and all their columns.

    And the root of what these gain in the model's own noises, with the sign of its coefficient, (trial,).

    Parameters
    ----------
    model : FittedModel
    trials : sequence of TrialEffect
    columns : sequence of (row, trial) array of float
        Of each run.

    Notes
    -----
    A column halfway between two of correlation c, beside the model and in its noise, has the correlation
    ((1 + c) / 2)^(1/2) with either: what it gains is seen but for a part of (1 - c) / 2. That part is the
    setting `slack`. Several shapes of a candidate are climbed instead (`shape_climb`).
    """
    every, tables = list(trials), list(columns)
    alike, most = 1.0 - 2.0 * model.settings.slack, 2 * model.settings.shape_values
    added: dict[str, int] = {}
    base = base_of(model)
    outside, part = _directions(model, base, tables)
    for _ in range(HALVINGS):
        pairs = [
            (float(outside[:, at] @ outside[:, other]), trial)
            for at, other, trial in neighbours(every)
            if len(trial.shapes) == 1 and max(part[at], part[other]) >= model.settings.testable
        ]
        between: list[TrialEffect] = []
        for correlation, trial in sorted(pairs, key=lambda pair: pair[0]):
            symbol = trial.force.symbol
            if correlation < alike and added.get(symbol, 0) < most:
                added[symbol] = added.get(symbol, 0) + 1
                between.append(trial)
        if not between:
            break
        new = [rows.coarse_columns(between) for rows in model.rows]
        added_outside, added_part = _directions(model, base, new)
        outside, part = np.column_stack([outside, added_outside]), np.append(part, added_part)
        every += between
        tables = [np.column_stack([table, column]) for table, column in zip(tables, new, strict=True)]
    return every, tables, outside.T @ np.concatenate(model.white_residuals())


def _directions(model: FittedModel, base: Array, columns: Sequence[Array]) -> tuple[Array, Array]:
    """What of columns is outside of the model's, of unit length or zero, and which part of each that is."""
    outside, part = outside_of(model, columns, base)
    return outside / np.maximum(np.linalg.norm(outside, axis=0), 1e-300), part


def neighbours(trials: Sequence[TrialEffect]) -> Iterator[tuple[int, int, TrialEffect]]:
    """Trials next to each other in one shape parameter, by their places, and the one halfway between."""
    lines: dict[tuple[str, str, tuple[tuple[str, float], ...]], list[tuple[float, int]]] = {}
    for at, trial in enumerate(trials):
        force = trial.force
        if any(is_frequency_parameter(force, name) for name in force.shape):
            continue
        for name, shape in force.shape.items():
            key = f"{force.symbol}.{name}"
            others = tuple(sorted((k, value) for k, value in trial.shapes.items() if k != key))
            if not is_phase(force, name):
                lines.setdefault((key, name, others), []).append((to_unit(shape, trial.shapes[key]), at))
    for (key, name, _), line in lines.items():
        line.sort()
        for (low, at), (high, other) in pairwise(line):
            trial = trials[at]
            middle = float(from_unit(trial.force.shape[name], np.asarray(0.5 * (low + high))))
            yield at, other, replace(trial, shapes={**trial.shapes, key: middle})
