"""The Kalman filter about a given path: innovations, smoothed states, and the likeliest random force.

Deviations z - path obey a linear equation with the derivatives of the exact steps. The gains do not depend on
the data: they are statsmodels'. With them the filter is linear in what it is given: the record and all
columns (start, sensor's zero, coefficients) go through it in one banded triangular solution (de Jong 1991).
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg.lapack import dtbtrs

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.likelihood.variance_ratio import VarianceRatio, WhiteRows, ratio_span, variance_ratio
from sysid_trib.motion_fit.steps import SensorNoise, Steps


@dataclass(frozen=True)
class LinearModel:
    """A record about a path, linear in the deviations of states and parameters.

    Attributes
    ----------
    steps : Steps
        From each state of the path.
    path : (sample, state) array of float
    record : (sample,) array of float, rad
        What was measured, minus what the sensor would show on the path.
    observed : (sample, state) array of float
        Derivative of what the sensor shows by the state.
    observed_parameters : (sample, column) array of float
        And by the columns' parameters.
    start : (state, column) array of float
        Derivative of the first state by the columns' parameters.
    by_column : (step, state, column) array of float
        Derivative of each end by the columns' parameters.
    sensor_filter : (tap,) array of float
        Whitens the sensor's noise. Of coloured noise the last values are further states, behind the others.
    """

    steps: Steps
    path: Array
    record: Array
    observed: Array
    observed_parameters: Array
    start: Array
    by_column: Array
    sensor_filter: Array = field(default_factory=lambda: np.ones(1))
    # Rows and the smoothed motion of one ratio have one filter.
    _last: dict[float, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @cached_property
    def mismatch(self) -> Array:
        """Where the exact steps end, from the path's next state, (step, state)."""
        return self.steps.end - self.path[1:]

    def _filtered(self, ratio: float) -> Any:
        """statsmodels' filter, of which gains and covariances are asked: they do not depend on the record."""
        if ratio not in self._last:
            covariance = ratio * self.steps.diffusion
            model = statsmodels_model(self.observed, self.steps.transition, covariance, self.sensor_filter)
            self._last.clear()
            self._last[ratio] = model.filter()
        return self._last[ratio]

    @cached_property
    def with_sensor_states(self) -> tuple[Array, Array]:
        """`observed` and the transitions, with those of the states of coloured noise."""
        noise = SensorNoise(self.sensor_filter)
        return noise.behind(self.observed, noise.shown), noise.block_diagonal(
            self.steps.transition, noise.transition
        )

    def gains(self, ratio: float) -> tuple[Array, Array]:
        """Gain of the prediction (sample, state) and variance of the innovations (sample,).

        In units of the variance of the sensor's noise, of its innovations where that is coloured.
        """
        return filter_gains(self._filtered(ratio))

    def rows(self, ratio: float) -> WhiteRows:
        """Normalised innovations of the record, and of the columns, for a ratio per_tau / variance."""
        innovations, columns, variance = self.innovations(ratio)
        size = np.sqrt(variance)
        return WhiteRows(innovations / size, columns / size[:, None], float(np.sum(np.log(variance))))

    def innovations(self, ratio: float) -> tuple[Array, Array, Array]:
        """Innovations of the record (sample,) and the columns (sample, column), rad; their variance."""
        gain, variance = self.gains(ratio)
        predicted = self._predicted(gain)
        shown = np.einsum("na,nac->nc", self.with_sensor_states[0], predicted)
        return self.record - shown[:, 0], shown[:, 1:] + self.observed_parameters, variance

    def _predicted(self, gain: Array) -> Array:
        """States predicted from the past, of the record and of each column, (sample, state, 1 + column)."""
        samples, size = self.path.shape
        columns = self.start.shape[1]
        source = np.zeros((samples, gain.shape[1], 1 + columns))
        source[0, :size, 1:] = self.start
        source[1:, :, 0] = gain[:-1] * self.record[:-1, None]
        source[1:, :size, 0] += self.mismatch
        source[1:, :, 1:] = -gain[:-1, :, None] * self.observed_parameters[:-1, None, :]
        source[1:, :size, 1:] += self.by_column
        return self.recursion(gain, source)

    def recursion(self, gain: Array, source: Array, *, backward: bool = False) -> Array:
        """States s[k + 1] = (transition - gain observed) s[k] + source[k + 1], s[0] = source[0].

        With as many states as gain and source have: those of coloured noise are among the filter's.

        Parameters
        ----------
        gain : (sample, state) array of float
            Of the prediction; zero for the motion that no record corrects.
        source : (sample, state, column) array of float
        backward : bool
            The transposed recursion from the last sample, r[k] = (transition - gain observed)' r[k + 1] +
            source[k]: the smoother's.

        Returns
        -------
        (sample, state, column) array of float
        """
        samples, size = gain.shape
        observed, transition = self.with_sensor_states
        turned = transition[:, :size, :size] - gain[:-1, :, None] * observed[:-1, None, :size]
        # Lower banded, with a unit diagonal.
        band = np.zeros((2 * size, samples * size))
        band[0] = 1.0
        for a in range(size):
            for b in range(size):
                band[size + a - b, b : (samples - 1) * size : size] = -turned[:, a, b]
        columns = source.reshape(samples * size, source.shape[2])
        if not columns.size:
            # LAPACK writes beyond an empty array.
            return source
        solved, _ = dtbtrs(band, columns, uplo="L", trans="T" if backward else "N", diag="U")
        return np.asarray(solved).reshape(source.shape)

    def smoothed_motion(self, ratio: float, parameters: Array) -> Array:
        """The path that is smoothed at given deviations of the parameters, (sample, state).

        By the fixed-interval smoother of de Jong (1989): the filter's recursion, and its transpose backwards.
        """
        predicted, surprise = self._surprised(ratio, parameters)
        gain, _ = self.gains(ratio)
        return self._corrected(ratio, predicted, self.recursion(gain, surprise, backward=True))

    def filtered_motion(self, ratio: float, parameters: Array) -> tuple[Array, Array]:
        """The path by the samples up to each one, at given deviations of the parameters.

        Returns
        -------
        path : (sample, state) array of float
        rate_error : (sample,) array of float
            Standard error of v on it, in units of that of the sensor's noise.
        """
        path = self._corrected(ratio, *self._surprised(ratio, parameters))
        return path, np.sqrt(np.maximum(self._filtered(ratio).filtered_state_cov[1, 1], 0.0))

    def _surprised(self, ratio: float, parameters: Array) -> tuple[Array, Array]:
        """States predicted from the past, and what each innovation tells of them, (sample, state, 1) each."""
        gain, variance = self.gains(ratio)
        record, added, start = self.driven(parameters)
        size = self.path.shape[1]
        source = np.zeros((*gain.shape, 1))
        source[0, :size, 0] = start
        source[1:, :, 0] = gain[:-1] * record[:-1, None]
        source[1:, :size, 0] += added
        predicted = self.recursion(gain, source)
        observed = self.with_sensor_states[0]
        innovations = record - np.einsum("na,na->n", observed, predicted[..., 0])
        return predicted, (observed * (innovations / variance)[:, None])[..., None]

    def _corrected(self, ratio: float, predicted: Array, surprise: Array) -> Array:
        """The path with what innovations tell of the predicted states, (sample, state)."""
        samples, size = self.path.shape
        covariance = self._filtered(ratio).predicted_state_cov[:size, :, :samples]
        change = predicted[:, :size, 0] + np.einsum("abn,nb->na", covariance, surprise[..., 0])
        return np.asarray(self.path + change)

    def driven(self, parameters: Array) -> tuple[Array, Array, Array]:
        """Record (sample,), what is added in each step (step, state) and first state, at given deviations."""
        record = self.record - self.observed_parameters @ parameters
        return record, self.mismatch + self.by_column @ parameters, self.start @ parameters


