"""Start of a search: the given model, fitted with both noises at its own frequency."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.discovery.engine import likelihood, model_fit
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.paths import RecordPath, Terms
from sysid_trib.discovery.engine.trials import DEFAULTS, Settings, TrialEffect, reference_power
from sysid_trib.errors import LibraryError
from sysid_trib.forces.force import Channel, Force
from sysid_trib.likelihood import colour, sensor_noise, weak_form
from sysid_trib.likelihood.integrated_noise import integrated_noise
from sysid_trib.records import signal, smoothing
from sysid_trib.records.inputs import inputs_of, values_of_inputs

# Fraction of its standard error by which a frequency may differ from the reference, and most rescalings.
SAME_REFERENCE, RESCALINGS = 0.02, 4
# Largest factor between two references. A model with a lower frequency, or with none because forces of the
# motion provide the stiffness, keeps the reference.
MOST_RESCALED = 2.0


def refitted(model: FittedModel, paths: Sequence[RecordPath] | None = None) -> FittedModel:
    """Return the model fitted again, with its frequency as the reference.

    `paths` : their frequency is the model's; by default the paths of the model.
    """
    near = [rows.path for rows in model.rows] if paths is None else paths
    for _ in range(RESCALINGS):
        squared = 1.0 + model.stiffness
        oscillates = squared >= 1.0 / MOST_RESCALED**2
        factor = min(float(np.sqrt(squared)), MOST_RESCALED) if oscillates else 1.0
        # Keep the forces themselves unchanged; otherwise a narrow resonance would move.
        powers = np.array([reference_power(trial.force) for trial in model.trials])
        first = np.append(model.coefficients * factor**powers, 0.0 if oscillates else model.stiffness)
        rescaled = [path.rescaled(path.frequency * factor) for path in near]
        trials = [trial.referred(factor) for trial in model.trials]
        after = model_fit.fit_model(rescaled, trials, first)
        if paths is None and after.likelihood.deviance > model.likelihood.deviance + model.settings.far:
            # Poorly determined shapes may lead the fit to a worse maximum: then keep the path at which they
            # were found.
            after = model_fit.fitted_along(rescaled, trials, first)
        model = after
        same = model.settled and abs(model.stiffness) <= SAME_REFERENCE * model.stiffness_error
        if same or not oscillates:
            break
        near = [rows.path for rows in model.rows]
    return model


# Number of harmonics that the spline of a path follows at least in part.
ABOVE = 0.5 * smoothing.KNOTS_PER_PERIOD + 2.0
# Differencing order d of 1/f noise, and the number of periods over which it is followed; the zero takes part
# of the slower noise.
FLICKER, FLICKER_PERIODS = 0.5, 2.0
# Step of a partial autocorrelation for the slope of the deviance.
LITTLE_COLOUR = 0.05
# Largest difference, in standard deviations of the sensor's noise, between the rates of a motion and of the
# surface to which it sticks (rad).
STICKING_ERRORS = 3.0
# Least acceleration (by tau) of a motion that crosses the rate of a surface, over the motion's RMS rate.
PASSING = 0.2


def fit_start_model(
    runs: Sequence[xr.Dataset],
    forces: Sequence[Force],
    frequency: float | None,
    settings: Settings = DEFAULTS,
    held: Terms = (),
    pasts: Sequence[tuple[float, xr.Dataset | None]] = (),
) -> FittedModel:
    """Fit the start model with both noises of each run.

    Parameters
    ----------
    runs : sequence of Dataset
        Runs with `angle(time)`.
    forces : sequence of Force
    frequency : float or None, rad/s
        The reference frequency, which is fixed; with None it is fitted.
    settings : Settings
    held : Terms
        Forces that are always present, with their coefficients.
    pasts : sequence of (float, Dataset or None)
        For each run: the time (s) from which the `t` of formulas counts, and the record up to and including
        the run's first sample, or None. Without this argument `t` counts from the first sample.

    Raises
    ------
    LibraryError
        A force has no values along the motion.
    """
    nominal = frequency or smoothing.first_frequency(runs)
    paths = [
        replace(_first_path(run, nominal, settings), held=held, frequency_free=frequency is None)
        for run in runs
    ]
    for at, (origin, before) in enumerate(pasts):
        earlier = None if before is None else path_like(paths[at], before, nominal, origin)
        paths[at] = replace(paths[at], origin=origin, before=earlier)
    trials = [TrialEffect(force, default_shapes(force), added=False) for force in forces]
    model = model_fit.fit_model(paths, trials)
    if not (model.is_finite and np.isfinite(model.deviance)):
        symbols = ", ".join(model.without_values)
        raise LibraryError(
            f"The start model cannot be computed along this record ({symbols}): a force or its slope is not "
            "finite there; leave it out."
        )
    return refitted(model)


def recoloured(model: FittedModel, other: FittedModel | None = None) -> FittedModel:
    """Return the model with the sensor's noise of the most likely colour.

    If there are few samples per period, or the noise is 1/f noise, the spectrum above the band of the path
    does not determine the colour. Autoregressions and 1/f noise, which has one parameter, are compared by the
    Bayesian information criterion. If `other`, a model of the same runs, fits better, a relative accuracy of
    the distance to its deviance is enough.
    """
    sensors = [_likeliest_sensor(model, run, other) for run in range(len(model.rows))]
    known = [rows.path.sensor for rows in model.rows]
    same = all(np.array_equal(a.filter_, b.filter_) for a, b in zip(sensors, known, strict=True))
    return model if same else with_sensor_noises(model, sensors)


def with_sensor_noises(model: FittedModel, sensors: Sequence[sensor_noise.NoiseModel]) -> FittedModel:
    """Return the model fitted with another noise of the sensor in each run."""
    paths = [replace(rows.path, sensor=sensor) for rows, sensor in zip(model.rows, sensors, strict=True)]
    return refitted(model_fit.fit_model(paths, model.trials, model.estimate))


def _likeliest_sensor(model: FittedModel, run: int, other: FittedModel | None) -> sensor_noise.NoiseModel:
    """Return a run's sensor noise of the most likely colour, of the order that its rows require."""
    path = model.rows[run].path
    known, samples = path.sensor.filter_, len(path.time)
    by_colour = _likelihood_by_colour(model, run)

    def deviance_of(filter_: Array) -> float:
        return by_colour(filter_).deviance

    least = (
        _likelihood_by_colour(other, run)(other.rows[run].path.sensor.filter_).deviance if other else np.inf
    )
    best, filter_ = deviance_of(known) + _parameters_of(path.sensor) * float(np.log(samples)), known
    # The spectrum usually gives the colour: search only if a small change of the colour gains enough.
    if gain_of_little_colour(deviance_of, known) > np.log(samples):
        best = np.inf
        for order in range(colour.MAX_COLOUR + 1):
            starts = [sensor_noise.of_order(start, order) for start in (np.ones(1), filter_, known)]
            tried, deviance = colour.most_likely_colour(
                deviance_of, starts, samples=float(path.form.rows), least=least
            )
            score = deviance + order * float(np.log(samples))
            if score < best:
                best, filter_ = score, tried
            elif order >= len(known):
                break
    # 1/f noise needs fewer parameters, and may be more likely than every autoregression.
    if deviance_of(flicker := _flicker_filter(path)) + np.log(samples) < best:
        filter_ = flicker
    return sensor_noise.NoiseModel(float(np.sqrt(by_colour(filter_).variances[0])), filter_)


