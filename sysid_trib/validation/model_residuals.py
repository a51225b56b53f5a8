"""Residuals of the simulated motions of identified models: size, phase error, and what is wrong with them."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.records.runs import root_mean_square
from sysid_trib.trajectory_fit.initial_conditions import FittedMotion
from sysid_trib.validation.residuals import fitted_motion

# In antiphase (rad) the residual says nothing more of the forces.
ANTIPHASE = np.pi


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
