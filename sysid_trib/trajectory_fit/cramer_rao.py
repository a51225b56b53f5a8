"""The errors that no unbiased method can beat (Cramér and Rao), from the sensitivities of the motion."""

from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike, NDArray

from sysid_trib.errors import UsageError
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory

Array = NDArray[np.float64]

# Each unknown is moved until the angle moves by about this part of its own size; central differences.
REACH = 1e-6


def cramer_rao_bound(
    model: Model, time: ArrayLike, angle: float, rate: float, noise: float, *, free: bool = False
) -> xr.Dataset:
    """Smallest standard errors with which a decay in white noise determines its model.

    Parameters
    ----------
    model : the truth; unknown are the coefficients it names, also those that are zero. Shapes are known.
    time : (sample,) s.
    angle, rate : start, rad and rad/s; unknown as well.
    noise : standard deviation of one sample, rad.
    free : whether the reference frequency is unknown too.

    Returns
    -------
    Dataset with `standard_error(force)`, `covariance(force, other_force)` and the scalars
    `start_angle_standard_error` (rad), `start_rate_standard_error` and
    `reference_frequency_standard_error` (rad/s; 0 where it is held).

    Raises
    ------
    UsageError
        Some unknowns are not determined: a force that does not act on this motion, or a force of formula `x`
        beside the frequency.
    """
    time = np.asarray(time, dtype=float)
    symbols = list(model.coefficients)
    table = _sensitivities(model, time, np.array([angle, rate], dtype=float), free)
    # Unknowns differ by orders of magnitude: without scaling the matrix is singular to rounding.
    size = np.linalg.norm(table, axis=0)
    _, singular, axes = np.linalg.svd(table / size, full_matrices=False)
    if singular[-1] < 1e-8 * singular[0]:
        names = [*symbols, "start angle", "start rate", "reference frequency"]
        tied = [name for name, part in zip(names, axes[-1], strict=False) if abs(part) > 1e-3]
        raise UsageError(f"No record can determine {' and '.join(tied)} together; leave one out.")
    covariance = noise**2 * (axes.T / singular**2) @ axes / np.outer(size, size)
    count = len(symbols)
    error = np.sqrt(np.diag(covariance))
    bounds = xr.Dataset(
        {
            "standard_error": ("force", error[:count], {"long_name": "Cramér-Rao bound"}),
            "covariance": (
                ("force", "other_force"),
                covariance[:count, :count],
                {"long_name": "smallest covariance"},
            ),
        },
        {"force": symbols, "other_force": symbols},
    )
    scalars = {
        "start_angle": (error[count], "rad"),
        "start_rate": (error[count + 1], "rad/s"),
        "reference_frequency": (error[count + 2] if free else 0.0, "rad/s"),
    }
    for name, (value, units) in scalars.items():
        long_name = f"Cramér-Rao bound of the {name.replace('_', ' ')}"
        bounds[f"{name}_standard_error"] = ((), float(value), {"units": units, "long_name": long_name})
    return bounds


def _sensitivities(model: Model, time: Array, start: Array, free: bool) -> Array:
    """Derivatives of the angle by coefficients, start and reference frequency, (sample, unknown)."""
    w = model.reference_frequency
    at = np.array([*model.coefficients.values(), *start, *([w] if free else [])], dtype=float)
    count = len(model.coefficients)

    def motion(values: Array) -> Array:
        coefficients = dict(zip(model.coefficients, values[:count].tolist(), strict=True))
        frequency = float(values[-1]) if free else w
        changed = replace(model, coefficients=coefficients, reference_frequency=frequency)
        return trajectory(changed, time, *values[count : count + 2]).angle

    def slope(unit: Array, step: float) -> Array:
        return (motion(at + step * unit) - motion(at - step * unit)) / (2.0 * step)

    swing = float(np.sqrt(np.mean(motion(at) ** 2)))
    columns = []
    for j, unit in enumerate(np.eye(len(at))):
        # An unknown's own scale is not known beforehand: a first small step tells it.
        first = slope(unit, 1e-2 * REACH * swing)
        if not first.any():
            raise UsageError(
                f"Force {list(model.coefficients)[j]} does not act on this motion; leave it out."
            )
        columns.append(slope(unit, REACH * swing / np.sqrt(np.mean(first**2))))
    return np.stack(columns, axis=1)
