"""Prediction of what a fit has not seen: which part is held out, and whether another model does better."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import xarray as xr
from scipy.stats import ttest_1samp

from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import counted_from
from sysid_trib.methods import method_of
from sysid_trib.methods.scope import scope_of
from sysid_trib.records.smoothing import least_squares_spline
from sysid_trib.results.schema import library_of, model_of
from sysid_trib.simulation import initial_conditions, internal_states
from sysid_trib.validation.residuals import fitted_motion, motion_residual
from sysid_trib.validation.simulated_pairs import with_held_random_force

PERIODS_PER_STRETCH = 20
# A run is long where identifying every simulated record whole would take longer than its stretches do, and
# something is gained: three short records cost as much as one of twice their length.
LONGEST_WHOLE = 120


def compared_part(
    runs: Sequence[xr.Dataset], results: Sequence[xr.Dataset]
) -> tuple[Sequence[xr.Dataset], Sequence[xr.Dataset], float | None]:
    """Stretches of long runs, with what both methods identify there.

    Parameters
    ----------
    runs, results : sequence of Dataset
        The runs, and the identifications of all they hold.

    Returns
    -------
    runs, results : sequence of Dataset
        The stretches as runs of one experiment, each with a start of its own; a random force is held at that
        of the whole. As given where no run is longer than `LONGEST_WHOLE` periods, where a force depends on
        time, or where a method cannot identify the stretches.
    duration : float or None, s
        Of each stretch; None where every run is taken whole.
    """
    whole, frequency = (runs, results, None), results[1].asymptotic_frequency.item()
    # A model that does not swing at small amplitudes has no period there.
    if not frequency > 0.0:
        return whole
    period = 2.0 * np.pi / frequency
    duration = PERIODS_PER_STRETCH * period
    parts = [part for run in runs for part in stretches(run, duration, LONGEST_WHOLE * period)]
    if len(parts) == len(runs):
        return whole
    libraries = [library_of(result, whole=True) for result in results]
    methods = [with_held_random_force(method_of(result), result) for result in results]
    # A stretch counts the time since the first sample anew.
    if any("t" in force.formula.names for library in libraries for force in library):
        return whole
    if not all(scope_of(method).several_runs for method in methods):
        return whole
    try:
        pairs = zip(methods, libraries, strict=True)
        return parts, [method.identify(parts, library) for method, library in pairs], duration
    except SysidTribError:
        return whole


def fitted_motions(
    runs: Sequence[xr.Dataset], results: Sequence[xr.Dataset]
) -> tuple[tuple[initial_conditions.FittedMotion | None, ...], ...]:
    """Motions of each result in each run."""
    motions: list[tuple[initial_conditions.FittedMotion | None, ...]] = []
    for result in results:
        nearby = motions[0] if motions else [None] * len(runs)
        pairs = enumerate(zip(runs, nearby, strict=True))
        motions.append(tuple(fitted_motion(run, result, at, nearby=near) for at, (run, near) in pairs))
    return tuple(motions)


def stretches(run: xr.Dataset, duration: float, longest: float) -> list[xr.Dataset]:
    """Beginning, middle and end, of `duration` (s), of a run longer than `longest`; else the run itself."""
    time = run.time.values
    whole = time[-1] - time[0]
    if whole <= longest:
        return [run]
    # A long run is compared on its beginning, its middle and its end: from three amplitudes what depends on
    # amplitude can be told, which a single stretch of a motion that hardly decays leaves undecided.
    starts = time[0] + np.linspace(0.0, 1.0, 3) * (whole - duration)
    ends = starts + duration
    bounds = zip(np.searchsorted(time, starts), np.searchsorted(time, ends, side="right"), strict=True)
    return [run.isel(time=slice(int(first), int(last))) for first, last in bounds]


# The part of a decay's time from which a model is identified where the rest is to be predicted.
TRAINING = 2.0 / 3.0


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


def up_to_held_out(decay: xr.Dataset) -> xr.Dataset:
    """The first two thirds of a decay and one sample, the first of the last third."""
    return decay.isel(time=slice(0, first_held_out(decay.time.values.astype(float)) + 1))


def in_all_runs(
    runs: Sequence[xr.Dataset],
    result: xr.Dataset,
    envelopes: Sequence[xr.Dataset],
    before: Sequence[xr.Dataset] | None = None,
) -> list[xr.Dataset]:
    """`motion_residual` of an identified model in each run; nothing where it diverges in one.

    Parameters
    ----------
    runs : sequence of Dataset
        The runs it is from, or later parts of these.
    result : Dataset
        The identification.
    envelopes : sequence of Dataset
        Of the whole runs, whose extrema give their phase.
    before : sequence of Dataset, optional
        Of later parts: the run up to the part's first sample, and with it (see `carried_on`).
    """
    motions = []
    for at, (run, envelope) in enumerate(zip(runs, envelopes, strict=True)):
        later = result
        if before is not None:
            later = carried_on(result, library_of(result, whole=True), before[at])
        motion = motion_residual(run, later, envelope, at)
        if motion is None or not np.all(np.isfinite(motion.residual)):
            return []
        motions.append(motion)
    return motions


def carried_on(result: xr.Dataset, library: ForceLibrary, before: xr.Dataset) -> xr.Dataset:
    """The identification as it holds for a motion that begins at the last sample of `before`.

    Parameters
    ----------
    result : Dataset
        The identification.
    library : ForceLibrary
        Its forces, `t` counted from the first sample of `before`.
    before : Dataset
        `angle(time)` up to where the motion begins.
    """
    model = model_of(result)
    time = before.time.values.astype(float)
    elapsed = time - time[0]
    tau = model.reference_frequency * elapsed
    if len(time) > 1 and not all(force.memoryless for force in library):
        spline, x = least_squares_spline(tau, before.angle.values.astype(float))
        motion = tau, x, spline(tau, 1)
        forces = [internal_states.begun_after(force, *motion, model.shapes, elapsed) for force in library]
        library = replace(library, forces=tuple(forces))
    later = result.assign_attrs(library=counted_from(library, float(elapsed[-1])).to_toml())
    return later.drop_vars(["start_angle", "start_rate"], errors="ignore")


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
    of_runs = zip(first, second, blocks, strict=True)
    losses = [_block_losses(own, block) - _block_losses(other, block) for own, other, block in of_runs]
    difference = np.concatenate(losses)
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
