"""Simplified models of the envelope of a decay for indirect inference, with a random force."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import scipy
import scipy.sparse as sp
import xarray as xr
from numpy.polynomial import legendre

from sysid_trib.arrays import Array, Index, jacobian
from sysid_trib.cycles.signatures import averages, tabulated_averages_of
from sysid_trib.forces.force import ForceLibrary, ShapeValues
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.likelihood.sensor_noise import covariance_band
from sysid_trib.likelihood.variance_ratio import VarianceRatio, held_ratio, rows_by_ratio, variance_ratio
from sysid_trib.methods import half_period_equations as half_periods
from sysid_trib.records.half_sines import IMPULSES, EnvelopeCurve, envelope, sample_responses
from sysid_trib.results.effects import birge_ratio
from sysid_trib.results.random_force import RandomForce
from sysid_trib.simulation.model import Model

# Degree of the polynomials in the amplitude that test for an amplitude dependence, and least number of
# instants.
DEGREES, TESTED_INSTANTS = 4, 40
Groups: TypeAlias = Mapping[str, half_periods.EquationSolution]


def same_half_periods(extremum: Array, time: Array) -> tuple[Array, Array]:
    """Return equations of a steady frequency: the parameter is the duration (s) of all half periods."""
    return np.ones((len(time) - 1, 1)), np.diff(time)


def energy_balance(library: ForceLibrary) -> half_periods.Equations:
    """Return the equations of the decrement for powers of the speed."""
    unit = [(-np.pi * averages(force, np.ones(1))[0].item(), force.degree or 0.0) for force in library]

    def decrements(extremum: Array, time: Array) -> tuple[Array, Array]:
        mean = 0.5 * (extremum[1:] + extremum[:-1])
        return np.stack([b * mean**p for b, p in unit], axis=1), -np.diff(extremum)

    return decrements


def averaged_equations(library: ForceLibrary, shapes: ShapeValues) -> half_periods.Equations:
    """Return the averaged equations at each instant: rate of the amplitude, and frequency.

    Their parameters are w c of each force, and w. The columns are L = <h sin phi> and M = <h cos phi>/a.
    """

    def equations(extremum: Array, time: Array) -> tuple[Array, Array]:
        a, span = 0.5 * (extremum[2:] + extremum[:-2]), time[2:] - time[:-2]
        design = np.zeros((len(a), 2, len(library) + 1))
        sine, cosine = tabulated_averages_of(library.forces, a, shapes, time[1:-1])
        design[:, 0, :-1], design[:, 1, :-1] = sine, cosine / a[:, None]
        design[:, 1, -1] = 1.0
        return design, np.stack([(extremum[2:] - extremum[:-2]) / span, 2.0 * np.pi / span], axis=1)

    return equations


@dataclass(frozen=True)
class AuxiliaryModel:
    """A simplified model of the envelope of a decay: quick to fit, but biased.

    Attributes
    ----------
    equations : mapping of str to Equations
        Groups of equations with separate parameters, `envelope` and `frequency`.
    values_of : callable
        Function from all parameters, in the order of the groups, to coefficients and, last, the frequency
        (rad/s).
    library : ForceLibrary
        The forces of the coefficients, for simulated motions.
    shapes : Mapping of str to float
        Shape parameters of these forces.
    wandering : tuple of str
        Groups of equations from which a random force is estimated.
    curve : {"half-sines", "analytic-signal"}
        Curve that gives the extrema.
    rule : Rule
        Rule of least squares (see `solve`).
    names : tuple of str
        Names of the first parameters, for errors.
    curves : tuple of arrays of int
        Parameters of each smooth curve, which are penalised (see `solve_curves`).
    means : callable, optional
        Function from coefficients and frequency to the parameters of the curves; zero for the others.
    """

    equations: Mapping[str, half_periods.Equations]
    values_of: Callable[[Array], Array]
    library: ForceLibrary
    shapes: Mapping[str, float] = field(default_factory=dict)
    wandering: tuple[str, ...] = ("envelope",)
    curve: EnvelopeCurve = "half-sines"
    rule: half_periods.Rule = "weighted"
    names: tuple[str, ...] = ()
    curves: tuple[Index, ...] = ()
    means: Callable[[Array], Array] | None = None

    def measure(self, decay: xr.Dataset) -> xr.Dataset:
        """Measure the envelope of a decay (see `envelope`); attributes: the method and `first_time` (s)."""
        attrs = {"first_time": float(decay.time.values[0]), "curve": self.curve}
        return envelope(decay, self.curve).assign_attrs(attrs)

    def fit(self, measured: Sequence[xr.Dataset]) -> Groups:
        """Fit each group by least squares to the envelopes of all runs."""
        if self.curves:
            return {
                name: half_periods.solve_curves(of_group, measured, self.names, self.curves)
                for name, of_group in self.equations.items()
            }
        return {
            name: half_periods.solve(of_group, measured, self.rule, self.names)
            for name, of_group in self.equations.items()
        }

    def fit_simulated(self, simulated: Sequence[xr.Dataset], values: Array, first: Groups) -> Groups:
        """Fit the envelopes of simulated motions in the same way as those of the records.

        Parameters
        ----------
        simulated : sequence of Dataset
            Envelopes of the simulated motions.
        values : (value,) array of float
            Coefficients and frequency of the model.
        first : Groups
            The fit of the records, whose smoothness of curves is kept. The penalty is centred at the curves
            of the model: the shrinkage of a record's curves towards zero is not a bias of averaging.
        """
        if not self.curves or self.means is None:
            return self.fit(simulated)
        means = self.means(values)
        fits = {}
        for name, of_group in self.equations.items():
            precision = first[name].precision
            penalty = None if precision is None else half_periods.Penalty(precision, means)
            fits[name] = half_periods.solve_curves(of_group, simulated, self.names, self.curves, penalty)
        return fits

    def values(self, groups: Groups) -> Array:
        """Return coefficients and, last, the frequency (rad/s)."""
        return self.values_of(np.concatenate([group.parameters for group in groups.values()]))

    def covariance(self, groups: Groups, ratios: Mapping[str, float]) -> Array:
        """Return the covariance of the values, with each group's errors multiplied by its Birge ratio."""
        parameters = np.concatenate([group.parameters for group in groups.values()])
        # The groups have the errors of the half periods in common.
        influence = np.concatenate(
            [max(1.0, ratios[name]) * group.influence for name, group in groups.items()]
        )
        by_error = jacobian(self.values_of, parameters, np.linalg.norm(influence, axis=1)) @ influence
        return np.asarray(by_error @ by_error.T)

    def influence(
        self, groups: Groups, measured: Sequence[xr.Dataset], decays: Sequence[xr.Dataset]
    ) -> list[Array]:
        """Compute the effect of each sample on the values, without bias correction: (value, sample) per run.

        Parameters
        ----------
        groups : mapping of str to EquationSolution
            The fit to the envelopes.
        measured : sequence of Dataset
            The envelopes, from half-sines.
        decays : sequence of Dataset
            The decays of these envelopes.
        """
        parameters = np.concatenate([group.parameters for group in groups.values()])
        of_errors = np.concatenate([group.influence for group in groups.values()])
        of_errors = jacobian(self.values_of, parameters, np.linalg.norm(of_errors, axis=1)) @ of_errors
        by_sample, begin = [], 0
        for envelope_of_run, decay in zip(measured, decays, strict=True):
            errors = half_periods.errors_of_half_periods(envelope_of_run)
            of_run = of_errors[:, begin : begin + len(errors)] / errors
            responses = sample_responses(decay, envelope_of_run.extremum_time.values)
            by_sample.append(np.asarray(of_run @ responses))
            impulses = IMPULSES * (envelope_of_run.sizes["half_period"] + 1)
            begin += len(errors) + impulses * (half_periods.DENSITY in envelope_of_run)
        return by_sample

    def model(self, values: Array) -> Model:
        """Return the model of coefficients and, last, the frequency (rad/s)."""
        coefficients = dict(zip(self.library.symbols, values[:-1].tolist(), strict=True))
        return Model(self.library, coefficients, float(values[-1]), self.shapes)


