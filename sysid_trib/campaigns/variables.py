"""What a store holds of each record: one table of variables, and an empty row of them."""

from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array

Row: TypeAlias = dict[str, Any]

EDGES = ("lowest", "highest")
# Of a record's time: enough to see how it decays, whether it stops, and what does not belong to it.
OUTLINE_PARTS = 60
FORCE_UNIT = "see the coordinate unit"
TRUTH, TIED, EFFECT_P_VALUE = "true_coefficient", "tied", "effect_p_value"


@dataclass(frozen=True)
class StoredVariable:
    """A variable of a store.

    Attributes
    ----------
    long_name, units : str
        As in the store.
    dims : tuple of str
        Beside the record.
    length : int
        Characters of a text; 0 of numbers. A million records of 400 in every text would be 6 GB.
    error : str
        The variable that is its standard error.
    """

    long_name: str
    units: str = ""
    dims: tuple[str, ...] = ()
    length: int = 0
    error: str = ""

    def empty(self, sizes: dict[str, int]) -> Any:
        """What it is of a record of which nothing is known."""
        return "" if self.length else np.full([sizes[dim] for dim in self.dims], np.nan)


def _of_method(long_name: str, units: str, error: str = "", *dims: str) -> StoredVariable:
    return StoredVariable(long_name, units, ("method", *dims), error=error)


VARIABLES = {
    "coefficient": _of_method("coefficient", FORCE_UNIT, "standard_error", "force"),
    "shape": _of_method("shape parameter", "see the library", "shape_standard_error", "shape_parameter"),
    "reference_frequency": _of_method("reference frequency", "rad/s", "reference_frequency_standard_error"),
    "asymptotic_frequency": _of_method(
        "asymptotic frequency", "rad/s", "asymptotic_frequency_standard_error"
    ),
    "random_force_density": _of_method(
        "density of the random force", "(rad/s^2)^2/Hz", "random_force_standard_error"
    ),
    "noise": _of_method("noise of a sample", ""),
    TRUTH: StoredVariable("coefficient that the record was simulated with", FORCE_UNIT, ("force",)),
    EFFECT_P_VALUE: StoredVariable("corrected p-value of an effect that a discovery named", "1", ("force",)),
    TIED: StoredVariable("effects that those named cannot be separated from", length=400),
    "outline": StoredVariable(
        "lowest and highest value of the record in each part of its time",
        "see signal_units",
        ("edge", "part"),
    ),
    "p_value": StoredVariable("p-value of the agreement of both methods", "1"),
    "seconds": StoredVariable("time that the record took", "s"),
    "verdict": StoredVariable("verdict on the record", length=100),
    "named": StoredVariable("effects that a discovery named", length=200),
    "message": StoredVariable("why a record has no numbers", length=400),
    "signal_units": StoredVariable("unit of the record's signal", length=40),
    "record_checksum": StoredVariable("SHA-256 of the record's file", length=64),
}
VARIABLES |= {
    known.error: replace(known, long_name=f"standard error of the {known.long_name}", error="")
    for known in list(VARIABLES.values())
    if known.error
}


def filled(row: Row, at: int, result: xr.Dataset, labels: dict[str, list[str]]) -> None:
    """Put the numbers of an identification, the one of number `at`, in their places of a row.

    Parameters
    ----------
    row : dict
    at : int
    result : Dataset
        The identification.
    labels : dict of str to list of str
        Of all forces and shape parameters of the store; those that the result lacks stay nan.
    """
    for name, known in VARIABLES.items():
        if "method" in known.dims and name in result and row[name].size:
            for dim in known.dims[1:]:
                row[name][at] = result[name].reindex({dim: labels[dim]}).values
            if len(known.dims) == 1:
                row[name][at] = float(np.mean(result[name].values))


def outline_of(decay: xr.Dataset) -> Array:
    """Lowest and highest value in each part of a decay's time: (edge, part), in its unit.

    A part without a sample is nan.
    """
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    edges = np.full((len(EDGES), OUTLINE_PARTS), np.nan)
    firsts = np.searchsorted(time, np.linspace(time[0], time[-1], OUTLINE_PARTS + 1)[:-1])
    holds = np.diff(np.append(firsts, len(time))) > 0
    for at, of_all in enumerate((np.minimum, np.maximum)):
        edges[at, holds] = of_all.reduceat(angle, firsts[holds])
    return edges
