"""Numbers of any result as one table: value, standard error, interval, unit, by model and quantity."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.printing import layout
from sysid_trib.results.judged import given_results
from sysid_trib.results.kinds import SIDES, contents_text, kind_of
from sysid_trib.results.models import library_of
from sysid_trib.results.store import Status
from sysid_trib.results.variables import HALF_INTERVAL

NUMBER_COLUMNS = ("value", "standard_error", "low", "high", "unit")
# For a campaign: true for quantities with one value per force.
_CAMPAIGN_QUANTITIES = {"coefficient": True, "reference_frequency": False, "asymptotic_frequency": False}
DIFFERENCE_ROW, STIFFNESS_ROW = "difference", "stiffness_difference"


def summary(result: xr.Dataset | xr.DataTree) -> pd.DataFrame:
    """Return the numbers of a result as a table.

    Parameters
    ----------
    result : Dataset or DataTree
        Result of `identify`, `laws`, `compare`, `discover`, `difference`, `campaign` or a method.

    Returns
    -------
    DataFrame
        A row for each coefficient, shape parameter and frequency, by `model` (for `difference` by `sample`,
        for `campaign` by `record` and `model`) and `quantity`: `value`, `standard_error`, `low` and `high`
        (limits of a normal 95 % interval) and `unit`. Fixed parameters have no error. Basis functions of
        curves are omitted: the laws are the variables `friction` and `restoring` of the identification.

    Raises
    ------
    UsageError
        The object is not such a result.

    Examples
    --------
    >>> import sysid_trib as st
    >>> table = st.summary(st.identify(st.records.paper_twin()))
    >>> print(table.loc["direct", ["value", "standard_error", "unit"]].round(5).to_string())
                            value  standard_error   unit
    quantity
    lambda               -0.00002         0.00000      1
    zeta                  0.00970         0.00004      1
    delta                 0.03707         0.00043      1
    nu                   -0.39952         0.00104      1
    epsilon               0.29743         0.00418      1
    reference_frequency   9.90992         0.00027  rad/s
    asymptotic_frequency  9.90945         0.00027  rad/s
    """
    rows: Iterator[dict[str, Any]]
    by = "model"
    tree = result if isinstance(result, xr.DataTree) else xr.DataTree()
    if isinstance(result, xr.Dataset):
        tree = xr.DataTree(result)
    kind = kind_of(tree)
    if kind == "difference":
        by, rows = "sample", _of_difference(tree)
    elif {"status", "coefficient"} <= set(tree.data_vars):
        return _of_campaign(tree.to_dataset())
    elif kind:
        named = {str(tree.attrs["method"]): tree.to_dataset()} if kind == "identify" else given_results(tree)
        rows = _of_identifications(named)
    else:
        raise UsageError(
            "summary needs a result of identify, laws, compare, discover, difference or campaign, or of a "
            f"method, not {contents_text(result)}."
        )
    table = pd.DataFrame([_with_interval(row) for row in rows], columns=["by", "quantity", *NUMBER_COLUMNS])
    return table.rename(columns={"by": by}).set_index([by, "quantity"])


def _of_identifications(named: Mapping[str, xr.Dataset]) -> Iterator[dict[str, Any]]:
    """Yield the coefficients, shape parameters and frequencies of each identification."""
    for name, result in named.items():
        parts = {force.symbol for force in library_of(result) if force.curve}
        for row in layout.quantities(result):
            if row["quantity"].partition(".")[0] not in parts:
                yield {"by": name} | row


def _of_campaign(store: xr.Dataset) -> pd.DataFrame:
    """Return the numbers of all records that have any, by record, model and quantity."""
    done = store.isel(record=np.flatnonzero(store.status.values == Status.DONE)).load()
    tables = []
    for name, of in _CAMPAIGN_QUANTITIES.items():
        numbers = done[[name, f"{name}_standard_error" if name != "coefficient" else "standard_error"]]
        numbers = numbers.rename(dict(zip(numbers.data_vars, NUMBER_COLUMNS, strict=False)))
        # A quantity with one name, or with one for each force.
        numbers = numbers.rename(force="quantity") if of else numbers.expand_dims(quantity=[name])
        units = numbers["unit"] if of else xr.DataArray([done[name].attrs["units"]], dims="quantity")
        table = numbers.reset_coords(drop=True).assign(unit=units.reset_coords(drop=True)).to_dataframe()
        tables.append(table.reset_index())
    whole = pd.concat(tables).dropna(subset="value")
    half = HALF_INTERVAL * whole.standard_error.fillna(0.0)
    whole = whole.assign(low=whole.value - half, high=whole.value + half)
    return whole.set_index(["record", "model", "quantity"])[list(NUMBER_COLUMNS)].sort_index(level=[0, 1])


def _of_difference(tree: xr.DataTree) -> Iterator[dict[str, Any]]:
    """Yield the coefficients of both samples, their difference, and that of the stiffnesses."""
    data = tree.to_dataset()
    for name in (*SIDES, DIFFERENCE_ROW):
        error = "standard_error" if name == DIFFERENCE_ROW else f"{name}_standard_error"
        for symbol, row in layout.by_label(data, "force").items():
            numbers = {"value": row[name].item(), "standard_error": row[error].item()}
            yield {"by": name, "quantity": symbol, "unit": row["unit"].item()} | numbers
    numbers = {
        "value": data[STIFFNESS_ROW].item(),
        "standard_error": data[f"{STIFFNESS_ROW}_standard_error"].item(),
    }
    yield {"by": DIFFERENCE_ROW, "quantity": STIFFNESS_ROW, "unit": "1"} | numbers


def _with_interval(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row with the limits of its interval."""
    value, error = float(row["value"]), float(row.get("standard_error", 0.0))
    half = HALF_INTERVAL * error
    return {"unit": "1"} | dict(row) | {"standard_error": error, "low": value - half, "high": value + half}
