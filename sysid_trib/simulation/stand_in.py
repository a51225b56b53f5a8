"""A model with polynomials in place of its curves: its motion is close, and its derivatives are fast."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.library import parse_library
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.under_way import STATE_PART

# Powers of speed and displacement that replace curves, and number of points of their fit.
FITTED_POWERS, FITTED_PLACES = (1, 3, 5, 7), 60
# Truncation error of the series in a step along curves: even thousands of steps stay far below any noise.
# noise.
CURVE_PART = 1e-10
# Most steps per period of a motion along curves; for those of a record fewer than a hundred are needed. Steep
# curves from a poor fit take thousands of steps with many basis functions each: such a motion took six
# minutes.
STEPS_ALONG_CURVES = 200


def has_curves(model: Model) -> bool:
    """Return True if forces of a model are basis functions of smooth curves."""
    return any(force.curve for force in model.forces)


def accuracy_of(model: Model) -> float:
    """Return the truncation error of the series in a step of a fitted motion (see `integrate`)."""
    return CURVE_PART if has_curves(model) else STATE_PART


def most_steps_of(model: Model, most_steps: int) -> int:
    """Return the number of steps per period that a fitted motion may take, at most `most_steps`."""
    return min(most_steps, STEPS_ALONG_CURVES) if has_curves(model) else most_steps


def without_curves(model: Model, largest: float) -> Model:
    """Return a model whose odd curves are replaced by polynomials and whose even curves are left out.

    Parameters
    ----------
    model : Model
    largest : float, rad
        Largest displacement and speed over w of the motion.

    Returns
    -------
    Model
        The simplified model. A sum of many narrow basis functions needs many steps, and many more for
        derivatives.
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
