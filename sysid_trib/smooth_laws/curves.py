"""Smooth laws as forces: a library of many parts of one formula, spread over the range of the records."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.forces.force import Force, ForceLibrary, Shape
from sysid_trib.forces.library import load_library
from sysid_trib.records.smoothing import first_frequency, smooth

CURVE_LIBRARY = "curves"
# Places of the parts of a curve, in parts of the largest speed or displacement: evenly in the logarithm up to
# the middle, then evenly. None is at the end: beyond it the law is a straight line and the named forces.
# Friction may change at low speed; what is narrow costs the simulation many steps.
FIRST_PLACES = {"v": 0.03, "x": 0.1}
MIDDLE, GEOMETRIC_PARTS = 0.5, 8
UPPER_PLACES = (0.6, 0.7, 0.8, 0.9)
# Curves that are odd.
ODD_CURVES = ("friction", "restoring")


def ranges(decays: Sequence[xr.Dataset], frequency: float | None = None) -> dict[str, float]:
    """Return the largest displacement (rad) and speed over w (rad) of the records.

    Parameters
    ----------
    decays : sequence of Dataset
        `angle(time)`.
    frequency : float, rad/s, optional
        w; that of the swing where left out.
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
    """Add the parts of curves to a library of named forces.

    Parameters
    ----------
    named : ForceLibrary
        Forces that stay outside of the penalty, and forces that are held.
    curves : iterable of str
        Symbols of `libraries/curves.toml`.
    largest : dict
        See `ranges`.
    lowest : float
        Least place of a part, in parts of the largest speed or displacement.
    """
    offered = load_library(CURVE_LIBRARY).select(curves)
    parts = [part for force in offered for part in _parts(force, largest, lowest)]
    return replace(named, title="Laws as curves", forces=(*named.forces, *parts))


def _parts(force: Force, largest: dict[str, float], lowest: float) -> list[Force]:
    """Return copies of a force, each at a place of its own."""
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
