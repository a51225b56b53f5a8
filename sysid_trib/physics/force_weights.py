"""Effect of each force in a cycle: its weight, its energy, and crossovers of two forces."""

import itertools
from collections.abc import Callable, Mapping
from functools import cache, partial

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.optimize import bisect, brentq

from sysid_trib.arrays import Array
from sysid_trib.cycles import one_cycle, signatures
from sysid_trib.errors import LibraryError
from sysid_trib.forces.force import Force
from sysid_trib.physics import model_estimate as estimates
from sysid_trib.physics.si_units import check_angle_unit
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import described, signal_units, with_error

# Points of a cycle at which the peak of a force is searched; every maximum of a power of x or v is one of
# them.
POINTS = 1440
POINTS_WITH_HISTORY = 360


def weights(result: xr.Dataset, amplitude: ArrayLike, *, time: ArrayLike = 0.0) -> xr.Dataset:
    """Compute the weights of the forces of an identification in the envelope and in the frequency.

    Parameters
    ----------
    result : Dataset
        An identification.
    amplitude : float or (amplitude,) array of float, rad
        One number or a one-dimensional array.
    time : float or (amplitude,) array of float, s
        `t` of the formulas: one value for all amplitudes, or one for each.

    Returns
    -------
    Dataset
        Over `force` (and `amplitude`): `peak_force` = |c| max |h| (rad; the paper's lambda, 2 zeta a, delta
        a^2), `decay` = -c <h sin phi> (rad of amplitude lost per rad of phase), `frequency_shift` = c <h cos
        phi>/a (1); `decay_share` and `frequency_share`, each over the sum of the magnitudes, negative if a
        force feeds energy in or lowers the frequency, nan if no force acts. Each has its standard error. All
        values refer to the reference frequency of the result, also an alpha that was stated at another one.

    Raises
    ------
    UsageError
        The dataset is not an identification, or the angles are not positive.
    LibraryError
        A force is not finite on such a cycle.

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> weights = st.physics.weights(result, amplitude=[0.05, 0.3])
    >>> weights.decay_share.sel(force=["zeta", "delta"]).round(2).values.tolist()
    [[0.9, 0.67], [0.07, 0.33]]
    """
    estimate, a = estimates.model_estimate(result), estimates.amplitude_row(amplitude)
    forces, shapes, at = estimate.forces, estimate.shapes, np.broadcast_to(np.asarray(time, float), a.shape)
    unit = np.array([signatures.averages(force, a, shapes, at) for force in forces])
    peaks = np.array([peak(force, a, shapes, at) for force in forces])
    c = estimate.coefficients[:, None]
    errors = np.sqrt(np.diag(estimate.coefficient_covariance))[:, None]
    # Avoid negative zeros.
    decay, shift = 0.0 - unit[:, 0], unit[:, 1] / a + 0.0
    data = {
        "peak_force": (np.abs(c) * peaks, errors * peaks),
        "decay": (c * decay, errors * np.abs(decay)),
        "frequency_shift": (c * shift, errors * np.abs(shift)),
        "decay_share": shares(estimate, decay),
        "frequency_share": shares(estimate, shift),
    }
    return estimate.over_amplitude(described("weights", data), amplitude)


def dissipated_energy(
    result: xr.Dataset,
    amplitude: ArrayLike,
    inertia: float | None = None,
    *,
    inertia_standard_error: float = 0.0,
    time: ArrayLike = 0.0,
) -> xr.Dataset:
    """Return the energy dissipated by each force in a cycle, to first order in the forces.

    Parameters
    ----------
    result : Dataset
        An identification.
    amplitude : float or (amplitude,) array of float, rad
        One number or a one-dimensional array.
    inertia : float, kg m^2, optional
        Moment of inertia; without it energies are in units of I w^2.
    inertia_standard_error : float, kg m^2
        Standard error of `inertia`.
    time : float or (amplitude,) array of float, s
        `t` of the formulas: one value for all amplitudes, or one for each.

    Returns
    -------
    Dataset
        Over `force` (and `amplitude`): `energy` = -2 pi a c <h sin phi> (rad^2, in units of I w^2; J with an
        inertia; negative if a force feeds energy in) and `energy_share`, each over the sum of the magnitudes;
        `total_energy` and `lost_fraction`, the total over a^2/2. Each has its standard error.

    Raises
    ------
    UsageError
        The dataset is not an identification, or the angles or the inertia are not positive.

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> energy = st.physics.dissipated_energy(result, amplitude=0.2)
    >>> energy.energy_share.sel(force=["zeta", "delta"]).round(2).values.tolist()
    [0.75, 0.24]
    >>> print(f"{energy.lost_fraction.item():.1%} of the energy is lost in a cycle")
    16.0% of the energy is lost in a cycle
    """
    estimate, a = estimates.model_estimate(result), estimates.amplitude_row(amplitude)
    if inertia is not None:
        check_angle_unit(signal_units(result))
        estimates.check_quantity("inertia", inertia, inertia_standard_error)
    at = np.broadcast_to(np.asarray(time, float), a.shape)
    sine = np.array([signatures.averages(f, a, estimate.shapes, at)[0] for f in estimate.forces])
    unit = -2.0 * np.pi * a * sine

    def energies(z: Array) -> Array:
        """Return the energy of each force, the total, and the total as a fraction of a^2/2."""
        of_forces, factor = z[: len(unit), None] * unit, 1.0 if inertia is None else z[-1] * z[-2] ** 2
        total = of_forces.sum(axis=0)
        return np.vstack([factor * of_forces, factor * total, total / (0.5 * a**2)])

    measured = estimate.with_inertia(inertia or 1.0, inertia_standard_error)
    energy, error = estimates.propagate(energies, *measured)
    units, both = "rad2" if inertia is None else "J", ("force", "amplitude")
    data = (
        with_error("energy", both, (energy[:-2], error[:-2]), "energy taken from a cycle", units)
        | described("weights", {"energy_share": shares(estimate, unit)})
        | with_error("total_energy", both[1:], (energy[-2], error[-2]), "energy lost in a cycle", units)
        | with_error("lost_fraction", both[1:], (energy[-1], error[-1]), "part of the energy lost in a cycle")
    )
    return estimate.over_amplitude(data, amplitude)


