"""Predictions of a record from earlier samples, with bands that grow with the random force."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import scipy
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.motion_fit.innovations import TrackedRecord, track
from sysid_trib.motion_fit.linearised import sensor_on
from sysid_trib.results import signal_scale, variables
from sysid_trib.results.frequencies import covariance_with_frequency
from sysid_trib.results.random_force import RandomForce, random_force_of
from sysid_trib.simulation.model import FREQUENCY
from sysid_trib.simulation.steps import Steps, steps_over

# Number of recent periods: as many as the longest predictions usually span.
RECENT_PERIODS = 10
# Number of periods in which the filter finds the start and the sensor's zero, before the first prediction.
SETTLING_PERIODS = 2.0


@signal_scale.in_units_of_the_motion
def prediction_bands(
    decay: xr.Dataset,
    result: xr.Dataset,
    periods: ArrayLike = (1.0, 3.0, 10.0),
    *,
    origins: Sequence[float] | None = None,
    run: int = 0,
) -> xr.Dataset:
    """Predict a record from some of its instants, each from the samples up to then.

    Parameters
    ----------
    decay : Dataset
        `angle(time)`: the record of the result, or another record of the same experiment.
    result : Dataset
        Any identification.
    periods : array_like of float
        Horizons in periods of the reference frequency; the nearest sample of each is predicted.
    origins : sequence of float, s, optional
        Times from which to predict; by default one per longest horizon, so that predictions do not overlap.
    run : int
        Index of the run of the result whose noise and random force apply.

    Returns
    -------
    Dataset
        Over `origin` (s) and `horizon` (periods): `time_ahead` (s), `predicted` (rad) and its
        `predicted_standard_error`, which includes the sensor's noise of the sample; `measured` (rad), nan
        beyond the record. Over `origin`: the `widening`, the factor by which the standard error was
        multiplied.

    Raises
    ------
    DecayError
        The record is too short, or the motion does not converge to it.
    UsageError
        A horizon that is not positive.

    Notes
    -----
    The state is that of the filter and uses no sample after the origin. The variance of a prediction is the
    sum of the variances of the state, of the random force until then (both along the motion, exact across
    switching), of the coefficients, of the sensor's zero and of its noise. The random force has its expected
    density, which exceeds the most likely density if that is zero or nearly so. If recent predictions one
    period ahead were wrong by more than chance allows, the model lacks something: the errors are then
    multiplied by the Birge ratio of these predictions (`widening`). Recent are those for times within ten
    periods before the origin.

    Examples
    --------
    The model explains the record: even ten periods ahead, the error (rad) is that of the sensor's noise.

    >>> import sysid_trib as st
    >>> decay = st.free_decay(st.records.paper_twin())
    >>> result = st.identify(decay, method="direct")
    >>> bands = st.validation.prediction_bands(decay, result, [1.0, 10.0], origins=[5.0])
    >>> bands.predicted_standard_error[0].round(4).values.tolist(), result.noise.round(4).item()
    ([0.0006, 0.0006], 0.0006)
    """
    ahead = np.sort(np.atleast_1d(np.asarray(periods, dtype=float)))
    if not (len(ahead) and np.all(np.isfinite(ahead)) and ahead[0] > 0.0):
        raise UsageError(f"Horizons of a prediction are positive numbers of periods, not {periods!r}.")
    return bands_of(track(decay, result, run), result, ahead, origins=origins, run=run)


def bands_of(
    tracked: TrackedRecord,
    result: xr.Dataset,
    ahead: Array,
    *,
    origins: Sequence[float] | None = None,
    run: int = 0,
) -> xr.Dataset:
    """Return `prediction_bands` of a tracked record for these horizons (periods, ascending)."""
    tracked = tracked.with_density(_expected_density(random_force_of(result, run)))
    starts = _origins(tracked, float(ahead[-1]), origins)
    ahead_of = partial(_predictions, tracked, result, run=run)
    times, predicted, errors, measured = ahead_of(starts, ahead)
    factor = _recent_ratios(tracked, starts, ahead_of)
    values = {
        "predicted": (predicted, factor[:, None] * errors),
        "measured": measured,
        "time_ahead": times,
        "widening": factor,
    }
    coords = variables.described("prediction", {"origin": tracked.time[starts], "horizon": ahead})
    return xr.Dataset(variables.described("prediction", values), coords)


def _recent_ratios(
    tracked: TrackedRecord, starts: Index, ahead_of: Callable[[Index, Array], tuple[Array, ...]]
) -> Array:
    """Return the factor of the errors at each start (start,), from predictions for times before it.

    The factor is the Birge ratio (1932) of the last `RECENT_PERIODS` predictions one period ahead if it is
    significantly above 1 (chi-square), else 1.

    Notes
    -----
    Errors due to a random force are a white series, so for a complete model the sum of their squares is a
    chi-square. The effect of a missing force changes with the amplitude, so old predictions contain little
    information about it.
    """
    time, period = tracked.time, 2.0 * np.pi / tracked.model.reference_frequency
    factors = np.ones(len(starts))
    # Predictions one period ahead, the last of which ends at the last start, and the others a period apart.
    earlier = np.arange(time[starts[-1]] - period, time[0] + SETTLING_PERIODS * period, -period)[::-1]
    if not len(earlier):
        return factors
    recent = ahead_of(_origins(tracked, 0.0, list(earlier)), np.ones(1))
    times, predicted, errors, measured = (table[:, 0] for table in recent)
    seen = np.isfinite(measured)
    squares = ((measured - predicted) / errors)[seen] ** 2
    for at, due in enumerate(np.searchsorted(times[seen], time[starts], side="right")):
        last = squares[max(0, due - RECENT_PERIODS) : due]
        # Significance level at which the predictions are worse than their stated errors.
        if len(last) and scipy.stats.chi2.sf(np.sum(last), len(last)) < 0.01:
            factors[at] = np.sqrt(np.mean(last))
    return factors


def _predictions(
    tracked: TrackedRecord, result: xr.Dataset, starts: Index, ahead: Array, *, run: int
) -> tuple[Array, ...]:
    """Predict from each start over the horizons `ahead` (periods, ascending).

    Return (origin, horizon) arrays: the times (s), the predictions with their standard errors (rad), and the
    measured values, nan where there is no sample.
    """
    names, of_parameters = parameters_of(result)
    by = (*names, FREQUENCY)
    states, covariance, by_states = _filtered(tracked, starts, by)
    model, time, w, at = tracked.model, tracked.time, tracked.model.reference_frequency, tracked.time[starts]
    wanted = at[:, None] + 2.0 * np.pi / w * ahead
    targets = _nearest(time, wanted)
    times = np.where(targets >= 0, time[targets], wanted)
    predicted, variance = np.empty((2, *times.shape))
    size = states.shape[1] - 1
    still = np.broadcast_to(np.eye(size), (len(starts), size, size))
    now = Steps(states[:, :size], still, by_states[:, :size], np.zeros_like(still))
    for j in range(len(ahead)):
        now = now.then(steps_over(model, w * (at - time[0]), w * (times[:, j] - at), now.end, by))
        at = times[:, j]
        shown, observed, by_sensor = sensor_on(model, at - time[0], now.end, by)
        predicted[:, j] = shown + states[:, size]
        by_start = np.pad(np.einsum("oa,oab->ob", observed, now.transition), ((0, 0), (0, 1)))
        by_start[:, size] = 1.0
        by_parameter = np.einsum("oa,oap->op", observed, now.sensitivity) + by_states[:, size] + by_sensor
        variance[:, j] = (
            np.einsum("oa,oab,ob->o", by_start, covariance, by_start)
            + tracked.per_tau * np.einsum("oa,oab,ob->o", observed, now.diffusion, observed)
            + np.einsum("op,pq,oq->o", by_parameter, of_parameters, by_parameter)
            + variables.noise_of_run(result, run) ** 2
        )
    measured = np.where(targets >= 0, tracked.angle[targets], np.nan)
    return times, predicted, np.sqrt(variance), measured


def _expected_density(force: RandomForce) -> float:
    """Return the expected density from its estimate and error: the mean of a Gaussian truncated at zero."""
    if not force.standard_error > 0.0:
        return force.density
    at = force.density / force.standard_error
    return force.density + force.standard_error * float(
        np.exp(scipy.stats.norm.logpdf(at) - scipy.stats.norm.logcdf(at))
    )


def _origins(tracked: TrackedRecord, longest: float, origins: Sequence[float] | None) -> Index:
    """Return the samples from which to predict."""
    time, period = tracked.time, 2.0 * np.pi / tracked.model.reference_frequency
    first = time[0] + SETTLING_PERIODS * period
    usual = np.arange(first, time[-1] - longest * period, longest * period) if origins is None else origins
    if origins is None and not len(usual):
        raise DecayError(
            f"No prediction of {longest:g} periods fits into this record after "
            f"{SETTLING_PERIODS:g} periods for the start; ask for fewer periods."
        )
    times = np.asarray(usual, dtype=float)
    if not (len(times) and np.all(np.isfinite(times)) and times.min() >= first and times.max() <= time[-1]):
        raise DecayError(
            f"Predictions start between {first:.4g} s, after {SETTLING_PERIODS:g} periods for the start, and "
            f"{time[-1]:.4g} s, the end of the record."
        )
    return np.searchsorted(time, times + 1e-9 * period, side="right") - 1


def _nearest(time: Array, wanted: Array) -> Index:
    """Return the indices of the nearest samples; -1 if the record has none within half a step."""
    half = 0.51 * float(np.median(np.diff(time)))
    return pd.Index(time).get_indexer(wanted.ravel(), "nearest", tolerance=half).reshape(wanted.shape)


def _filtered(tracked: TrackedRecord, starts: Index, by: tuple[str, ...]) -> tuple[Array, Array, Array]:
    """Return the filtered states at each start, with the sensor's zero as the last state.

    Return also their covariance, and their derivatives by coefficients and frequency, because other
    coefficients give another motion for the same samples. Shape of the states: (start, state + 1). Motion and
    zero are unknown before the first sample: their standard deviation there is the swing.
    """
    linear = tracked.linear_about(tracked.linear.path, tracked.zero, by)
    behind, (steps, size, _) = (0, 1), linear.steps.transition.shape
    first = np.zeros((size + 1, size + 1))
    first[[0, 1, size], [0, 1, size]] = (float(np.max(np.abs(tracked.angle))) / tracked.noise) ** 2
    # The start is not a column here, but part of that covariance.
    linear = linear.by_parameters(np.eye(len(by) + 3, len(by)))
    linear = replace(linear, start=0.0 * linear.start)
    diffusion = np.pad(linear.steps.diffusion, ((0, 0), behind, behind))
    linear = linear.with_further_state(np.ones(steps), diffusion, 1.0, first)
    changes, covariance = linear.filtered_motion(tracked.ratio)
    states = linear.path + changes[..., 0]
    states[:, size] += tracked.zero
    return states[starts], tracked.noise**2 * covariance[starts], changes[starts, :, 1:]


def parameters_of(result: xr.Dataset) -> tuple[tuple[str, ...], Array]:
    """Return the coefficients of the model, and their covariance with the reference frequency as the last."""
    return tuple(result.force.values.tolist()), np.nan_to_num(covariance_with_frequency(result))
