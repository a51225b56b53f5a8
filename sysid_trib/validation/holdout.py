"""A part of a decay held out: how a model follows what it has not seen, and whether another does better."""

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import t as student

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import parse_library
from sysid_trib.records.runs import root_mean_square
from sysid_trib.results.schema import library_of
from sysid_trib.trajectory_fit.initial_conditions import FittedMotion
from sysid_trib.validation.cross_check_statistics import fitted_motion

Array = NDArray[np.float64]

# Of the time of a decay, what a model is identified from where the rest is to be predicted.
TRAINING = 2.0 / 3.0
# In antiphase (rad) a model has lost the record: its RMS says nothing more of the forces.
SLIPPED = np.pi
TIME = re.compile(r"\bt\b")


@dataclass(frozen=True)
class Followed:
    """How the motion of a model follows a record, its start and the sensor's zero fitted there.

    Attributes
    ----------
    gap : (sample,) rad, record minus model; phase_error : rad, the largest, nan of a motion that stops early.
    stop_time : s, nan if the model does not stop within the record.
    """

    gap: Array
    phase_error: float
    stop_time: float

    @property
    def rms(self) -> float:
        """RMS of the gap, rad."""
        return float(np.sqrt(np.mean(self.gap**2)))

    @property
    def complaint(self) -> str:
        """Why the motion is not the record's, in a few words; nothing if it is."""
        if np.isfinite(self.stop_time):
            return f"stops at {self.stop_time:.3g} s"
        if self.phase_error > SLIPPED:
            return f"slips by {self.phase_error / (2.0 * np.pi):.2g} periods"
        return ""


@dataclass(frozen=True)
class FollowedRuns:
    """How the motions of one model follow several runs, or the one there is.

    Attributes
    ----------
    runs : each run's; noises : rad, of one sample of each.
    """

    runs: tuple[Followed, ...]
    noises: tuple[float, ...]

    @property
    def each_rms(self) -> Array:
        """RMS of the gap in each run, rad."""
        return np.array([run.rms for run in self.runs])

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
        """The largest of all runs, rad; nan if one stops early."""
        return float(np.max([run.phase_error for run in self.runs]))

    @property
    def complaint(self) -> str:
        """Why the motion of a run is not the record's, and of which; nothing if all are."""
        for at, run in enumerate(self.runs):
            if run.complaint:
                return f"{run.complaint} in run {at + 1}" if len(self.runs) > 1 else run.complaint
        return ""


@dataclass(frozen=True)
class RunInParts:
    """A decay, what is identified from and what is held out, and its envelope."""

    decay: xr.Dataset
    train: xr.Dataset
    rest: xr.Dataset
    measured: xr.Dataset

    @property
    def noise(self) -> float:
        """Of one sample, rad."""
        return float(self.measured.noise.item())

    @property
    def block(self) -> int:
        """Samples of a period."""
        step = float(np.median(np.diff(self.decay.time.values)))
        return max(1, round(2 * float(np.median(np.diff(self.measured.extremum_time))) / step))

    @property
    def labelled(self) -> xr.Dataset:
        """The record with the time at which the part held out starts."""
        about = {"units": "s", "long_name": "start of the part held out"}
        return self.decay.assign(holdout_start=((), float(self.rest.time.values[0]), about))


def split(decay: xr.Dataset) -> tuple[xr.Dataset, xr.Dataset]:
    """The first two thirds of a decay by time, and the last."""
    time = decay.time.values.astype(float)
    first = int(np.searchsorted(time, time[0] + TRAINING * (time[-1] - time[0])))
    return decay.isel(time=slice(0, first)), decay.isel(time=slice(first, None))


def followed(decay: xr.Dataset, result: xr.Dataset, measured: xr.Dataset, run: int = 0) -> Followed | None:
    """How an identified model follows the decay, or the run, it is from; None if it diverges.

    `measured` : the record's envelope, whose extrema give its phase.
    """
    motion = fitted_motion(decay, result, run)
    return None if motion is None else _held_against(decay, motion, measured)


def predicted(
    part: xr.Dataset, result: xr.Dataset, measured: xr.Dataset, first_time: float
) -> Followed | None:
    """How a model identified from an earlier part of a decay follows a later part; None if it diverges.

    `first_time` : s, of the decay's first sample, from which `t` in a formula counts. States of forces with
    a past begin anew, as after a release.
    """
    later = _counted_from(result, float(part.time.values[0] - first_time))
    return followed(part, later.drop_vars(["start_angle", "start_rate"], errors="ignore"), measured)


def no_better(gaps: Sequence[Array], best: Sequence[Array], blocks: Sequence[int]) -> float:
    """Probability by chance of as large a ratio between two models' squared errors (two-sided).

    Parameters
    ----------
    gaps, best : (sample,) rad of each run, what each model leaves of the same runs.
    blocks : samples of each run over which errors may be correlated, a period.

    Notes
    -----
    Diebold & Mariano 1995, with the logarithm of the mean square over a block as the loss: a decay's last
    swings then count as its first. Blocks are taken as independent; Student's distribution.
    """
    sides = [
        np.concatenate([_block_losses(gap, block) for gap, block in zip(each, blocks, strict=True)])
        for each in (gaps, best)
    ]
    loss = sides[0] - sides[1]
    count = len(loss)
    if count < 3:
        return float("nan")
    spread = float(loss.std(ddof=1))
    if spread == 0.0:
        return float(loss[0] == 0.0)
    return float(2.0 * student.sf(abs(loss.mean()) / spread * np.sqrt(count), count - 1))


def _block_losses(gap: Array, block: int) -> Array:
    """Logarithm of the mean square of a gap over each whole block."""
    count = len(gap) // block
    squares = np.mean(gap[: count * block].reshape(count, block) ** 2, axis=1)
    return np.asarray(np.log(np.maximum(squares, 1e-300)))


def _held_against(decay: xr.Dataset, motion: FittedMotion, measured: xr.Dataset) -> Followed:
    time = decay.time.values.astype(float)
    gap = decay.angle.values - motion.offset - motion.x
    stop = motion.stop_time if motion.stop_time < time[-1] else float("nan")
    error = float("nan") if np.isfinite(stop) else _phase_error(time, motion, measured)
    return Followed(np.asarray(gap, dtype=float), error, stop)


def _phase_error(time: Array, motion: FittedMotion, measured: xr.Dataset) -> float:
    """Largest angle (rad) between the phase of a motion and the record's, at the record's extrema."""
    inside = (measured.extremum_time.values > time[0]) & (measured.extremum_time.values < time[-1])
    turns, sign = measured.extremum_time.values[inside], measured.sign.values[inside]
    if not len(turns):
        return float("nan")
    phase = np.interp(turns, time, np.unwrap(np.arctan2(-motion.v, motion.x)))
    ahead = phase - np.pi * np.arange(len(turns)) - (0.0 if sign[0] > 0 else np.pi)
    # Whole turns count from where the two are nearest: the start's own are arbitrary.
    middle = 2.0 * np.pi * np.round(np.median(ahead) / (2.0 * np.pi))
    return float(np.max(np.abs(ahead - middle)))


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

    def moved(formula: Any) -> Any:
        if isinstance(formula, dict):
            return {name: moved(text) for name, text in formula.items()}
        return TIME.sub(f"(t + {seconds!r})", str(formula))

    for force in data["force"]:
        force |= {key: moved(force[key]) for key in ("formula", "state", "memory", "start") if key in force}
    return parse_library(data, library.source)
