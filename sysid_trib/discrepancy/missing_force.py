"""The force that a residual asks for, by the equation of motion, over angle and rate."""

from collections.abc import Sequence

import numpy as np
import xarray as xr
from scipy.stats import binned_statistic_2d

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.free_motion import FreeMotion
from sysid_trib.noise.smoothing import smooth
from sysid_trib.results.variables import variable

# Cells of the map, each way.
CELLS = 11
# Drawings of noise, for the errors of the map.
DRAWS = 32


def mean_missing_force(runs: Sequence[FreeMotion]) -> xr.Dataset:
    """Mean force that residuals ask for, in cells of angle and rate.

    Parameters
    ----------
    runs : sequence of FreeMotion

    Returns
    -------
    xr.Dataset
        Over `x` and `v` (rad): `force` as a part of I w^2 (nan without samples), its `standard_error` by the
        noise alone, and the number of `samples`.
    """
    cells = [(run.x, run.v, _force(run), _force_of_noise(run)) for run in runs]
    x, v, force, drawn = (np.concatenate(part, axis=-1) for part in zip(*cells, strict=True))
    size = 1.001 * float(np.max(np.hypot(x, v)))
    edges = np.linspace(-size, size, CELLS + 1)
    good = np.isfinite(force)
    if not np.any(good):
        # Where a smoothed residual has no middle, as in a record of a period: every cell is empty.
        good, force = np.ones(len(x), dtype=bool), np.full(len(x), np.nan)
    values = np.concatenate([np.ones((1, len(x))), force[None], drawn])[:, good]
    binned = binned_statistic_2d(x[good], v[good], values, "sum", bins=[edges, edges]).statistic
    samples = binned[0]
    mean, *scatter = np.where(samples > 0, binned[1:] / np.maximum(samples, 1.0), np.nan)
    error = np.sqrt(np.mean(np.square(scatter), axis=0))
    middle = 0.5 * (edges[1:] + edges[:-1])
    both = ("x", "v")
    return xr.Dataset(
        {
            "force": variable(both, mean, "force that the residual asks for, over I w^2", "rad"),
            "standard_error": variable(both, error, "standard error of that force by the noise", "rad"),
            "samples": variable(both, samples, "number of samples", "1"),
        },
        {
            "x": variable("x", middle, "angle", "rad"),
            "v": variable("v", middle, "angular rate over w", "rad"),
        },
    )


def _force(run: FreeMotion) -> Array:
    """The force that would make the residual over I w^2, by its equation of motion.

    Both motions are smoothed alike, so that what smoothing takes from them cancels.
    """
    model, time = run.model, run.time - run.time[0]
    tau = model.reference_frequency * time
    angle, rate, curvature, _ = smooth(tau, run.residual)
    asked = -(curvature + angle)
    for force in model.library:
        if force.memoryless and force.kind == "force":
            with_residual, without = (
                force.value(run.x + part * angle, run.v + part * rate, time, shapes=model.shapes)
                for part in (1.0, 0.0)
            )
            asked = asked - model.coefficients.get(force.symbol, 0.0) * (with_residual - without)
    # A spline bends freely in the quarter period before its ends.
    inside = np.minimum(tau, tau[-1] - tau) > 0.5 * np.pi
    return np.where(inside, asked, np.nan)


def _force_of_noise(run: FreeMotion) -> Array:
    """The same of drawings of the noise, (draw, sample); what it does to the model's forces is small."""
    drawn = run.noise.draws(len(run.time), DRAWS)
    angle, _, curvature, _ = smooth(run.model.reference_frequency * run.time, drawn.T)
    return np.asarray(-(curvature + angle).T)