def filter_gains(filtered: Any) -> tuple[Array, Array]:
    """Gain of the prediction (sample, state) and variance of the innovations (sample,) of statsmodels."""
    return filtered.kalman_gain[:, 0].T, filtered.forecasts_error_cov[0, 0]


def statsmodels_model(
    observed: Array,
    transition: Array,
    covariance: Array,
    sensor_filter: Array,
    *,
    first: Array | None = None,
    smoother: bool = False,
) -> Any:
    """statsmodels' filter or smoother of one signal in noise whose innovations have the variance one.

    Parameters
    ----------
    observed : (sample, state) array of float
        Derivative of the signal by the state.
    transition, covariance : (step, state, state) array of float
        Of each step, and of the noise that it adds.
    sensor_filter : (tap,) array of float
        Whitens the sensor's noise; that has states behind these where it is coloured.
    first : (state, state) array of float, optional
        Covariance of the first state; known where left out.
    smoother : bool
        Whether it can smooth too: states and their covariance.
    """
    # Here, since importing statsmodels takes longer than an identification.
    from statsmodels.tsa.statespace.kalman_filter import KalmanFilter
    from statsmodels.tsa.statespace.kalman_smoother import SMOOTHER_STATE, SMOOTHER_STATE_COV, KalmanSmoother

    noise = SensorNoise(sensor_filter)
    samples, size = observed.shape[0], observed.shape[1] + noise.order
    sizes = {"k_endog": 1, "k_states": size, "k_posdef": size}
    # States and their covariance: disturbances and the rest would take twice the time.
    output = SMOOTHER_STATE | SMOOTHER_STATE_COV
    model: Any = KalmanSmoother(**sizes, smoother_output=output) if smoother else KalmanFilter(**sizes)
    model.bind(np.zeros((1, samples)))
    model["design"] = noise.behind(observed, noise.shown).T[None]
    model["transition"] = _padded(
        np.moveaxis(noise.block_diagonal(transition, noise.transition), 0, -1), np.eye(size)
    )
    model["selection"] = np.eye(size)
    driven = np.moveaxis(noise.block_diagonal(covariance, noise.driven), 0, -1)
    model["state_cov"] = _padded(driven, np.zeros((size, size)))
    model["obs_cov"] = np.full((1, 1), float(not noise.order))
    known = np.zeros(2 * observed.shape[1:]) if first is None else first
    model.initialize_known(np.zeros(size), noise.block_diagonal(known, noise.first))
    return model