def _likelihood_by_colour(model: FittedModel, run: int) -> Callable[[Array], likelihood.Likelihood]:
    """Return the function that gives the maximum likelihood of a run for a whitening filter (tap,)."""
    columns, near = range(1, 1 + model.columns), model.likelihood.ratios[[run]]

    def by_filter(filter_: Array) -> likelihood.Likelihood:
        of_colour = partial(model.rows[run].products, model.tables[run], colour=filter_)
        _, likeliest = likelihood.likeliest_near([of_colour], near.tolist(), columns)
        # The next colour is close to this one, and its ratio to this ratio.
        near[:] = likeliest.ratios
        return likeliest

    return by_filter


def _flicker_filter(path: RecordPath) -> Array:
    """Return the whitening filter of 1/f noise, (tap,): the coefficients of (1 - B)^d (Hosking 1981)."""
    per_period = 2.0 * np.pi / float(np.median(np.diff(path.form.tau)))
    k = np.arange(1, max(2 + colour.MAX_COLOUR, round(FLICKER_PERIODS * per_period)))
    return np.concatenate([[1.0], np.cumprod((k - 1.0 - FLICKER) / k)])


def gain_of_little_colour(deviance: Callable[[Array], float], filter_: Array) -> float:
    """Return the largest decrease of the deviance by a small partial autocorrelation, to second order.

    It follows from slope and curvature of the deviance (Rao's score test).

    `deviance` : deviance for a whitening filter, (tap,).
    """
    filter_ = sensor_noise.of_order(filter_, colour.MAX_COLOUR)
    here, gains = deviance(filter_), []
    correlations = sensor_noise.partial_autocorrelations(filter_)
    for step in np.diag(np.minimum(LITTLE_COLOUR, 0.5 * (1.0 - np.abs(correlations)))):
        sides = (sensor_noise.filter_of(correlations + side * step) for side in (-1.0, 1.0))
        below, above = map(deviance, sides)
        slope, bend = above - below, above - 2.0 * here + below
        gains.append(slope**2 / (8.0 * bend) if bend > 0.0 else np.inf)
    return max(gains)


