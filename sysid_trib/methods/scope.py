"""Scope of a method, and its consequences for the forces of a library."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import xarray as xr

from sysid_trib.forces.constraints import ConstraintTable
from sysid_trib.forces.force import ForceLibrary

MOTION = "the motion"


class Method(Protocol):
    """An identification method: a frozen object with its options, and a `scope` (see `MethodScope`)."""

    def identify(self, decay: Any, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`, or from several if supported."""


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
        Whether its standard errors are valid in white noise only.
    names_forces : bool
        Whether it identifies coefficients of the offered forces; otherwise it identifies curves.
    driven : bool
        Whether it also identifies forces from records with a known input.
    family : str
        Family of methods, for colour and mark in figures.
    variants : Mapping
        Options of variants by their name; `compare` runs these variants with the method.
    example : Mapping of str to float
        Coefficients, by formulas, of an example decay in which the method neglects no force; tests use it.

    Examples
    --------
    >>> import sysid_trib as st
    >>> scope = st.methods.EnergyDecay().scope
    >>> scope.sentence_label, scope.observes, scope.identifies
    ('Energy decay', 'extrema', 'solid and viscous friction')
    >>> scope.assumes
    'weak solid and viscous friction and a linear spring, nothing else'
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
        Constraints, see `Constraints`.
    """

    constraints: ConstraintTable = field(default_factory=dict)


def scope_of(method: Method) -> MethodScope:
    """Return the scope of a method; by default with the name of its class as the label."""
    stated = getattr(method, "scope", None)
    return stated if isinstance(stated, MethodScope) else MethodScope(type(method).__name__.lower())