def birge_ratios(groups: Groups) -> dict[str, float]:
    """Return the root of the reduced chi-square of each group, and of all under an empty name."""
    every = list(groups.values())
    whole = birge_ratio(sum(g.chi_square for g in every), sum(g.degrees_of_freedom for g in every))
    of_groups = {name: birge_ratio(g.chi_square, g.degrees_of_freedom) for name, g in groups.items()}
    return {"": whole} | of_groups


def with_noises(measured: xr.Dataset, noise: float, density: float) -> xr.Dataset:
    """Return an envelope with the errors due to white sensor noise and, if any, a random force.

    Parameters
    ----------
    measured : Dataset
        The envelope (see `AuxiliaryModel.measure`).
    noise : float
        Standard deviation of a sample, in the unit of the decay.
    density : float
        Density of the random force, (rad/s^2)^2/Hz.
    """
    return _at_noise(measured, noise).assign({half_periods.DENSITY: density} if density else {})


def with_random_force(measured: xr.Dataset, ratio: VarianceRatio) -> xr.Dataset:
    """Return an envelope with the errors due to the sensor's noise and a random force.

    Parameters
    ----------
    measured : Dataset
        The envelope (see `AuxiliaryModel.measure`).
    ratio : VarianceRatio
        Result of `random_force_ratio`.
    """
    density = RandomForce.density_of(ratio.ratio * ratio.variance, swing_frequency(measured))
    return with_noises(measured, float(np.sqrt(ratio.variance)), density)


def swing_frequency(measured: xr.Dataset) -> float:
    """Return the median frequency of an envelope (rad/s), to which the unit of the ratio refers."""
    return float(np.median(measured.frequency.values))


def _at_noise(measured: xr.Dataset, noise: float) -> xr.Dataset:
    """Return the envelope with errors due to white sensor noise, without the scatter of a random force."""
    white = max(measured.white_noise.item(), float(np.finfo(float).tiny))
    scatters = [measured.attrs[name] for name in ("scatter_of_extrema", "scatter_of_times")]
    pairs = zip(half_periods.ENVELOPE_ERRORS, scatters, strict=True)
    return measured.assign({name: measured[name] * (noise / white / scatter) for name, scatter in pairs})


