"""Conditions of a campaign: estimates of its records side by side, and a table of conditions."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import xarray as xr

from sysid_trib.errors import RecordError, UsageError
from sysid_trib.records.tables import check_is_file
from sysid_trib.results.store import Status, of_model
from sysid_trib.validation.common_reference import ASYMPTOTIC_FREQUENCY

# Column with the names of the records in a table of conditions; without it, rows are in the order of records.
RECORD = "record"


def estimates_of(store: xr.Dataset, model: str) -> xr.Dataset:
    """Return coefficients and frequency of all records with numbers, in the form for `between_runs`.

    Parameters
    ----------
    store : Dataset
        Store of a campaign.
    model : str
        Label of the identification, as `of_model` takes it.

    Returns
    -------
    Dataset
        `value(run, quantity)` and `standard_error(run, quantity)`, coefficients at the mean reference
        frequency (attrs), `run` (name of the record) and `at(run)` (its position). Records in another unit
        than the majority are omitted (attrs: `signal_units`, and `other_units`, their number).

    Examples
    --------
    Runs of a campaign, prepared for `between_runs`.

    >>> import sysid_trib as st
    >>> records = [st.records.paper_twin(seed=seed) for seed in (1, 2, 3)]
    >>> task = st.campaigns.Task("identify", methods={"direct": st.methods.Direct()})
    >>> store = st.campaign(records, task, output="runs.zarr", workers=0)
    >>> estimates = st.campaigns.estimates_of(store, "direct")
    >>> estimates.value.sel(quantity="zeta").round(4).values.tolist()
    [0.0096, 0.0097, 0.0097]
    >>> st.campaigns.between_runs(estimates).verdict.sel(quantity="zeta").item()
    'common'
    """
    places = np.flatnonzero(store.status.values == Status.DONE)
    units = store.signal_units.values[places].astype(str)
    usual = pd.Series(units).mode().get(0, "")
    places = places[units == usual]
    done = of_model(store.isel(record=places), model)
    reference = done.reference_frequency.values
    mean = float(np.nanmean(reference)) if np.any(np.isfinite(reference)) else np.nan
    degrees = done.speed_degree.values
    # A force without a degree does not scale; its coefficient is compared unchanged.
    power = np.where(np.isnan(degrees), 0.0, 2.0 - degrees)
    factor = (reference[:, None] / mean) ** power
    values = np.column_stack([factor * done.coefficient.values, done.asymptotic_frequency.values])
    of_frequency = done.asymptotic_frequency_standard_error.values
    errors = np.column_stack([factor * done.standard_error.values, of_frequency])
    known = np.flatnonzero(np.sum(np.isfinite(values) & (errors > 0.0), axis=0) > 1)
    dims, of_quantities = ("run", "quantity"), np.array([*done.force.values, ASYMPTOTIC_FREQUENCY], dtype=str)
    of_units = np.array([*done.unit.values, "rad/s"], dtype=str)
    data = {"value": (dims, values[:, known]), "standard_error": (dims, errors[:, known])}
    coords = {"run": done.record.values.astype(str), "at": ("run", places)}
    coords |= {"quantity": of_quantities[known], "unit": ("quantity", of_units[known])}
    attrs = {"signal_units": str(usual), "other_units": int(np.sum(units != usual))}
    return xr.Dataset(data, coords, {"reference_frequency": mean} | attrs)


def read_conditions(path: Path, records: Sequence[str]) -> pd.DataFrame:
    """Read a table of conditions with one row for each record.

    Parameters
    ----------
    path : Path
        CSV file with a heading. A column `record` contains the names of the records, as file names or as they
        were given; without it, rows are in the order of the records.
    records : sequence of str
        Names of the records.

    Raises
    ------
    UsageError
        There is no such file, or it has no row for a record.
    RecordError
        The file is not a table.
    """
    check_is_file(path)
    try:
        with path.open() as file:
            heading = file.readline()
        # Separator in spreadsheets with a decimal comma.
        marks = {"sep": ";", "decimal": ","} if ";" in heading and "," not in heading else {}
        # Separator of cells copied from a spreadsheet.
        marks = {"sep": "\t"} if "\t" in heading and "," not in heading else marks
        table = pd.read_csv(path, skipinitialspace=True, **marks)
    except (OSError, ValueError) as error:
        raise RecordError(f"{path.name}: not a table of conditions in CSV ({error}).") from None
    _check_values(path, table)
    if RECORD not in table:
        base_names = {Path(name).name for name in records}
        for column in table:
            if set(table[column].astype(str)) & base_names:
                raise UsageError(
                    f"{path.name}: column '{column}' contains names of records; call it '{RECORD}'."
                )
        if len(table) != len(records):
            rows = f"{len(table)} row{'s' * (len(table) != 1)}"
            raise UsageError(
                f"{path.name}: {rows} for {len(records)} records; give one row a record, or a "
                f"column '{RECORD}' with their names."
            )
        return table
    table.index = pd.Index(table.pop(RECORD).astype(str))
    if (repeated := table.index[table.index.duplicated()]).size:
        raise UsageError(f"{path.name}: '{repeated[0]}' has two rows.")
    known = [name if name in table.index else Path(name).name for name in records]
    short = [of for of, name in zip(known, records, strict=True) if of != name]
    if twice := [name for name in short if short.count(name) > 1 and name in table.index]:
        raise UsageError(
            f"{path.name}: '{twice[0]}' is the name of several records; give them with their folders."
        )
    if lacking := [name for name in known if name not in table.index]:
        raise UsageError(f"{path.name}: has no row for record '{lacking[0]}'.")
    return table.loc[known].reset_index(drop=True)


def _check_values(path: Path, table: pd.DataFrame) -> None:
    """Raise an error, before any computation, for a table in which a record lacks a condition."""
    for column in table:
        missing = np.flatnonzero(table[column].isna())
        if len(missing):
            row = table[RECORD].iloc[missing[0]] if RECORD in table else f"row {missing[0] + 1}"
            raise UsageError(f"{path.name}: '{column}' has no value for {row}; complete it.")
