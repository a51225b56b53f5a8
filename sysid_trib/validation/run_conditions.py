"""Conditions of runs (load, material, laboratory) as columns of a fit."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError


def conditions_table(conditions: Mapping[str, ArrayLike] | pd.DataFrame | None, runs: int) -> pd.DataFrame:
    """The table of conditions, a row a run.

    Raises
    ------
    UsageError
        It has another number of rows, or a row without a value.
    """
    try:
        table = pd.DataFrame({} if conditions is None else conditions).reset_index(drop=True)
    except ValueError as error:
        raise UsageError(f"The conditions are no table: {error}.") from None
    if not len(table.columns):
        return pd.DataFrame(index=range(runs))
    if len(table) != runs:
        raise UsageError(f"The conditions have {len(table)} rows for {runs} runs; give one row a run.")
    for name in table:
        missing = table[name].isna().to_numpy()
        if missing.any():
            raise UsageError(
                f"Condition '{name}' has no value for run {int(np.argmax(missing)) + 1}; "
                "complete it, or leave the run out."
            )
    return table.copy()


def columns_of(table: pd.DataFrame) -> tuple[dict[str, Array], list[str]]:
    """Columns of the fit by the name of their term, and of which condition each is; the mean's is ''.

    Raises
    ------
    UsageError
        A condition does not vary, or goes with others.
    """
    for name, column in table.items():
        if len(set(column)) < 2:
            raise UsageError(f"Condition '{name}' is the same in all runs; leave it out.")
    _, collinear = without_collinear(table)
    if collinear:
        name, others = next(iter(collinear.items()))
        raise UsageError(f"Condition '{name}' goes with {others} in these runs; leave one of them out.")
    columns, condition_of = {"mean": np.ones(len(table))}, [""]
    for name, column in table.items():
        of_condition = _columns_of_condition(str(name), column)
        columns |= of_condition
        condition_of += [str(name)] * len(of_condition)
    return columns, condition_of


def without_collinear(table: pd.DataFrame) -> tuple[pd.DataFrame, dict[str, str]]:
    """The conditions without those that go with ones before them.

    Parameters
    ----------
    table : DataFrame
        Conditions that vary, a row a run.

    Returns
    -------
    table : DataFrame
        Those whose effects a fit can tell apart.
    collinear : dict of str to str
        Each of the others, and with which it goes: `'load'`, or `'load', 'speed' together`.
    """
    kept: list[str] = []
    collinear = {}
    for name in table:
        if not _goes_with(table, name, kept):
            kept.append(name)
            continue
        partners = [other for other in kept if _goes_with(table, name, [other])]
        collinear[str(name)] = f"'{partners[0]}'" if partners else f"{listed(table[kept])} together"
    return table[kept], collinear


def _goes_with(table: pd.DataFrame, name: str, others: Sequence[str]) -> bool:
    """True if a condition is a mean and effects of others, in more runs than decide all of them."""
    columns = [np.ones(len(table))]
    for condition in (*others, name):
        columns += _columns_of_condition(condition, table[condition]).values()
    design = np.column_stack(columns)
    sized = design / np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    return bool(np.linalg.matrix_rank(sized) < min(sized.shape))


def _columns_of_condition(name: str, column: pd.Series) -> dict[str, Array]:
    """One column of numbers, or one of each group of texts but the first."""
    if pd.api.types.is_numeric_dtype(column) and not pd.api.types.is_bool_dtype(column):
        numbers = column.to_numpy(dtype=float)
        return {name: numbers - numbers.mean()}
    groups = column.astype(str)
    columns = {}
    for group in list(dict.fromkeys(groups))[1:]:
        inside = (groups == group).to_numpy(dtype=float)
        # As of numbers: the mean stays that of all runs, the effect is over the first group.
        columns[f"{name}={group}"] = inside - inside.mean()
    return columns


def listed(table: pd.DataFrame) -> str:
    """Names of the conditions, as a sentence takes them."""
    return ", ".join(f"'{name}'" for name in table) or "none"
