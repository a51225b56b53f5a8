"""Roles of the variables of a record: inputs that drive the motion, and known constants of a run."""

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


def constants_of(record: xr.Dataset) -> dict[str, float]:
    """Return the known constants of a run by their names."""
    marked = ((str(name), values) for name, values in record.data_vars.items() if CONSTANT in values.attrs)
    return {name: float(values.values[0]) for name, values in marked}