def shares(estimate: estimates.ModelEstimate, unit: Array) -> tuple[Array, Array]:
    """Return each term over the sum of the magnitudes, and its standard error, (force, amplitude) each.

    Parameters
    ----------
    estimate : ModelEstimate
        Estimate with the coefficients of the terms.
    unit : (force, amplitude) array of float
        Terms for unit coefficients.
    """

    def of_values(z: Array) -> Array:
        terms = z[:-1, None] * unit
        return np.asarray(terms / np.abs(terms).sum(axis=0) + 0.0)

    with np.errstate(invalid="ignore", divide="ignore"):
        return estimates.propagate(of_values, estimate.values, estimate.covariance)


def peak(force: Force, a: Array, shapes: Mapping[str, float], time: ArrayLike = 0.0) -> Array:
    """Return the largest |h| on cycles of these amplitudes, rad; internal states follow their steady cycle.

    For a force with memory, this is half the distance between the peaks.
    """
    at = np.broadcast_to(np.asarray(time, float), a.shape)
    if not force.memoryless:
        return _steady_peaks(force, a, shapes, at)
    phi = 2.0 * np.pi * np.arange(POINTS) / POINTS
    x, v = np.multiply.outer(a, np.cos(phi)), -np.multiply.outer(a, np.sin(phi))
    return np.asarray(np.abs(force.value(x, v, at[:, None], shapes=shapes)).max(axis=1))


def _steady_peaks(force: Force, a: Array, shapes: Mapping[str, float], time: Array) -> Array:
    """Return the peaks on steady cycles; for a force with memory, half the distance between the peaks."""
    peaks = np.zeros(a.size)
    for rows, begun, _ in one_cycle.cycles_at(force, a, time, shapes):
        for row, of_cycle in zip(rows, begun, strict=True):
            phi, hidden = one_cycle.history_over(of_cycle, float(a[row]), POINTS_WITH_HISTORY, shapes)
            x, v = a[row] * np.cos(phi), -a[row] * np.sin(phi)
            h = force.value(x, v, time[row], shapes=shapes, hidden=hidden)
            peaks[row] = 0.5 * np.ptp(h) if force.memory else np.abs(h).max()
    return peaks


# Amplitudes (rad) at which a crossover is searched if a force is not a power law: 12 per decade.
LOWEST, HIGHEST, GRID = 1e-4, np.pi, 55
RULES = ("peak force", "averaged")
# Characters of the forces that act on the envelope, and on the frequency.
ACTS_ON = {"envelope": ("dissipative", "mixed"), "frequency": ("conservative", "mixed")}
# Step of ln a for the slopes of two weights at their crossover.
RELATIVE_STEP = 1e-4
Weight = Callable[[Array], Array]


