"""The paper's identification: amplitude decay and frequency shift against the signatures of the forces."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import parse_library
from sysid_trib.forces.selection import forces_to_identify, refuse_sensors
from sysid_trib.likelihood.least_squares import ConstraintMap, constraint_map
from sysid_trib.likelihood.random_force import RandomForceOption, check_random_force
from sysid_trib.methods.auxiliary import (
    AuxiliaryModel,
    amplitude_p_value,
    averaged_equations,
    energy_balance,
    with_noises,
)
from sysid_trib.methods.classical import one_record
from sysid_trib.methods.indirect import IndirectEstimate, as_identification, as_measured, indirect_estimate
from sysid_trib.methods.scope import Constrained, MethodScope
from sysid_trib.records.runs import Decays, as_runs
from sysid_trib.results.signal_scale import in_units_of_the_motion

SCOPE = MethodScope(
    label="averaging",
    assumes="weak forces: amplitude and phase hardly change within a period",
    observes="envelope and frequency",
    family="averaging",
    variants={
        "analytic signal": {"curve": "analytic-signal"},
        # The rule printed by Le Bot et al. 2019: last frequency, least squares, first order.
        "printed rule": {"frequency": "last", "correct": False, "weighted": False},
    },
)


@dataclass(frozen=True)
class Averaging(Constrained):
    """Least squares of da/dt and w(a) on the forces' signatures (Le Bot et al. 2019, Sec. 2.3).

    Parameters
    ----------
    frequency : {"fit", "last"}
        `fit` estimates the asymptotic frequency too; `last` is the paper's rule: the frequency of the last
        half periods, with ordinary least squares.
    correct : bool
        Whether indirect inference removes the first-order bias: the identified model is simulated, its motion
        is averaged in the same way, and its error is subtracted, until convergence.
    reference_frequency : float, rad/s
        Reference frequency w, which is then held; the library's force of formula `x` is then identified.
    weighted : bool
        Generalised least squares with the covariance of the half-sine fits (never with `last`).
    shapes : Mapping of str to float
        Values of shape parameters, which are fixed.
    curve : {"half-sines", "analytic-signal"}
        Curve that gives the extrema (see `envelope`).
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        `estimated` estimates a white random acceleration in each run in addition to the sensor's noise, by
        the restricted likelihood of the equations; a number is its one-sided density, which is fixed. `auto`
        leaves the choice to `identify`. Not available for the paper's rule.
    constraints : mapping of str to float, (float, float) or str
        `{"lambda": 0, "zeta": (0, None), "nu": "-2.356*delta"}`: fixed values of coefficients and shape
        parameters, lowest and highest values of coefficients, and coefficients as linear formulas of others.

    Notes
    -----
    With the columns L = <h sin phi> and M = <h cos phi>/a, and the parameters w and w c: da/dt = L (w c) and
    w(a) = w + M (w c). A force with both signatures has the same parameter in both equations.

    Examples
    --------
    Indirect inference removes the bias of first-order averaging: without noise, nu is exact.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.01, "nu": -0.4}, 9.91)
    >>> decay = st.simulate(model, np.arange(0.0, 10.0, 0.01), angle=0.3)
    >>> methods = [st.methods.Averaging(correct=correct) for correct in (True, False)]
    >>> [st.identify(decay, "zeta,nu", method).coefficient[1].round(3).item() for method in methods]
    [-0.4, -0.413]
    """

    frequency: Literal["fit", "last"] = "fit"
    correct: bool = True
    reference_frequency: float | None = None
    weighted: bool = True
    shapes: Mapping[str, float] = field(default_factory=dict)
    curve: Literal["half-sines", "analytic-signal"] = "half-sines"
    random_force: RandomForceOption = "auto"

    def __post_init__(self) -> None:
        if self.frequency not in ("fit", "last"):
            raise UsageError(f"frequency='{self.frequency}' is neither 'fit' nor 'last'.")
        check_random_force(self.random_force)
        if not isinstance(self.random_force, str) and self.frequency == "last":
            raise UsageError("frequency='last' takes no random_force; take frequency='fit', or leave it out.")

    @in_units_of_the_motion
    def identify(self, decay: Decays, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces of `library` from a decay with `angle(time)`, or from several runs.

        Raises
        ------
        DecayError
            The decay cannot support the request: it is too short, or forces have the same signature.
        UsageError
            The paper's rule was asked for several runs, but each has its own last frequency. Or a constraint
            is not linear in the coefficients, or does not fit the library.
        """
        asked = forces_to_identify(library, self.reference_frequency)
        runs = as_runs(decay)
        if not self.scope.several_runs and len(runs) > 1:
            raise UsageError("frequency='last' is a rule for one record; take 'fit' for several runs.")
        wanted = constraints = Constraints(self.constraints)
        shapes = {**self.shapes, **{k: v for k, v in wanted.fixed.items() if k not in asked.symbols}}
        method = replace(self, shapes=shapes)
        # The errors of the paper's rule do not include a random force.
        force = self.random_force if self.frequency == "fit" else "off"
        unbounded = None
        while True:
            auxiliary = method._auxiliary(asked, constraint_map(constraints, asked, shapes))
            estimate = indirect_estimate(auxiliary, runs, correct=self.correct, random_force=force)
            value = dict(zip(asked.symbols, estimate.values.tolist(), strict=False))
            passed = {k: float(np.clip(value[k], low, high)) for k, (low, high) in wanted.bounds.items()}
            passed = {k: bound for k, bound in passed.items() if bound != value[k]}
            unbounded = unbounded or estimate
            if not passed:
                break
            # Fix the worst violation first: this often removes the others.
            error = dict(zip(asked.symbols, np.sqrt(np.diag(estimate.covariance)).tolist(), strict=False))
            furthest = max(passed, key=lambda k: abs(value[k] - passed[k]) / max(error[k], 1e-300))
            constraints = constraints.holding({furthest: passed[furthest]})
            if not constraints.linear_map(asked, shapes)[0]:
                at_bounds = ", ".join(sorted(constraints.fixed.keys() - wanted.fixed.keys()))
                raise DecayError(
                    f"With the fixed values, {at_bounds} would exceed the bounds: nothing is left to fit; "
                    "fix other or fewer values."
                )
        if unbounded is not estimate:
            estimate = _with_errors_of_unbounded(estimate, unbounded)
        result = as_identification(method, decay, asked, estimate, library)
        return wanted.marked(result, constraints.fixed.keys() - wanted.fixed.keys())

    def influence(
        self,
        decays: Sequence[xr.Dataset],
        motions: Sequence[xr.Dataset],
        asked: ForceLibrary,
        free: ConstraintMap,
        noises: Sequence[tuple[float, float]],
    ) -> list[Array]:
        """Compute the effect of each sample on coefficients and frequency, without bias correction.

        Parameters
        ----------
        decays : sequence of Dataset
            The runs.
        motions : sequence of Dataset
            Motions of the identified model in these runs; the equations are linear about their averages.
        asked : ForceLibrary
            The identified forces.
        free : ConstraintMap
            Free coefficients of these forces.
        noises : sequence of (float, float), rad and (rad/s^2)^2/Hz
            Noise of a sample and random force in each run.

        Returns
        -------
        list of (value, sample) array of float
            One array per run; the frequency is the last value.
        """
        auxiliary = self._auxiliary(asked, free)
        simulated = []
        for decay, motion, (noise, density) in zip(decays, motions, noises, strict=True):
            measured = auxiliary.measure(decay)
            measured = with_noises(measured, noise, density) if density else measured
            simulated.append(as_measured(auxiliary.measure(motion), measured))
        return auxiliary.influence(auxiliary.fit(simulated), simulated, motions)

    def amplitude_p_value(
        self, decays: Sequence[xr.Dataset], motions: Sequence[xr.Dataset], asked: ForceLibrary
    ) -> float:
        """Test whether the residual of the averages depends on the amplitude, unlike a random force.

        Parameters
        ----------
        decays, motions, asked
            As in `influence`.

        Returns
        -------
        float
            P-value of all runs together (Bonferroni).
        """
        free = constraint_map(Constraints({}), asked, self.shapes)
        auxiliary, p_values = self._auxiliary(asked, free), []
        for decay, motion in zip(decays, motions, strict=True):
            measured = auxiliary.measure(decay)
            simulated = as_measured(auxiliary.measure(motion), measured)
            first, of_motion = (auxiliary.fit([envelope]) for envelope in (measured, simulated))
            rest = [first[name].without_bias(of_motion[name]).runs[0] for name in first]
            p_values.append(amplitude_p_value(rest, measured))
        return min(1.0, len(p_values) * min(p_values))

    @property
    def scope(self) -> MethodScope:
        """Scope of the method; the paper's rule takes one record."""
        return replace(SCOPE, several_runs=self.frequency == "fit")

    def _auxiliary(self, library: ForceLibrary, free: ConstraintMap) -> AuxiliaryModel:
        """Return the averaged equations of the free coefficients; the parameters are w c of each, and w."""
        whole, reference = averaged_equations(library, self.shapes), self.reference_frequency
        damping = [(library.symbols.index(s), factor) for s, factor in library.damping_factors.items()]
        # Linear map from (w c of each free force, w) to (w c of each force, w).
        expand = np.block([[free.matrix, free.constant[:, None]], [np.zeros(len(free.free)), np.ones(1)]])

        def equations(extremum: Array, time: Array) -> tuple[Array, Array]:
            design, target = whole(extremum, time)
            design = design @ expand
            if reference is None:
                return design, target
            return design[..., :-1], target - reference * design[..., -1]

        def values(parameters: Array) -> Array:
            if reference is None and parameters[-1] <= 0.0:
                raise DecayError(
                    "These half periods do not determine the frequency at zero amplitude; give it "
                    "(reference_frequency=), or offer fewer forces."
                )
            *products, frequency = expand @ (
                parameters if reference is None else np.append(parameters, reference)
            )
            if reference is None:
                # Damping lowers the frequency at zero amplitude: go back to w, that without damping.
                for at, factor in damping:
                    frequency = np.hypot(frequency, factor * products[at])
            coefficients = np.array(products)[free.free] / frequency
            return np.append(free.matrix @ coefficients + free.constant, frequency)

        names = tuple(library.symbols[i] for i in free.free)
        curves = tuple(library.curves_among(names).values())

        def means(values: Array) -> Array:
            """Return the parameters w c of the curves of a model."""
            parameters = np.zeros(len(names) + (reference is None))
            for curve in curves:
                parameters[curve] = values[free.free[curve]] * values[-1]
            return parameters

        last = self.frequency == "last" and reference is None
        return AuxiliaryModel(
            {"": equations},
            values,
            library,
            self.shapes,
            wandering=("",),
            curve=self.curve,
            rule="last" if last else "weighted" if self.weighted else "plain",
            names=names,
            curves=curves,
            means=means,
        )


