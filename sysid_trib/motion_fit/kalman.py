"""The Kalman filter about a given path: innovations, smoothed states, and the likeliest random force.

Deviations z - path obey a linear equation with the derivatives of the exact steps. The gains do not depend on
the data; they come from statsmodels. With known gains the filter is linear in its input: the record and all
columns (start, sensor's zero, coefficients) are filtered by one banded triangular solution (de Jong 1991).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import solve_discrete_lyapunov
from scipy.linalg.lapack import dtbtrs

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.likelihood.variance_ratio import VarianceRatio, WhiteRows, variance_ratio
from sysid_trib.simulation.steps import Steps


@dataclass(frozen=True)
class LinearModel:
    """A record about a path, linear in the deviations of states and parameters.

    Attributes
    ----------
    steps : Steps
        Steps from each state of the path.
    path : (sample, state) array of float
    record : (sample,) array of float, rad
        Measured value minus the sensor's reading on the path.
    observed : (sample, state) array of float
        Derivatives of the sensor's reading by the state.
    observed_parameters : (sample, column) array of float
        Derivatives of the sensor's reading by the columns' parameters.
    start : (state, column) array of float
        Derivative of the first state by the columns' parameters.
    by_column : (step, state, column) array of float
        Derivative of each end by the columns' parameters.
    sensor_filter : (tap,) array of float
        Whitening filter of the sensor's noise. For coloured noise, its last values, in units of its
        innovations, are further states after the others.
    first : (state, state) array of float, optional
        Covariance of the first state; zero by default. Like all covariances of the filter it is in units of
        the variance of the sensor's noise, or of its innovations if the noise is coloured.
    """

    steps: Steps
    path: Array
    record: Array
    observed: Array
    observed_parameters: Array
    start: Array
    by_column: Array
    sensor_filter: Array = field(default_factory=lambda: np.ones(1))
    first: Array | None = None
    # The rows and the smoothed motion for one ratio use the same filter.
    _last: dict[float, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    def with_further_state(
        self, transition: Array, diffusion: Array, shown: float, first: Array | None = None
    ) -> "LinearModel":
        """Return the model with one more state, last, whose path is zero and which no parameter changes.

        `transition` : (step,) factor from this state to its next value. `diffusion` :
        (step, state + 1, state + 1) diffusion of all states. `shown` : derivative of the sensor's reading by
        this state. `first` : covariance of the first values of all states, as in the class.
        """
        behind = (0, 1)
        whole = np.pad(self.steps.transition, ((0, 0), behind, behind))
        whole[:, -1, -1] = transition
        end = np.pad(self.steps.end, ((0, 0), behind))
        return replace(
            self,
            steps=self.steps._replace(end=end, transition=whole, diffusion=diffusion),
            path=np.pad(self.path, ((0, 0), behind)),
            observed=np.pad(self.observed, ((0, 0), behind), constant_values=shown),
            start=np.pad(self.start, (behind, (0, 0))),
            by_column=np.pad(self.by_column, ((0, 0), behind, (0, 0))),
            first=first,
        )

    def by_parameters(self, columns: Array) -> "LinearModel":
        """Return the model with columns for parameters that determine its own, (column, parameter)."""
        tables = self.observed_parameters, self.start, self.by_column
        shown, start, by_column = (table @ columns for table in tables)
        return replace(self, observed_parameters=shown, start=start, by_column=by_column)

    @cached_property
    def _noise_transition(self) -> Array:
        """Companion matrix of the states of coloured noise, (order, order)."""
        order = len(self.sensor_filter) - 1
        return np.concatenate([-self.sensor_filter[None, 1:], np.eye(order)[:-1]])[:order]

    @cached_property
    def observed_states(self) -> Array:
        """Derivatives of the signal by all states, with those of coloured noise last, (sample, state)."""
        samples, order = len(self.record), len(self.sensor_filter) - 1
        return np.concatenate([self.observed, np.tile(np.eye(1, order), (samples, 1))], axis=1)

    @cached_property
    def _transition(self) -> Array:
        """Transitions of all states, (step, state, state)."""
        return _block_diagonal(self.steps.transition, self._noise_transition)

    def statsmodels(self, ratio: float, *, smoothed: bool = False) -> Any:
        """Return statsmodels' filter of this model, or its smoother of the states' covariance.

        The record is not passed on, because gains and covariances do not depend on it.
        """
        # Import only here: importing statsmodels takes longer than an identification.
        from statsmodels.tsa.statespace.kalman_filter import KalmanFilter
        from statsmodels.tsa.statespace.kalman_smoother import SMOOTHER_STATE_COV, KalmanSmoother

        samples, size = self.observed_states.shape
        order = len(self.sensor_filter) - 1
        sizes = {"k_endog": 1, "k_states": size, "k_posdef": size}
        # Further outputs, such as disturbances, would double the time.
        smoother: Any = KalmanSmoother(**sizes, smoother_output=SMOOTHER_STATE_COV) if smoothed else None
        model: Any = smoother or KalmanFilter(**sizes)
        driven = np.eye(order)[:, :1] @ np.eye(order)[:1]
        lasting = solve_discrete_lyapunov(self._noise_transition, driven) if order else driven
        first = np.zeros((size - order, size - order)) if self.first is None else self.first
        covariance = _block_diagonal(ratio * self.steps.diffusion, driven)
        model.bind(np.zeros((1, samples)))
        model["design"] = self.observed_states.T[None]
        model["transition"] = _of_each_sample(self._transition)
        model["selection"] = np.eye(size)
        model["state_cov"] = _of_each_sample(covariance)
        model["obs_cov"] = np.full((1, 1), float(not order))
        model.initialize_known(np.zeros(size), _block_diagonal(first, lasting))
        return model

    def _filtered(self, ratio: float) -> Any:
        if ratio not in self._last:
            self._last.clear()
            self._last[ratio] = self.statsmodels(ratio).filter()
        return self._last[ratio]

    def gains(self, ratio: float) -> tuple[Array, Array]:
        """Return the gain of the prediction (sample, state) and variance of the innovations (sample,)."""
        filtered = self._filtered(ratio)
        return filtered.kalman_gain[:, 0].T, filtered.forecasts_error_cov[0, 0]

    def rows(self, ratio: float) -> WhiteRows:
        """Return normalised innovations of the record, and of the columns, for a ratio per_tau / variance."""
        _, innovations, variance = self.innovations(ratio)
        white = innovations / np.sqrt(variance)[:, None]
        return WhiteRows(white[:, 0], -white[:, 1:], float(np.sum(np.log(variance))))

    def innovations(self, ratio: float, parameters: Array | None = None) -> tuple[Array, Array, Array]:
        """Return the predicted states, the innovations, and their variance.

        Parameters
        ----------
        ratio : float
            Ratio of the random force's growth of the variance of v to the variance of the sensor's noise.
        parameters : (column,) array of float, optional
            Deviations at which the record is filtered. Without them, record and columns are separate signals.

        Returns
        -------
        predicted : (sample, state, signal) array of float
        innovations : (sample, signal) array of float, rad
            Innovations of the record, minus those of each column.
        variance : (sample,) array of float
        """
        gain, variance = self.gains(ratio)
        signals, added, start = self._signals
        if parameters is not None:
            signals, added, start = (part @ np.append(1.0, parameters)[:, None] for part in self._signals)
        samples, size = self.path.shape
        source = np.zeros((samples, gain.shape[1], signals.shape[1]))
        source[0, :size] = start
        source[1:] = gain[:-1, :, None] * signals[:-1, None]
        source[1:, :size] += added
        predicted = self.recursion(gain, source)
        shown = np.einsum("na,nac->nc", self.observed_states, predicted)
        return predicted, signals - shown, variance

    @cached_property
    def _signals(self) -> tuple[Array, Array, Array]:
        """Signals (sample, signal), increments of each step, first states: of the record, then of columns."""
        # Ends of the exact steps, relative to the path's next state.
        mismatch = self.steps.end - self.path[1:]
        return (
            np.column_stack([self.record, -self.observed_parameters]),
            np.concatenate([mismatch[:, :, None], self.by_column], axis=2),
            np.pad(self.start, ((0, 0), (1, 0))),
        )

    def recursion(self, gain: Array, source: Array, *, backward: bool = False) -> Array:
        """Solve s[k + 1] = (transition - gain observed) s[k] + source[k + 1], s[0] = source[0].

        Gain and source may have fewer states than the filter: those of coloured noise come last.

        Parameters
        ----------
        gain : (sample, state) array of float
            Gain of the prediction; zero for a motion that is not corrected by the record.
        source : (sample, state, column) array of float
        backward : bool
            Solve the smoother's recursion, transposed and from the last sample: r[k] = (transition - gain
            observed)' r[k + 1] + source[k].

        Returns
        -------
        (sample, state, column) array of float
        """
        samples, size = gain.shape
        observed = self.observed_states[:-1, None, :size]
        turned = self._transition[:, :size, :size] - gain[:-1, :, None] * observed
        # Lower banded, with a unit diagonal.
        band = np.zeros((2 * size, samples * size))
        band[0] = 1.0
        for a in range(size):
            for b in range(size):
                band[size + a - b, b : (samples - 1) * size : size] = -turned[:, a, b]
        columns = source.reshape(samples * size, source.shape[2])
        solved, _ = dtbtrs(band, columns, uplo="L", trans="T" if backward else "N", diag="U")
        return np.asarray(solved).reshape(source.shape)

    def smoothed_motion(self, ratio: float, parameters: Array) -> Array:
        """Return the smoothed path at given deviations of the parameters, (sample, state).

        This is the fixed-interval smoother of de Jong (1989): the filter's recursion, then its transpose
        backwards.
        """
        predicted, surprise = self._surprised(ratio, parameters)
        surprise = self.recursion(self.gains(ratio)[0], surprise, backward=True)
        return self.path + self._corrected(ratio, predicted, surprise)[..., 0]

    def filtered_motion(self, ratio: float, parameters: Array | None = None) -> tuple[Array, Array]:
        """Return deviations from the path, filtered with the samples so far, and their covariance.

        Parameters
        ----------
        ratio, parameters
            As in `innovations`.

        Returns
        -------
        change : (sample, state, signal) array of float
        covariance : (sample, state, state) array of float
            In units of the variance of the sensor's noise.
        """
        size = self.path.shape[1]
        covariance = np.moveaxis(self._filtered(ratio).filtered_state_cov[:size, :size], -1, 0)
        return self._corrected(ratio, *self._surprised(ratio, parameters)), covariance

    def _surprised(self, ratio: float, parameters: Array | None) -> tuple[Array, Array]:
        """Return predicted states and each innovation's correction, (sample, state, signal)."""
        predicted, innovations, variance = self.innovations(ratio, parameters)
        weighted = innovations / variance[:, None]
        return predicted, self.observed_states[:, :, None] * weighted[:, None]

    def _corrected(self, ratio: float, predicted: Array, surprise: Array) -> Array:
        """Correct the predicted states by the innovations, without those of coloured noise."""
        samples, size = self.path.shape
        covariance = self._filtered(ratio).predicted_state_cov[:size, :, :samples]
        return np.asarray(predicted[:, :size] + np.einsum("abn,nbc->nac", covariance, surprise))


def likely_ratio(linear: LinearModel, start: float | None = None) -> VarianceRatio:
    """Return the ratio per_tau / variance of largest restricted likelihood, near the last one (`start`).

    Raise a DecayError if friction holds the body all the time.
    """
    impulses = linear.steps.diffusion[:, 1, 1]
    # A random force does not move a body that friction holds.
    impulses = impulses[impulses > 0.0]
    if not len(impulses):
        raise DecayError("Friction of this size holds the body all the time; use random_force='off'.")
    span = float(np.sum(impulses)), float(np.median(impulses))
    return variance_ratio(linear.rows, *span, start)


def _block_diagonal(matrices: Array, further: Array) -> Array:
    """Return matrices (..., state, state), each extended by a diagonal block."""
    size, order = matrices.shape[-1], len(further)
    if not order:
        return matrices
    whole = np.zeros((*matrices.shape[:-2], size + order, size + order))
    whole[..., :size, :size] = matrices
    whole[..., size:, size:] = further
    return whole


def _of_each_sample(matrices: Array) -> Array:
    """Return the matrices of the steps in statsmodels' form, with one for the step after the last sample."""
    return np.moveaxis(np.concatenate([matrices, matrices[-1:]]), 0, -1)
