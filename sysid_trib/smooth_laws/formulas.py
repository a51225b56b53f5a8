"""From a law to formulas: the simplest sums of library forces that stay within its band."""

import itertools
from collections.abc import Iterator, Sequence

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import EFFECTS
from sysid_trib.results import schema, signal_scale
from sysid_trib.results.variables import described

# Most terms of a formula, and most formulas that are listed.
MOST_TERMS, MOST_LISTED = 3, 6
# Values of each shape parameter that are tried, evenly in the logarithm over the visited range.
SHAPE_VALUES = 6
# Directions of a law's covariance below this part of the largest tell nothing but rounding.
SMALLEST_VARIANCE = 1e-9
VARIABLES = {"friction": ("speed", "v"), "restoring": ("displacement", "x")}


@signal_scale.in_units_of_the_motion
def formulas(result: xr.Dataset, law: str = "friction", candidates: ForceLibrary | None = None) -> xr.Dataset:
    """List the simplest sums of library forces that stay within the band of a law.

    Parameters
    ----------
    result : Dataset
        An identification by `laws`.
    law : {"friction", "restoring"}
    candidates : ForceLibrary, optional
        Forces to choose from: those of speed alone, or of displacement alone. By default those of
        `contact_forces` and `candidate_effects`.

    Returns
    -------
    Dataset
        Over `alternative` (the fewest terms first, then by information) and `force` the `coefficient`, nan of
        a force that is not in the formula, and its `standard_error`; `chi_square`, `information` (Akaike's,
        less the least), `largest_deviation` from the law over the half width of its band. Empty over
        `alternative` where no formula of up to three terms stays inside. Forces with shape parameters occur
        once for each value tried, which is in the symbol's `formula`.

    Raises
    ------
    UsageError
        Not a law, or no candidate of its variable.
    DecayError
        The identification holds no law.

    Notes
    -----
    Every sum is solved by `WhitenedLeastSquares`, an optimiser of pysindy, on the features of
    `ForceFeatures`, in the metric of the law's covariance.
    """
    if law not in VARIABLES:
        raise UsageError(f"law='{law}' is neither 'friction' nor 'restoring'.")
    if law not in result:
        raise DecayError("This identification holds no laws; make one by laws.")
    variable, of = VARIABLES[law]
    part = result.isel({variable: np.flatnonzero(result[f"{variable}_visited"].values)})
    places = part[variable].values
    w = result.reference_frequency.item()
    offered = _candidates(candidates, of, float(np.max(np.abs(places))) / (w if of == "v" else 1.0))
    columns = w**2 * _features(offered, places, of, w)
    target, extra = part[law].values, np.zeros((len(places), 0))
    if of == "x":
        # The frequency is fitted with each formula.
        target, extra = target - w**2 * places, w**2 * places[:, None]
    at = np.flatnonzero(result[f"{variable}_visited"].values)
    whitening = _whitening(result[f"{law}_covariance"].values[np.ix_(at, at)])
    half = 0.5 * (part[f"{law}_high"].values - part[f"{law}_low"].values)
    rows = list(_inside(whitening, columns, extra, target, half))
    return _as_dataset(rows, offered, law)


def _candidates(candidates: ForceLibrary | None, of: str, largest: float) -> ForceLibrary:
    """Return the forces of one variable, those with a shape parameter once for each value of it."""
    if candidates is None:
        shipped = (*load_library(), *load_library(EFFECTS))
        candidates = ForceLibrary("candidates of formulas", tuple({f.symbol: f for f in shipped}.values()))
    kept: list[Force] = []
    for force in candidates:
        memoryless = force.kind == "force" and force.memoryless and not force.holds_time
        if not memoryless or force.channels or {"x", "v"} & set(force.formula.names) != {of}:
            continue
        if force.matches("x") or force.parity == "even" or len(force.shape) > 1:
            continue
        kept += _at_shapes(force, largest)
    if not kept:
        raise UsageError(f"The candidates hold no force of {of} alone; offer some.")
    return ForceLibrary("candidates of formulas", tuple(kept))


