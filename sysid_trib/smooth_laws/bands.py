"""Friction against speed and restoring force against displacement of an identification, with bands."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.results import models
from sysid_trib.results.frequencies import covariance_with_frequency
from sysid_trib.results.law_curves import NAME_IN_FORMULAS, VARIABLE_OF_LAW
from sysid_trib.results.variables import CONFIDENCE, Variables, described

# Points of a law in the visited range of the record, and width of the extrapolated range relative to it.
VISITED_POINTS, SHOWN_BEYOND = 40, 0.25
# Number of draws for the width of a simultaneous band.
DRAWS = 4000


@dataclass(frozen=True)
class Law:
    """One law of an identification: a force over the inertia against one variable of the motion.

    Attributes
    ----------
    name : {"friction", "restoring"}
    variable : {"speed", "displacement"}
    places : (place,) array of float, rad/s or rad
    visited : (place,) array of bool
        True at the places that the record reaches.
    values : (place,) array of float, rad/s^2
    covariance : (place, place) array of float
        Covariance due to the noise and to the smoothness penalty.
    """

    name: str
    variable: str
    places: Array
    visited: Mask
    values: Array
    covariance: Array

    def reached(self, largest: float) -> "Law":
        """Return the law of a run that visits places up to the largest."""
        return replace(self, visited=np.abs(self.places) <= largest * (1.0 + 1e-9))


def grid(largest: float, *, both_sides: bool) -> tuple[Array, Mask]:
    """Return the places of a law, (place,), and the mask of those that the record visits.

    Parameters
    ----------
    largest : float
        Largest speed or displacement of the record.
    both_sides : bool
        True if the law is shown for both signs because it is not odd.
    """
    step = largest / VISITED_POINTS
    count = VISITED_POINTS + round(SHOWN_BEYOND * VISITED_POINTS)
    # At zero speed the law has its limit from above.
    places = step * np.arange(1, count + 1)
    if both_sides:
        places = np.concatenate([-places[::-1], places])
    visited: Mask = np.abs(places) <= largest * (1.0 + 1e-9)
    return np.asarray(places, dtype=float), visited


def laws_of(result: xr.Dataset, largest: Mapping[str, float], run: int | None = None) -> list[Law]:
    """Return the laws of any identification with forces that depend on speed or displacement alone.

    Parameters
    ----------
    result : Dataset
        An identification.
    largest : dict
        Largest displacement `x` (rad) and speed `v` (rad/s) of the records.
    run : int, optional
        Number of the run, from 1, if runs have separate laws; if omitted, the mean of these laws.

    Returns
    -------
    list of Law
        `friction`, from the forces of v alone, and `restoring`, from w^2 x and the forces of x alone.
    """
    library = models.library_of(result)
    laws = []
    for name, variable in VARIABLE_OF_LAW.items():
        of = NAME_IN_FORMULAS[variable]
        forces = [force for force in library if force.depends_only_on(of)]
        even = any(force.parity != "odd" for force in forces)
        places, visited = grid(largest[of], both_sides=even)
        values, jacobian = law_and_jacobian(result, library, forces, of, places, run)
        covariance = jacobian @ covariance_with_frequency(result) @ jacobian.T
        covariance = 0.5 * (covariance + covariance.T)
        laws.append(Law(name, variable, places, visited, values, covariance))
    return laws


def law_and_jacobian(
    result: xr.Dataset,
    library: ForceLibrary,
    forces: Sequence[Force],
    of: str,
    places: Array,
    run: int | None,
) -> tuple[Array, Array]:
    """Return a law (place,), rad/s^2, and its derivatives to coefficients and w, (place, force + 1).

    Parameters
    ----------
    result : Dataset
        An identification.
    library : ForceLibrary
        Forces of the identification.
    forces : sequence of Force
        Forces of the law.
    of : {"v", "x"}
    places : (place,) array of float
    run : int or None
        See `laws_of`.
    """
    shapes = models.shape_values_of(result)
    symbols = result.force.values.tolist()
    w = result.reference_frequency.item()
    coefficients = np.where(result.active.values, result.coefficient.values, 0.0)
    runs = max((force.run or 1 for force in library), default=1)

    def part(force: Force) -> float:
        """Return the factor of a force in the law of the run, or in the mean of all runs."""
        if force.run is None:
            return 1.0
        return 1.0 / runs if run is None else float(force.run == run)

    def columns(frequency: float) -> Array:
        """Return the forces over the inertia with unit coefficients, (place, force), rad/s^2."""
        x, v = (0.0 * places, places / frequency) if of == "v" else (places, 0.0 * places)
        values = np.zeros((len(places), len(symbols)))
        for force in forces:
            values[:, symbols.index(force.symbol)] = part(force) * force.value(x, v, shapes=shapes)
        return frequency**2 * values

    def law(frequency: float) -> Array:
        linear = frequency**2 * places if of == "x" else 0.0
        return np.asarray(linear + columns(frequency) @ coefficients)

    step = 1e-6 * w
    by_frequency = (law(w + step) - law(w - step)) / (2.0 * step)
    return law(w), np.column_stack([columns(w), by_frequency])


def standard_errors(covariance: Array) -> Array:
    """Return the square roots of the variances, (place,); negative ones from rounding count as zero.

    Parameters
    ----------
    covariance : (place, place) array of float
    """
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


def largest_of_draws(covariance: Array) -> Array:
    """Return the largest |z| along a curve of zero mean in each of many draws; empty if it has no error.

    Parameters
    ----------
    covariance : (place, place) array of float
        Covariance of the curve.
    """
    errors = standard_errors(covariance)
    known = np.flatnonzero(errors > 0.0)
    if not len(known):
        return np.zeros(0)
    correlation = covariance[np.ix_(known, known)] / np.outer(errors[known], errors[known])
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    draws = np.random.default_rng(0).standard_normal((DRAWS, len(values))) @ root.T
    return np.asarray(np.max(np.abs(draws), axis=1))


def simultaneous_factor(covariance: Array) -> float:
    """Return the number of standard errors of a band with a simultaneous confidence of 95 %.

    Parameters
    ----------
    covariance : (place, place) array of float

    Notes
    -----
    This is the quantile of the largest of correlated normal variables, from draws (Ruppert, Wand & Carroll
    2003,
    Sec. 6.5).
    """
    draws = largest_of_draws(covariance)
    return float(np.quantile(draws, CONFIDENCE)) if len(draws) else 0.0


def band(name: str, values: Array, covariance: Array, visited: Mask) -> dict[str, Array]:
    """Return the standard error of a curve and its simultaneous 95 % band, by name.

    Parameters
    ----------
    name : str
        Name of the curve.
    values : (place,) array of float
    covariance : (place, place) array of float
    visited : (place,) array of bool
        Places at which the band is simultaneous.
    """
    error = standard_errors(covariance)
    half = simultaneous_factor(covariance[np.ix_(visited, visited)]) * error
    return {f"{name}_standard_error": error, f"{name}_low": values - half, f"{name}_high": values + half}


def law_variables(laws: Sequence[Law], of_model: Sequence[Array]) -> tuple[Variables, Variables]:
    """Return the variables of laws with their bands, and their coordinates with units.

    Parameters
    ----------
    laws : sequence of Law
    of_model : sequence of (place, place) arrays of float
        Covariance of the error of the model, for each law.
    """
    values: dict[str, object] = {}
    places: dict[str, object] = {}
    for law, added in zip(laws, of_model, strict=True):
        covariance = law.covariance + added
        values[law.name] = law.values
        values |= band(law.name, law.values, covariance, law.visited)
        values[f"{law.name}_error_of_model"] = standard_errors(added)
        values[f"{law.name}_covariance"] = covariance
        values[f"{law.variable}_visited"] = law.visited
        places[law.variable] = law.places
        places[f"other_{law.variable}"] = law.places
    return described("laws", values), described("laws", places)


def interpolation(places: Array, common: Array) -> Array:
    """Return the matrix that interpolates a law at common places, (common, place).

    Parameters
    ----------
    places : (place,) array of float
        Places of the law; if all are positive, the law is odd.
    common : (common,) array of float
    """
    weights = np.zeros((len(common), len(places)))
    two_sided = bool(np.any(places < 0.0))
    for row, place in enumerate(common):
        sign = 1.0 if two_sided else float(np.sign(place))
        # A law may be discontinuous at zero, so the two sides are interpolated separately.
        side = np.flatnonzero(places * place > 0.0) if two_sided else np.arange(len(places))
        at, target = np.abs(places[side]), abs(float(place))
        order = np.argsort(at)
        for column in np.eye(len(side))[order]:
            weights[row, side[int(np.argmax(column))]] = sign * np.interp(target, at[order], column[order])
    return weights
