"""Grids of shape parameters made finer where two neighbours' columns differ, so that nothing lies between."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sysid_trib.arrays import Array, Mask
from sysid_trib.discrepancy.frequency_parameters import is_frequency_parameter, is_phase
from sysid_trib.discrepancy.likelihood import has_products
from sysid_trib.discrepancy.model_fit import FittedModel
from sysid_trib.discrepancy.trials import TrialEffect, from_unit, to_unit

# Times a cell of a grid is halved at most.
HALVINGS = 4


def refined(
    model: FittedModel, trials: Sequence[TrialEffect], columns: Sequence[Array]
) -> tuple[list[TrialEffect], list[Array]]:
    """Trials with values of their shapes between those whose columns are not alike, and all their columns.

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
    setting `slack`.
    """
    every, tables = list(trials), list(columns)
    base = np.linalg.qr(np.vstack([table[:, 1:] for table in model.white_tables()]))[0]
    alike, most = 1.0 - 2.0 * model.settings.slack, 2 * model.settings.shape_values
    added: dict[str, int] = {}
    outside, size = _outside(model, base, tables)
    for _ in range(HALVINGS):
        pairs = [
            (float(outside[:, at] @ outside[:, other]), trial)
            for at, other, trial in _neighbours(every)
            if max(size[at], size[other]) >= model.settings.testable
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
        parts = _outside(model, base, new)
        outside, size = np.column_stack([outside, parts[0]]), np.append(size, parts[1])
        every += between
        tables = [np.column_stack([table, column]) for table, column in zip(tables, new, strict=True)]
    return every, tables


def known_finely(
    model: FittedModel, trials: Sequence[TrialEffect], columns: Sequence[Array], effects: Sequence[str]
) -> Mask:
    """Whether the columns of trials are the same along a motion that is as likely, (trial,).

    Parameters
    ----------
    model : FittedModel
    trials : sequence of TrialEffect
    columns : sequence of (row, trial) array of float
        Of each run, along its path.
    effects : sequence of str
        Of the model, which trials may replace: beside these they need not be told apart.

    Notes
    -----
    Beside a random force a motion is known as well as the sensor tells it. What a column gains along the path
    is its square correlation with the one along the motion: all but a part that the setting `slack` allows.
    """
    if not np.any(model.likelihood.ratios):
        return np.ones(len(trials), dtype=bool)
    random = np.random.default_rng(model.settings.seed)
    aside = [rows.coarse_columns(trials) for rows in model.possible_rows(random)]
    kept = model.columns_without(effects)
    base = np.linalg.qr(np.vstack([table[:, kept] for table in model.white_tables()]))[0]
    (here, size), (there, _) = (_outside(model, base, tables) for tables in (columns, aside))
    alike = np.einsum("ij,ij->j", here, there)
    return (alike >= np.sqrt(1.0 - model.settings.slack)) | (size < model.settings.testable)


def _outside(model: FittedModel, base: Array, columns: Sequence[Array]) -> tuple[Array, Array]:
    """Directions of columns outside of an orthonormal base, of unit length or zero, and that part of each."""
    white = np.vstack(
        [
            rows.whitened(np.where(has_products(column), column, 0.0), model.likelihood, at)
            for at, (rows, column) in enumerate(zip(model.rows, columns, strict=True))
        ]
    )
    rest = white - base @ (base.T @ white)
    length, whole = np.linalg.norm(rest, axis=0), np.linalg.norm(white, axis=0)
    return rest / np.maximum(length, 1e-300), length / np.maximum(whole, 1e-300)


def _neighbours(trials: Sequence[TrialEffect]) -> Iterator[tuple[int, int, TrialEffect]]:
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
