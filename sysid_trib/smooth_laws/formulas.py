"""Formulas of a law: the simplest sums of library forces within its band."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import EFFECTS
from sysid_trib.results import schema, signal_scale
from sysid_trib.results.law_curves import NAME_IN_FORMULAS, VARIABLE_OF_LAW
from sysid_trib.results.variables import described

# Largest number of terms, and of listed formulas: each is also fitted to a part of the record.
MOST_TERMS, MOST_FORMULAS = 3, 4
# Number of start values of a shape parameter, logarithmic over the visited range.
SHAPE_VALUES = 8
SMALLEST_SHAPE, LARGEST_SHAPE = 0.03, 1.5
# Directions of a law's covariance below this fraction of the largest contain only rounding errors.
SMALLEST_VARIANCE = 1e-5


@signal_scale.in_units_of_the_motion
def law_formulas(
    result: xr.Dataset, law: str = "friction", candidates: ForceLibrary | None = None
) -> xr.Dataset:
    """List the simplest sums of library forces that stay within the band of a law.

    Parameters
    ----------
    result : Dataset
        An identification by `laws`.
    law : {"friction", "restoring"}
        Name of the law.
    candidates : ForceLibrary, optional
        Forces to choose from: those of speed alone, or of displacement alone. By default those of
        `contact_forces` and `candidate_effects`.

    Returns
    -------
    Dataset
        Over `alternative` (the fewest sufficient terms, then one more, each ordered by information) and
        `force`: `coefficient`, nan for a force that is not in the formula, and its `standard_error`;
        `chi_square`, `information` (Akaike's, minus the smallest), `largest_deviation` from the law over the
        half width of its band; and the law of each formula, `friction(alternative, speed)` or
        `restoring(alternative, displacement)`, over the inertia. `alternative` is empty if no formula of up
        to three terms stays within the band. The fitted value of a shape parameter is written in the force's
        `formula`.

    Raises
    ------
    UsageError
        `law` is not the name of a law, or no candidate depends on its variable alone.
    DecayError
        The identification contains no law, or a law without an error.

    Notes
    -----
    Each sum is fitted by `WhitenedLeastSquares`, an optimiser of pysindy, with the features of
    `ForceFeatures`, in the metric of the law's covariance.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> time, noise = np.arange(0.0, 8.0, 0.02), np.random.default_rng(0)
    >>> model = st.Model("contact_forces", {"zeta": 0.01, "epsilon": 0.3}, 9.91)
    >>> angle = st.simulate(model, time, angle=0.3).angle + noise.normal(0.0, 1e-4, 400)
    >>> candidates = st.library("lambda,zeta,delta")
    >>> formulas = st.physics.law_formulas(st.best(st.laws(angle)), "friction", candidates)
    >>> simplest = formulas.isel(alternative=0).coefficient.dropna("force")
    >>> simplest.round(3).to_series().to_dict()
    {'zeta': 0.01}
    """
    if law not in VARIABLE_OF_LAW:
        raise UsageError(f"law='{law}' is neither 'friction' nor 'restoring'.")
    if law not in result:
        raise DecayError("This identification contains no laws; identify them by laws.")
    variable = VARIABLE_OF_LAW[law]
    of = NAME_IN_FORMULAS[variable]
    part = result.isel({variable: np.flatnonzero(result[f"{variable}_visited"].values)})
    places = part[variable].values
    w = result.reference_frequency.item()
    at = np.flatnonzero(result[f"{variable}_visited"].values)
    if not np.any(part[f"{law}_standard_error"].values > 0.0):
        raise DecayError(f"The {law} law of this identification has no error: it is fixed, or it is absent.")
    problem = _LawProblem(
        places=places,
        of=of,
        frequency=w,
        known=w**2 * places if of == "x" else np.zeros_like(places),
        law=part[law].values,
        half=0.5 * (part[f"{law}_high"].values - part[f"{law}_low"].values),
        whitening=_whitening(result[f"{law}_covariance"].values[np.ix_(at, at)]),
    )
    inside = problem.formulas_inside(_candidates(candidates, of))
    return _as_dataset(inside, law, part[variable])


def _candidates(candidates: ForceLibrary | None, of: str) -> list[Force]:
    """Return the forces of one variable that a formula may contain."""
    if candidates is None:
        shipped = (*load_library(), *load_library(EFFECTS))
        candidates = ForceLibrary("candidates of formulas", tuple({f.symbol: f for f in shipped}.values()))
    kept = [
        force
        for force in candidates
        if force.kind == "force"
        and force.memoryless
        and not force.holds_time
        and not force.channels
        and {"x", "v"} & set(force.formula.names) == {of}
        and force.parity != "even"
        and not force.matches("x")
        and len(force.shape) < 2
    ]
    if not kept:
        raise UsageError(f"The candidates contain no force of {of} alone; offer some.")
    return kept


@dataclass(frozen=True)
class LawFormula:
    """A sum of forces that stays within the band of a law.

    Attributes
    ----------
    forces : sequence of Force
        Forces with their shape parameters written into the formulas.
    coefficients, errors : (force,) array of float
    chi_square : float
        Chi square of the law minus the formula, in the metric of the law's covariance.
    values : (place,) array of float
        Law of this formula over the inertia.
    deviation : float
        Largest deviation from the law, over the half width of its band.
    shapes : int
        Number of fitted shape parameters.
    """

    forces: Sequence[Force]
    coefficients: Array
    errors: Array
    values: Array
    chi_square: float
    deviation: float
    shapes: int = 0

    @property
    def information(self) -> float:
        """Akaike's information criterion; fitted shape parameters count as well."""
        return self.chi_square + 2.0 * (len(self.forces) + self.shapes)


class _Distance(NamedTuple):
    """Distance of a sum of forces from a law.

    Attributes
    ----------
    chi_square : float
        Chi square in the metric of the law's covariance.
    deviation : float
        Largest deviation over the half width of the band.
    """

    chi_square: float
    deviation: float


@dataclass(frozen=True)
class _LawProblem:
    """A law over its visited range, and its comparison with sums of forces.

    Attributes
    ----------
    places : (place,) array of float, rad/s or rad
    of : {"v", "x"}
    frequency : float, rad/s
        w.
    law, known, half : (place,) array of float, rad/s^2
        The law, its known part (w^2 x of a restoring force), and the half width of its band.
    whitening : (direction, place) array of float
    columns : dict of (str, float or None) to (place,) array of float
        Forces with coefficient 1 over the inertia, computed so far, by symbol and value of the shape
        parameter.
    """

    places: Array
    of: str
    frequency: float
    law: Array
    known: Array
    half: Array
    whitening: Array
    columns: dict[tuple[str, float | None], Array] = field(default_factory=dict)

    @property
    def target(self) -> Array:
        """The law without its known part, (place,)."""
        return self.law - self.known

    def formulas_inside(self, offered: Sequence[Force]) -> list[LawFormula]:
        """Return sums within the band, with the fewest terms and one more, each ordered by information."""
        inside: list[LawFormula] = []
        for count in range(1, MOST_TERMS + 1):
            enough = bool(inside)
            chosen = [
                forces
                for forces in itertools.combinations(offered, count)
                if sum(bool(force.shape) for force in forces) <= 1
            ]
            formulas = [self.inside(forces) for forces in chosen]
            inside += [formula for formula in formulas if formula is not None]
            if enough:
                # Longer sums contain these.
                break
        return sorted(inside, key=lambda formula: (len(formula.forces), formula.information))

    def inside(self, forces: Sequence[Force]) -> LawFormula | None:
        """Return the sum of forces that is nearest to the law; None if it leaves the band."""
        value = self.nearest_shape(forces)
        if self.distance(forces, value).deviation > 1.0:
            return None
        shaped = [force for force in forces if force.shape]
        if not shaped:
            return self.solved(forces)
        (name,) = shaped[0].shape
        written = [_with_value(force, name, value) if force.shape else force for force in forces]
        formula = replace(self.solved(written), shapes=1)
        # The written value is rounded to four digits.
        return formula if formula.deviation <= 1.0 else None

    def nearest_shape(self, forces: Sequence[Force]) -> float:
        """Return the shape parameter at which a sum of forces is nearest to the law, or nan."""
        shapes = [shape for force in forces for shape in force.shape.values()]
        if not shapes:
            return float("nan")
        largest = float(np.max(np.abs(self.places))) / (self.frequency if self.of == "v" else 1.0)
        low, high = max(shapes[0].low, SMALLEST_SHAPE * largest), min(shapes[0].high, LARGEST_SHAPE * largest)
        if not low < high:
            low, high = shapes[0].low, shapes[0].high

        def chi_square(logarithm: float) -> float:
            return self.distance(forces, float(np.exp(logarithm))).chi_square

        grid = np.linspace(np.log(low), np.log(high), SHAPE_VALUES)
        nearest = int(np.argmin([chi_square(value) for value in grid]))
        ends = grid[max(0, nearest - 1)], grid[min(SHAPE_VALUES - 1, nearest + 1)]
        fitted = scipy.optimize.minimize_scalar(
            chi_square, bounds=ends, method="bounded", options={"xatol": 1e-3}
        )
        return float(np.exp(fitted.x))

    def distance(self, forces: Sequence[Force], value: float) -> _Distance:
        """Return the distance of the nearest sum of forces from the law, at a value of its shape."""
        columns = np.column_stack([self.column(force, value) for force in forces])
        if self.of == "x":
            # The frequency is fitted with each formula.
            columns = np.column_stack([columns, self.frequency**2 * self.places])
        columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
        white, white_target = self.whitening @ columns, self.whitening @ self.target
        coefficients = np.linalg.lstsq(white, white_target, rcond=None)[0]
        residual = white_target - white @ coefficients
        deviation = np.abs(columns @ coefficients - self.target) / self.half
        return _Distance(float(residual @ residual), float(deviation.max()))

    def column(self, force: Force, value: float) -> Array:
        """Return a force with coefficient 1 over the inertia at the places, (place,)."""
        key = force.symbol, value if force.shape else None
        if key not in self.columns:
            rest = np.zeros_like(self.places)
            x, v = (self.places, rest) if self.of == "x" else (rest, self.places / self.frequency)
            shapes = {f"{force.symbol}.{name}": value for name in force.shape}
            self.columns[key] = self.frequency**2 * force.value(x, v, shapes=shapes)
        return self.columns[key]

    def solved(self, forces: Sequence[Force]) -> LawFormula:
        """Return the sum of forces that is nearest to the law, by an optimiser of pysindy."""
        # Imported here, because the import of pysindy takes as long as twenty identifications.
        from sysid_trib.likelihood.pysindy_features import ForceFeatures, WhitenedLeastSquares

        states = np.zeros((len(self.places), 2))
        states[:, 0 if self.of == "x" else 1] = self.places / (self.frequency if self.of == "v" else 1.0)
        features = ForceFeatures(ForceLibrary("terms of a formula", tuple(forces)))
        columns = self.frequency**2 * np.asarray(features.fit(states).transform(states), dtype=float)
        if self.of == "x":
            columns = np.column_stack([columns, self.frequency**2 * self.places])
        white, white_target = self.whitening @ columns, self.whitening @ self.target
        coefficients = WhitenedLeastSquares().fit(white, white_target).coef_[0]
        residual = white_target - white @ coefficients
        errors = np.sqrt(np.diag(np.linalg.pinv(white.T @ white)))
        fitted = columns @ coefficients
        deviation = np.abs(fitted - self.target) / self.half
        count = len(forces)
        return LawFormula(
            forces=forces,
            coefficients=coefficients[:count],
            errors=errors[:count],
            values=fitted + self.known,
            chi_square=float(residual @ residual),
            deviation=float(deviation.max()),
        )


def _with_value(force: Force, name: str, value: float) -> Force:
    """Return a force with its shape parameter written into the formula."""
    number = f"{value:.4g}"
    written = force.with_instead(name, number)
    return replace(written, name=f"{force.name}, {name} = {number}", shape={})


def _whitening(covariance: Array) -> Array:
    """Return the matrix that transforms a law's errors to independent unit errors, (direction, place)."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > SMALLEST_VARIANCE * values.max()
    return np.asarray(vectors[:, kept].T / np.sqrt(values[kept])[:, None])


def _as_dataset(inside: Sequence[LawFormula], law: str, places: xr.DataArray) -> xr.Dataset:
    """Return the formulas, ordered by distance from the law, over their forces.

    Parameters
    ----------
    inside : sequence of LawFormula
    law : {"friction", "restoring"}
    places : (place,) DataArray
        Visited speeds or displacements.
    """
    listed = inside[:MOST_FORMULAS]
    forces: dict[str, Force] = {}
    names: list[list[str]] = []
    for formula in listed:
        of_formula = []
        for force in formula.forces:
            # A force with another value of its shape parameter is a different force.
            same = (name for name, other in forces.items() if other.formula.text == force.formula.text)
            symbol = next(same, "")
            if not symbol:
                count = sum(name.split("__")[0] == force.symbol for name in forces)
                symbol = f"{force.symbol}__{count + 1}" if count else force.symbol
                forces[symbol] = replace(force, symbol=symbol)
            of_formula.append(symbol)
        names.append(of_formula)
    values, errors = np.full((2, len(listed), len(forces)), np.nan)
    for at, (formula, of_formula) in enumerate(zip(listed, names, strict=True)):
        columns = [list(forces).index(symbol) for symbol in of_formula]
        values[at, columns] = formula.coefficients
        errors[at, columns] = formula.errors
    information = np.array([formula.information for formula in listed])
    data = {
        "coefficient": values,
        "standard_error": errors,
        "chi_square": [formula.chi_square for formula in listed],
        "information": information - information.min() if len(listed) else information,
        "largest_deviation": [formula.deviation for formula in listed],
        law: np.reshape([formula.values for formula in listed], (len(listed), places.size)),
    }
    library = ForceLibrary("forces of formulas", tuple(forces.values()))
    coords: dict[str, Any] = {"force": list(forces), **schema.force_labels(library.forces)}
    coords[str(places.name)] = places
    attrs = {"law": law, "library": library.to_toml() if forces else ""}
    return xr.Dataset(described("law_formulas", data), coords, attrs)
