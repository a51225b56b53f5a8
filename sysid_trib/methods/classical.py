"""What the classical methods share: the forces they want, the half periods' frequency, the result."""

from collections.abc import Callable
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.methods.indirect import Found, Law, find
from sysid_trib.regression.relations import Equations
from sysid_trib.results.schema import Estimate, identification
from sysid_trib.simulation.model import Model

Array = NDArray[np.float64]


def needed(library: ForceLibrary, formula: str, method: str) -> Force:
    """The library's force of a formula.

    Raises
    ------
    DecayError
        It has none, so that the method does not apply.
    """
    force = library.role(formula)
    if force is None:
        raise DecayError(f"{method} wants a force of formula {formula}, and the library has none.")
    return force


def one_record(decay: Any, method: str) -> xr.Dataset:
    """The decay itself.

    Raises
    ------
    UsageError
        Several were given, or something else.
    """
    if not isinstance(decay, xr.Dataset):
        raise UsageError(f"{method} takes one record at a time.")
    return decay


def same_half_periods(extremum: Array, time: Array) -> tuple[Array, Array]:
    """Equations of a steady frequency: every half period lasts as long; the unknown is that time (s)."""
    return np.ones((len(time) - 1, 1)), np.diff(time)


def law_of_forces(library: ForceLibrary, amplitude: Equations, values: Callable[[Array], Array]) -> Law:
    """A law of the decrement beside a steady frequency, for the model of all forces of `library`."""

    def model(found: Array) -> Model:
        coefficients = dict(zip(library.symbols, found[:-1].tolist(), strict=True))
        return Model(library, coefficients, float(found[-1]))

    return Law({"envelope": amplitude, "frequency": same_half_periods}, values, model)


def identified(
    method: Any, decay: xr.Dataset, asked: ForceLibrary, law: Law, offered: ForceLibrary
) -> xr.Dataset:
    """Solve a law on a decay and label what it gives: `method` has the option `correct` and `ASSUMES`."""
    return labelled(method, decay, asked, find(law, decay, method.correct), offered)


def labelled(
    method: Any, decay: xr.Dataset, asked: ForceLibrary, found: Found, offered: ForceLibrary
) -> xr.Dataset:
    """The identification of what was found, with its bias, its Birge ratios and what the method assumes."""
    extra = {"birge_ratio": (found.birge_ratio, "1", "Birge ratio of the equations")}
    for group, value in found.birge_ratios.items():
        extra[f"{group}_birge_ratio"] = (value, "1", f"Birge ratio of the {group}'s equations alone")
    estimate = Estimate(found.values[:-1], found.covariance, float(found.values[-1]), found.noise, extra)
    result = identification(method, decay, asked, estimate, offered=offered)
    result["first_order_bias"] = (
        "force",
        found.bias[:-1],
        {"units": "1", "long_name": "first-order bias removed"},
    )
    return result.assign_attrs(first_order_bias_removed=found.told, assumes=type(method).ASSUMES)
