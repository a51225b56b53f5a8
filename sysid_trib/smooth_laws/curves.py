"""Smooth laws as forces: many basis functions of one formula, distributed over the records' range."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.forces.force import Force, ForceLibrary, Shape
from sysid_trib.forces.library import load_library
from sysid_trib.records.smoothing import first_frequency, smooth

CURVE_LIBRARY = "curves"
# Places of the basis functions, as fractions of the largest speed or displacement: logarithmic up to the
# middle, then linear. None is at the end: beyond it the law is a straight line plus the named forces.
# Friction may change at low speed, but narrow functions need many time steps of the simulation.
FIRST_PLACES = {"v": 0.03, "x": 0.1}
MIDDLE, GEOMETRIC_PARTS = 0.5, 8
UPPER_PLACES = (0.6, 0.7, 0.8, 0.9)
# Curves that are odd.
ODD_CURVES = ("friction", "restoring")


def ranges(decays: Sequence[xr.Dataset], frequency: float | None = None) -> dict[str, float]:
    """Return the largest displacement (rad) and the largest speed over w (rad) of the records.

    Parameters
    ----------
    decays : sequence of Dataset
        `angle(time)`.
    frequency : float, rad/s, optional
        w; the frequency of the swing if omitted.
    """
    largest = {"x": 0.0, "v": 0.0}
    for decay in decays:
        w = frequency or first_frequency([decay])
        time = decay.time.values.astype(float)
        x, v, *_ = smooth(w * (time - time[0]), decay.angle.values.astype(float))
        largest["x"] = max(largest["x"], float(np.max(np.abs(x))))
        largest["v"] = max(largest["v"], float(np.max(np.abs(v))))
    return largest


def with_curves(
    named: ForceLibrary, curves: Iterable[str], largest: dict[str, float], lowest: float = 0.0
) -> ForceLibrary:
    """Add the basis functions of curves to a library of named forces.

    Parameters
    ----------
    named : ForceLibrary
        Forces without penalty, and fixed forces.
    curves : iterable of str
        Symbols of `libraries/curves.toml`.
    largest : dict
        See `ranges`.
    lowest : float
        Smallest place of a basis function, as a fraction of the largest speed or displacement.
    """
    offered = load_library(CURVE_LIBRARY).select(curves)
    parts = [part for force in offered for part in _parts(force, largest, lowest)]
    return replace(named, title="Laws as curves", forces=(*named.forces, *parts))


def _parts(force: Force, largest: dict[str, float], lowest: float) -> list[Force]:
    """Return copies of a force at different places."""
    ((name, shape),) = force.shape.items()
    by = "v" if "v" in force.formula.names else "x"
    first = min(max(FIRST_PLACES[by], lowest), 0.5 * MIDDLE)
    places = largest[by] * np.append(np.geomspace(first, MIDDLE, GEOMETRIC_PARTS), UPPER_PLACES)
    return [
        replace(
            force,
            symbol=f"{force.symbol}_{number}",
            name=f"{force.name}, part {number}",
            shape={name: Shape(float(f"{place:.6g}"), shape.low, shape.high, shape.meaning)},
        )
        for number, place in enumerate(places, 1)
    ]
