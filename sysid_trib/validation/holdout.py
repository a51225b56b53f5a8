"""Hold-out: how a model predicts a part of a decay that it has not seen, and whether another does better."""

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import ttest_1samp

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import parse_library
from sysid_trib.noise.level import sensor_noise
from sysid_trib.records.runs import root_mean_square
from sysid_trib.results.schema import library_of
from sysid_trib.trajectory_fit.initial_conditions import FittedMotion
from sysid_trib.validation.residuals import fitted_motion

Array = NDArray[np.float64]

# The part of a decay's time from which a model is identified where the rest is to be predicted.
TRAINING = 2.0 / 3.0
# In antiphase (rad) the residual says nothing more of the forces.
ANTIPHASE = np.pi
TIME = re.compile(r"\bt\b")


@dataclass(frozen=True)
class ModelResidual:
    """Record minus the motion of a model, its start and the sensor's zero fitted there.

    Attributes
    ----------
    residual : (sample,) array of float, rad
        Record minus model.
    phase_error : float, rad
        The largest; nan of a motion that stops early.
    stop_time : float, s
        nan if the model does not stop within the record.
    """

    residual: Array
    phase_error: float
    stop_time: float

    @property
    def rms(self) -> float:
        """RMS of the residual, rad."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def complaint(self) -> str:
        """Why the motion is not the record's, in a few words; empty if it is."""
        if np.isfinite(self.stop_time):
            return f"stops at {self.stop_time:.3g} s"
        if self.phase_error > ANTIPHASE:
            return f"slips by {self.phase_error / (2.0 * np.pi):.2g} periods"
        return ""


@dataclass(frozen=True)
class ModelResiduals:
    """Residuals of one model in several runs, or in the one there is.

    Attributes
    ----------
    runs : tuple of ModelResidual
        Those of each run; none where the model has no motion in one.
    noises : tuple of float, rad
        Noise of one sample of each run.
    """

    runs: tuple[ModelResidual, ...]
    noises: tuple[float, ...]

    @property
    def each_rms(self) -> Array:
        """RMS of the residual of each run, rad; nan without a motion."""
        return np.array([run.rms for run in self.runs] or [np.nan] * len(self.noises))

    @property
    def rms(self) -> float:
        """RMS over the runs, whatever their lengths, rad."""
        return root_mean_square(self.each_rms)

    @property
    def over_noise(self) -> float:
        """The same of each run's RMS over its own noise."""
        return root_mean_square(self.each_rms / np.array(self.noises))

    @property
    def phase_error(self) -> float:
        """The largest of all runs, rad; nan if one stops early, or without a motion."""
        return float(np.max([run.phase_error for run in self.runs] or [np.nan]))

    @property
    def complaint(self) -> str:
        """Why the motion of a run is not the record's, and of which; empty if all are."""
        for at, run in enumerate(self.runs):
            if run.complaint:
                return f"{run.complaint} in run {at + 1}" if len(self.runs) > 1 else run.complaint
        return ""


@dataclass(frozen=True)
class RunInParts:
    """A decay, the part from which models are identified, the part held out, and its envelope."""

    decay: xr.Dataset
    train: xr.Dataset
    rest: xr.Dataset
    envelope: xr.Dataset

    @cached_property
    def noise(self) -> float:
        """The sensor's noise, rad."""
        return sensor_noise(self.decay)

    @property
    def block(self) -> int:
        """Samples of a period."""
        step = float(np.median(np.diff(self.decay.time.values)))
        return max(1, round(2 * float(np.median(np.diff(self.envelope.extremum_time))) / step))

    @property
    def record(self) -> xr.Dataset:
        """The record with the time at which the part held out starts."""
        attrs = {"units": "s", "long_name": "start of the part held out"}
        return self.decay.assign(holdout_start=((), float(self.rest.time.values[0]), attrs))


def first_held_out(time: Array) -> int:
    """Index of the first sample of the last third of a record, by time.

    Parameters
    ----------
    time : (sample,) array of float, s
        Times of the record.
    """
    return int(np.searchsorted(time, time[0] + TRAINING * (time[-1] - time[0])))


def split(decay: xr.Dataset) -> tuple[xr.Dataset, xr.Dataset]:
    """The first two thirds of a decay by time, and the last."""
    first = first_held_out(decay.time.values.astype(float))
    return decay.isel(time=slice(0, first)), decay.isel(time=slice(first, None))


