"""The stored model of an identification: its forces, shape parameters and reference frequencies."""

import numpy as np
import xarray as xr

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import library_of_text

# Marks an option that is stored as text only and cannot be read back: an optimiser, a start model.
NOT_KEPT = "not kept"
# Attribute of a result: units of the inputs that have separate units.
INPUT_UNITS = "input_units"


def library_of(result: xr.Dataset, whole: bool = False) -> ForceLibrary:
    """Return the force library of an identification: its forces, or the whole file it was read from."""
    library = library_of_text(result.attrs["library"], result.attrs["library_source"])
    return library if whole else library.select(result.force.values.tolist())


def shape_values_of(result: xr.Dataset, library: ForceLibrary | None = None) -> dict[str, float]:
    """Return the shape parameters of an identification by name, such as `dahl.s`; of one library if given."""
    if "shape" not in result:
        return {}
    names = result.shape_parameter.values.tolist()
    values = dict(zip(names, result["shape"].values.tolist(), strict=True))
    if library is None:
        return values
    known = library.shape_values()
    return {name: value for name, value in values.items() if name in known}


def in_model(result: xr.Dataset, symbol: str) -> bool:
    """Return true if a coefficient refers to the identification's own reference frequency."""
    return symbol in forces_in_model(result)


def forces_in_model(result: xr.Dataset) -> list[str]:
    """Return forces whose coefficient refers to the identification's own reference frequency."""
    own = np.isclose(result.refers_to.values, result.reference_frequency.item(), rtol=1e-12)
    return [str(symbol) for symbol in result.force.values[own]]
