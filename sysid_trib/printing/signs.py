"""Coefficients whose sign a system forbids."""

from typing import TYPE_CHECKING

import xarray as xr

from sysid_trib.printing.layout import coefficient_text
from sysid_trib.results.common_reference import is_constrained

if TYPE_CHECKING:
    from sysid_trib.forces.systems import System

# Standard errors below zero from which on a coefficient is negative and not by chance.
CLEARLY_NEGATIVE = 3.0


def sign_sentences(tree: xr.DataTree, system: "System | None") -> list[str]:
    """What a fit wants to be negative though the system forbids it, by the second identification.

    Parameters
    ----------
    tree : DataTree
        Result of `cross_check`.
    system : System, optional
        Nothing is said without one.
    """
    if system is None:
        return []
    result = tree[tree["comparison"].attrs["second"]].to_dataset()
    sentences = []
    for symbol in result.force.values.tolist():
        force = result.sel(force=symbol)
        below = -force.coefficient.item() > CLEARLY_NEGATIVE * force.standard_error.item()
        if symbol in system.not_negative and below and not is_constrained(result, symbol):
            sentences.append(
                f"{symbol} wants to be negative ({coefficient_text(force)}), which it cannot be in a "
                f"{system.name}: something is missing, or it stands for another force."
            )
    return sentences