def residual_of(
    decay: xr.Dataset, result: xr.Dataset, envelope: xr.Dataset, run: int = 0
) -> ModelResidual | None:
    """Residual of an identified model in the decay, or the run, that it is from; None if it diverges.

    Parameters
    ----------
    decay : Dataset
        `angle(time)`.
    result : Dataset
        The identification.
    envelope : Dataset
        The record's envelope, whose extrema give its phase.
    run : int
        Which run it is.
    """
    motion = fitted_motion(decay, result, run)
    if motion is None:
        return None
    time = decay.time.values.astype(float)
    residual = decay.angle.values - motion.offset - motion.x
    stop = motion.stop_time if motion.stop_time < time[-1] else float("nan")
    error = float("nan") if np.isfinite(stop) else _phase_error(time, motion, envelope)
    return ModelResidual(np.asarray(residual, dtype=float), error, stop)


def predicted(
    part: xr.Dataset, result: xr.Dataset, envelope: xr.Dataset, first_time: float
) -> ModelResidual | None:
    """Residual in a later part of a decay of a model from an earlier part; None if it diverges.

    Parameters
    ----------
    part : Dataset
        `angle(time)` of the later part.
    result : Dataset
        The identification of the earlier part.
    envelope : Dataset
        The envelope of the decay.
    first_time : float, s
        Of the decay's first sample, from which `t` in a formula counts. Internal states of history-dependent
        forces begin anew, as after a release.
    """
    later = _counted_from(result, float(part.time.values[0] - first_time))
    return residual_of(part, later.drop_vars(["start_angle", "start_rate"], errors="ignore"), envelope)


def diebold_mariano(first: Sequence[Array], second: Sequence[Array], blocks: Sequence[int]) -> float:
    """P-value of the ratio between two models' squared residuals (Diebold-Mariano test, two-sided).

    Parameters
    ----------
    first, second : sequence of (sample,) array of float, rad
        Residuals of each model in the same runs.
    blocks : sequence of int
        Samples of each run over which residuals may be correlated, a period.

    Returns
    -------
    float
        P-value where both predict equally well; nan of fewer than three blocks.

    Notes
    -----
    Diebold & Mariano 1995, with the logarithm of the mean square over a block as the loss: a decay's last
    swings then count as its first. Blocks are taken as independent, so that Student's t-test serves.
    """
    losses = [
        np.concatenate(
            [_block_losses(run, block) for run, block in zip(model_residuals, blocks, strict=True)]
        )
        for model_residuals in (first, second)
    ]
    difference = losses[0] - losses[1]
    if len(difference) < 3:
        return float("nan")
    if np.ptp(difference) == 0.0:
        return float(difference[0] == 0.0)
    return float(ttest_1samp(difference, 0.0).pvalue)


def _block_losses(residual: Array, block: int) -> Array:
    """Logarithm of the mean square of a residual over each whole block."""
    count = len(residual) // block
    squares = np.mean(residual[: count * block].reshape(count, block) ** 2, axis=1)
    return np.asarray(np.log(np.maximum(squares, 1e-300)))


def _phase_error(time: Array, motion: FittedMotion, envelope: xr.Dataset) -> float:
    """Largest angle (rad) between the phase of a motion and the record's, at the record's extrema."""
    inside = (envelope.extremum_time.values > time[0]) & (envelope.extremum_time.values < time[-1])
    turns, sign = envelope.extremum_time.values[inside], envelope.sign.values[inside]
    if not len(turns):
        return float("nan")
    phase = np.interp(turns, time, np.unwrap(np.arctan2(-motion.v, motion.x)))
    lead = phase - np.pi * np.arange(len(turns)) - (0.0 if sign[0] > 0 else np.pi)
    # Whole turns count from where the two are nearest: the start's own are arbitrary.
    middle = 2.0 * np.pi * np.round(np.median(lead) / (2.0 * np.pi))
    return float(np.max(np.abs(lead - middle)))


def _counted_from(result: xr.Dataset, seconds: float) -> xr.Dataset:
    """The identification with `t` of its formulas moved, for a motion that starts so much later."""
    if not any(force.holds_time for force in library_of(result)):
        return result
    library = counted_from(library_of(result, whole=True), seconds)
    return result.assign_attrs(library=library.to_toml())


def counted_from(library: ForceLibrary, seconds: float) -> ForceLibrary:
    """The forces with `t` of their formulas moved, for a motion that starts so much later."""
    if not any(force.holds_time for force in library):
        return library
    data = tomllib.loads(library.to_toml())

    def shifted(formula: Any) -> Any:
        if isinstance(formula, dict):
            return {name: shifted(text) for name, text in formula.items()}
        return TIME.sub(f"(t + {seconds!r})", str(formula))

    for force in data["force"]:
        force |= {key: shifted(force[key]) for key in ("formula", "state", "memory", "start") if key in force}
    return parse_library(data, library.source)
