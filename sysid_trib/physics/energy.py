"""Energy that each force takes in a cycle, and when the motion ends."""

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.cycles.averaged_motion import predict_envelope
from sysid_trib.cycles.signatures import averages
from sysid_trib.errors import SimulationError, UsageError
from sysid_trib.physics.force_weights import shares
from sysid_trib.physics.model_estimate import (
    ModelEstimate,
    amplitude_row,
    check_quantity,
    model_estimate,
    propagate,
)
from sysid_trib.results.variables import described, variable, with_error
from sysid_trib.simulation.simulate import trajectory


def dissipated_energy(
    result: xr.Dataset,
    amplitude: ArrayLike,
    inertia: float | None = None,
    *,
    inertia_standard_error: float = 0.0,
    time: ArrayLike = 0.0,
) -> xr.Dataset:
    """Energy that each force takes from a cycle, to first order in the forces.

    Parameters
    ----------
    result : Dataset
        An identification.
    amplitude : float or (amplitude,) array of float, rad
        A number or one row of them.
    inertia : float, kg m^2, optional
        Moment of inertia; without it energies are in units of I w^2.
    inertia_standard_error : float, kg m^2
        Its standard error.
    time : float or (amplitude,) array of float, s
        `t` of the formulas, at all amplitudes or at each.

    Returns
    -------
    Dataset
        Over `force` (and `amplitude`): `energy` = -2 pi a c <h sin phi> (rad^2, in units of I w^2; J with an
        inertia; negative where a force feeds energy in) and `energy_share`, each over the sum of their
        sizes; `total_energy` and `lost_fraction`, the total over a^2/2. Each with its standard error.

    Raises
    ------
    UsageError
        Not an identification, not positive angles, or no positive inertia.
    """
    estimate, a = model_estimate(result), amplitude_row(amplitude)
    if inertia is not None:
        check_quantity("inertia", inertia, inertia_standard_error)
    at = np.broadcast_to(np.asarray(time, float), a.shape)
    sine = np.array([averages(f, a, estimate.shapes, at)[0] for f in estimate.forces])
    unit = -2.0 * np.pi * a * sine
    taken, covariance = estimate.coefficients[:, None] * unit, estimate.coefficient_covariance

    def energies(z: Array) -> Array:
        """Energy of each force, of all, and of all as a part of a^2/2."""
        of_forces, factor = z[: len(unit), None] * unit, 1.0 if inertia is None else z[-1] * z[-2] ** 2
        total = of_forces.sum(axis=0)
        return np.vstack([factor * of_forces, factor * total, total / (0.5 * a**2)])

    energy, error = propagate(energies, *estimate.with_inertia(inertia or 1.0, inertia_standard_error))
    units, both = "rad2" if inertia is None else "J", ("force", "amplitude")
    data = (
        with_error("energy", both, (energy[:-2], error[:-2]), "energy taken from a cycle", units)
        | described("weights", {"energy_share": shares(taken, unit, covariance)})
        | with_error("total_energy", both[1:], (energy[-2], error[-2]), "energy lost in a cycle", units)
        | with_error("lost_fraction", both[1:], (energy[-1], error[-1]), "part of the energy lost in a cycle")
    )
    return estimate.over_amplitude(data, amplitude)


def arrest_time(result: xr.Dataset, amplitude: float) -> xr.Dataset:
    """When the motion stops, from rest at an amplitude.

    Parameters
    ----------
    result : Dataset
        An identification.
    amplitude : float, rad
        At which the motion starts.

    Returns
    -------
    Dataset
        `arrest_time`, by the averaged equations (s, nan if the motion fades or goes on) and its standard
        error, and `stop_time` of the exact motion (s, in steps of about half a period; nan if it does not
        stop, or only after 20,000 periods).

    Raises
    ------
    UsageError
        Not an identification, or not a positive angle.

    Notes
    -----
    With dry and viscous friction ln(1 + pi zeta a/(2 lambda))/(zeta w), of which the paper's remaining time
    pi/(4 zeta w) after a = lambda/(2 zeta) is a rough bound (Le Bot et al. 2019, Sec. 4).
    """
    estimate = model_estimate(result)
    if np.ndim(amplitude):
        raise UsageError("One amplitude (rad) at which the motion starts is needed.")
    start = float(amplitude_row(amplitude)[0])

    def arrest(values: Array) -> float:
        try:
            return float(predict_envelope(estimate.model(values), [0.0], start).arrest_time)
        except SimulationError:
            return np.nan

    end, error = arrest(estimate.values), np.nan
    if np.isfinite(end):
        error = float(propagate(arrest, estimate.values, estimate.covariance)[1])
    stop = _exact_stop(estimate, start, end)
    data = with_error("arrest_time", (), (end, error), "arrest of the averaged motion", "s")
    data["stop_time"] = variable((), stop, "stop of the exact motion", "s")
    at = variable((), start, "amplitude at the start", "rad")
    return xr.Dataset(data, {"amplitude": at}, estimate.provenance)


def _exact_stop(estimate: ModelEstimate, start: float, averaged: float) -> float:
    period = 2.0 * np.pi / estimate.frequency
    # Of periods: a longer motion is not simulated to its end.
    if not averaged < 20_000 * period:
        return np.nan
    # Averaging errs by no more than a few periods and a part of the whole.
    time = np.array([0.0, 1.2 * averaged + 5.0 * period])
    try:
        return float(trajectory(estimate.model(estimate.values), time, start, 0.0).stop_time)
    except SimulationError:
        return np.nan
