"""What the classical methods share: equations between half periods; and the shift of the frequency."""

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.cycles.signatures import averages
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import parse_library
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


def energy_balance(library: ForceLibrary) -> Equations:
    """Equations of the decrement for powers of the speed."""
    unit = [(-np.pi * averages(force, np.ones(1))[0].item(), force.degree or 0.0) for force in library]

    def decrements(extremum: Array, time: Array) -> tuple[Array, Array]:
        mean = 0.5 * (extremum[1:] + extremum[:-1])
        return np.stack([b * mean**p for b, p in unit], axis=1), -np.diff(extremum)

    return decrements


# Friction by which the simulated amplitude shrinks as the record's does; it is not reported.
FORMULAS = {f"damping_beside_{p}": formula for p, formula in enumerate(("sign(v)", "2*v", "v*abs(v)"))}
DAMPING = parse_library(
    {"force": [{"symbol": symbol, "formula": formula} for symbol, formula in FORMULAS.items()]},
    "damping of frequency_shift",
)
VISCOUS = 1
# (w_inf/w)^2 of a motion that hardly swings.
SMALLEST = 1e-2


@dataclass(frozen=True)
class FrequencyShift:
    """Conservative forces from w(a) = w_inf (1 + sum of c <h cos phi>/a).

    Parameters
    ----------
    reference_frequency : float, rad/s
        w without contact, held: coefficients refer to it, and the library's force of formula `x` is
        identified. Without it they refer to the undamped w fitted.
    correct : bool
        Whether the bias of half-sines and averaging is removed by indirect inference.
    shapes : Mapping of str to float
        Values of shape parameters, which are held.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        As that of `Averaging`.

    Notes
    -----
    Solid, viscous and quadratic friction that follow the envelope are found beside, for the simulation and
    for w_inf = w sqrt(1 + alpha - zeta^2), and are not reported.
    """

    scope: ClassVar = MethodScope(
        label="frequency shift",
        assumes="conservative forces alone shift the frequency, whatever damps the motion",
        observes="frequency",
        identifies="conservative forces",
        several_runs=False,
    )

    reference_frequency: float | None = None
    correct: bool = True
    shapes: Mapping[str, float] = field(default_factory=dict)
    random_force: RandomForceOption = "auto"

    def __post_init__(self) -> None:
        check_random_force(self.random_force)

    @in_units_of_the_motion
    def identify(self, decay: xr.Dataset, library: ForceLibrary) -> xr.Dataset:
        """Identify the conservative forces of `library` from a decay with `angle(time)`.

        Raises
        ------
        DecayError
            The library has no conservative force but that of formula `x`, or they look the same; or a sensor
            term.
        UsageError
            Several decays.
        """
        decay = one_record(self, decay)
        refuse_sensors(library)
        stiffness = library.role("x")
        shifting = [
            f for f in library if f.kind == "force" and f.character == "conservative" and not f.holds_time
        ]
        asked = library.select(force.symbol for force in shifting if force is not stiffness)
        if not len(asked):
            label = self.scope.sentence_label
            raise DecayError(f"{label} wants a nonlinear conservative force, and the library has none.")
        auxiliary = _damped_model(asked, self.shapes)
        estimate = indirect_estimate(auxiliary, [decay], correct=self.correct, random_force=self.random_force)
        limit = estimate.mapped(_limit)
        forces, reference, count = asked.forces, self.reference_frequency, len(asked)
        if reference is not None and stiffness is not None:
            forces = (stiffness, *forces)

        def identified(values: Array) -> Array:
            """Coefficients, with that of the force of formula `x` if it is identified, and frequency."""
            coefficients, fitted = values[:count], values[-1]
            if reference is None:
                return np.append(coefficients, fitted)
            ratio = (fitted / reference) ** 2
            elastic = [] if stiffness is None else [ratio - 1.0]
            return np.concatenate([elastic, coefficients * ratio, [reference]])

        of_frequency = estimate.birge_ratios["frequency"]
        birge_ratios = {"": of_frequency, "frequency": of_frequency}
        shown = replace(estimate.mapped(identified), birge_ratios=birge_ratios)
        result = as_identification(self, decay, replace(asked, forces=forces), shown, library)
        known = {"": limit.values.item(), "_standard_error": float(np.sqrt(limit.covariance.item()))}
        of_limit = {f"asymptotic_frequency{name}": value for name, value in known.items()}
        return result.assign({name: result[name].copy(data=value) for name, value in of_limit.items()})


def _shifts(library: ForceLibrary, shapes: Mapping[str, float]) -> Equations:
    """Frequency of every period against w_inf c of each force, and w_inf."""

    def frequencies(extremum: Array, time: Array) -> tuple[Array, Array]:
        a = 0.5 * (extremum[2:] + extremum[:-2])
        columns = [averages(force, a, shapes)[1] / a for force in library]
        return np.stack([*columns, np.ones_like(a)], axis=1), 2.0 * np.pi / (time[2:] - time[:-2])

    return frequencies


def _damped_model(library: ForceLibrary, shapes: Mapping[str, float]) -> AuxiliaryModel:
    """Shift of the frequency, and friction that the simulated amplitude shrinks by as the record's."""
    whole = ForceLibrary("conservative forces, damped", (*library.forces, *DAMPING.forces))
    count = len(library)

    def values(parameters: Array) -> Array:
        damping = parameters[count + 1 :]
        # Undamped, the frequency would be higher than w_inf.
        w = parameters[count] / np.sqrt(max(1.0 - damping[VISCOUS] ** 2, SMALLEST))
        return np.concatenate([parameters[:count] * parameters[count] / w**2, damping, [w]])

    equations = {"frequency": _shifts(library, shapes), "envelope": energy_balance(DAMPING)}
    return AuxiliaryModel(equations, values, whole, shapes, wandering=tuple(equations))


def _limit(values: Array) -> Array:
    """Frequency at vanishing amplitude, rad/s, of values of the damped model: (1,)."""
    viscous = values[len(values) - 1 - len(DAMPING) + VISCOUS]
    return np.array([values[-1] * np.sqrt(max(1.0 - viscous**2, SMALLEST))])
