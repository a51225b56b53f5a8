"""What a method says of itself, and what follows from it for the forces of a library."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import Field, InitVar, dataclass, field, fields, is_dataclass, replace
from typing import Any, Literal, Protocol

import numpy as np
import xarray as xr

from sysid_trib.cycles.signatures import averages, exactly_dependent, indistinguishable
from sysid_trib.errors import SysidTribError, UsageError
from sysid_trib.forces.constraints import Bounds, Constraints, ConstraintTable
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.selection import known_coefficients
from sysid_trib.likelihood.random_force import RandomForceOption, check_random_force

MOTION = "the motion"


class Method(Protocol):
    """An identification method: a frozen object with its options, and a `scope` (see `MethodScope`)."""

    def identify(self, decay: Any, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`, or from several if it can."""


@dataclass(frozen=True)
class MethodScope:
    """What a method assumes, observes and identifies: its attribute `scope`.

    Parameters
    ----------
    label : str
        Name in tables and sentences.
    assumes : str
        What must hold for its numbers to be right.
    observes : str
        What it takes from the record: the motion itself, or averages over half periods.
    identifies : str
        The forces that it identifies of those offered.
    several_runs : bool
        Whether it identifies several runs together.
    white_noise : bool
        Whether its standard errors are right in white noise only.
    names_forces : bool
        Whether it identifies coefficients of the forces offered; else it identifies curves.
    driven : bool
        Whether it identifies the forces with a known input of the record, too.
    family : str
        Colour and mark in figures.
    variants : Mapping
        Options of variants by their name, which `compare` runs with the method.
    example : Mapping of str to float
        Coefficients, by formulas, of a decay in which it neglects no force: tests try it there.
    """

    label: str
    assumes: str = ""
    observes: str = MOTION
    identifies: str = "every force offered"
    several_runs: bool = True
    white_noise: bool = False
    names_forces: bool = True
    driven: bool = False
    family: Literal["trajectory", "direct", "averaging", "other"] = "other"
    variants: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    example: Mapping[str, float] = field(default_factory=dict)

    @property
    def sentence_label(self) -> str:
        """The label as the first word of a sentence."""
        return self.label[0].upper() + self.label[1:]


@dataclass(frozen=True, kw_only=True)
class Constrained:
    """What methods have in common whose parameters can be held, bounded or tied.

    Parameters
    ----------
    constraints : mapping of str to float, (float, float) or str
        See `Constraints`.
    fix, bounds, tie : mapping, deprecated
        Parts of `constraints`.
    """

    constraints: ConstraintTable = field(default_factory=dict)
    fix: InitVar[Mapping[str, float] | None] = None
    bounds: InitVar[Mapping[str, Bounds] | None] = None
    tie: InitVar[Mapping[str, str] | None] = None

    def __post_init__(
        self,
        fix: Mapping[str, float] | None,
        bounds: Mapping[str, Bounds] | None,
        tie: Mapping[str, str] | None,
    ) -> None:
        old = without_old_arguments(type(self).__name__, fix, bounds, tie, stacklevel=5)
        object.__setattr__(self, "constraints", {**self.constraints, **old})


def without_old_arguments(
    where: str,
    fix: Mapping[str, float] | None,
    bounds: Mapping[str, Bounds] | None = None,
    tie: Mapping[str, str] | None = None,
    *,
    stacklevel: int,
) -> ConstraintTable:
    """The table of what was given as `fix`, `bounds` and `tie`, with a warning where any was."""
    if fix is None and bounds is None and tie is None:
        return {}
    table = Constraints.merged(fix, bounds, tie).table
    message = f"{where}: fix, bounds and tie are one argument now, constraints={dict(table)}."
    warnings.warn(message, DeprecationWarning, stacklevel=stacklevel)
    return table


def constrained(method: Method, constraints: Constraints) -> Method:
    """The method with constraints on its coefficients and shape parameters.

    Parameters
    ----------
    method : Method
        The method without them.
    constraints : Constraints
        What is fixed, bounded and tied.

    Raises
    ------
    UsageError
        The method takes no such constraint.
    """
    if not constraints:
        return method
    if not isinstance(method, Constrained):
        raise UsageError(f"{scope_of(method).sentence_label} takes no fixed, bounded or tied coefficients.")
    return replace(method, constraints={**method.constraints, **constraints.table})


def with_stated(constraints: ConstraintTable, library: ForceLibrary, method: Method) -> Constraints:
    """Constraints, with the coefficients held that a library of one's own states if nothing else is asked.

    Parameters
    ----------
    constraints : mapping of str to float, (float, float) or str
        What is asked for.
    library : ForceLibrary
        Those offered.
    method : Method
        What its own constraints ask for is left to it.
    """
    asked = {*constraints, *getattr(method, "constraints", {})}
    stated = {name: value for name, value in known_coefficients(library).items() if name not in asked}
    return Constraints({**stated, **constraints})


def with_random_force(method: Method, random_force: RandomForceOption) -> Method:
    """The method with an option for the random force; as it is where it takes none.

    A variant that excludes a random force (the strong form, coloured noise) stays as it is too.

    Parameters
    ----------
    method : Method
        The method without it.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        See `methods.Trajectory`.

    Raises
    ------
    UsageError
        No such option.
    """
    check_random_force(random_force)
    if not is_dataclass(method) or "random_force" not in {option.name for option in fields(method)}:
        return method
    try:
        return replace(method, random_force=random_force)
    except UsageError:
        return method


