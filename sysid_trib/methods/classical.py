"""What the classical methods share: equations between half periods, the forces they need, their result."""

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import refuse_sensors
from sysid_trib.likelihood.random_force import RandomForceOption, check_random_force
from sysid_trib.methods.auxiliary import AuxiliaryModel, same_half_periods
from sysid_trib.methods.half_period_equations import Equations
from sysid_trib.methods.indirect import as_identification, indirect_estimate
from sysid_trib.methods.scope import Method, MethodScope, scope_of
from sysid_trib.records.inputs import refuse_inputs
from sysid_trib.results.signal_scale import in_units_of_the_motion


@dataclass(frozen=True)
class ClassicalMethod:
    """A decrement: equations between the extrema of half periods, with a steady frequency.

    A method of this kind states its `scope`, the formulas of the forces that it needs, its equations and what
    coefficients follow from their parameters.

    Parameters
    ----------
    correct : bool
        Whether the bias of the half-sines is removed (see `indirect_estimate`).
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        Whether the errors are those of a motion with a random force: `estimated` finds the force from
        the extrema; a number is its one-sided density, held; `auto` leaves it to `identify`.
    """

    scope: ClassVar[MethodScope]
    FORMULAS: ClassVar[tuple[str, ...]] = ()

    correct: bool = True
    random_force: RandomForceOption = "auto"

    def __post_init__(self) -> None:
        check_random_force(self.random_force)

    @in_units_of_the_motion
    def identify(self, decay: xr.Dataset, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces that the method describes, those of its `FORMULAS`.

        Parameters
        ----------
        decay : Dataset
            `angle(time)` about its equilibrium.
        library : ForceLibrary
            The forces offered.

        Raises
        ------
        DecayError
            The library lacks a force, or the decay has too few half periods.
        UsageError
            Several decays.
        """
        decay = one_record(self, decay)
        asked = self.forces_of(library)
        groups = {"envelope": self.equations(asked), "frequency": same_half_periods}
        # A frequency that is not steady is no random force.
        auxiliary = AuxiliaryModel(groups, self.values, asked)
        estimate = indirect_estimate(auxiliary, [decay], correct=self.correct, random_force=self.random_force)
        return as_identification(self, decay, asked, estimate, library)

    def forces_of(self, library: ForceLibrary) -> ForceLibrary:
        """The forces of a library that the method identifies."""
        return needed_forces(self, library, self.FORMULAS)

    def equations(self, library: ForceLibrary) -> Equations:
        """The method's `relation`; one whose equations depend on its forces makes them here."""
        return self.relation

    def relation(self, extremum: Array, time: Array) -> tuple[Array, Array]:
        """Design and target of equations between the extrema of neighbouring half periods."""
        raise NotImplementedError

    @abstractmethod
    def values(self, parameters: Array) -> Array:
        """Coefficients and w (rad/s) from the parameters and, last, half a period (s)."""


def decrement_scope(label: str, forces: str, *, weak: bool = False) -> MethodScope:
    """The scope of a method that takes these forces and a linear spring for all there are."""
    assumes = f"{'weak ' if weak else ''}{forces} and a linear spring, nothing else"
    return MethodScope(label, assumes, observes="extrema", identifies=forces, several_runs=False)


def needed_forces(method: Method, library: ForceLibrary, formulas: Sequence[str]) -> ForceLibrary:
    """The library's forces of these formulas.

    Raises
    ------
    DecayError
        One is missing, so that the method does not apply; or there is a sensor term.
    """
    refuse_sensors(library)
    forces = [library.role(formula) for formula in formulas]
    if None in forces:
        raise DecayError(
            f"{scope_of(method).sentence_label} wants a force of formula {formulas[forces.index(None)]}, and "
            "the library has none."
        )
    return library.select(force.symbol for force in forces if force is not None)


def one_record(method: Method, decay: Any) -> xr.Dataset:
    """The decay itself.

    Raises
    ------
    UsageError
        Several were given, or something else, or a record with a known input.
    """
    if not isinstance(decay, xr.Dataset):
        raise UsageError(f"{scope_of(method).sentence_label} takes one record at a time.")
    refuse_inputs(decay)
    return decay