def _with_errors_of_unbounded(estimate: IndirectEstimate, unbounded: IndirectEstimate) -> IndirectEstimate:
    """Return an estimate at its bounds with the covariance of the unbounded estimate.

    A coefficient at its bound is uncertain: the errors of the others include this uncertainty. The residual
    due to the bounds increases the errors.
    """
    ratios = [max(1.0, of.birge_ratios[""]) for of in (estimate, unbounded)]
    widening = max(1.0, ratios[0] / ratios[1])
    return replace(estimate, covariance=widening**2 * unbounded.covariance)


# Friction with which the simulated amplitude decays as the record's does; it is not reported.
FRICTION_FORMULAS, VISCOUS = ("sign(v)", "2*v", "v*abs(v)"), 1
DAMPING_FORCES = [{"symbol": f"damping_beside_{p}", "formula": f} for p, f in enumerate(FRICTION_FORMULAS)]
DAMPING = parse_library({"force": DAMPING_FORCES}, "damping of frequency_shift")
# Lower limit of (w_inf/w)^2, for a motion that hardly oscillates.
SMALLEST = 1e-2


@dataclass(frozen=True)
class FrequencyShift:
    """Conservative forces from w(a) = w_inf (1 + sum of c <h cos phi>/a).

    Parameters
    ----------
    reference_frequency : float, rad/s
        Frequency w without contact, which is fixed: coefficients refer to it, and the library's force of
        formula `x` is identified. Without it, coefficients refer to the fitted undamped w.
    correct : bool
        Whether indirect inference removes the bias of half-sines and averaging.
    shapes : Mapping of str to float
        Values of shape parameters, which are fixed.
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        As in `Averaging`.

    Notes
    -----
    Solid, viscous and quadratic friction are fitted to the envelope too. They serve the simulation and
    w_inf = w sqrt(1 + alpha - zeta^2), and are not reported.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.01, "nu": -0.4, "epsilon": 0.3}, 9.91)
    >>> decay = st.simulate(model, np.arange(0.0, 10.0, 0.02), angle=0.3)
    >>> found = st.identify(decay, method=st.methods.FrequencyShift())
    >>> found.coefficient.round(2).to_series().to_dict()
    {'nu': -0.4, 'epsilon': 0.3}
    """

    scope: ClassVar = MethodScope(
        label="frequency shift",
        assumes="only conservative forces shift the frequency",
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
            The library has no conservative force except that of formula `x`, the conservative forces have the
            same signature, or there is a sensor term.
        UsageError
            Several decays were given.
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
            raise DecayError(f"{label} needs a nonlinear conservative force, and the library has none.")
        auxiliary = _damped_model(asked, self.shapes)
        estimate = indirect_estimate(auxiliary, [decay], correct=self.correct, random_force=self.random_force)
        forces, reference, count = asked.forces, self.reference_frequency, len(asked)
        if reference is not None and stiffness is not None:
            forces = (stiffness, *forces)

        def identified(values: Array) -> Array:
            """Return coefficients at the reference frequency, formula `x` first, and this frequency."""
            coefficients, fitted = values[:count], values[-1:]
            if reference is None:
                return np.append(coefficients, fitted)
            ratio = (fitted / reference) ** 2
            elastic = np.empty(0) if stiffness is None else ratio - 1.0
            return np.concatenate([elastic, coefficients * ratio, [reference]])

        def at_rest(values: Array) -> Array:
            """Return the frequency at vanishing amplitude."""
            return values[-1:] * np.sqrt(max(1.0 - values[count + VISCOUS] ** 2, SMALLEST))

        of_frequency, limit = estimate.birge_ratios["frequency"], estimate.mapped(at_rest)
        shown = replace(
            estimate.mapped(identified), birge_ratios={"": of_frequency, "frequency": of_frequency}
        )
        result = as_identification(self, decay, replace(asked, forces=forces), shown, library)
        for name, number in (("", limit.values), ("_standard_error", np.sqrt(limit.covariance))):
            result[f"asymptotic_frequency{name}"].values = number.item()
        return result


def _damped_model(library: ForceLibrary, shapes: Mapping[str, float]) -> AuxiliaryModel:
    """Return equations of the frequency shift, and of friction with which the simulated amplitude decays."""
    whole = ForceLibrary("conservative forces, damped", (*library.forces, *DAMPING.forces))
    count, averaged = len(library), averaged_equations(library, shapes)

    def shifts(extremum: Array, time: Array) -> tuple[Array, Array]:
        """Return design and target of the frequency of every period, for w_inf c of each force and w_inf."""
        design, target = averaged(extremum, time)
        return design[:, 1], target[:, 1]

    def values(parameters: Array) -> Array:
        damping = parameters[count + 1 :]
        # Without damping, the frequency would be higher than w_inf.
        w = parameters[count] / np.sqrt(max(1.0 - damping[VISCOUS] ** 2, SMALLEST))
        return np.concatenate([parameters[:count] * parameters[count] / w**2, damping, [w]])

    equations = {"frequency": shifts, "envelope": energy_balance(DAMPING)}
    return AuxiliaryModel(equations, values, whole, shapes, wandering=tuple(equations))
