"""Limits of curves: friction that depends on the position, or stiffness that depends on the speed."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.errors import SysidTribError
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import EFFECTS
from sysid_trib.methods import Trajectory
from sysid_trib.results import schema
from sysid_trib.results.variables import described
from sysid_trib.smooth_laws.fits import EXTENSION_GAIN, EXTENSION_LEVEL, LawFit, fit_of, p_value_of

# Products of a force of the speed and one of the displacement.
PRODUCTS = (
    *("structural_damping", "angle_damping", "angle_drag", "van_der_pol"),
    *("inertia", "speed_stiffness"),
)
# Places of the map along each axis.
MAP_POINTS = 41


def interaction(fit: LawFit, largest: Mapping[str, float]) -> xr.Dataset | None:
    """Test whether the force is the sum of a law of speed and a law of displacement.

    Parameters
    ----------
    fit : LawFit
        By Direct.
    largest : mapping of str to float
        Largest displacement `x` (rad) and speed `v` (rad/s).

    Returns
    -------
    Dataset or None
        Where the sum is rejected and products of both follow the record better: the map `force(displacement,
        speed)` (rad/s^2) of what the products add, with its `standard_error`; `p_value`; `residual_before`
        and `residual_after` (rad). None elsewhere.
    """
    runs = list(fit.followed.runs.values())
    added = load_library(EFFECTS).select(PRODUCTS)
    named = replace(fit.model.named, forces=(*fit.model.named.forces, *added.forces))
    method = fit.method
    if isinstance(method, Trajectory):
        return None
    try:
        whole = fit_of(runs, method, replace(fit.model, named=named))
    except (SysidTribError, np.linalg.LinAlgError):
        return None
    result = whole.followed.result
    p_value = p_value_of(result, PRODUCTS)
    if p_value >= EXTENSION_LEVEL or not whole.residual_rms < EXTENSION_GAIN * fit.residual_rms:
        return None
    w = result.reference_frequency.item()
    displacement, speed = (np.linspace(-1.0, 1.0, MAP_POINTS) * largest[of] for of in ("x", "v"))
    x, v = np.meshgrid(displacement, speed / w, indexing="ij")
    library = schema.library_of(result).select(PRODUCTS)
    columns = w**2 * np.stack([force.value(x, v) for force in library], axis=-1)
    at = [result.force.values.tolist().index(symbol) for symbol in PRODUCTS]
    covariance = result.covariance.values[np.ix_(at, at)]
    variance = np.einsum("...i,ij,...j->...", columns, covariance, columns)
    values = {
        "force": columns @ result.coefficient.values[at],
        "standard_error": np.sqrt(np.maximum(variance, 0.0)),
        "p_value": p_value,
        "residual_before": fit.residual_rms,
        "residual_after": whole.residual_rms,
    }
    coords = described("interaction", {"displacement": displacement, "speed": speed})
    return xr.Dataset(described("interaction", values), coords)
