"""Friction and restoring force of a result as curves: their names and values."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.results.models import library_of, shape_values_of

# Groups of a result: the laws of each run, those in SI units, and the difference of two samples.
OWN_LAWS = "own_laws"
LAWS_SI = "laws_si"
LAW_DIFFERENCE = "law_difference"
# Attribute of an identification with a passive law: speeds at which the constraint is active, relative to the
# largest visited speed, as JSON.
PASSIVE = "passive_at"
# Attribute with it: largest number of standard errors by which friction is negative without the constraint.
PASSIVE_DEFICIT = "passive_deficit"
# Just above zero speed, as a fraction of the largest: there friction jumps.
NEXT_TO_ZERO = 1e-6
# Attribute of `judged` if laws explain each run alone, but not all together: the laws that explain them
# if they are separate for each run, or an empty text.
EXPLAINING_OWN = "explaining_own"
# Laws, the motion variable of each, its name in formulas, and their names in words.
VARIABLE_OF_LAW = {"friction": "speed", "restoring": "displacement"}
NAME_IN_FORMULAS = {"speed": "v", "displacement": "x"}
LAW_WORDS = {"friction": "friction", "restoring": "restoring force"}
# Why a result contains no curves although its record determines some.
NO_BETTER = "The named forces follow the record as well as curves do: the laws are sums of the named forces."
# A restoring force below this fraction of w^2 x counts as none.
NO_RESTORING_FORCE = 1e-9
# Number of standard errors of both methods above which they differ.
LARGE_DIFFERENCE = 3.0


@dataclass(frozen=True)
class Curve:
    """A law of one identification, in the units of its record.

    Attributes
    ----------
    places : (place,) array of float
        Speeds or displacements.
    values, errors, low, high : (place,) arrays of float
        The law with its standard error, and the ends of its simultaneous 95 % band.
    visited : (place,) array of bool
        Whether the record reaches the place.
    """

    places: Array
    values: Array
    errors: Array
    low: Array
    high: Array
    visited: Mask

    def without(self, known: Array) -> "Curve":
        """Return the law minus its known part, (place,)."""
        ends = self.low - known, self.high - known
        return Curve(self.places, self.values - known, self.errors, *ends, self.visited)

    def on_both_sides(self) -> "Curve":
        """Return the law for both signs; a law that is known for positive places only is odd."""
        if np.any(self.places < 0.0):
            return self

        def odd(values: Array, mirrored: Array) -> Array:
            return np.concatenate([-mirrored[::-1], values])

        return Curve(
            odd(self.places, self.places),
            odd(self.values, self.values),
            np.concatenate([self.errors[::-1], self.errors]),
            odd(self.low, self.high),
            odd(self.high, self.low),
            np.concatenate([self.visited[::-1], self.visited]),
        )

    def at(self, places: Array) -> "Curve":
        """Return the law at some of its places."""
        chosen = [int(np.argmin(np.abs(self.places - place))) for place in places]
        return Curve(
            self.places[chosen],
            self.values[chosen],
            self.errors[chosen],
            self.low[chosen],
            self.high[chosen],
            self.visited[chosen],
        )


def curve_of(result: xr.Dataset, law: str) -> Curve:
    """Return a law of an identification.

    Parameters
    ----------
    result : Dataset
        With `friction(speed)` and `restoring(displacement)`.
    law : {"friction", "restoring"}
    """
    variable = VARIABLE_OF_LAW[law]
    return Curve(
        result[variable].values,
        result[law].values,
        result[f"{law}_standard_error"].values,
        result[f"{law}_low"].values,
        result[f"{law}_high"].values,
        result[f"{variable}_visited"].values.astype(bool),
    )


def restores(result: xr.Dataset) -> bool:
    """Return True if there is a restoring force; a body that is free to move has none."""
    size = result.reference_frequency.item() ** 2 * np.abs(result.displacement.values)
    return bool(np.any(np.abs(result.restoring.values) > NO_RESTORING_FORCE * size))


def laws_in(result: xr.Dataset) -> list[str]:
    """Return the laws of an identification."""
    return list(VARIABLE_OF_LAW) if restores(result) else ["friction"]


def curves_of(
    results: Mapping[str, xr.Dataset], law: str, answer: str, *, mirrored: bool = False
) -> dict[str, Curve]:
    """Return a law from each identification, in a form comparable with the preferred one.

    Parameters
    ----------
    results : mapping of str to Dataset
        Identifications by name.
    law : {"friction", "restoring"}
    answer : str
        The preferred identification. If its law is odd, the odd part of the others is used.
    mirrored : bool
        Whether an odd law is shown for both signs next to one that is not odd; otherwise it is left out.
    """
    curves = {name: curve_of(result, law) for name, result in results.items()}
    sides = {name: bool(np.any(curve.places < 0.0)) for name, curve in curves.items()}
    if len(set(sides.values())) < 2:
        return curves
    if not sides.get(answer, True):
        return {name: _odd_curve(results[name], law) for name in curves}
    if mirrored:
        return {name: curve.on_both_sides() for name, curve in curves.items()}
    return {name: curve for name, curve in curves.items() if sides[name]}


def _odd_curve(result: xr.Dataset, law: str) -> Curve:
    """Return the odd part of a law, with a band as wide as that of the law in standard errors."""
    whole = curve_of(result, law)
    odd = odd_part(result, law)
    at = whole.places > 0.0
    values = odd[law].values
    errors = odd[f"{law}_standard_error"].values
    known = at & (whole.errors > 0.0)
    ratios = (whole.high - whole.values)[known] / whole.errors[known]
    width = float(np.max(ratios, initial=0.0))
    return Curve(
        whole.places[at],
        values,
        errors,
        values - width * errors,
        values + width * errors,
        whole.visited[at],
    )


def odd_part(result: xr.Dataset, law: str) -> xr.Dataset:
    """Return the odd part of a law with its standard error, at positive places: averages show only this part.

    Parameters
    ----------
    result : Dataset
        Identification with `friction(speed)` and `restoring(displacement)`.
    law : {"friction", "restoring"}

    Returns
    -------
    Dataset
        The law and its `_standard_error`, by their names.
    """
    (variable,) = result[law].dims
    places = result[variable].values
    names = [law, f"{law}_standard_error"]
    if not np.any(places < 0.0):
        return result[names]
    # The places are the same on both sides, in increasing order.
    half = len(places) // 2
    part = 0.5 * np.hstack([-np.eye(half)[::-1], np.eye(half)])
    covariance = part @ result[f"{law}_covariance"].values @ part.T
    values = part @ result[law].values
    errors = np.sqrt(np.diag(covariance))
    right = result[names].isel({variable: slice(half, None)})
    return right.assign(
        {
            names[0]: (variable, values, result[law].attrs),
            names[1]: (variable, errors, result[names[1]].attrs),
        }
    )


def known_part(result: xr.Dataset, places: Array) -> tuple[Array, list[str]]:
    """Return the straight line w^2 x plus the held forces, at some places, and the names of these forces.

    Parameters
    ----------
    result : Dataset
        An identification by `laws`.
    places : (place,) array of float
        Displacements in the unit of the record.
    """
    square = result.reference_frequency.item() ** 2
    known: Array = square * places
    names: list[str] = []
    constraint = result.coords.get("constraint")
    if constraint is None:
        return known, names
    shapes = shape_values_of(result)
    for force in library_of(result, whole=True):
        # A fit of the motion to driven records holds the curves; they still belong to the law.
        is_held = constraint.sel(force=force.symbol).item() == "fixed"
        if force.curve or not is_held or not force.depends_only_on("x"):
            continue
        coefficient = result.coefficient.sel(force=force.symbol).item()
        if coefficient:
            known = known + square * coefficient * force.value(places, 0.0 * places, shapes=shapes)
            names.append(force.symbol)
    return known, names


def stretches(places: Array, chosen: Mask) -> list[tuple[float, float]]:
    """Return the first and last place of each unbroken stretch of chosen places."""
    between = np.concatenate([[False], chosen, [False]])
    edges = np.flatnonzero(np.diff(between.astype(int)))
    firsts = places[edges[::2]]
    lasts = places[edges[1::2] - 1]
    return list(zip(firsts.tolist(), lasts.tolist(), strict=True))


def difference_over_error(first: Curve, second: Curve) -> Array:
    """Return the difference of two curves over the errors of both, (place,).

    Both methods use the same noisy record, so these numbers are rather too small.
    """
    error = np.hypot(first.errors, second.errors)
    difference = first.values - second.values
    return np.divide(difference, error, out=np.zeros_like(difference), where=error > 0.0)


def apart(results: Mapping[str, xr.Dataset], law: str) -> tuple[Array, Array]:
    """Return visited places, and the difference of both methods' odd parts there over the errors of both."""
    first, second = (_odd_curve(result, law) for result in results.values())
    common = second.visited & first.visited
    return second.places[common], difference_over_error(first, second)[common]


