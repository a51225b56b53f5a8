"""On which part of a long record two identifications are held against each other."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods import method_of
from sysid_trib.methods.scope import scope_of
from sysid_trib.results.schema import library_of
from sysid_trib.trajectory_fit.initial_conditions import FittedMotion
from sysid_trib.validation.residuals import fitted_motion
from sysid_trib.validation.simulated_pairs import with_held_random_force

# A long run is compared on its beginning, its middle and its end: from three amplitudes what depends on
# amplitude can be told, which a single stretch of a motion that hardly decays leaves undecided.
STRETCHES = 3
PERIODS_PER_STRETCH = 20
# A run is long where identifying every simulated record whole would take longer than its stretches do, and
# something is gained: three short records cost as much as one of twice their length.
LONGEST_WHOLE = 120


@dataclass(frozen=True)
class ComparedPart:
    """What is compared: runs, or stretches of them, with the identifications of just these.

    Attributes
    ----------
    runs : tuple of Dataset
    results : tuple of Dataset
    motions : tuple of tuples of FittedMotion, or None
        Of each result, in each run.
    duration : float or None, s
        Of each stretch; None where every run is taken whole.
    """

    runs: tuple[xr.Dataset, ...]
    results: tuple[xr.Dataset, ...]
    motions: tuple[tuple[FittedMotion | None, ...], ...]
    duration: float | None = None


def compared_part(whole: ComparedPart) -> ComparedPart:
    """Stretches of long runs, with what both methods identify there.

    Parameters
    ----------
    whole : ComparedPart
        The runs and the identifications of all they hold.

    Returns
    -------
    ComparedPart
        The stretches as runs of one experiment, each with a start of its own; a random force is held at that
        of the whole. As given where no run is longer than `LONGEST_WHOLE` periods, where a force depends on
        time, or where a method cannot identify the stretches.
    """
    frequency = whole.results[1].asymptotic_frequency.item()
    # A model that does not swing at small amplitudes has no period there.
    if not frequency > 0.0:
        return whole
    period = 2.0 * np.pi / frequency
    duration = PERIODS_PER_STRETCH * period
    stretches = tuple(
        part for run in whole.runs for part in _stretches(run, duration, LONGEST_WHOLE * period)
    )
    if len(stretches) == len(whole.runs):
        return whole
    libraries = [library_of(result, whole=True) for result in whole.results]
    methods = [with_held_random_force(method_of(result), result) for result in whole.results]
    if any(_depends_on_time(library) for library in libraries):
        return whole
    if not all(scope_of(method).several_runs for method in methods):
        return whole
    try:
        pairs = zip(methods, libraries, strict=True)
        results = tuple(method.identify(stretches, library) for method, library in pairs)
    except SysidTribError:
        return whole
    return ComparedPart(stretches, results, fitted_motions(stretches, results), duration)


def fitted_motions(
    runs: Sequence[xr.Dataset], results: Sequence[xr.Dataset]
) -> tuple[tuple[FittedMotion | None, ...], ...]:
    """Motions of each result in each run."""
    motions: list[tuple[FittedMotion | None, ...]] = []
    for result in results:
        nearby = motions[0] if motions else [None] * len(runs)
        pairs = enumerate(zip(runs, nearby, strict=True))
        motions.append(tuple(fitted_motion(run, result, at, nearby=near) for at, (run, near) in pairs))
    return tuple(motions)


def _stretches(run: xr.Dataset, duration: float, longest: float) -> list[xr.Dataset]:
    """Beginning, middle and end of a run that is longer than `longest` (s); else the run itself."""
    time = run.time.values
    whole = time[-1] - time[0]
    if whole <= longest:
        return [run]
    starts = time[0] + np.linspace(0.0, 1.0, STRETCHES) * (whole - duration)
    ends = starts + duration
    bounds = zip(np.searchsorted(time, starts), np.searchsorted(time, ends, side="right"), strict=True)
    return [run.isel(time=slice(int(first), int(last))) for first, last in bounds]


def _depends_on_time(library: ForceLibrary) -> bool:
    """Whether a force depends on the time since the first sample, which a stretch counts anew."""
    return any("t" in force.formula.names for force in library)
