"""The start of a search: the model that is given, fitted beside both noises."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.fitted_model import FittedModel
from sysid_trib.discrepancy.likelihood import Likelihood, likelihood
from sysid_trib.discrepancy.model_fit import fit_model
from sysid_trib.discrepancy.paths import RecordPath, path_of
from sysid_trib.discrepancy.reference import refitted
from sysid_trib.discrepancy.settings import DEFAULTS, Settings
from sysid_trib.discrepancy.trials import TrialEffect
from sysid_trib.errors import LibraryError
from sysid_trib.forces.force import Force
from sysid_trib.noise.autoregression import fractional_difference
from sysid_trib.noise.colour import MAX_COLOUR, colour_above, most_likely_colour, of_order
from sysid_trib.noise.level import swing_frequency
from sysid_trib.noise.residual_noise import NoiseModel
from sysid_trib.noise.smoothing import KNOTS_PER_PERIOD, smooth
from sysid_trib.regression.weak_form import coloured

# Harmonics that the spline of a path follows, at least in part.
ABOVE = 0.5 * KNOTS_PER_PERIOD + 2.0
# The d of 1/f noise, and the periods over which it is followed: the zero takes a part of what is slower.
FLICKER, FLICKER_PERIODS = 0.5, 2.0
# Partial autocorrelation at which the deviance is computed for its slope where there is none.
LITTLE_COLOUR = 0.05


def fit_start_model(
    runs: Sequence[xr.Dataset],
    forces: Sequence[Force],
    frequency: float | None,
    settings: Settings = DEFAULTS,
) -> FittedModel:
    """Fit the start model beside both noises of each run.

    Parameters
    ----------
    runs : sequence of Dataset
        With `angle(time)`.
    forces : sequence of Force
    frequency : float or None, rad/s
        The reference frequency, held; None has it fitted.
    settings : Settings

    Raises
    ------
    LibraryError
        A force has no values along the motion.
    """
    nominal = frequency or float(np.median([swing_frequency(run) for run in runs]))
    paths = [_first_path(run, nominal, settings) for run in runs]
    trials = [TrialEffect(force, default_shapes(force)) for force in forces]
    model = fit_model(paths, trials, frequency_free=frequency is None)
    if not np.isfinite(model.deviance):
        symbols = ", ".join(model.without_values)
        raise LibraryError(
            f"The start model cannot be computed along this record ({symbols}): a force or its slope is not "
            "finite there; leave it out."
        )
    return refitted(model)


def recoloured(model: FittedModel) -> FittedModel:
    """The model beside noise of the sensor of the colour that makes its rows likeliest.

    Where samples of a period are few, or the noise as 1/f, the spectrum above what a path follows does not
    tell it. Autoregressions and 1/f noise, which has one parameter, are compared by the Bayesian
    information criterion.
    """
    return beside_noises(model, [_likeliest_sensor(model, run) for run in range(len(model.rows))])


def beside_noises(model: FittedModel, sensors: Sequence[NoiseModel]) -> FittedModel:
    """The model fitted beside other noises of the sensor, one of each run."""
    paths = [replace(rows.path, sensor=sensor) for rows, sensor in zip(model.rows, sensors, strict=True)]
    first = np.append(model.coefficients, model.stiffness)
    return refitted(fit_model(paths, model.trials, frequency_free=model.frequency_free, first=first))


def _likeliest_sensor(model: FittedModel, run: int) -> NoiseModel:
    """Noise of a run of the likeliest colour, of the order that its rows ask for."""
    rows, table = model.rows[run], model.tables[run]
    # Of a level that another colour gave nothing is known.
    settings, columns = replace(model.settings, level_rows=0.0), range(1, 1 + table.shape[1])

    def likelihood_of(filter_: Array) -> Likelihood:
        acting = coloured(rows.operator, filter_)
        coloured_rows = replace(rows, path=replace(rows.path, settings=settings), acting=acting)
        return likelihood([coloured_rows.products(table)], columns)

    samples, best, filter_ = len(rows.path.time), np.inf, np.ones(1)
    # Most noise is white, and its spectrum says so: then a little colour is tried before a search.
    shown = len(rows.path.sensor.filter_) > 1
    shown = shown or gain_of_little_colour(lambda at: likelihood_of(at).deviance) > np.log(samples)
    for order in range(MAX_COLOUR + 1 if shown else 1):
        starts = [of_order(known, order) for known in (np.ones(1), filter_, rows.path.sensor.filter_)]
        tried, deviance = most_likely_colour(
            lambda at: likelihood_of(at).deviance, starts, samples=float(rows.path.form.rows)
        )
        if deviance + order * np.log(samples) < best:
            best, filter_ = deviance + order * float(np.log(samples)), tried
    if shown and likelihood_of(flicker := _flicker_filter(rows.path)).deviance + np.log(samples) < best:
        filter_ = flicker
    return NoiseModel(float(np.sqrt(likelihood_of(filter_).variances[0])), filter_)


def _flicker_filter(path: RecordPath) -> Array:
    """Whitening filter of 1/f noise, (tap,)."""
    per_period = 2.0 * np.pi / float(np.median(np.diff(path.form.tau)))
    return fractional_difference(FLICKER, max(2 + MAX_COLOUR, round(FLICKER_PERIODS * per_period)))


def gain_of_little_colour(deviance: Callable[[Array], float]) -> float:
    """By how much the deviance of white noise would fall by the partial autocorrelation that shows most.

    By its slope and its bend where there is none (Rao's score test).
    `deviance` : of a whitening filter, (tap,).
    """
    white, gains = deviance(np.ones(1)), []
    for lag in range(1, MAX_COLOUR + 1):
        down, up = (deviance(np.append(np.eye(1, lag)[0], side)) for side in (LITTLE_COLOUR, -LITTLE_COLOUR))
        slope, bend = up - down, up - 2.0 * white + down
        gains.append(slope**2 / (8.0 * bend) if bend > 0.0 else np.inf)
    return max(gains)


def colour_penalty(model: FittedModel) -> float:
    """What the colours of a model's noise cost beside its deviance (Bayesian information criterion)."""
    return float(sum(_parameters_of(rows.path.sensor) * np.log(len(rows.path.time)) for rows in model.rows))


def _parameters_of(sensor: NoiseModel) -> int:
    """Of its colour: a filter that is longer than any autoregression's is that of 1/f noise, with one."""
    order = len(sensor.filter_) - 1
    return order if order <= MAX_COLOUR else 1


def _first_path(run: xr.Dataset, frequency: float, settings: Settings) -> RecordPath:
    """A run as a path, with the noise of its sensor: by the spectrum above what the path follows."""
    time, angle = run.time.values.astype(float), run.angle.values.astype(float)
    tau = frequency * (time - time[0])
    sensor = colour_above(angle - smooth(tau, angle).x, tau, ABOVE)
    return path_of(time, angle, frequency, sensor, settings=settings)


def default_shapes(force: Force) -> dict[str, float]:
    """Shape parameters of a force by their names, `dahl.s`."""
    return {f"{force.symbol}.{name}": shape.default for name, shape in force.shape.items()}
