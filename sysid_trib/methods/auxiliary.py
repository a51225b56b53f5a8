"""Auxiliary models of indirect inference: simplified models of the envelope of a decay."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.decays.half_sines import EnvelopeCurve
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.regression.half_period_noise import HalfPeriodEquations
from sysid_trib.results.birge import birge_ratio
from sysid_trib.simulation.model import Model


@dataclass(frozen=True)
class AuxiliaryFit:
    """Least squares of an auxiliary model on envelopes.

    Attributes
    ----------
    values : (value,) array of float
        Coefficients and, last, the frequency (rad/s).
    residuals : Mapping of str to list of array
        Of each group of equations, in each run.
    degrees_of_freedom : Mapping of str to int
        Of each group's residuals.
    chi_square : callable
        Chi-square of residuals of a group, given its name and the residuals.
    covariance : callable
        Covariance of the values, (value, value); each group's errors are multiplied by its number.
    equations : Mapping of str to list of HalfPeriodEquations
        Of each group, in each run.
    """

    values: Array
    residuals: Mapping[str, Sequence[Array]]
    degrees_of_freedom: Mapping[str, int]
    chi_square: Callable[[str, Sequence[Array]], float]
    covariance: Callable[[Mapping[str, float]], Array]
    equations: Mapping[str, Sequence[HalfPeriodEquations]]

    def birge_ratio(self, *groups: str) -> float:
        """Root of the reduced chi-square of some groups."""
        total = sum(self.chi_square(group, self.residuals[group]) for group in groups)
        return birge_ratio(total, sum(self.degrees_of_freedom[group] for group in groups))

    def error_factors(self) -> dict[str, float]:
        """The Birge ratio of each group, by which errors are raised; at least 1."""
        return {group: max(1.0, self.birge_ratio(group)) for group in self.residuals}


@dataclass(frozen=True)
class AuxiliaryModel:
    """A simplified model of the envelope of a decay, quick to fit, and biased.

    Attributes
    ----------
    measure : callable
        Envelope of a decay (see `envelope`).
    fit : callable
        `AuxiliaryFit` of the envelopes of all runs.
    library : ForceLibrary
        The forces of the coefficients, for motions of its own.
    shapes : Mapping of str to float
        Shape parameters of these forces.
    wandering : tuple of str
        Groups of equations that a random force is estimated from.
    curve : {"half-sines", "analytic-signal"}
        What `measure` takes extrema from.
    """

    measure: Callable[[xr.Dataset], xr.Dataset]
    fit: Callable[[Sequence[xr.Dataset]], AuxiliaryFit]
    library: ForceLibrary
    shapes: Mapping[str, float] = field(default_factory=dict)
    wandering: tuple[str, ...] = ("",)
    curve: EnvelopeCurve = "half-sines"

    def model(self, values: Array) -> Model:
        """The model of coefficients and, last, the frequency (rad/s)."""
        coefficients = dict(zip(self.library.symbols, values[:-1].tolist(), strict=True))
        return Model(self.library, coefficients, float(values[-1]), self.shapes)
