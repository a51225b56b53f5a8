"""A model with polynomials in the place of its curves: its motion is near, and quick to differentiate."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.library import parse_library
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.under_way import STATE_PART

# Powers of the speed and of the displacement that replace curves, and places of their fit.
FITTED_POWERS, FITTED_PLACES = (1, 3, 5, 7), 60
# Truncation error of the series in a step of a motion along curves: thousands of them are far below any
# noise.
CURVE_PART = 1e-10


def has_curves(model: Model) -> bool:
    """Return True if forces of a model are parts of smooth curves."""
    return any(force.curve for force in model.forces)


def accuracy_of(model: Model) -> float:
    """Return the truncation error of the series in a step of a fitted motion (see `integrate`)."""
    return CURVE_PART if has_curves(model) else STATE_PART


def without_curves(model: Model, largest: float) -> Model:
    """Return a model whose odd curves are polynomials and whose even ones are left out.

    Parameters
    ----------
    model : Model
    largest : float, rad
        Largest displacement and speed over w of the motion.

    Returns
    -------
    Model
        The sum of many narrow parts costs a motion many steps, and its derivatives many times that.
    """
    kept = [force for force in model.library if not force.curve]
    coefficients = {symbol: c for symbol, c in model.coefficients.items() if not model.library[symbol].curve}
    places = largest * (np.arange(FITTED_PLACES) + 0.5) / FITTED_PLACES
    for of in ("x", "v"):
        parts = [force for force in model.forces if force.curve and of in force.formula.names]
        law = np.zeros(FITTED_PLACES)
        for part in parts:
            x, v = (places, 0.0 * places) if of == "x" else (0.0 * places, places)
            odd = part.value(x, v, shapes=model.shapes) - part.value(-x, -v, shapes=model.shapes)
            law += 0.5 * model.coefficients[part.symbol] * odd
        if not law.any():
            continue
        powers = np.stack([(places / largest) ** power for power in FITTED_POWERS], axis=1)
        fitted = np.linalg.lstsq(powers, law, rcond=None)[0]
        for force, power, value in zip(_powers(of), FITTED_POWERS, fitted.tolist(), strict=True):
            kept.append(force)
            coefficients[force.symbol] = value / largest**power
    shapes = {name: v for name, v in model.shapes.items() if not model.library[name.split(".")[0]].curve}
    library = ForceLibrary("Polynomials in the place of curves", tuple(kept))
    return replace(model, library=library, coefficients=coefficients, shapes=shapes)


@lru_cache(maxsize=8)
def _powers(of: str) -> tuple[Force, ...]:
    rows = [{"symbol": f"power_of_{of}_{power}", "formula": f"{of}**{power}"} for power in FITTED_POWERS]
    return parse_library({"force": rows}, "powers").forces
