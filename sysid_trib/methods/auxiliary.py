"""Simplified models of the envelope of a decay, for indirect inference, and the averaged equations of one."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import xarray as xr
from scipy.interpolate import CubicSpline

from sysid_trib.arrays import Array
from sysid_trib.cycles.signatures import averages
from sysid_trib.forces.force import Force, ForceLibrary, ShapeValues
from sysid_trib.methods.half_period_equations import Equations, EquationSolution, Rule, solve
from sysid_trib.records.half_sines import EnvelopeCurve, envelope
from sysid_trib.results.effects import birge_ratio
from sysid_trib.simulation.model import Model


def averaged_equations(library: ForceLibrary, shapes: ShapeValues) -> Equations:
    """Rate of the amplitude and frequency of each instant, against w c of each force, and w.

    Of the columns L = <h sin phi> and M = <h cos phi>/a.
    """

    def equations(extremum: Array, time: Array) -> tuple[Array, Array]:
        a, span = 0.5 * (extremum[2:] + extremum[:-2]), time[2:] - time[:-2]
        design = np.zeros((len(a), 2, len(library) + 1))
        low, high = float(np.floor(np.log2(a.min()))), float(np.ceil(np.log2(a.max())))
        for j, force in enumerate(library):
            if force.degree is not None or force.holds_time:
                sine, cosine = averages(force, a, shapes, time[1:-1])
            else:
                held = tuple(force.shape_values(shapes).items())
                sine, cosine = _table(force, held, low, high)(np.log2(a)).T
            design[:, 0, j], design[:, 1, j] = sine, cosine / a
        design[:, 1, -1] = 1.0
        return design, np.stack([(extremum[2:] - extremum[:-2]) / span, 2.0 * np.pi / span], axis=1)

    return equations


@lru_cache(maxsize=64)
def _table(force: Force, held: tuple[tuple[str, float], ...], low: float, high: float) -> CubicSpline:
    """Signature against log2 of the amplitude: a history-dependent force takes a millisecond an amplitude."""
    # A cubic spline through these is exact to 1e-10 rad, at a kink (Jenkins) to 1e-5.
    nodes = np.linspace(low, high, max(2, round(64 * (high - low))) + 1)
    shapes = {f"{force.symbol}.{name}": value for name, value in held}
    return CubicSpline(nodes, np.stack(averages(force, 2.0**nodes, shapes), axis=1))


def same_half_periods(extremum: Array, time: Array) -> tuple[Array, Array]:
    """Equations of a steady frequency: every half period lasts as long; the parameter is that time (s)."""
    return np.ones((len(time) - 1, 1)), np.diff(time)


def jacobian(function: Callable[[Array], Array], at: Array, errors: Array) -> Array:
    """Derivatives of values by parameters with these errors, (value, parameter)."""
    steps = np.clip(1e-3 * errors + 1e-300, 1e-7 * np.abs(at), None)
    slopes = [
        (function(at + step * unit) - function(at - step * unit)) / (2.0 * step)
        for step, unit in zip(steps, np.eye(len(at)), strict=True)
    ]
    return np.stack(slopes, axis=1)


@dataclass(frozen=True)
class AuxiliaryFit:
    """Least squares of an auxiliary model on envelopes.

    Attributes
    ----------
    groups : mapping of str to EquationSolution
        Each with parameters of its own, of the same half periods.
    values_of : callable
        From all parameters, in the groups' order, to coefficients and, last, the frequency (rad/s).
    """

    groups: Mapping[str, EquationSolution]
    values_of: Callable[[Array], Array]

    @property
    def parameters(self) -> Array:
        """Parameters of all groups."""
        return np.concatenate([group.parameters for group in self.groups.values()])

    @property
    def values(self) -> Array:
        """Coefficients and, last, the frequency (rad/s)."""
        return self.values_of(self.parameters)

    def birge_ratio(self, *names: str) -> float:
        """Root of the reduced chi-square of some groups."""
        groups = [self.groups[name] for name in names]
        return birge_ratio(sum(g.chi_square for g in groups), sum(g.degrees_of_freedom for g in groups))

    def covariance(self, other: "AuxiliaryFit") -> Array:
        """Covariance of the values, each group's errors raised by its Birge ratio in a fit."""
        # Groups share the errors of half periods.
        influence = np.concatenate(
            [max(1.0, other.birge_ratio(name)) * group.influence for name, group in self.groups.items()]
        )
        slopes = jacobian(self.values_of, self.parameters, np.linalg.norm(influence, axis=1))
        by_error = slopes @ influence
        return np.asarray(by_error @ by_error.T)


@dataclass(frozen=True)
class AuxiliaryModel:
    """A simplified model of the envelope of a decay, quick to fit, and biased.

    Attributes
    ----------
    equations : mapping of str to Equations
        Groups with parameters of their own, `envelope`, `frequency`.
    values_of : callable
        See `AuxiliaryFit`.
    library : ForceLibrary
        The forces of the coefficients, for motions of its own.
    shapes : Mapping of str to float
        Shape parameters of these forces.
    wandering : tuple of str
        Groups of equations that a random force is estimated from.
    curve : {"half-sines", "analytic-signal"}
        What extrema are taken from.
    rule : Rule
        Of least squares (see `solve`).
    names : tuple of str
        Of the first parameters, for what is refused.
    """

    equations: Mapping[str, Equations]
    values_of: Callable[[Array], Array]
    library: ForceLibrary
    shapes: Mapping[str, float] = field(default_factory=dict)
    wandering: tuple[str, ...] = ("envelope",)
    curve: EnvelopeCurve = "half-sines"
    rule: Rule = "weighted"
    names: tuple[str, ...] = ()

    def measure(self, decay: xr.Dataset) -> xr.Dataset:
        """Envelope of a decay (see `envelope`), with `first_time` (s) in its attrs."""
        return envelope(decay, self.curve).assign_attrs(first_time=float(decay.time.values[0]))

    def fit(self, measured: Sequence[xr.Dataset]) -> AuxiliaryFit:
        """Least squares on the envelopes of all runs."""
        groups = {
            name: solve(of_group, measured, self.rule, self.names)
            for name, of_group in self.equations.items()
        }
        return AuxiliaryFit(groups, self.values_of)

    def model(self, values: Array) -> Model:
        """The model of coefficients and, last, the frequency (rad/s)."""
        coefficients = dict(zip(self.library.symbols, values[:-1].tolist(), strict=True))
        return Model(self.library, coefficients, float(values[-1]), self.shapes)
