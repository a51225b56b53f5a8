"""What an overview of a result shows, as numbers to draw, the same on paper and on a page."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.errors import SysidTribError
from sysid_trib.physics.force_weights import weights
from sysid_trib.plots.discovery_data import COLOUR_PERCENT, DOT_BEYOND, held_out_sentence
from sysid_trib.plots.looked import curves_of
from sysid_trib.plots.motion_panels import MotionData, motion_data
from sysid_trib.plots.style import MODEL_LINES
from sysid_trib.records.half_sines import envelope
from sysid_trib.results.files import kind_of
from sysid_trib.results.significance import determines
from sysid_trib.results.variables import record_groups
from sysid_trib.validation.cross_check import LARGE
from sysid_trib.validation.findings import answer_of, holds, kept_results
from sysid_trib.validation.residual_force import residual_force
from sysid_trib.validation.residuals import fitted_motion
from sysid_trib.validation.verdict import run_record_noise

# Amplitudes between which shares are drawn.
DRAWN_AMPLITUDES = 60
# Standard errors of a 95 % interval.
INTERVAL = 1.96


@dataclass(frozen=True)
class OverviewData:
    """A result at a glance.

    Attributes
    ----------
    motion : MotionData
        The record and the models that are drawn.
    results : mapping of str to Dataset
        Identifications whose coefficients are shown, the main one last; none where all have failed.
    weighed : Dataset, or None
        `weights` of the main one over amplitude; none where a force is not finite there.
    missing : Dataset, or None
        `residual_force`; none where the samples do not determine the motion.
    holds : bool
        Whether the model explains the record.
    models : tuple of str
        Those whose motions are drawn: of a discovery the last alone.
    held_out : str
        What of the record a discovery held out, as a sentence.
    of_discovery : bool
        Whether `story` shows the residuals and what is missing.
    backbone : pair of Dataset, or None
        `curves_of` the run: of the record, and of the models; none of few half periods, or without a check.
    """

    motion: MotionData
    results: Mapping[str, xr.Dataset]
    weighed: xr.Dataset | None
    missing: xr.Dataset | None
    holds: bool
    models: tuple[str, ...]
    held_out: str
    of_discovery: bool
    backbone: tuple[xr.Dataset, xr.Dataset | None] | None = None

    @property
    def units(self) -> str:
        """Unit of the record."""
        return self.motion.units

    @property
    def colour_limit(self) -> float:
        """Missing force at which colours end, in small units: what is but noise stays pale."""
        assert self.missing is not None
        force, error = (self.missing[name].values for name in ("force", "force_standard_error"))
        ends = (
            np.nanpercentile(np.abs(force), COLOUR_PERCENT),
            DOT_BEYOND * np.nanpercentile(error, COLOUR_PERCENT),
        )
        return self.motion.small_units[0] * float(max(ends)) or 1.0


def _is_incomplete(tree: xr.DataTree) -> bool:
    """True if the final model of a discovery lacks something; else names alone are in doubt."""
    tests = [tree[group].significant.isel(selection_step=-1) for group in ("omnibus", "ranking")]
    return tree.attrs["verdict"] == "unknown effect" and any(test.values.any() for test in tests)


def overview_data(tree: xr.DataTree, run: int = 0) -> OverviewData:
    """The overview of a run in a result of `cross_check`, `compare` or `discover`.

    Parameters
    ----------
    tree : DataTree
        The result.
    run : int
        Which of several runs, from 0.
    """
    record = tree[record_groups(tree)[run]].to_dataset()
    if kind_of(tree) == "discover":
        results = {"final model": tree["after"].to_dataset()}
        explained = not _is_incomplete(tree) and determines(results["final model"])
        drawn = motion_data(tree, run)
    elif kind_of(tree) == "compare":
        best = tree["comparison"].attrs["best"]
        results, drawn = {best: tree[best].to_dataset()}, _best_motion(tree, run)
        explained = bool(tree["comparison"].holdout_over_noise.sel({"method": best}) <= LARGE)
    else:
        results, drawn, explained = kept_results(tree), motion_data(tree, run), holds(tree)
        # The last is drawn as the main one.
        results = dict(sorted(results.items(), key=lambda pair: pair[0] == answer_of(tree)))
    main = next(reversed(results.values()), None)
    # A model that failed has no weights, but what it lacks can be seen.
    of_surface = main if main is not None else tree[tree["comparison"].attrs["second"]].to_dataset()
    weighed = missing = None
    with suppress(SysidTribError):
        missing = residual_force(record[["angle"]], of_surface, run)
    with suppress(SysidTribError):
        if main is not None:
            halves = envelope(record[["angle"]])
            # `t` of a formula is the time since the first sample.
            halves = halves.assign(elapsed=halves.instant_time - float(record.time[0]))
            weighed = _weights(main, halves)
    models = tuple(drawn.lines)[-1 if kind_of(tree) == "discover" else 0 :]
    held = held_out_sentence(tree)
    curves = None
    if any(name.startswith("lack_of_fit") for name in tree.children):
        with suppress(KeyError):
            curves = curves_of(tree, run)
    of_discovery = kind_of(tree) == "discover"
    return OverviewData(drawn, results, weighed, missing, explained, models, held, of_discovery, curves)


def _best_motion(tree: xr.DataTree, run: int) -> MotionData:
    """The record with the motion of the method that predicts best."""
    best = tree["comparison"].attrs["best"]
    record = tree[record_groups(tree)[run]].to_dataset()
    motion = fitted_motion(record, tree[best].to_dataset(), run)
    noise = run_record_noise(tree, run)
    if motion is None:
        return MotionData(record, noise, {}, {best: best})
    angle = (("model", "time"), (motion.x + motion.offset)[None])
    shown = record.assign_coords(model=[best]).assign(simulated_angle=angle)
    return MotionData(shown, noise, {best: MODEL_LINES[1]}, {best: best})


def _weights(result: xr.Dataset, halves: xr.Dataset) -> xr.Dataset:
    """Weights of the forces over the amplitudes of a decay, each at its own time."""
    order = np.argsort(halves.amplitude.values)
    amplitude, since = halves.amplitude.values[order], halves.elapsed.values[order]
    drawn = np.linspace(float(amplitude[0]), float(amplitude[-1]), DRAWN_AMPLITUDES)
    return weights(result, drawn, time=np.interp(drawn, amplitude, since))
