"""Roles of the variables of a record: inputs that drive the motion, and known constants of a run."""

import json

import xarray as xr

# The input that acts directly, as an acceleration; all others act through the forces with their names.
INPUT = "input"
# Value of attrs["role"] for an input.
ROLE = "input"
# attrs[CONSTANT] of an input that is constant within a run.
CONSTANT = "constant"


def input_names(record: xr.Dataset) -> list[str]:
    """Return the names of the inputs of a record: `input`, and variables with attrs["role"] = "input"."""
    return [str(n) for n in record.variables if n == INPUT or record[n].attrs.get("role") == ROLE]


# The name of a single input, if its column was given without one.
SINGLE_INPUT = "u"


def input_label(record: xr.Dataset, name: str, *details: str) -> str:
    """Return the name of an input as its user knows it: the column, where the program named it `u`.

    `details` : in the brackets that follow.
    """
    column = str(json.loads(record.attrs.get("input_columns", "{}")).get(name, name))
    renamed = name == SINGLE_INPUT and column != name
    inside = [f"{name} in formulas", *details] if renamed else list(details)
    shown = column if renamed else name
    return f"{shown} ({', '.join(inside)})" if inside else shown


def constants_of(record: xr.Dataset) -> dict[str, float]:
    """Return the known constants of a run by their names."""
    marked = ((str(name), values) for name, values in record.data_vars.items() if CONSTANT in values.attrs)
    return {name: float(values.values[0]) for name, values in marked}
