"""Rows of a run about its path, with as many samples as needed: their columns and both noises."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy
import scipy.sparse as sp
import xarray as xr
from scipy.sparse.linalg import spsolve

from sysid_trib.arrays import Array
from sysid_trib.discovery.engine.likelihood import Likelihood
from sysid_trib.discovery.engine.paths import RecordPath
from sysid_trib.discovery.engine.run_products import RunProducts, products_of, tried_ratios, unresolved
from sysid_trib.discovery.engine.trials import DEFAULTS, TrialEffect
from sysid_trib.likelihood.sensor_noise import covariance_band
from sysid_trib.likelihood.weak_form import cholesky_factor, coloured, log_determinant, whiten
from sysid_trib.records import equilibrium, sensor, signal, smoothing

# Least number of samples kept per period for a sensor with coarse steps.
FEWEST_PER_PERIOD = 10
# Least slope of the sensor's reading with the angle.
LEAST_SENSOR_GAIN = 0.05
# Variance of rows without information, over the largest variance due to the sensor's noise.
SAYS_NOTHING = 1e8


def decimated(decay: xr.Dataset, per_period: int = DEFAULTS.samples_per_period) -> xr.Dataset:
    """Return the decay with about `per_period` samples a period, each from a parabola through its neighbours.

    A parabola over a sixtieth of a period follows the swing to a part in a million (Savitzky and Golay 1964).
    No sample enters two parabolas, so white noise stays white, and its level decreases. For a sensor with
    coarse steps, single samples are kept, so far apart that most neighbours differ by a step: then the
    rounding is white. Attributes of the result: `decimated`, in words, and `decimation`, the ratio of the
    numbers of samples.
    """
    time, angle, halves = equilibrium.with_half_periods(decay)
    period = 2.0 * np.median(halves.duration) / np.median(np.diff(time))
    apart = _apart_for_rounding(angle, sensor.coarse_step(decay, smoothing.sensor_noise(decay)))
    factor = max(int(period / per_period), min(apart, int(period / FEWEST_PER_PERIOD)))
    if factor < 2:
        return decay
    width = factor if factor % 2 else factor - 1
    smoothed = not apart and width >= 3 and signal.is_uniform(time)
    if smoothed:
        angle = scipy.signal.savgol_filter(angle, width, 2)
    kept = slice(factor // 2, None, factor)
    # Keep properties of the whole decay, such as its equilibrium.
    fewer = decay.drop_dims("time").assign_coords(time=("time", time[kept], decay.time.attrs))
    fewer = fewer.assign(angle=("time", angle[kept], decay.angle.attrs))
    how = "parabolas" if smoothed else "single samples"
    said = f"{len(time)} samples to {fewer.sizes['time']}, by {how}"
    return fewer.assign_attrs(decimated=said, decimation=len(time) / fewer.sizes["time"])


def _apart_for_rounding(angle: Array, step: float) -> int:
    """Return the distance (samples) over which most values differ by a coarse sensor step; 0 if fine."""
    if not step:
        return 0
    apart = 1
    while apart < len(angle) // 2 and np.median(np.abs(angle[apart:] - angle[:-apart])) < step:
        apart += 1
    return apart


@dataclass(frozen=True)
class RunRows:
    """Rows of a run about its path, with their noise.

    Attributes
    ----------
    path : RecordPath
    operator, acting : (row, sample) sparse array of float
        Operators of small deviations of the record: on the sensor's noise, and on the innovations of this
        noise.
    gain : (sample,) array of float
        Slope of the record by the angle, as the operator has it.
    """

    path: RecordPath
    operator: sp.csr_matrix
    acting: sp.csr_matrix
    gain: Array

    @cached_property
    def band(self) -> Array:
        """Covariance of the rows due to innovations of the sensor's noise, of unit size."""
        return self._sensor_band(self.acting)

    @cached_property
    def white_band(self) -> Array:
        """Covariance band due to white noise of the sensor, of unit size."""
        return self.band if self.acting is self.operator else self._sensor_band(self.operator)

    def _sensor_band(self, operator: sp.csr_matrix) -> Array:
        band = covariance_band(operator)
        band[0] += SAYS_NOTHING * band[0].max() * self.path.sticking
        return band

    @cached_property
    def target(self) -> Array:
        """Target of the regression, (row,)."""
        return -(self.operator @ (self.path.angle - self.path.at_samples[0])) - self.path.known_part

    def columns(self, trials: Sequence[TrialEffect]) -> Array:
        """Return the column of each trial, (row, trial)."""
        return self.path.columns(trials, self.operator)

    def coarse_columns(self, trials: Sequence[TrialEffect]) -> Array:
        """Return columns of trials from a fifth of the points, for comparisons."""
        settings = self.path.settings
        # Do not cache this: for a long record it takes tens of MB per model.
        fewer = replace(settings, points_per_period=settings.points_per_period // 5)
        return replace(self.path, settings=fewer).columns(trials, self.operator)

    def products(
        self, columns: Array, near: float | None = None, *, colour: Array | None = None
    ) -> RunProducts:
        """Return the products of the target and columns, (row, column), for ratios of both noises.

        Parameters
        ----------
        columns : (row, column) array of float
        near : float, optional
            A likely ratio, about which ratios are tried. With 0 the grid over the whole span is coarse;
            without it the grid is fine.
        colour : (tap,) array of float, optional
            Whitening filter of the sensor's noise instead of the path's; its level is then unknown.
        """
        path, table = self.path, np.column_stack([self.target, columns])
        band, level_rows = self.band, path.settings.level_rows
        if colour is not None:
            band = self._sensor_band(coloured(self.operator, colour, has_past=True))
            level_rows = 0.0
        ratios = tried_ratios(path.form.tau, path.settings.ratio_step, near)
        products, determinants = products_of(band, path.form.gram, table, ratios)
        white = (
            determinants[0] if band is self.white_band else log_determinant(cholesky_factor(self.white_band))
        )
        said = int(np.sum(~path.sticking))
        return RunProducts(products, determinants - white, ratios, said, path.sensor.innovation, level_rows)

    def factor(self, ratio: float) -> Array:
        """Return the Cholesky factor of the rows' covariance, in units of the sensor noise's variance."""
        return cholesky_factor(self.band, self.path.form.gram, ratio)

    def whitened(self, table: Array, likelihood: Likelihood, run: int) -> Array:
        """Return columns (row, column) in which the noises of a run are white and of unit variance."""
        return whiten(self.factor(float(likelihood.ratios[run])), table) / np.sqrt(likelihood.variances[run])

    def unresolved(self, tangent: tuple[Array, Array], ratio: float) -> float:
        """Return the deficit of the deviance with a random force, if the rows do not resolve a stiffness.

        It is the whole excess of the noise's determinant if the random force is much larger than the noise,
        and zero without a random force.
        """
        excess = unresolved(self.path.form, self.path.points[0], *tangent, self.path.operator(tangent))
        noise, both = (log_determinant(self.factor(q)) for q in (0.0, ratio))
        return excess * (both - noise) / (both - noise + excess) if excess else 0.0

    def smoothed_motion(
        self, residual: Array, errors: Array, slopes: tuple[Array, Array], ratio: float, part: float = 1.0
    ) -> Array:
        """Return the most likely motion at the samples, (sample,), or a motion a fraction of the way to it.

        Parameters
        ----------
        residual : (row,) array of float
            Residual of the rows.
        errors : (sample,) array of float, rad
            Errors of the sensor, its zero among them.
        slopes : pair of (sample,) array of float
            Derivatives of these errors by the angle and by its rate.
        ratio : float
            Ratio of the random force to the noise of the sensor.
        part : float

        Notes
        -----
        The motion is the spline about the path that minimises the sum of squares of sensor innovations and
        random force. Without a random force, its rows are constraints, and the motion is a free motion of the
        model. The multipliers of the rows in this saddle point are the random force over its covariance.
        """
        unexplained = self.path.angle - errors - self.path.at_samples[0]
        at_rest = residual + self.operator @ unexplained
        step = self._most_likely(self._whitening @ unexplained, at_rest, slopes, ratio)
        return np.asarray(self.path.at_samples[0] + part * step)

    def possible_deviation(
        self, deviation: float, slopes: tuple[Array, Array], ratio: float, random: np.random.Generator
    ) -> Array:
        """Draw a random deviation from the most likely motion, (sample,), rad, with the motion's uncertainty.

        Parameters
        ----------
        deviation : float, rad
            Standard deviation of the sensor's innovations.
        slopes, ratio
            As in `smoothed_motion`.
        random : Generator

        Notes
        -----
        The most likely motion for randomly drawn noises has the covariance of the motion's uncertainty
        (Papandreou, Yuille 2010).
        """
        innovations = random.standard_normal(len(self.path.time))
        force = np.zeros(self.path.form.rows)
        if ratio:
            lower = cholesky_factor(np.zeros_like(self.band), self.path.form.gram, ratio)
            force = _banded(lower, len(force)) @ random.standard_normal(len(force))
        return deviation * self._most_likely(innovations, force, slopes, ratio)

    @cached_property
    def _whitening(self) -> sp.dia_array:
        count = len(self.path.time)
        # The filter of a whole record may be longer than a section of the record.
        return _banded(self.path.sensor.filter_[:count], count)

    def _most_likely(
        self, innovations: Array, force: Array, slopes: tuple[Array, Array], ratio: float
    ) -> Array:
        """Return the most likely spline at the samples for innovations (sample,) and forces (row,)."""
        splines = self.path.form.splines
        basis = seen = splines.design()
        if np.any(slopes):
            seen = basis + sp.diags_array(slopes[0]) @ basis + sp.diags_array(slopes[1]) @ splines.design(1)
        white = (self._whitening @ seen).tocsr() if len(self.path.sensor.filter_) > 1 else seen
        felt = self.operator @ (sp.diags_array(self.gain) @ basis if np.any(self.gain != 1.0) else basis)
        lower = _banded(self.path.form.gram, len(force))
        # The largest value of the band belongs to a row without information.
        reactions = sp.diags_array(self.band[0].max() * self.path.sticking)
        covariance = ratio * (lower + sp.tril(lower, -1).T) + reactions
        system = sp.block_array([[white.T @ white, felt.T], [felt, -covariance]], format="csc")
        right = np.concatenate([white.T @ innovations, force])
        return np.asarray(basis @ spsolve(system, right)[: basis.shape[1]])


def _banded(diagonals: Array, count: int) -> sp.dia_array:
    """Return a lower triangular band from its diagonals, each given by one value or by many."""
    return sp.diags_array(diagonals, offsets=-np.arange(len(diagonals)), shape=(count, count))


def run_rows(path: RecordPath, trials: Sequence[TrialEffect], guess: Array) -> RunRows:
    """Return the rows of a run with a model whose coefficients and stiffness are `guess`, (trial + 1,)."""
    *coefficients, stiffness = guess.tolist()
    model = list(zip(trials, coefficients, strict=True))
    operator = path.operator(path.tangent(model, stiffness))
    # A reading that decreases while the angle rises is impossible; a fit may pass through such values.
    gain = np.maximum(1.0 + path.sensor_slopes(model)[0], LEAST_SENSOR_GAIN)
    # A motion deviates by less than the record where errors of the sensor grow with the angle.
    if np.any(gain != 1.0):
        operator = (operator @ sp.diags_array(1.0 / gain)).tocsr()
    return RunRows(path, operator, coloured(operator, path.sensor.filter_, has_past=True), gain)