def feeding(result: xr.Dataset) -> dict[str, list[tuple[float, float]]]:
    """Find speeds at which friction feeds energy in: `certainly` and `seemingly` if visited, and `beyond`.

    Each is a list of stretches of speeds.
    """
    curve = curve_of(result, "friction")
    certain, seeming = feeds_energy(result)
    feeds = (np.sign(curve.places) * curve.values < 0.0) & ~curve.visited
    masks = {
        "certainly": np.isin(curve.places, certain),
        "seemingly": np.isin(curve.places, seeming),
        "beyond": feeds,
    }
    return {name: stretches(curve.places, chosen) for name, chosen in masks.items()}


def feeds_energy(result: xr.Dataset) -> tuple[Array, Array]:
    """Return the visited speeds at which friction certainly, and at which it seemingly, feeds energy in.

    Parameters
    ----------
    result : Dataset
        With `friction(speed)` and its band.
    """
    part = result.isel(speed=np.flatnonzero(result.speed_visited.values))
    speed = part.speed.values
    power = np.sign(speed) * part.friction.values
    highest = np.where(speed > 0.0, part.friction_high.values, -part.friction_low.values)
    return speed[highest < 0.0], speed[(power < 0.0) & (highest >= 0.0)]


def places_shown(curve: Curve, parts: Sequence[float]) -> Array:
    """Return places near these fractions of the largest visited one, on both sides if the law is not odd."""
    largest = float(np.max(curve.places[curve.visited]))
    places = largest * np.asarray(parts)
    return np.concatenate([-places[::-1], places]) if np.any(curve.places < 0.0) else places
