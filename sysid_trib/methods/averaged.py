"""The averaged equations of one decay, and the simplified models of its envelope for indirect inference."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
import scipy.sparse as sp
import xarray as xr
from scipy.interpolate import CubicSpline

from sysid_trib.arrays import Array
from sysid_trib.cycles.signatures import averages
from sysid_trib.forces.force import Force, ForceLibrary, ShapeValues
from sysid_trib.methods.half_period_equations import HalfPeriodEquations
from sysid_trib.records.half_sines import EnvelopeCurve, instant_derivatives
from sysid_trib.results.effects import birge_ratio
from sysid_trib.simulation.model import Model


def averaged_equations(
    measured: xr.Dataset, library: ForceLibrary, shapes: ShapeValues
) -> tuple[Array, Array]:
    """The averaged equations of an envelope.

    Parameters
    ----------
    measured : Dataset
        The envelope (see `envelope`), with `first_time` (s) in its attrs.
    library : ForceLibrary
    shapes : mapping of str to float

    Returns
    -------
    design : (2 instants, force + 1) array of float
        Against w c of each force, and w; amplitude rate and frequency of each instant, in turn.
    target : (2 instants,) array of float
    """
    a, w = measured.amplitude.values, measured.frequency.values
    design = np.zeros((len(a), 2, len(library) + 1))
    design[:, :, :-1] = _signature_columns(measured, library, shapes, a)
    design[:, 1, -1] = 1.0
    target = np.stack([measured.amplitude_rate.values, w], axis=1)
    return design.reshape(-1, len(library) + 1), target.reshape(-1)


def _signature_columns(
    measured: xr.Dataset, library: ForceLibrary, shapes: ShapeValues, amplitude: Array
) -> Array:
    """L and M: <h sin phi> and <h cos phi>/a, (instant, 2, force)."""
    t = measured.instant_time.values - measured.attrs["first_time"]
    columns = np.zeros((len(amplitude), 2, len(library)))
    low, high = np.floor(np.log2(amplitude.min())), np.ceil(np.log2(amplitude.max()))
    for j, force in enumerate(library):
        if force.degree is not None or force.holds_time:
            sine, cosine = averages(force, amplitude, shapes, t)
        else:
            held = tuple(force.shape_values(shapes).items())
            sine, cosine = _table(force, held, float(low), float(high))(np.log2(amplitude)).T
        columns[:, 0, j], columns[:, 1, j] = sine, cosine / amplitude
    return columns


@lru_cache(maxsize=64)
def _table(force: Force, held: tuple[tuple[str, float], ...], low: float, high: float) -> CubicSpline:
    """Signature against log2 of the amplitude: a history-dependent force takes a millisecond an amplitude."""
    # A cubic spline through these is exact to 1e-10 rad, at a kink (Jenkins) to 1e-5.
    nodes = np.linspace(low, high, max(2, round(64 * (high - low))) + 1)
    shapes = {f"{force.symbol}.{name}": value for name, value in held}
    return CubicSpline(nodes, np.stack(averages(force, 2.0**nodes, shapes), axis=1))


def slopes_of_equations(
    measured: xr.Dataset, library: ForceLibrary, shapes: ShapeValues, coefficients: Array
) -> sp.csr_matrix:
    """Derivatives of the averaged equations by the extrema and their times.

    Parameters
    ----------
    measured : Dataset
        The envelope.
    library : ForceLibrary
    shapes : mapping of str to float
    coefficients : (force,) array of float, rad/s
        w c of each force.

    Returns
    -------
    (2 instants, 2 half periods) sparse array of float
        By the extrema, then by their times.
    """
    slope = instant_derivatives(measured)
    a = measured.amplitude.values
    step = 1e-4 * a
    near = [_signature_columns(measured, library, shapes, a + s * step) @ coefficients for s in (-1.0, 1.0)]
    slope_by_amplitude = (near[1] - near[0]) / (2.0 * step)[:, None]
    by_amplitude = slope_by_amplitude[:, :, None] * slope["amplitude_by_extremum"][:, None]
    # Of each instant: rate and frequency, by extrema and by times, before and after.
    slopes = np.empty((len(a), 2, 2, 2))
    slopes[:, 0, 0] = slope["amplitude_rate_by_extremum"] - by_amplitude[:, 0]
    slopes[:, 0, 1] = slope["amplitude_rate_by_time"]
    slopes[:, 1, 0] = -by_amplitude[:, 1]
    slopes[:, 1, 1] = slope["frequency_by_time"]
    half_periods = len(a) + 2
    columns = np.add.outer(np.arange(len(a)), np.add.outer([0, half_periods], [0, 2]))[:, None]
    places = np.broadcast_to(columns, slopes.shape).ravel(), np.arange(0, slopes.size + 1, 4)
    return sp.csr_matrix((slopes.ravel(), *places), (2 * len(a), 2 * half_periods))


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