def scope_of(method: Method) -> MethodScope:
    """The scope of a method; of one that states none, its class as label and nothing else."""
    stated = getattr(method, "scope", None)
    return stated if isinstance(stated, MethodScope) else MethodScope(type(method).__name__.lower())


def force_scope(
    method: Method, library: ForceLibrary, result: xr.Dataset | None, amplitude: float
) -> dict[str, Any]:
    """What a method makes of the forces of a library, by their signatures.

    Parameters
    ----------
    method : Method
        With its options.
    library : ForceLibrary
        The forces offered.
    result : Dataset or None
        Its identification; None if the method failed.
    amplitude : float, rad
        The largest of the record.

    Returns
    -------
    dict
        Texts `identifies`, the forces identified and by what; `neglects`, those left out and what they are
        taken for; `cannot_tell_apart`, those that are the same to it. Empty of a method that failed and that
        does not identify every force offered. `damped`, whether a force that it identifies acts on the
        envelope.
    """
    row = {"identifies": "", "neglects": "", "cannot_tell_apart": "", "damped": True}
    scope, stiffness = scope_of(method), library.role("x")
    if result is None and scope.identifies != MethodScope.identifies:
        return row
    fitted: Sequence[str] = () if result is None else result.force.values.tolist()
    # Else it is exchangeable with the frequency.
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
            # One amplitude does: which forces have a signature does not depend on it, but at a zero of one.
            parts = {force.symbol: _signature(force, 0.7 * amplitude, shapes) for force in library}
            row["damped"] = any(parts[symbol][0] for symbol in fitted if symbol in parts)
            row |= {"identifies": _identified(fitted, parts), "neglects": _neglected(fitted, parts)}
    except SysidTribError:
        return row
    alike = (" = ".join(group) for group in groups if set(group) & set(fitted))
    return row | {"cannot_tell_apart": "; ".join(alike)}


def _identified(fitted: Sequence[str], parts: Mapping[str, tuple[bool, bool]]) -> str:
    """Which forces by the envelope, which by the frequency."""
    ways = {"the envelope": (True, False), "the frequency": (False, True), "both": (True, True)}
    by_way = {way: [s for s in fitted if parts.get(s) == part] for way, part in ways.items()}
    return "; ".join(f"{', '.join(symbols)} by {way}" for way, symbols in by_way.items() if symbols)


def _neglected(fitted: Sequence[str], parts: Mapping[str, tuple[bool, bool]]) -> str:
    """Forces left out, by what takes their place in the envelope or in the frequency."""
    by_place: dict[str, list[str]] = {}
    known = [s for s in fitted if s in parts]
    for symbol, (in_envelope, in_frequency) in parts.items():
        if symbol in fitted and (in_envelope or in_frequency):
            continue
        takers = [s for s in known if in_envelope and parts[s][0]]
        takers += [s for s in known if in_frequency and parts[s][1] and s not in takers]
        takers += ["the frequency"] if in_frequency else []
        place = f" (taken for {' and '.join(takers)})" if takers else ""
        by_place.setdefault(place, []).append(symbol)
    return "; ".join(f"{', '.join(symbols)}{place}" for place, symbols in by_place.items())


def _signature(force: Force, amplitude: float, shapes: Mapping[str, float]) -> tuple[bool, bool]:
    """Two truths: a force acts on the envelope, and on the frequency."""
    phase = np.linspace(0.0, 2.0 * np.pi, 64)
    try:
        sine, cosine = (abs(float(part[0])) for part in averages(force, np.array([amplitude]), shapes))
        size = np.abs(force.value(amplitude * np.cos(phase), -amplitude * np.sin(phase), shapes=shapes)).max()
    except SysidTribError:
        return True, True
    # Internal states are zero here: a force that is made of them alone has its own averages for a size.
    # Of the largest force on the cycle; below it a signature is rounding.
    least = 1e-9 * max(float(size), sine, cosine)
    return sine > least, cosine > least


def by_unique_label(pairs: Sequence[tuple[str, Method]], reserved: Sequence[str]) -> dict[str, Method]:
    """Methods by a unique label that may be the name of a group in a netCDF file.

    Parameters
    ----------
    pairs : sequence of (str, Method)
        Each with its name; where that is empty, with what its scope and its options say.
    reserved : sequence of str
        Names of other groups.
    """
    by_label: dict[str, Method] = {}
    for name, method in pairs:
        same = [other for _, other in pairs if type(other) is type(method)]
        label = " ".join(str(name).replace("/", "-").split()) or _label(method, same)
        label = f"{label} (method)".strip() if label in reserved else label
        number, unique = 1, label
        while unique in by_label:
            number += 1
            unique = f"{label} {number}"
        by_label[unique] = method
    return by_label


def _label(method: Method, same: Sequence[Method]) -> str:
    """Label of a method, with the options in which it differs from others of it and from the default."""
    options = []
    all_options: tuple[Field[Any], ...] = fields(method) if is_dataclass(method) else ()
    for option in all_options:
        value = getattr(method, option.name)
        default = option.default_factory() if callable(option.default_factory) else option.default
        alike = all(repr(getattr(other, option.name)) == repr(value) for other in same)
        if not alike and repr(value) != repr(default):
            options.append(_option(option.name.replace("_", " "), value))
    label = scope_of(method).label
    return f"{label} ({', '.join(options)})".replace("/", "-") if options else label


def _option(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return name if value else f"not {name}"
    return f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
