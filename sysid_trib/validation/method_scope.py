"""What a method can see of the forces offered, what it is blind to, and what it takes for something else."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid_trib.averaging.identifiability import exactly_dependent, indistinguishable
from sysid_trib.averaging.signatures import averages
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.methods.averaging import Averaging
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.trajectory import Trajectory

ASSUMPTIONS = {
    Averaging: "weak forces: amplitude and phase hardly change within a period",
    Direct: "the forces offered are all there are",
    Trajectory: "the forces offered are all there are; what they leave is white noise",
}
# Of the largest force on the cycle; below it a signature is rounding.
ROUNDING = 1e-9


@dataclass(frozen=True)
class Visibility:
    """What a method sees, in a few words each.

    Attributes
    ----------
    sees : the forces identified, and by what. blind_to : the forces offered that it leaves out, and what they
        are taken for. cannot_tell_apart : forces that are the same to it. damped : whether a force that it
        identifies acts on the envelope.
    """

    sees: str = ""
    blind_to: str = ""
    cannot_tell_apart: str = ""
    assumes: str = ""
    damped: bool = True


def visibility(
    method: Any,
    library: ForceLibrary,
    fitted: Sequence[str] | None,
    amplitude: float,
    shapes: Mapping[str, float],
) -> Visibility:
    """What a method sees of the forces of a library, by their signatures.

    Parameters
    ----------
    library : the forces offered, without one that is exchangeable with the frequency.
    fitted : symbols of those identified; None if the method failed.
    amplitude : rad, the largest of the record.
    """
    assumes = str(getattr(type(method), "ASSUMES", "") or ASSUMPTIONS.get(type(method), ""))
    classical = hasattr(type(method), "ASSUMES")
    if fitted is None:
        if classical:
            return Visibility(assumes=assumes)
        fitted = library.symbols
    averaged = classical or isinstance(method, Averaging)
    # One amplitude does: which forces have a signature does not depend on it, but at a zero of one.
    parts = {force.symbol: _signature(force, 0.7 * amplitude, shapes) for force in library}
    groups = (
        indistinguishable(library, 0.02 * amplitude, amplitude, shapes=shapes)
        if averaged
        else exactly_dependent(library, amplitude, shapes=shapes)
    )
    tied = "; ".join(" = ".join(group) for group in groups if set(group) & set(fitted))
    if not averaged:
        left_out = [s for s in library.symbols if s not in fitted]
        return Visibility(f"{', '.join(fitted)} by the motion itself", ", ".join(left_out), tied, assumes)
    damped = any(parts[symbol][0] for symbol in fitted if symbol in parts)
    return Visibility(_seen(fitted, parts), _not_seen(fitted, parts), tied, assumes, damped)


def _seen(fitted: Sequence[str], parts: Mapping[str, tuple[bool, bool]]) -> str:
    """Which forces by the envelope, which by the frequency."""
    ways = {"the envelope": (True, False), "the frequency": (False, True), "both": (True, True)}
    told = []
    for way, signature in ways.items():
        if symbols := [s for s in fitted if parts.get(s) == signature]:
            told.append(f"{', '.join(symbols)} by {way}")
    return "; ".join(told)


def _not_seen(fitted: Sequence[str], parts: Mapping[str, tuple[bool, bool]]) -> str:
    """Forces left out, by what takes their place in the envelope or in the frequency."""
    told: dict[str, list[str]] = {}
    for symbol, (in_envelope, in_frequency) in parts.items():
        silent = not (in_envelope or in_frequency)
        if symbol in fitted:
            if silent:
                told.setdefault("", []).append(symbol)
            continue
        takers = [s for s in fitted if s in parts and parts[s][0]] if in_envelope else []
        takers += (
            [s for s in fitted if s in parts and parts[s][1] and s not in takers] if in_frequency else []
        )
        if in_frequency:
            takers.append("the frequency")
        told.setdefault(f" (taken for {' and '.join(takers)})" if takers else "", []).append(symbol)
    return "; ".join(f"{', '.join(symbols)}{taken}" for taken, symbols in told.items())


def _signature(force: Force, amplitude: float, shapes: Mapping[str, float]) -> tuple[bool, bool]:
    """Whether a force acts on the envelope, and on the frequency."""
    phase = np.linspace(0.0, 2.0 * np.pi, 64)
    try:
        sine, cosine = (abs(float(part[0])) for part in averages(force, np.array([amplitude]), shapes))
        size = np.abs(force.value(amplitude * np.cos(phase), -amplitude * np.sin(phase), shapes=shapes)).max()
    except SysidTribError:
        return True, True
    # States are not carried along here: a force that is made of them alone has its own averages for a size.
    least = ROUNDING * max(float(size), sine, cosine)
    return sine > least, cosine > least
