"""Scope of a method, and its consequences for the forces of a library."""

from collections.abc import Mapping, Sequence
from dataclasses import Field, dataclass, field, fields, is_dataclass, replace
from typing import Any, Literal, Protocol

import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.forces.constraints import Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import known_coefficients
from sysid_trib.likelihood.random_force import RandomForceOption, check_random_force

MOTION = "the motion"


class Method(Protocol):
    """An identification method: a frozen object with its options, and a `scope` (see `MethodScope`)."""

    def identify(self, decay: Any, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`, or from several if it can."""


@dataclass(frozen=True)
class MethodScope:
    """Assumptions, observed quantities and identified forces of a method: its attribute `scope`.

    Parameters
    ----------
    label : str
        Name in tables and sentences.
    assumes : str
        Assumptions of the method.
    observes : str
        Observed quantity: the motion itself, or averages over half periods.
    identifies : str
        Forces that it identifies among those offered.
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
    """Base of methods whose parameters can be held, bounded or tied.

    Parameters
    ----------
    constraints : mapping of str to float, (float, float) or str
        See `Constraints`.
    """

    constraints: ConstraintTable = field(default_factory=dict)


def constrained(method: Method, constraints: Constraints) -> Method:
    """Return the method with constraints on its coefficients and shape parameters.

    Parameters
    ----------
    method : Method
        The method without them.
    constraints : Constraints
        Fixed values, bounds and ties.

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
    """Add held coefficients that a user's library states, unless constraints say otherwise.

    Parameters
    ----------
    constraints : mapping of str to float, (float, float) or str
        Constraints asked for.
    library : ForceLibrary
        Forces offered.
    method : Method
        Method; its own constraints are left as they are.
    """
    asked = {*constraints, *getattr(method, "constraints", {})}
    stated = {name: value for name, value in known_coefficients(library).items() if name not in asked}
    return Constraints({**stated, **constraints})


def with_random_force(method: Method, random_force: RandomForceOption) -> Method:
    """Return the method with an option for the random force; unchanged if it has no such option.

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
    """Return the scope of a method; by default its class as label."""
    stated = getattr(method, "scope", None)
    return stated if isinstance(stated, MethodScope) else MethodScope(type(method).__name__.lower())


def by_unique_label(pairs: Sequence[tuple[str, Method]], reserved: Sequence[str]) -> dict[str, Method]:
    """Return methods by a unique label that may be the name of a group in a netCDF file.

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
    """Return a method's label, with the options in which it differs from its like and from the default."""
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
