"""The model of an identification as it is stored: its forces, its shape parameters, what they refer to."""

import numpy as np
import xarray as xr

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import library_of_text


def library_of(result: xr.Dataset, whole: bool = False) -> ForceLibrary:
    """Return force library of an identification: the forces it holds, or the whole file it was read from."""
    library = library_of_text(result.attrs["library"], result.attrs["library_source"])
    return library if whole else library.select(result.force.values.tolist())


def shape_values_of(result: xr.Dataset, library: ForceLibrary | None = None) -> dict[str, float]:
    """Return the shape parameters of an identification by name, such as `dahl.s`; of one library if given."""
    if "shape" not in result:
        return {}
    values = dict(zip(result.shape_parameter.values.tolist(), result["shape"].values.tolist(), strict=True))
    return values if library is None else {k: v for k, v in values.items() if k in library.shape_values()}


def in_model(result: xr.Dataset, symbol: str) -> bool:
    """Return true if a coefficient refers to the identification's own reference frequency."""
    return symbol in forces_in_model(result)


def forces_in_model(result: xr.Dataset) -> list[str]:
    """Return forces whose coefficient refers to the identification's own reference frequency."""
    own = np.isclose(result.refers_to.values, result.reference_frequency.item(), rtol=1e-12)
    return [str(symbol) for symbol in result.force.values[own]]
