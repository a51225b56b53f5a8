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


OF_SEARCH = {TIED, EFFECT_P_VALUE}
# What may become of a record, by the number that the store has of it.
STATUS = ("waiting", "done", "refused", "failed", "lost")
WAITING, IDENTIFIED, REFUSED, FAILED, LOST = range(5)
# CRC-32 of a record's name and row.
CHECKSUM = "checksum"


@dataclass(frozen=True)
class StoredVariable:
    """A variable of a store.

    Attributes
    ----------
    long_name, units : str
        As in the store.
    dims : tuple of str
        Beside the record.
    kind : str
        As numpy has it, of texts with their length: a million records of 400 letters are 1.6 GB.
    """

    long_name: str
    units: str = ""
    dims: tuple[str, ...] = ()
    kind: str = "f8"

    def empty(self, sizes: dict[str, int]) -> Array:
        """What it is of a record of which nothing is known."""
        fill = {"f": np.nan, "U": "", "i": 0}[self.kind[0]]
        return np.full([sizes[dim] for dim in self.dims], fill, dtype=self.kind)


OF_METHOD, OF_FORCE = ("method",), ("method", "force")
VARIABLES = {
    "coefficient": StoredVariable("coefficient", FORCE_UNIT, OF_FORCE),
    "shape": StoredVariable("shape parameter", "see the library", ("method", "shape_parameter")),
    "reference_frequency": StoredVariable("reference frequency", "rad/s", OF_METHOD),
    "asymptotic_frequency": StoredVariable("asymptotic frequency", "rad/s", OF_METHOD),
    "random_force_density": StoredVariable("density of the random force", "(rad/s^2)^2/Hz", OF_METHOD),
    "noise": StoredVariable("noise of a sample", "", OF_METHOD),
    TRUTH: StoredVariable("coefficient that the record was simulated with", FORCE_UNIT, ("force",)),
    EFFECT_P_VALUE: StoredVariable("corrected p-value of an effect that a discovery named", "1", ("force",)),
    TIED: StoredVariable("effects that those named cannot be separated from", kind="U400"),
    "outline": StoredVariable(
        "lowest and highest value of the record in each part of its time",
        "see signal_units",
        ("edge", "part"),
    ),
    "p_value": StoredVariable("p-value of the agreement of both methods", "1"),
    "seconds": StoredVariable("time that the record took", "s"),
    "verdict": StoredVariable("verdict on the record", kind="U100"),
    "named": StoredVariable("effects that a discovery named", kind="U200"),
    "message": StoredVariable("why a record has no numbers", kind="U400"),
    "signal_units": StoredVariable("unit of the record's signal", kind="U40"),
    "record_checksum": StoredVariable("SHA-256 of the record's file", kind="U64"),
    "status": StoredVariable("what became of the record", kind="i1"),
    CHECKSUM: StoredVariable("CRC-32 of the record's row", kind="i8"),
}
# By their names, those that are standard errors of others.
STATED_ERRORS = {
    "standard_error": "coefficient",
    "shape_standard_error": "shape",
    "reference_frequency_standard_error": "reference_frequency",
    "asymptotic_frequency_standard_error": "asymptotic_frequency",
    "random_force_standard_error": "random_force_density",
}
VARIABLES |= {
    name: replace(VARIABLES[of], long_name=f"standard error of the {VARIABLES[of].long_name}")
    for name, of in STATED_ERRORS.items()
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
