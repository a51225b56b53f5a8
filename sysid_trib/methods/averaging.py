"""The paper's identification: amplitude decay and frequency shift against the signatures of the forces."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np
import scipy.sparse as sp
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.constraints import Constrained, Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.selection import forces_to_identify
from sysid_trib.likelihood.optimizers import ConstraintMap, constraint_map
from sysid_trib.likelihood.random_force import RandomForceOption, check_random_force
from sysid_trib.likelihood.weak_form import whiten, whitener
from sysid_trib.methods.averaged import AuxiliaryFit, AuxiliaryModel, averaged_equations, slopes_of_equations
from sysid_trib.methods.half_period_equations import DENSITY, HalfPeriodEquations
from sysid_trib.methods.indirect import as_identification, indirect_estimate
from sysid_trib.methods.scope import MethodScope
from sysid_trib.records.decay import Decays, as_runs
from sysid_trib.records.half_sines import envelope
from sysid_trib.results.signal_scale import in_units_of_the_motion

SCOPE = MethodScope(
    label="averaging",
    assumes="weak forces: amplitude and phase hardly change within a period",
    observes="envelope and frequency",
    family="averaging",
    variants={
        "analytic signal": {"curve": "analytic-signal"},
        # As Le Bot et al. 2019 print it: last frequency, least squares, first order.
        "printed rule": {"frequency": "last", "correct": False, "weighted": False},
    },
)


@dataclass(frozen=True)
class Averaging(Constrained):
    """Least squares of da/dt and w(a) on the forces' signatures (Le Bot et al. 2019, Sec. 2.3).

    Parameters
    ----------
    frequency : {"fit", "last"}
        `fit` estimates the asymptotic frequency too; `last` is the paper's rule, the last half periods'
        frequency, with its plain least squares.
    correct : bool
        Whether the first-order bias is removed by indirect inference: the identified model is simulated, its
        motion goes through the same averaging, and what that got wrong is subtracted, until nothing moves.
    reference_frequency : float, rad/s
        w, held; the library's force of formula `x` is then identified.
    weighted : bool
        Generalised least squares with the covariance of the half-sine fits (never with `last`).
    shapes : Mapping of str to float
        Values of shape parameters, which are held.
    curve : {"half-sines", "analytic-signal"}
        What gives the extrema (see `envelope`).
    random_force : "auto", "off", "estimated" or float, (rad/s^2)^2/Hz
        `estimated` finds a white random acceleration in each run besides the sensor's noise, by the
        restricted likelihood of the equations; a number is its one-sided density, held. `auto` leaves it to
        `identify`. Not for the paper's rule.
    constraints : mapping of str to float, (float, float) or str
        `{"lambda": 0, "zeta": (0, None), "nu": "-2.356*delta"}`: coefficients and shape parameters that are
        held, lowest and highest value of coefficients, and coefficients as linear formulas of others.
    fix, bounds, tie : mapping, deprecated
        Parts of `constraints`.

    Notes
    -----
    With the columns L = <h sin phi> and M = <h cos phi>/a, parameters w and w c: da/dt = L (w c) and
    w(a) = w + M (w c). A force with both signatures has one parameter in both.
    """

    frequency: Literal["fit", "last"] = "fit"
    correct: bool = True
    reference_frequency: float | None = None
    weighted: bool = True
    shapes: Mapping[str, float] = field(default_factory=dict)
    curve: Literal["half-sines", "analytic-signal"] = "half-sines"
    random_force: RandomForceOption = "auto"

    def __post_init__(self, *old: Any) -> None:
        super().__post_init__(*old)
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
            The decay cannot support the request: too short, or forces of the same signature.
        UsageError
            The paper's rule for several runs: each has its own last frequency. A constraint is not linear in
            the coefficients, or does not fit to the library.
        """
        asked = forces_to_identify(library, self.reference_frequency)
        runs = as_runs(decay)
        if not self.scope.several_runs and len(runs) > 1:
            raise UsageError("frequency='last' is a rule for one record; take 'fit' for several runs.")
        wanted = constraints = Constraints(self.constraints)
        shapes = {**self.shapes, **{k: v for k, v in wanted.fixed.items() if k not in asked.symbols}}
        method = replace(self, shapes=shapes)
        # The paper's rule has no errors that would know a random force.
        force = self.random_force if self.frequency == "fit" else "off"
        while True:
            auxiliary = AuxiliaryModel(
                self._envelope,
                partial(_first_order, method, library=asked, free=constraint_map(constraints, asked, shapes)),
                asked,
                shapes,
                curve=self.curve,
            )
            estimate = indirect_estimate(auxiliary, runs, correct=self.correct, random_force=force)
            value = dict(zip(asked.symbols, estimate.values.tolist(), strict=False))
            passed = {k: float(np.clip(value[k], low, high)) for k, (low, high) in wanted.bounds.items()}
            passed = {k: bound for k, bound in passed.items() if bound != value[k]}
            if not passed:
                break
            # The furthest first: held there, it often frees the others.
            error = dict(zip(asked.symbols, np.sqrt(np.diag(estimate.covariance)).tolist(), strict=False))
            furthest = max(passed, key=lambda k: abs(value[k] - passed[k]) / max(error[k], 1e-300))
            constraints = constraints.holding({furthest: passed[furthest]})
            if not constraints.linear_map(asked, shapes)[0]:
                at_bounds = ", ".join(sorted(constraints.fixed.keys() - wanted.fixed.keys()))
                raise DecayError(
                    f"With what is fixed, {at_bounds} would pass the bounds: nothing is left to fit; "
                    "fix other values, or fewer."
                )
        result = as_identification(method, decay, asked, estimate, library)
        if constraints:
            at_bound = constraints.fixed.keys() - wanted.fixed.keys()
            kinds = wanted.kinds(asked.symbols, at_bound)
            result = result.assign_coords(constraint=("force", kinds))
        return result

    @property
    def scope(self) -> MethodScope:
        """What the method says of itself; the paper's rule is for one record."""
        return replace(SCOPE, several_runs=self.frequency == "fit")

    def _envelope(self, decay: xr.Dataset) -> xr.Dataset:
        return envelope(decay, self.curve).assign_attrs(first_time=float(decay.time.values[0]))


