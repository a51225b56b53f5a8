"""The unit of a record's signal, as tables, sentences and figures write it."""

from typing import Any

import xarray as xr

from sysid_trib.results.per_run import record_groups

# Variables in the unit of the signal, one of which each part of a result has.
STATED_IN = ("angle", "noise", "innovation", "measured", "amplitude", "force")


def signal_units(data: Any) -> str:
    """Unit of the signal in a dataset, or in the records of a tree; rad where none is stated.

    Parameters
    ----------
    data : Dataset or DataTree
        A record, an identification, a part of a result, or a whole one.
    """
    part = data[record_groups(data)[0]] if isinstance(data, xr.DataTree) and not data.data_vars else data
    stated = (part[name].attrs.get("units") for name in STATED_IN if name in part)
    return str(next((units for units in stated if units), "rad"))


def small_units(units: str) -> tuple[float, str]:
    """Factor and unit of what is small beside the signal: mrad for angles, else the same."""
    return (1e3, "mrad") if units == "rad" else (1.0, units)


def signal_label(units: str) -> str:
    """What a signal is, with its unit, as the label of an axis."""
    return f"{'angle' if units == 'rad' else 'displacement'} ({units})"


def signal_symbol(units: str) -> str:
    """The symbol of a signal in LaTeX."""
    return r"\theta" if units == "rad" else "x"