def colour_penalty(model: FittedModel) -> float:
    """Return the penalty of the colours of a model's noise (Bayesian information criterion)."""
    return float(sum(_parameters_of(rows.path.sensor) * np.log(len(rows.path.time)) for rows in model.rows))


def _parameters_of(sensor: sensor_noise.NoiseModel) -> int:
    """Return the number of parameters of a colour: 1 for 1/f noise, which has a long filter."""
    order = len(sensor.filter_) - 1
    return order if order <= colour.MAX_COLOUR else 1


def _first_path(run: xr.Dataset, frequency: float, settings: Settings) -> RecordPath:
    """Return a run as a path; its sensor noise is from the spectrum above the band of the path.

    The noise of an integrated mode is known.
    """
    tau, angle = frequency * (run.time.values - run.time.values[0]), run.angle.values.astype(float)
    sensor = integrated_noise(run)
    if sensor is None:
        sensor = colour.colour_above(angle - smoothing.smooth(tau, angle)[0], tau, ABOVE)
    return _path_of(run, frequency, sensor, float(run.time.values[0]), settings)


def path_like(
    near: RecordPath, run: xr.Dataset, frequency: float, origin: float, before: xr.Dataset | None = None
) -> RecordPath:
    """Return another run as a path with the sensor and the held forces of a given path.

    `origin`, `before` : as in `RecordPath`.
    """
    path = _path_of(run, frequency, near.sensor, origin, near.settings)
    earlier = None if before is None else path_like(near, before, frequency, origin)
    return replace(path, held=near.held, frequency_free=near.frequency_free, before=earlier)


def _path_of(
    run: xr.Dataset, frequency: float, sensor: sensor_noise.NoiseModel, origin: float, settings: Settings
) -> RecordPath:
    """Return a run as a path along its least-squares spline, with its inputs and sticking rows.

    The motion sticks in rows in which it rests or follows a moving surface.
    """
    time, angle = run.time.values.astype(float), run.angle.values.astype(float)
    tau, inputs = frequency * (time - time[0]), inputs_of(run)
    intervals = smoothing.knot_intervals(tau)
    form = weak_form.build_weak_form(tau, intervals)
    spline, _ = smoothing.least_squares_spline(tau, angle, intervals)
    record, nowhere = (time, angle, frequency), np.zeros(form.rows, dtype=bool)
    path = RecordPath(*record, form, spline, sensor, origin, intervals, settings, nowhere, inputs=inputs)
    unit = signal.unit_of_signal(run)
    surfaces = [name for name in inputs if run[name].attrs.get("units") == unit]
    return replace(path, sticking=_sticking_rows(path, surfaces)) if inputs else path


def _sticking_rows(path: RecordPath, surfaces: Iterable[str]) -> Mask:
    """Return true for rows in which the motion has the rate of a surface and does not pass it, (row,).

    Static friction takes any value up to its largest (Leine and Nijmeijer 2004, chapter 4). It is not a
    column, so such rows contain no information on the forces.
    """
    tau, _, v, _ = path.points
    moving = [Channel(name, 1, "displacement") for name in surfaces]
    rates = values_of_inputs(path.inputs, moving, tau / path.frequency, path.frequency)
    slowest, knot = PASSING * np.sqrt(np.mean(v**2)), (tau[-1] - tau[0]) / path.intervals
    sticking = np.zeros(len(tau), dtype=bool)
    for shortest, rate in ((2.0 * knot, np.zeros(1)), *((0.0, rate) for rate in rates.values())):
        slip = v - rate
        near = np.abs(slip) < STICKING_ERRORS * path.sensor.innovation
        first, end = np.flatnonzero(np.diff(near, prepend=False, append=False)).reshape(-1, 2).T
        stay = tau[end - 1] - tau[first]
        stays = np.abs(slip[end - 1] - slip[first]) < slowest * stay
        # A moving surface is known to exist. Without one, a body that does not rest for long is only
        # reversing slowly.
        if stay[stays].max(initial=0.0) > shortest:
            for begin, after in zip(first[stays], end[stays], strict=True):
                sticking[begin:after] = True
    return np.asarray(path.integrals @ sticking.astype(float) > 0.0)


def default_shapes(force: Force) -> dict[str, float]:
    """Return the shape parameters of a force by their names, `dahl.s`."""
    return {f"{force.symbol}.{name}": shape.default for name, shape in force.shape.items()}
