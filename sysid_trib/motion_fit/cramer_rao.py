"""The errors that no unbiased method can beat (Cramér and Rao), from the sensitivities of the motion."""

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.likelihood.random_force import RandomForce
from sysid_trib.motion_fit.linearised import whitened
from sysid_trib.results.variables import variable
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.motions import BY_ANGLE, BY_RATE, FREQUENCY
from sysid_trib.simulation.simulate import trajectory


def cramer_rao_bound(
    model: Model,
    time: ArrayLike,
    angle: float,
    rate: float,
    noise: float,
    *,
    free: bool = False,
    random_force: float = 0.0,
) -> xr.Dataset:
    """Smallest standard errors with which a decay in white noise determines its model.

    Parameters
    ----------
    model : Model
        The truth. Its coefficients are estimated, also those that are zero; its shapes are known.
    time : (sample,) array_like of float, s
        Times of the samples.
    angle : float, rad
        Angle at the first sample; estimated as well.
    rate : float, rad/s
        Rate at the first sample; estimated as well.
    noise : float, rad
        Standard deviation of one sample.
    free : bool
        Whether the reference frequency is estimated too.
    random_force : float, (rad/s^2)^2/Hz
        One-sided density of a white acceleration that pushes the motion; it is known.

    Returns
    -------
    xarray.Dataset
        `standard_error(force)`, `covariance(force, other_force)` and the scalars
        `start_angle_standard_error` (rad), `start_rate_standard_error` and
        `reference_frequency_standard_error` (rad/s; 0 where it is held).

    Raises
    ------
    UsageError
        Some parameters are not determined: a force that does not act on this motion, or a force of formula
        `x` besides the frequency.

    Notes
    -----
    The inverse of Fisher's information, J' J / noise^2 with the sensitivities J of the motion. With a
    random force J are the innovations of these sensitivities over their size, by the Kalman filter about the
    motion that nothing pushes.
    """
    time = np.asarray(time, dtype=float)
    symbols = list(model.coefficients)
    start = np.array([angle, rate], dtype=float)
    ratio = RandomForce(random_force).per_tau(model.reference_frequency) / noise**2
    sensitivity = whitened(model, time, (angle, rate), ratio, sensitivities(model, time, start, free))
    # Parameters differ by orders of magnitude: without scaling the matrix is singular to rounding.
    size = np.linalg.norm(sensitivity, axis=0)
    _, singular, axes = np.linalg.svd(sensitivity / size, full_matrices=False)
    if singular[-1] < 1e-8 * singular[0]:
        names = [*symbols, "start angle", "start rate", "reference frequency"]
        dependent = [name for name, part in zip(names, axes[-1], strict=False) if abs(part) > 1e-3]
        raise UsageError(f"No record can determine {' and '.join(dependent)} together; leave one out.")
    covariance = noise**2 * (axes.T / singular**2) @ axes / np.outer(size, size)
    count, both = len(symbols), ("force", "other_force")
    error = np.sqrt(np.diag(covariance))
    bounds = xr.Dataset(
        {
            "standard_error": variable("force", error[:count], "Cramér-Rao bound"),
            "covariance": variable(both, covariance[:count, :count], "smallest covariance"),
        },
        {"force": symbols, "other_force": symbols},
    )
    scalars = {"start_angle": "rad", "start_rate": "rad/s", "reference_frequency": "rad/s"}
    for (name, units), value in zip(scalars.items(), [*error[count:], 0.0], strict=False):
        long_name = f"Cramér-Rao bound of the {name.replace('_', ' ')}"
        bounds[f"{name}_standard_error"] = variable((), float(value), long_name, units)
    return bounds


def sensitivities(model: Model, time: Array, start: Array, free: bool) -> Array:
    """Derivatives of the angle by coefficients, start and reference frequency, (sample, parameter)."""
    names = [*model.coefficients, BY_ANGLE, BY_RATE, *([FREQUENCY] if free else [])]
    columns = trajectory(model, time, *start.tolist(), by=names).derivatives["angle"]
    for name, column in zip(names, columns.T, strict=True):
        if not column.any():
            raise UsageError(f"Force {name} does not act on this motion; leave it out.")
    return columns