def amplitude_p_value(groups: Sequence[half_periods.HalfPeriodEquations], measured: xr.Dataset) -> float:
    """Test whether the residual of equations depends on the amplitude, unlike a random force.

    Parameters
    ----------
    groups : sequence of HalfPeriodEquations
        Equations of one run: the rate of the amplitude and the frequency at each instant.
    measured : Dataset
        Their envelope.

    Returns
    -------
    float
        P-value of polynomials of `DEGREES` in the amplitude, in both equations; 1 if there are too few
        instants.

    Notes
    -----
    This is a score test (Rao 1948): it uses the fit without these columns, with the noise of the sensor and
    the most likely random force with these columns.
    """
    w = swing_frequency(measured)
    table, noise, gram = _table_of(groups, measured)
    # A motion that ends early has no equations at the last instants.
    amplitude = measured.amplitude.values[: len(table) // 2]
    if len(amplitude) < TESTED_INSTANTS:
        return 1.0
    low, high = amplitude.min(), amplitude.max()
    powers = legendre.legvander((2.0 * amplitude - low - high) / (high - low), DEGREES)
    # For each instant: first the rate of the amplitude, then the frequency.
    further = np.zeros((len(amplitude), 2, 2 * (DEGREES + 1)))
    further[:, 0, : DEGREES + 1] = amplitude[:, None] * powers
    further[:, 1, DEGREES + 1 :] = powers
    columns = further.reshape(len(table), -1)
    alternative = rows_by_ratio(noise, gram, np.column_stack([table[:, :-1], columns, table[:, -1]]))
    times = measured.extremum_time.values
    ratio = variance_ratio(alternative, w * float(times[-1] - times[0]), 0.1)
    white = alternative(ratio.ratio)
    count = table.shape[1] - 1
    designs = white.design[:, :count], white.design
    without, residual = (_unexplained(white.target, design) for design in designs)
    degrees_of_freedom = len(table) - count - columns.shape[1]
    if degrees_of_freedom < 1 or residual <= 0.0:
        return 1.0
    statistic = (without - residual) / columns.shape[1] / (residual / degrees_of_freedom)
    return float(scipy.stats.f.sf(statistic, columns.shape[1], degrees_of_freedom))


def _unexplained(target: Array, design: Array) -> float:
    """Return the sum of the squared residuals of a target on columns."""
    size = np.linalg.norm(design, axis=0)
    scaled = design / np.where(size > 0.0, size, 1.0)
    residual = target - scaled @ np.linalg.lstsq(scaled, target, rcond=1e-10)[0]
    return float(residual @ residual)


def _table_of(
    groups: Sequence[half_periods.HalfPeriodEquations], measured: xr.Dataset
) -> tuple[Array, Array, Array]:
    """Return columns and residual of equations, and their covariances due to unit noise and a random force.

    Both covariances are (band, row); the random force has unit size per unit of tau.
    """
    w, white = swing_frequency(measured), _at_noise(measured, 1.0)
    order = np.argsort(np.concatenate([group.first for group in groups]), kind="stable")
    sensor = sp.vstack([group.noise(white) for group in groups]).tocsr()[order]
    impulses = sp.vstack([group.impulses(white) for group in groups]).tocsr()[order]
    noise, gram = (covariance_band(part) for part in (sensor, impulses))
    design = sp.block_diag([group.design for group in groups]).toarray()
    table = np.column_stack([design, np.concatenate([group.residual for group in groups])])[order]
    return table, noise, RandomForce.density_of(1.0, w) * gram


def random_force_ratio(
    groups: Sequence[half_periods.HalfPeriodEquations], measured: xr.Dataset, option: RandomForceOption
) -> VarianceRatio:
    """Return a run's ratio of random force to sensor noise, by the restricted likelihood of its equations.

    Parameters
    ----------
    groups : sequence of HalfPeriodEquations
        Groups with separate parameters, over the same half periods.
    measured : Dataset
        Envelope of these half periods.
    option : "auto" or float, (rad/s^2)^2/Hz
        A number is the one-sided density, which is fixed.

    Returns
    -------
    VarianceRatio
        Ratio of the growth of the variance of v per unit of tau to the variance of the sensor's noise
        (rad^2).
    """
    w = swing_frequency(measured)
    table, noise, gram = _table_of(groups, measured)
    # Waves or a moving camera displace extrema more than white noise does; nothing displaces them less. A few
    # half periods may seem less noisy by chance, and a random force would then absorb the difference.
    rows = rows_by_ratio(noise, gram, table, least_variance=measured.white_noise.item() ** 2)
    if not isinstance(option, str):
        return held_ratio(rows, RandomForce(float(option)).per_tau(w), None)
    times = measured.extremum_time.values
    # Time in units of tau: the largest impulses tried hide the sensor's noise within this time.
    return variance_ratio(rows, w * float(times[-1] - times[0]), 0.1)
