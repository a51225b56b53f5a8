"""Forces of a library that a method identifies, neglects, or cannot separate, by their signatures."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.cycles.signatures import averages
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.methods.scope import MOTION, Method, MethodScope, scope_of
from sysid_trib.validation.separability import exactly_dependent, indistinguishable


def force_scope(
    method: Method, library: ForceLibrary, result: xr.Dataset | None, amplitude: float
) -> dict[str, Any]:
    """List the forces of a library that a method identifies, neglects or cannot separate.

    Parameters
    ----------
    method : Method
        Method with its options.
    library : ForceLibrary
        The offered forces.
    result : Dataset or None
        Identification by this method; None if the method failed.
    amplitude : float, rad
        Largest amplitude of the record.

    Returns
    -------
    dict
        Texts `identifies`, the identified forces and the curves that determine them; `neglects`, the
        neglected forces and the forces that absorb them; `cannot_tell_apart`, forces that are identical for
        the method. They are empty for a failed method that does not identify every offered force. `damped`:
        whether an identified force acts on the envelope.
    """
    row = {"identifies": "", "neglects": "", "cannot_tell_apart": "", "damped": True}
    scope, stiffness = scope_of(method), library.role("x")
    if result is None and scope.identifies != MethodScope.identifies:
        return row
    fitted: Sequence[str] = () if result is None else result.force.values.tolist()
    # Otherwise it can be exchanged with the frequency.
    held = stiffness is None or stiffness.symbol in fitted
    library = library.select(s for s in library.symbols if held or library[s] is not stiffness)
    fitted = fitted or library.symbols
    shapes = dict(getattr(method, "shapes", {}))
    try:
        if scope.observes == MOTION:
            groups = exactly_dependent(library, amplitude, shapes=shapes)
            row["identifies"] = f"{', '.join(fitted)} by {MOTION} itself"
            row["neglects"] = ", ".join(s for s in library.symbols if s not in fitted)
        else:
            groups = indistinguishable(library, 0.02 * amplitude, amplitude, shapes=shapes)
            # One amplitude is enough: whether a force has a signature does not depend on it, except at a
            # zero.
            parts = {force.symbol: _signature(force, 0.7 * amplitude, shapes) for force in library}
            row["damped"] = any(parts[symbol][0] for symbol in fitted if symbol in parts)
            row |= {"identifies": _identified(fitted, parts), "neglects": _neglected(fitted, parts)}
    except SysidTribError:
        return row
    alike = (" = ".join(group) for group in groups if set(group) & set(fitted))
    return row | {"cannot_tell_apart": "; ".join(alike)}


def _identified(fitted: Sequence[str], parts: Mapping[str, tuple[bool, bool]]) -> str:
    """List the forces identified by the envelope and by the frequency."""
    ways = {"the envelope": (True, False), "the frequency": (False, True), "both": (True, True)}
    by_way = {way: [s for s in fitted if parts.get(s) == part] for way, part in ways.items()}
    return "; ".join(f"{', '.join(symbols)} by {way}" for way, symbols in by_way.items() if symbols)


def _neglected(fitted: Sequence[str], parts: Mapping[str, tuple[bool, bool]]) -> str:
    """List the neglected forces, with what absorbs them in the envelope or in the frequency."""
    by_place: dict[str, list[str]] = {}
    known = [s for s in fitted if s in parts]
    for symbol, (in_envelope, in_frequency) in parts.items():
        if symbol in fitted and (in_envelope or in_frequency):
            continue
        takers = [s for s in known if in_envelope and parts[s][0]]
        takers += [s for s in known if in_frequency and parts[s][1] and s not in takers]
        takers += ["the frequency"] if in_frequency else []
        place = f" (absorbed by {' and '.join(takers)})" if takers else ""
        by_place.setdefault(place, []).append(symbol)
    return "; ".join(f"{', '.join(symbols)}{place}" for place, symbols in by_place.items())


def _signature(force: Force, amplitude: float, shapes: Mapping[str, float]) -> tuple[bool, bool]:
    """Return two truth values: the force acts on the envelope, and on the frequency."""
    phase = np.linspace(0.0, 2.0 * np.pi, 64)
    try:
        sine, cosine = (abs(float(part[0])) for part in averages(force, np.array([amplitude]), shapes))
        size = np.abs(force.value(amplitude * np.cos(phase), -amplitude * np.sin(phase), shapes=shapes)).max()
    except SysidTribError:
        return True, True
    # Relative to the largest force on the cycle, a smaller signature is rounding. Internal states are zero
    # here; the size of a force that consists of states only is that of its averages.
    least = 1e-9 * max(float(size), sine, cosine)
    return sine > least, cosine > least
