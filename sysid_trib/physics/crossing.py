"""Amplitudes at which two forces weigh the same."""

import itertools
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import xarray as xr
from scipy.optimize import bisect, brentq

from sysid_trib.averaging.signatures import averages
from sysid_trib.errors import LibraryError
from sysid_trib.forces.force import Force
from sysid_trib.physics.force_weights import peak
from sysid_trib.physics.quantities import Array
from sysid_trib.physics.unknowns import Unknowns, unknowns_of

# Amplitudes (rad) among which a crossover is sought where a force is no power law: 12 a decade.
LOWEST, HIGHEST, GRID = 1e-4, np.pi, 55
RULES = ("peak force", "averaged")
# Of ln a, for the slope of two weights that cross.
STEP = 1e-4

Size = Callable[[Array], Array]


def crossovers(result: xr.Dataset) -> xr.Dataset:
    """Amplitudes at which two forces weigh the same, by peak force and by what they do on average.

    Parameters
    ----------
    result : an identification.

    Returns
    -------
    Dataset over `pair` (coordinates `first`, `second`, and `acts_on`: envelope or frequency) and `rule`
    (`peak force`, `averaged`): `amplitude` (rad; nan if there is none; of forces that are no power laws the
    smallest from 1e-4 to pi) with `amplitude_standard_error`, `crossings`, how many there are, and over
    `pair` `opposed`, whether the two act against each other at the averaged crossover: a pair of which one
    feeds and one damps then sustains an oscillation there. Signs do not count for the amplitude. Forces with
    a past are in both groups.

    Raises
    ------
    UsageError
        Not an identification.

    Notes
    -----
    Le Bot et al. 2019, Sec. 4, compares peak forces in the envelope, 2 zeta/delta and lambda/(2 zeta), and
    averages in the frequency, 32 nu/(9 pi epsilon). By averages the first are 3 pi zeta/(4 delta) and
    2 lambda/(pi zeta), by peak force the last is nu/epsilon.
    """
    found = unknowns_of(result)
    at, rows, sizes = [], [], _Sizes(found)
    for acts_on, kinds in (
        ("envelope", ("dissipative", "mixed")),
        ("frequency", ("conservative", "mixed")),
    ):
        group = [i for i, force in enumerate(found.forces) if force.character in kinds]
        for pair in itertools.combinations(group, 2):
            at.append((*(found.symbols[i] for i in pair), acts_on))
            rows.append([_crossing(found, pair, [sizes(i, acts_on, rule) for i in pair]) for rule in RULES])
    table = np.array(rows, dtype=float).reshape(-1, len(RULES), 4)
    told = {"units": "rad", "long_name": "amplitude at which two forces weigh the same"}
    error = told | {"long_name": "standard error of the amplitude"}
    data = {
        "amplitude": (("pair", "rule"), table[..., 0], told),
        "amplitude_standard_error": (("pair", "rule"), table[..., 1], error),
        "crossings": (("pair", "rule"), table[..., 2].astype(int), {"units": "1", "long_name": "crossings"}),
        "opposed": ("pair", table[:, 1, 3] > 0, {"long_name": "whether they act against each other"}),
    }
    first, second, acts_on_each = (np.array([row[k] for row in at], dtype=str) for k in range(3))
    return xr.Dataset(
        data,
        {
            "pair": np.array([f"{one} {two} {kind}" for one, two, kind in at], dtype=str),
            "rule": list(RULES),
            "first": ("pair", first),
            "second": ("pair", second),
            "acts_on": ("pair", acts_on_each),
        },
        {"library": result.attrs["library"]},
    )


class _Sizes:
    """Weight of each force with coefficient 1 as a function of amplitude, tabulated once."""

    def __init__(self, found: Unknowns) -> None:
        self.found = found
        self.grid = np.geomspace(LOWEST, HIGHEST, GRID)
        self.tables: dict[tuple[int, str, str], tuple[Size, Array]] = {}

    def __call__(self, i: int, acts_on: str, rule: str) -> tuple[Size, Array]:
        key = (i, acts_on if rule == "averaged" else "", rule)
        if key not in self.tables:
            size = self._size(self.found.forces[i], acts_on, rule)
            self.tables[key] = size, size(self.grid)
        return self.tables[key]

    def _size(self, force: Force, acts_on: str, rule: str) -> Size:
        def size(a: Array) -> Array:
            if rule == "peak force":
                return peak(force, a, self.found.shapes)
            return averages(force, a, self.found.shapes)[0 if acts_on == "envelope" else 1]

        def where_finite(a: Array) -> Array:
            try:
                return size(a)
            except LibraryError:
                found = np.full(a.size, np.nan)
            # A limit of a formula: what lies beyond is no amplitude of this force.
            with suppress(LibraryError):
                for i in range(a.size if a.size > 1 else 0):
                    found[i] = size(a[i : i + 1])[0]
            return found

        return where_finite


def _crossing(
    found: Unknowns, pair: tuple[int, ...], sizes: list[tuple[Size, Array]]
) -> tuple[float, float, int, bool]:
    """Smallest amplitude of equal weights, its error, how many there are, and whether they are opposed."""
    c, spread = found.coefficients[list(pair)], found.spread[np.ix_(pair, pair)]

    def difference(tables: list[Array]) -> Array:
        with np.errstate(all="ignore"):
            levels = [np.log(np.abs(k * table)) for k, table in zip(c, tables, strict=True)]
            return levels[0] - levels[1]

    def at(log_a: float) -> float:
        return float(difference([size(np.array([np.exp(log_a)])) for size, _ in sizes])[0])

    degrees = [found.forces[i].degree for i in pair]
    if degrees[0] is not None and degrees[1] is not None:
        level = at(0.0)
        powers = degrees[1] - degrees[0]
        roots = [level / powers] if powers and np.isfinite(level) else []
    else:
        roots = _roots(at, difference([table for _, table in sizes]))
    if not roots:
        return np.nan, np.nan, 0, False
    root = min(roots)
    a = float(np.exp(root))
    slope = (at(root + STEP) - at(root - STEP)) / (2.0 * STEP)
    gradient = np.array([1.0, -1.0]) / c
    error = a * float(np.sqrt(gradient @ spread @ gradient)) / abs(slope) if slope else np.nan
    signed = [k * size(np.array([a]))[0] for k, (size, _) in zip(c, sizes, strict=True)]
    return a, error, len(roots), bool(signed[0] * signed[1] < 0)


def _roots(function: Callable[[float], float], level: Array) -> list[float]:
    """Zeros in ln a of a function that is `level` on the grid."""
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