@in_units_of_the_motion
def crossovers(result: xr.Dataset) -> xr.Dataset:
    """Find the amplitudes at which two forces have equal weights, by peak force and by average effect.

    Parameters
    ----------
    result : Dataset
        An identification.

    Returns
    -------
    Dataset
        Over `pair` (coordinates `first`, `second`, and `acts_on`: envelope or frequency) and `rule` (`peak
        force`, `averaged`): `amplitude` with `amplitude_standard_error`, and `crossings`, the number of
        crossovers. The amplitude is in rad or in the signal's unit, nan if there is none. For forces that are
        not power laws it is the smallest from 1e-4 to pi; for displacements these limits are in a unit of the
        motion itself. Over `pair`: `opposed` is true if the two act against each other at the averaged
        crossover; if one of them feeds energy in and the other damps, the pair sustains an oscillation there.
        Signs are ignored for the amplitude. History-dependent forces are in both groups.

    Raises
    ------
    UsageError
        The dataset is not an identification.

    Notes
    -----
    Le Bot et al. 2019, Sec. 4, compare peak forces in the envelope, 2 zeta/delta and lambda/(2 zeta), and
    averages in the frequency, 32 nu/(9 pi epsilon). With averages, the former are 3 pi zeta/(4 delta) and 2
    lambda/(pi zeta); with peak forces, the latter is nu/epsilon.

    Examples
    --------
    Quadratic friction exceeds viscous friction above 2 zeta/delta, 0.52 rad, by peak force.

    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> pairs = st.physics.crossovers(result)
    >>> pair = pairs.isel(pair=((pairs["first"] == "zeta") & (pairs.second == "delta")).values)
    >>> pair.amplitude.sel(rule="peak force").round(2).values.tolist()
    [0.52]
    """
    estimate = estimates.model_estimate(result)
    tabulated = cache(partial(_weight, estimate))
    pairs, rows = [], []
    for acts_on, characters in ACTS_ON.items():
        group = [i for i, force in enumerate(estimate.forces) if force.character in characters]
        for pair in itertools.combinations(group, 2):
            pairs.append((*(estimate.symbols[i] for i in pair), acts_on))
            for rule in RULES:
                # The peak force is the same in both groups.
                tables = [tabulated(i, acts_on if rule == "averaged" else "") for i in pair]
                rows.append(_crossing(estimate, pair, tables))
    table = np.array(rows, dtype=float).reshape(-1, len(RULES), 4)
    crossings, opposed = table[..., 2].astype(int), table[:, 1, 3] > 0
    data = {"amplitude": (table[..., 0], table[..., 1]), "crossings": crossings, "opposed": opposed}
    columns = list(np.array(pairs, dtype=str).reshape(-1, 3).T)
    coords = dict(zip(("first", "second", "acts_on"), columns, strict=True))
    coords["pair"] = np.array([" ".join(pair) for pair in pairs], dtype=str)
    labels = xr.Dataset(coords=described("crossovers", coords)).assign_coords(rule=list(RULES))
    return labels.assign(described("crossovers", data)).assign_attrs(estimate.provenance)


def _weight(estimate: estimates.ModelEstimate, i: int, acts_on: str) -> tuple[Weight, Array]:
    """Return the weight of a unit force by amplitude, and on the grid; its peak if there is no average."""
    force, shapes = estimate.forces[i], estimate.shapes

    def weight(a: Array) -> Array:
        try:
            if not acts_on:
                return peak(force, a, shapes)
            return signatures.averages(force, a, shapes)[0 if acts_on == "envelope" else 1]
        except LibraryError:
            # The formula has a limit: this force is not defined at larger amplitudes.
            parts = [weight(a[at : at + 1]) for at in range(a.size)] if a.size > 1 else [np.array([np.nan])]
            return np.concatenate(parts)

    return weight, weight(np.geomspace(LOWEST, HIGHEST, GRID))


def _crossing(
    estimate: estimates.ModelEstimate, pair: tuple[int, ...], tables: list[tuple[Weight, Array]]
) -> tuple[float, float, int, bool]:
    """Return the smallest amplitude of equal weights, its error, their number, and `opposed`."""
    c, covariance = estimate.coefficients[list(pair)], estimate.coefficient_covariance[np.ix_(pair, pair)]

    def difference(weights: list[Array]) -> Array:
        with np.errstate(all="ignore"):
            levels = [np.log(np.abs(k * weight)) for k, weight in zip(c, weights, strict=True)]
            return levels[0] - levels[1]

    def at(log_a: float) -> float:
        return float(difference([weight(np.array([np.exp(log_a)])) for weight, _ in tables])[0])

    degrees = [estimate.forces[i].degree for i in pair]
    if degrees[0] is not None and degrees[1] is not None:
        level = at(0.0)
        powers = degrees[1] - degrees[0]
        roots = [level / powers] if powers and np.isfinite(level) else []
    else:
        roots = _roots(at, difference([table for _, table in tables]))
    if not roots:
        return np.nan, np.nan, 0, False
    root = min(roots)
    a = float(np.exp(root))
    slope = (at(root + RELATIVE_STEP) - at(root - RELATIVE_STEP)) / (2.0 * RELATIVE_STEP)
    gradient = np.array([1.0, -1.0]) / c
    error = a * float(np.sqrt(gradient @ covariance @ gradient)) / abs(slope) if slope else np.nan
    signed = [k * weight(np.array([a]))[0] for k, (weight, _) in zip(c, tables, strict=True)]
    return a, error, len(roots), bool(signed[0] * signed[1] < 0)


def _roots(function: Callable[[float], float], level: Array) -> list[float]:
    """Return the zeros in ln a of a function that is `level` on the grid."""
    grid = np.log(np.geomspace(LOWEST, HIGHEST, GRID))
    # A force that does not act at small amplitudes has an infinite level there, which has a sign too.
    sides = np.sign(level)
    if not np.any(np.isfinite(level) & (level != 0.0)):
        return []
    roots = grid[level == 0.0].tolist()
    for i in np.flatnonzero(sides[:-1] * sides[1:] < 0):
        search = brentq if np.all(np.isfinite(level[i : i + 2])) else bisect
        roots.append(float(search(function, grid[i], grid[i + 1], xtol=1e-12)))
    return roots
