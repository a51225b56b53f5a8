"""Where a model says nothing of a record: its motion breaks down, or its errors leave out what is left."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.noise.level import sensor_noise
from sysid_trib.noise.random_force import random_force_of
from sysid_trib.records.runs import root_mean_square
from sysid_trib.results.per_run import record_groups

PARTS_OF_RECORD = ("first", "second", "last")
DIVERGES = "its motion diverges"
# Of the largest angle of the record; a motion that grows beyond is none of it.
LARGEST_MOTION = 3.0
NO_NEARER = "over the {} third{} its motion is no nearer to the record than rest"


def record_noise(tree: xr.DataTree) -> float:
    """The sensor's noise of the records in a result, rad: RMS over the runs of `sensor_noise`.

    The one noise beside which tables, sentences and figures show residuals: it is the record's, whatever the
    model.
    """
    return root_mean_square([run_record_noise(tree, run) for run in range(len(record_groups(tree)))])


def run_record_noise(tree: xr.DataTree, run: int) -> float:
    """The same of one run."""
    return sensor_noise(tree[record_groups(tree)[run]].to_dataset())


def breakdown(tree: xr.DataTree, model: str) -> str:
    """Why there is no motion of a model, in a few words; empty where there is one, even far from the record.

    Parameters
    ----------
    tree : DataTree
        With `simulated_angle(model, time)` in its records.
    model : str
        Which of the models.
    """
    groups = record_groups(tree)
    for at, group in enumerate(groups):
        simulated = np.abs(tree[group].simulated_angle.sel(model=model).values)
        if not np.max(simulated) <= LARGEST_MOTION * np.max(np.abs(tree[group].angle.values)):
            return f"{DIVERGES}{f' in run {at + 1}' if len(groups) > 1 else ''}"
    return ""


def no_nearer_than_rest(angle: Array, residual: Array) -> str:
    """Over which third of a record a model is as far from it as rest, as a text to name the run in; or none.

    Parameters
    ----------
    angle, residual : (sample,) array of float, rad
        The record about its equilibrium, and record minus model.
    """
    if not np.all(np.isfinite(residual)):
        return DIVERGES
    thirds = zip(PARTS_OF_RECORD, np.array_split(angle, 3), np.array_split(residual, 3), strict=True)
    for name, motion, missed in thirds:
        if np.sum(missed**2) >= np.sum(motion**2):
            return NO_NEARER.format(name, "{}")
    return ""


def widening(result: xr.Dataset, residual_over_noise: float) -> float:
    """By how much stated errors are to be widened where a model does not explain the record; 1 at least.

    Parameters
    ----------
    result : Dataset
        An identification.
    residual_over_noise : float
        RMS of record minus model over the noise.

    Notes
    -----
    Birge 1932: errors by the noise alone times the residual over the noise. What a method has widened
    already, by the Birge ratio of its own equations, is not widened twice; nor is what it takes for a random
    force, which its errors allow for.
    """
    return 1.0 if random_force_of(result) else max(1.0, residual_over_noise / stated_widening(result))


def stated_widening(result: xr.Dataset) -> float:
    """By how much the errors that a method states exceed those by the noise alone; 1 at least."""
    return max(1.0, float(result.birge_ratio)) if "birge_ratio" in result else 1.0