def _first_order(
    method: Averaging, runs: Sequence[xr.Dataset], library: ForceLibrary, free: ConstraintMap
) -> AuxiliaryFit:
    """The paper's least squares on the half periods of all runs' envelopes, of the free coefficients."""
    equations = [averaged_equations(measured, library, method.shapes) for measured in runs]
    design, target = (np.concatenate(part) for part in zip(*equations, strict=True))
    # Of (w c of each force, w) as linear functions of (w c of each free one, w).
    expand = np.block([[free.matrix, free.constant[:, None]], [np.zeros(len(free.free)), np.ones(1)]])
    design = design @ expand
    last = method.frequency == "last" and method.reference_frequency is None
    fixed = float(runs[0].frequency.values[-1]) if last else method.reference_frequency
    if fixed is not None:
        design, target = design[:, :-1], target - fixed * design[:, -1]
    _check_rank(design, tuple(library.symbols[i] for i in free.free), len(target) // 2)
    plain: Array = np.asarray(np.linalg.lstsq(design, target, rcond=None)[0], dtype=float)
    by_force = (expand @ (plain if fixed is None else np.append(plain, fixed)))[:-1]
    ends = np.cumsum([len(part) for _, part in equations])[:-1]
    slopes = [slopes_of_equations(run, library, method.shapes, by_force) for run in runs]
    of_runs = [
        HalfPeriodEquations(a, y - a @ plain, slope, np.arange(len(y)) // 2)
        for a, y, slope in zip(np.split(design, ends), np.split(target, ends), slopes, strict=True)
    ]
    noise = sp.block_diag([part.noise(run) for part, run in zip(of_runs, runs, strict=True)], format="csr")
    weighted = method.weighted and not last
    parameters, covariance, residual = _solve(design, target, noise, weighted=weighted, last=last)
    if fixed is None and parameters[-1] <= 0.0 and any(DENSITY in run for run in runs):
        raise DecayError(
            "Beside the random force these half periods do not decide the frequency at zero amplitude; "
            "give it (reference_frequency=), or offer fewer forces."
        )
    degrees_of_freedom = max(1, len(target) - len(parameters))
    if fixed is not None:
        parameters = np.append(parameters, fixed)
        covariance = np.pad(covariance, (0, 1))
        if last:
            covariance[-1, -1] = runs[0].frequency_standard_error.values[-1] ** 2
    given = method.reference_frequency is not None
    values, jacobian = _to_coefficients(library, expand @ parameters, given=given)
    # Of the frequency that holds here, and not of the one at zero amplitude.
    values[:-1] = free.matrix @ values[free.free] + free.constant
    jacobian[:-1] = free.matrix @ jacobian[free.free]
    slopes = jacobian @ expand
    covariance = slopes @ covariance @ slopes.T
    return AuxiliaryFit(
        values,
        {"": np.split(residual, ends)},
        {"": degrees_of_freedom},
        lambda _, residuals: sum(float(part @ part) for part in residuals),
        lambda ratios: covariance * ratios[""] ** 2,
        {"": of_runs},
    )


def _solve(
    design: Array, target: Array, noise: sp.csr_matrix, *, weighted: bool, last: bool
) -> tuple[Array, Array, Array]:
    """Least squares: parameters, their covariance, whitened residual."""
    factor = whitener(noise)
    rows, y = whiten(factor, design), whiten(factor, target)
    if weighted:
        parameters: Array = np.asarray(np.linalg.lstsq(rows, y, rcond=None)[0], dtype=float)
        covariance: Array = np.asarray(np.linalg.inv(rows.T @ rows), dtype=float)
    else:
        parameters = np.asarray(np.linalg.lstsq(design, target, rcond=None)[0], dtype=float)
        inverse = np.linalg.pinv(design)
        influence = inverse @ noise
        if last:
            # The error of the last frequency is in every shift that is taken from it.
            influence = influence - np.outer(inverse[:, 1::2].sum(axis=1), noise[[-1]].toarray())
        covariance = np.asarray(influence @ influence.T, dtype=float)
    return parameters, covariance, y - rows @ parameters


def _check_rank(design: Array, symbols: tuple[str, ...], instants: int) -> None:
    """Refuse what the averaged equations cannot decide, by name."""
    if len(design) < design.shape[1] + 2:
        raise DecayError(
            f"{instants} amplitudes cannot decide {len(symbols)} forces; give a longer record or fewer."
        )
    size = np.linalg.norm(design, axis=0)
    silent = [s for s, n in zip(symbols, size, strict=False) if n < 1e-12 * size.max()]
    if silent:
        raise DecayError(
            f"Force {silent[0]} has no signature in envelope or frequency: averaging cannot see it; "
            "leave it out (--forces) or use the direct method alone."
        )
    _, singular, axes = np.linalg.svd(design / size, full_matrices=False)
    if singular[-1] < 1e-8 * singular[0]:
        tied = [s for s, part in zip((*symbols, "the frequency"), axes[-1], strict=False) if abs(part) > 1e-3]
        raise DecayError(
            f"Averaging cannot tell apart {' and '.join(tied)}: their signatures are the same; leave one out."
        )


def _to_coefficients(library: ForceLibrary, parameters: Array, *, given: bool) -> tuple[Array, Array]:
    """From (w c, w_inf) to (c, w), and the derivatives; the frequency at zero amplitude is w_inf, not w."""
    frequency = parameters[-1]
    jacobian = np.eye(len(parameters))
    if not given:
        for symbol, factor in library.damping_factors.items():
            at = library.symbols.index(symbol)
            damping = factor * parameters[at]
            frequency = float(np.hypot(frequency, damping))
            jacobian[-1, at] = factor * damping / frequency
            jacobian[-1, -1] = parameters[-1] / frequency
    coefficients = parameters[:-1] / frequency
    jacobian[:-1, :] -= np.outer(coefficients, jacobian[-1])
    jacobian[:-1, :] /= frequency
    return np.append(coefficients, frequency), jacobian
