"""Forces on a mass in SI units, as sentences and for JSON."""

from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.physics.translation import translation_units
from sysid_trib.printing.layout import by_label, quantity, quantity_json


def translation_sentences(result: xr.Dataset, mass: float | None, load: float | None) -> list[str]:
    """Coefficients in SI units by the mass, and the coefficient of friction by the load; none without a mass.

    Parameters
    ----------
    result : Dataset
        An identification of a displacement.
    mass : float, kg, or None
    load : float, N, or None
    """
    if mass is None:
        return []
    values = translation_units(result, mass, load)
    forces = by_label(values, "force").items()
    texts = [f"{s} {quantity(force, 'coefficient', ' ' + force['unit'].item())}" for s, force in forces]
    sentences = [f"In SI units, with a mass of {mass:g} kg: {', '.join(texts)}."]
    if load is not None:
        ratios = [
            f"{s} {quantity(force, 'friction_coefficient')}"
            for s, force in forces
            if np.isfinite(force.friction_coefficient.item())
        ]
        sentences += [f"Over the load of {load:g} N, coefficient of friction: {', '.join(ratios)}."] * bool(
            ratios
        )
    return sentences


def second_of(tree: xr.DataTree) -> xr.Dataset:
    """The identification that stands for a result of `cross_check`."""
    return tree[str(tree["comparison"].attrs["second"])].to_dataset()


def translation_json(result: xr.Dataset, mass: float | None, load: float | None) -> dict[str, Any]:
    """The same as plain data."""
    if mass is None:
        return {}
    forces = by_label(translation_units(result, mass, load), "force").items()
    return {
        "si_units": {
            s: quantity_json(force, "coefficient")
            | {"unit": force["unit"].item()}
            | ({} if load is None else {"friction_coefficient": quantity_json(force, "friction_coefficient")})
            for s, force in forces
        }
    }