def _at_shapes(force: Force, largest: float) -> Iterator[Force]:
    """Yield a force, with its shape parameter written into the formula for each value tried."""
    if not force.shape:
        yield force
        return
    ((name, shape),) = force.shape.items()
    low, high = max(shape.low, 0.03 * largest), min(shape.high, 1.5 * largest)
    if not low < high:
        low, high = shape.low, shape.high
    for number, value in enumerate(np.geomspace(low, high, SHAPE_VALUES), 1):
        written = force.with_instead(name, f"{value:.4g}")
        yield Force(
            symbol=f"{force.symbol}_at_{number}",
            name=f"{force.name}, {name} = {value:.4g}",
            formula=written.formula,
            family=force.family,
            meaning=force.meaning,
            source=force.source,
        )


def _features(offered: ForceLibrary, places: Array, of: str, w: float) -> Array:
    """Return the features of the forces at the places of a law, (place, force), rad."""
    # Here, since importing pysindy takes as long as twenty identifications.
    from sysid_trib.likelihood.pysindy_features import ForceFeatures

    states = np.zeros((len(places), 2))
    states[:, 0 if of == "x" else 1] = places / (w if of == "v" else 1.0)
    features = ForceFeatures(offered)
    return np.asarray(features.fit(states).transform(states), dtype=float)


def _whitening(covariance: Array) -> Array:
    """Return the matrix that makes a law's errors independent of unit variance, (direction, place)."""
    values, vectors = np.linalg.eigh(covariance)
    kept = values > SMALLEST_VARIANCE * values.max()
    return np.asarray(vectors[:, kept].T / np.sqrt(values[kept])[:, None])


def _inside(
    whitening: Array, columns: Array, extra: Array, target: Array, half: Array
) -> Iterator[tuple[Sequence[int], Array, Array, float, float]]:
    """Yield the sums that stay within the band: forces, coefficients, errors, chi-square, deviation."""
    from sysid_trib.likelihood.pysindy_features import WhitenedLeastSquares

    white, white_target = whitening @ np.column_stack([columns, extra]), whitening @ target
    others = list(range(columns.shape[1], white.shape[1]))
    for count in range(1, MOST_TERMS + 1):
        found = 0
        for chosen in itertools.combinations(range(columns.shape[1]), count):
            at = [*chosen, *others]
            if len(at) >= len(white):
                continue
            fit = WhitenedLeastSquares().fit(white[:, at], white_target)
            solved = fit.coef_[0]
            deviation = np.abs(np.column_stack([columns, extra])[:, at] @ solved - target)
            largest = float(np.max(deviation / half))
            if not largest <= 1.0:
                continue
            residual = white_target - white[:, at] @ solved
            inverse = np.linalg.pinv(white[:, at].T @ white[:, at])
            errors = np.sqrt(np.diag(inverse))
            found += 1
            yield chosen, solved[:count], errors[:count], float(residual @ residual), largest
        if found:
            # The simplest formulas: longer ones hold these.
            return


def _as_dataset(
    rows: Sequence[tuple[Sequence[int], Array, Array, float, float]], offered: ForceLibrary, law: str
) -> xr.Dataset:
    """Return the formulas by their information, over the forces that they hold."""
    rows = sorted(rows, key=lambda row: row[3])[:MOST_LISTED]
    used = sorted({force for row in rows for force in row[0]})
    values, errors = np.full((2, len(rows), len(used)), np.nan)
    for at, (chosen, solved, error, *_) in enumerate(rows):
        places = [used.index(force) for force in chosen]
        values[at, places], errors[at, places] = solved, error
    information = np.array([square + 2.0 * len(chosen) for chosen, _, _, square, _ in rows])
    data = {
        "coefficient": values,
        "standard_error": errors,
        "chi_square": [row[3] for row in rows],
        "information": information - information.min() if len(rows) else information,
        "largest_deviation": [row[4] for row in rows],
    }
    forces = [offered.forces[force] for force in used]
    library = ForceLibrary(offered.title, tuple(forces))
    coords = {"force": [force.symbol for force in forces], **schema.force_labels(forces)}
    attrs = {"law": law, "library": library.to_toml() if forces else ""}
    return xr.Dataset(described("law_formulas", data), coords, attrs)
