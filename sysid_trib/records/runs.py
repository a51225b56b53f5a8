"""Runs of one experiment: forms of given records, as a list, and checks common to all."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeAlias

import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.records import inputs
from sysid_trib.records.driven_parts import driven_parts
from sysid_trib.records.roles import ROLE, input_label
from sysid_trib.records.signal import checked_signal

Decays: TypeAlias = xr.Dataset | Sequence[xr.Dataset]
# Forms of a record in Python: a Dataset with angle(time), or times and angles in any usual form.
RecordLike: TypeAlias = (
    xr.Dataset
    | xr.DataArray
    | pd.DataFrame
    | pd.Series
    | Array
    | Mapping[str, ArrayLike]
    | tuple[ArrayLike, ArrayLike]
)
# One decay, or several.
RecordsLike: TypeAlias = RecordLike | Iterable[RecordLike]


def as_runs(decay: Decays, *, driven: bool = False) -> list[xr.Dataset]:
    """Return the runs as a list, also a single one.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        `angle(time)` of one run, or of several.
    driven : bool
        Whether known inputs are allowed; a driven record is cleaned, and divided at its gaps.

    Raises
    ------
    UsageError
        No run is given, a run is not a decay, or a known input is not allowed.
    DecayError
        A value is not a number, or the times do not increase.
    """
    runs = [decay] if isinstance(decay, xr.Dataset) else list(decay)
    if not runs:
        raise UsageError("No run is given; give at least one decay.")
    for run in runs:
        checked_signal(run)
    if driven:
        runs = [part for run in runs for part in driven_parts(run)]
    for run in runs:
        if not driven:
            inputs.refuse_inputs(run)
    if driven:
        _refuse_mixed_inputs(runs)
    return runs


def _refuse_mixed_inputs(runs: Sequence[xr.Dataset]) -> None:
    """Raise an error for runs whose inputs of one name have different units."""
    units: dict[str, set[str]] = {}
    for run in runs:
        for name, values in run.variables.items():
            if values.attrs.get("role") == ROLE and (unit := values.attrs.get("units")):
                units.setdefault(str(name), set()).add(str(unit))
    for name, different in units.items():
        if len(different) > 1:
            raise UsageError(
                f"The input {input_label(runs[0], name)} is in different units "
                f"({', '.join(sorted(different))}); runs of one experiment have it in one: convert it."
            )


def one_or_all(runs: Sequence[xr.Dataset]) -> Decays:
    """Return the decay itself if there is only one."""
    return runs[0] if len(runs) == 1 else list(runs)
