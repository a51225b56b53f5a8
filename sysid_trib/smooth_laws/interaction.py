"""Limits of the laws: friction that depends on position, or stiffness that depends on speed."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import EFFECTS
from sysid_trib.methods import Direct
from sysid_trib.records.smoothing import smooth
from sysid_trib.results import models
from sysid_trib.results.variables import described
from sysid_trib.smooth_laws.fits import (
    EXTENSION_GAIN,
    EXTENSION_LEVEL,
    REFINEMENTS_OF_EXTENSION,
    LawFit,
    fit_of,
    p_value_of,
)

# Products of a force of the speed and a force of the displacement.
PRODUCTS = (
    *("structural_damping", "angle_damping", "angle_drag", "van_der_pol"),
    *("inertia", "speed_stiffness"),
)
# Points of the map along each axis.
MAP_POINTS = 41


def interaction(fit: LawFit, largest: Mapping[str, float]) -> xr.Dataset | None:
    """Test whether the force is the sum of a law of speed and a law of displacement.

    Parameters
    ----------
    fit : LawFit
        Fit by Direct.
    largest : mapping of str to float
        Largest displacement `x` (rad) and speed `v` (rad/s).

    Returns
    -------
    Dataset or None
        If the sum is rejected and products of both follow the record better: the map
        `force(displacement, speed)` (rad/s^2) of the products' contribution, with its `standard_error` and
        the points that the runs visit (`visited`); `p_value`; `residual_before` and `residual_after` (rad).
        Otherwise None.
    """
    whole = with_products(fit)
    if whole is None:
        return None
    result = whole.followed.result
    p_value = p_value_of(result, PRODUCTS)
    if p_value >= EXTENSION_LEVEL or not whole.residual_rms < EXTENSION_GAIN * fit.residual_rms:
        return None
    w = result.reference_frequency.item()
    displacement, speed = (np.linspace(-1.0, 1.0, MAP_POINTS) * largest[of] for of in ("x", "v"))
    x, v = np.meshgrid(displacement, speed / w, indexing="ij")
    library = models.library_of(result).select(PRODUCTS)
    columns = w**2 * np.stack([force.value(x, v) for force in library], axis=-1)
    at = [result.force.values.tolist().index(symbol) for symbol in PRODUCTS]
    covariance = result.covariance.values[np.ix_(at, at)]
    variance = np.einsum("...i,ij,...j->...", columns, covariance, columns)
    values = {
        "force": columns @ result.coefficient.values[at],
        "standard_error": np.sqrt(np.maximum(variance, 0.0)),
        "visited": _visited(list(fit.followed.runs.values()), displacement, speed, w),
        "p_value": p_value,
        "residual_before": fit.residual_rms,
        "residual_after": whole.residual_rms,
    }
    coords = described("interaction", {"displacement": displacement, "speed": speed})
    return xr.Dataset(described("interaction", values), coords)


def with_products(fit: LawFit, *, refine: bool = True) -> LawFit | None:
    """Return the fit with products of speed and displacement added to the laws; None if there is none."""
    method = fit.method_from_here(REFINEMENTS_OF_EXTENSION)
    if not isinstance(method, Direct):
        return None
    added = load_library(EFFECTS).select(PRODUCTS)
    named = replace(fit.model.named, forces=(*fit.model.named.forces, *added.forces))
    runs = list(fit.followed.runs.values())
    try:
        return fit_of(runs, replace(method, refine=refine), replace(fit.model, named=named))
    except (SysidTribError, np.linalg.LinAlgError):
        return None


def _visited(runs: Sequence[xr.Dataset], displacement: Array, speed: Array, w: float) -> Mask:
    """Return the mask of points of a map between the smallest and the largest swing of the runs."""
    largest = float(displacement.max()), float(speed.max())

    def size(x: Array, v: Array) -> Array:
        return np.asarray(np.hypot(x / largest[0], v / largest[1]))

    sizes = []
    for run in runs:
        time = run.time.values.astype(float)
        x, v, *_ = smooth(w * (time - time[0]), run.angle.values.astype(float))
        sizes.append(size(x, w * v))
    everywhere = size(*np.meshgrid(displacement, speed, indexing="ij"))
    every = np.concatenate(sizes)
    return np.asarray((everywhere >= every.min()) & (everywhere <= every.max()))


# If the sum of law and products is known this many times better than the law, only the sum is determined.
BETTER_KNOWN = 5.0
# Standard error of the law's part, relative to the sum, below which it is known well enough.
WELL_KNOWN = 0.2
CYCLE_POINTS = 256


def readings(fit: LawFit, amplitude: float) -> xr.Dataset | None:
    """Test whether the runs separate friction that changes with speed from friction that depends on position.

    Parameters
    ----------
    fit : LawFit
        Fit by Direct.
    amplitude : float
        Amplitude of the cycle over which forces are averaged, rad.

    Returns
    -------
    Dataset or None
        `sum`, the damping ratio of the friction law and of products of speed and displacement together over a
        cycle; its `standard_error`; `error_of_law`, that of the friction law's part alone; and whether the
        two are `separated`. None if the fit is impossible.

    Notes
    -----
    From the covariance of all coefficients: if two readings have the same average over a cycle, their errors
    cancel in the sum. The columns are computed from the smoothed record, which is accurate enough for errors.
    """
    whole = with_products(fit, refine=False)
    if whole is None:
        return None
    result = whole.followed.result
    library = models.library_of(result)
    phase = 2.0 * np.pi * np.arange(CYCLE_POINTS) / CYCLE_POINTS
    x, v = amplitude * np.cos(phase), -amplitude * np.sin(phase)
    shapes = models.shape_values_of(result)
    of_law, of_products = np.zeros((2, len(library)))
    for at, force in enumerate(library):
        # A viscous force 2 v has a damping ratio of 1.
        ratio = np.mean(force.value(x, v, shapes=shapes) * v) / amplitude**2
        if force.depends_only_on("v"):
            of_law[at] = ratio
        elif force.symbol in PRODUCTS:
            of_products[at] = ratio
    both, covariance = of_law + of_products, result.covariance.values
    total = float(both @ result.coefficient.values)
    error, of_law_alone = (float(np.sqrt(max(row @ covariance @ row, 0.0))) for row in (both, of_law))
    values = {
        "sum": total,
        "standard_error": error,
        "error_of_law": of_law_alone,
        "separated": of_law_alone <= max(BETTER_KNOWN * error, WELL_KNOWN * abs(total)),
        "amplitude": amplitude,
    }
    return xr.Dataset(described("readings", values))
