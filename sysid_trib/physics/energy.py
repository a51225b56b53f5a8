"""Energy that each force takes in a cycle, and when the motion ends."""

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.averaging.envelope_prediction import predict_envelope
from sysid_trib.averaging.signatures import averages
from sysid_trib.errors import SimulationError, UsageError
from sysid_trib.physics.force_weights import shares
from sysid_trib.physics.quantities import Array, amplitudes, check_quantity, propagated, with_error
from sysid_trib.physics.unknowns import Unknowns, unknowns_of
from sysid_trib.simulation.simulate import trajectory

# Of periods: a longer motion is not simulated to its end.
LONGEST = 20_000


def dissipated_energy(
    result: xr.Dataset,
    amplitude: ArrayLike,
    inertia: float | None = None,
    *,
    inertia_standard_error: float = 0.0,
    time: float = 0.0,
) -> xr.Dataset:
    """Energy that each force takes from a cycle, to first order in the forces.

    Parameters
    ----------
    result : an identification.
    amplitude : rad, a number or one row of them.
    inertia, inertia_standard_error : kg m^2; without it energies are in units of I w^2.
    time : `t` of the formulas, s.

    Returns
    -------
    Dataset over `force` (and `amplitude`): `energy` = -2 pi a c <h sin phi> (rad^2, in units of I w^2; J with
    an inertia; negative where a force feeds energy in) and `energy_share`, each over the sum of their
    sizes; `total_energy` and `lost_fraction`, the total over a^2/2. Each with its standard error.

    Raises
    ------
    UsageError
        Not an identification, not positive angles, or no positive inertia.
    """
    found, a = unknowns_of(result), amplitudes(amplitude)
    if inertia is not None:
        check_quantity("inertia", inertia, inertia_standard_error)
    sine = np.array([averages(f, a, found.shapes, np.full(a.size, time))[0] for f in found.forces])
    unit = -2.0 * np.pi * a * sine
    taken = found.coefficients[:, None] * unit
    values, covariance = _with_inertia(found, inertia, inertia_standard_error)

    def each(z: Array) -> Array:
        factor = 1.0 if inertia is None else z[-1] * z[-2] ** 2
        energies = factor * z[: len(unit), None] * unit
        return np.vstack([energies, energies.sum(axis=0)])

    energy, error = propagated(each, values, covariance)
    total = taken.sum(axis=0) / (0.5 * a**2)
    lost = np.sqrt(np.einsum("ia,ij,ja->a", unit, found.spread, unit)) / (0.5 * a**2)
    units, both = "rad2" if inertia is None else "J", ("force", "amplitude")
    data = (
        with_error("energy", both, (energy[:-1], error[:-1]), units, "energy taken from a cycle")
        | with_error("energy_share", both, shares(taken, unit, found.spread), "1", "share in this energy")
        | with_error("total_energy", both[1:], (energy[-1], error[-1]), units, "energy lost in a cycle")
        | with_error("lost_fraction", both[1:], (total, lost), "1", "part of the energy lost in a cycle")
    )
    coords = {
        "force": found.symbols,
        "amplitude": ("amplitude", a, {"units": "rad", "long_name": "amplitude"}),
    }
    labelled = xr.Dataset(data, coords, {"library": result.attrs["library"]})
    return labelled if np.ndim(amplitude) else labelled.isel(amplitude=0)


def arrest_time(result: xr.Dataset, amplitude: float) -> xr.Dataset:
    """When the motion stops, from rest at an amplitude.

    Parameters
    ----------
    result : an identification.
    amplitude : rad, at which the motion starts.

    Returns
    -------
    Dataset with `arrest_time`, by the averaged equations (s, nan if the motion fades or goes on) and its
    standard error, and `stop_time` of the exact motion (s, in steps of about half a period; nan if it does
    not stop, or only after 20,000 periods).

    Raises
    ------
    UsageError
        Not an identification, or not a positive angle.

    Notes
    -----
    With dry and viscous friction ln(1 + pi zeta a/(2 lambda))/(zeta w), of which the paper's remaining time
    pi/(4 zeta w) after a = lambda/(2 zeta) is a rough bound (Le Bot et al. 2019, Sec. 4).
    """
    found = unknowns_of(result)
    if np.ndim(amplitude):
        raise UsageError("One amplitude (rad) at which the motion starts is needed.")
    start = float(amplitudes(amplitude)[0])

    def ends(values: Array) -> float:
        return _averaged_end(found, values, start)

    at = ends(found.values)
    end, error = propagated(ends, found.values, found.covariance) if np.isfinite(at) else (at, np.nan)
    data = with_error("arrest_time", (), (float(end), float(error)), "s", "arrest of the averaged motion")
    stop = _exact_end(found, start, float(end))
    told = {"units": "s", "long_name": "stop of the exact motion"}
    start_told = {"units": "rad", "long_name": "amplitude at the start"}
    return xr.Dataset(
        data | {"stop_time": ((), stop, told)},
        {"amplitude": ((), start, start_told)},
        {"library": result.attrs["library"]},
    )


def _averaged_end(found: Unknowns, values: Array, start: float) -> float:
    try:
        return float(predict_envelope(found.model(values), [0.0], start).arrest_time)
    except SimulationError:
        return np.nan


def _exact_end(found: Unknowns, start: float, averaged: float) -> float:
    period = 2.0 * np.pi / found.frequency
    if not averaged < LONGEST * period:
        return np.nan
    # Averaging errs by no more than a few periods and a part of the whole.
    time = np.array([0.0, 1.2 * averaged + 5.0 * period])
    try:
        return float(trajectory(found.model(found.values), time, start, 0.0).stop_time)
    except SimulationError:
        return np.nan


def _with_inertia(found: Unknowns, inertia: float | None, error: float) -> tuple[Array, Array]:
    """The unknowns with the inertia as the last, which was measured apart from them."""
    size = len(found.values)
    covariance = np.zeros((size + 1, size + 1))
    covariance[:size, :size] = found.covariance
    covariance[size, size] = error**2
    return np.append(found.values, 1.0 if inertia is None else inertia), covariance
