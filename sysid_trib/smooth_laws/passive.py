"""Passivity: a friction law that dissipates energy at every speed."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.scope import Method
from sysid_trib.records.runs import Decays
from sysid_trib.results import models
from sysid_trib.results.frequencies import asymptotic_frequency, covariance_with_frequency
from sysid_trib.results.law_curves import NEXT_TO_ZERO, PASSIVE, PASSIVE_DEFICIT
from sysid_trib.smooth_laws import bands

# Below this fraction of its largest value, a force counts as zero at rest.
NOTHING_AT_REST = 1e-5
# Below this fraction of the largest multiplier, a constraint is inactive.
LEAST_MULTIPLIER = 1e-9
# Largest number of steps, and the fraction of the largest power that is attributed to rounding.
PASSIVE_STEPS, POWER_ROUNDING = 5, 1e-9


@dataclass(frozen=True)
class Passive:
    """Method whose friction law is made passive.

    Attributes
    ----------
    method : Method
    largest : mapping of str to float
        Largest displacement `x` (rad) and speed `v` (rad/s) of the runs.
    """

    method: Method
    largest: Mapping[str, float]

    def identify(self, decay: Decays, library: ForceLibrary) -> xr.Dataset:
        """Identify the forces by the method, and make the friction law passive."""
        return made_passive(self.method.identify(decay, library), self.largest)


def made_passive(result: xr.Dataset, largest: Mapping[str, float]) -> xr.Dataset:
    """Return the nearest identification whose friction dissipates energy at every displayed speed.

    Parameters
    ----------
    result : Dataset
        An identification.
    largest : mapping of str to float
        Largest displacement `x` (rad) and speed `v` (rad/s) of its records.

    Returns
    -------
    Dataset
        Coefficients and frequency differ where the constraint is active; attributes `passive_at` and
        `passive_deficit`. Errors are those without the constraint.

    Raises
    ------
    DecayError
        Fixed forces feed energy in.

    Notes
    -----
    Least squares in the metric of the covariance of the estimate. This is the solution of the original
    equations with the inequality, at the smoothness found without it (least distance programming: Lawson &
    Hanson, Solving Least Squares Problems, 1974, Ch. 23).
    """
    acting: set[float] = set()
    deficit = _deficit(result, largest)
    # The constraint is also linear in the frequency, so the second step is tiny.
    for _ in range(PASSIVE_STEPS):
        result, at_speeds = _stepped(result, largest)
        if not at_speeds:
            break
        acting |= at_speeds
    at = json.dumps([speed / largest["v"] for speed in sorted(acting)])
    return result.assign_attrs({PASSIVE: at, PASSIVE_DEFICIT: deficit})


def _deficit(result: xr.Dataset, largest: Mapping[str, float]) -> float:
    """Return the largest number of standard errors by which friction is negative; 0 if it never is."""
    rows = _power_over_speed(result, largest)[1]
    coefficients = np.where(result.active.values, result.coefficient.values, 0.0)
    power, variance = rows[:, :-1] @ coefficients, rows @ covariance_with_frequency(result)
    error = np.sqrt(np.maximum(np.sum(variance * rows, axis=1), 0.0))
    short = np.divide(-power, error, out=np.zeros_like(power), where=error > 0.0)
    return float(np.max(short, initial=0.0))


def _stepped(result: xr.Dataset, largest: Mapping[str, float]) -> tuple[xr.Dataset, set[float]]:
    """Return the nearest identification with a passive law, and the speeds of active constraints."""
    speeds, rows = _power_over_speed(result, largest)
    estimate = np.append(
        np.where(result.active.values, result.coefficient.values, 0.0), result.reference_frequency.item()
    )
    covariance = covariance_with_frequency(result)
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    power = rows[:, :-1] @ estimate[:-1]
    if np.all(power >= -POWER_ROUNDING * np.max(np.abs(power))):
        return result, set()
    # Each row is scaled by its own error; a row that no free coefficient changes cannot be satisfied.
    size = np.linalg.norm(rows @ root, axis=1)
    if np.any((power < 0.0) & (size == 0.0)):
        raise DecayError("Held forces feed energy in, so no friction law is passive together with them.")
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    moves, needed = scale[:, None] * (rows @ root), -scale * power
    step, multipliers = _least_distance(moves, needed)
    changed = estimate + root @ step
    acting = multipliers > LEAST_MULTIPLIER * multipliers.max()
    return _with_values(result, changed, covariance), set(speeds[acting].tolist())


def _power_over_speed(result: xr.Dataset, largest: Mapping[str, float]) -> tuple[Array, Array]:
    """Return speeds (place,), and derivatives of friction * sign(speed) by coefficients and frequency."""
    library = models.library_of(result)
    runs: Sequence[int | None] = sorted({force.run for force in library if force.run}) or [None]
    forces = [force for force in library if force.depends_only_on("v")]
    even = any(force.parity != "odd" for force in forces)
    at_rest = NEXT_TO_ZERO * largest["v"] * np.array([-1.0, 1.0] if even else [1.0])
    places = np.concatenate([at_rest, bands.grid(largest["v"], both_sides=even)[0]])
    jacobians = [bands.law_and_jacobian(result, library, forces, "v", places, run)[1] for run in runs]
    rows = np.vstack([np.where(places < 0.0, -1.0, 1.0)[:, None] * jacobian for jacobian in jacobians])
    # The frequency only scales the speed and changes no sign.
    rows[:, -1] = 0.0
    # At rest, a force without a jump is zero.
    rows[np.abs(rows) < NOTHING_AT_REST * np.max(np.abs(rows), axis=0)] = 0.0
    return np.tile(places, len(runs)), rows


def _least_distance(moves: Array, needed: Array) -> tuple[Array, Array]:
    """Return the shortest step with `moves @ step >= needed`, and the multiplier of each row."""
    width = moves.shape[1]
    # Rows are scaled to similar magnitudes; otherwise the result would depend on rounding of small ones.
    height = float(np.max(np.abs(needed)))
    table = np.vstack([moves.T, needed / height])
    wanted = np.append(np.zeros(width), 1.0)
    multipliers, _ = scipy.optimize.nnls(table, wanted, maxiter=50 * table.shape[1])
    residual = table @ multipliers - wanted
    return np.asarray(-residual[:width] / residual[width] * height), np.asarray(multipliers)


def _with_values(result: xr.Dataset, values: Array, covariance: Array) -> xr.Dataset:
    """Return the identification with other coefficients and another frequency, and the same errors."""
    library, w = models.library_of(result), float(values[-1])
    limit, gradient = asymptotic_frequency(library, values[:-1], w)
    with_frequency = covariance @ gradient if limit > 0.0 else covariance[:, -1]
    variance = float(gradient @ covariance @ gradient) if limit > 0.0 else 0.0
    error = float(np.sqrt(max(variance, 0.0)))
    changed = {
        "coefficient": values[:-1],
        "refers_to": np.full(len(values) - 1, w),
        "reference_frequency": np.array(w),
        "asymptotic_frequency": np.array(limit),
        "asymptotic_frequency_standard_error": np.array(error),
        "frequency_covariance": with_frequency[:-1],
    }
    return result.assign({name: result[name].copy(data=value) for name, value in changed.items()})