def set_signal(model: Any, record: Array, added: Array, start: Array) -> None:
    """Give a model of statsmodels its record, what each step adds to the state, and the first state.

    The states of coloured noise have nothing added.
    """
    further = model.k_states - len(start)
    model.bind(np.ascontiguousarray(record[None]))
    added = np.pad(added.T, ((0, further), (0, 0)))
    model["state_intercept"] = _padded(added, np.zeros(len(added)))
    model.initialize_known(np.pad(start, (0, further)), model.initialization.stationary_cov)


def _padded(values: Array, last: Array) -> Array:
    """Values of each step, and one more that statsmodels wants for the step after the last sample."""
    return np.concatenate([values, last[..., None]], axis=-1)


def likely_ratio(
    linear: LinearModel, rows: Callable[[float], WhiteRows] | None = None, start: float | None = None
) -> VarianceRatio:
    """The ratio per_tau / variance of most restricted likelihood.

    Parameters
    ----------
    linear : LinearModel
    rows : callable, optional
        White rows of a ratio, in the place of the model's with all its columns.
    start : float, optional
        Where the ratio was last.

    Raises
    ------
    DecayError
        Friction holds the body all the time.
    """
    impulses = linear.steps.diffusion[:, 1, 1]
    # A body that friction holds is not pushed.
    impulses = impulses[impulses > 0.0]
    if not len(impulses):
        raise DecayError("Friction of this size holds the body all the time; take random_force='off'.")
    low, high = ratio_span(float(np.sum(impulses)), float(np.median(impulses)))
    return variance_ratio(linear.rows if rows is None else rows, low, high, start)
