"""Smooth laws as forces: a library of many parts of one formula, spread over the range of the records."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.forces.force import Force, ForceLibrary, Shape
from sysid_trib.forces.library import load_library
from sysid_trib.records.smoothing import smooth, swing_frequency

LIBRARY = "curves"
# Parts of a curve, and the range of their places, in parts of the largest speed or displacement.
PARTS = 12
LOWEST, HIGHEST = 0.02, 1.5
# Curves that are odd, and those that make a law differ between directions or sides.
ODD = ("friction", "restoring")
EVEN = ("friction_even", "restoring_even")


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
        w = frequency or swing_frequency(decay)
        time = decay.time.values.astype(float)
        x, v, *_ = smooth(w * (time - time[0]), decay.angle.values.astype(float))
        largest["x"] = max(largest["x"], float(np.max(np.abs(x))))
        largest["v"] = max(largest["v"], float(np.max(np.abs(v))))
    return largest


def with_curves(
    named: ForceLibrary, curves: Iterable[str], largest: dict[str, float], lowest: float = LOWEST
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
        Place of the first part, in parts of the largest speed or displacement.
    """
    offered = load_library(LIBRARY).select(curves)
    parts = [part for force in offered for part in _parts(force, largest, lowest)]
    return replace(named, title="Laws as curves", forces=(*named.forces, *parts))


def _parts(force: Force, largest: dict[str, float], lowest: float) -> list[Force]:
    """Copies of a force, each at a place of its own."""
    ((name, shape),) = force.shape.items()
    by = "v" if "v" in force.formula.names else "x"
    places = largest[by] * np.geomspace(lowest, HIGHEST, PARTS)
    return [
        replace(
            force,
            symbol=f"{force.symbol}_{number}",
            name=f"{force.name}, part {number}",
            shape={name: Shape(float(f"{place:.6g}"), shape.low, shape.high, shape.meaning)},
        )
        for number, place in enumerate(places, 1)
    ]
