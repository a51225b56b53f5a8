"""Conditions of runs (load, material, laboratory) as columns of a fit."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError

MEAN = "mean"


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
        A condition does not vary, or several go together.
    """
    columns, condition_of = {MEAN: np.ones(len(table))}, [""]
    for name, column in table.items():
        if len(set(column)) < 2:
            raise UsageError(f"Condition '{name}' is the same in all runs; leave it out.")
        if pd.api.types.is_numeric_dtype(column) and not pd.api.types.is_bool_dtype(column):
            numbers = column.to_numpy(dtype=float)
            columns[str(name)] = numbers - numbers.mean()
            condition_of.append(str(name))
            continue
        groups = column.astype(str)
        for group in list(dict.fromkeys(groups))[1:]:
            inside = (groups == group).to_numpy(dtype=float)
            # As of numbers: the mean stays that of all runs, the effect is over the first group.
            columns[f"{name}={group}"] = inside - inside.mean()
            condition_of.append(str(name))
    design = np.column_stack(list(columns.values()))
    sized = design / np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    if np.linalg.matrix_rank(sized) < min(sized.shape):
        raise UsageError(f"The conditions {listed(table)} go together in these runs; leave some out.")
    return columns, condition_of


def listed(table: pd.DataFrame) -> str:
    """Names of the conditions, as a sentence takes them."""
    return ", ".join(f"'{name}'" for name in table) or "none"
