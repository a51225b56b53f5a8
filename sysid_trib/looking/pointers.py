"""Which forces the backbone of a decay points to: the fewest whose averages stay within its bands."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.optimize import lsq_linear, nnls
from scipy.special import ellipk

from sysid_trib.arrays import Array
from sysid_trib.averaging.backbone import BackboneCurves
from sysid_trib.averaging.signatures import averages
from sysid_trib.forces.force import ForceLibrary

# By formula, as libraries may name them otherwise; in words.
FRICTION = {"sign(v)": "dry friction", "2*v": "viscous friction", "v*abs(v)": "drag"}
ELASTIC = {"x*abs(x)": "a stiffness that goes with the amplitude", "x**3": "a cubic stiffness"}
# Beside the band, of a shift of the frequency: what a pendulum's third harmonic and a string that gives leave
# open.
OPEN_PART = 0.1
# Decrements go with the square of the period: averages of first order leave that open.
OF_SHIFT = 2.0
# A curve that is nowhere known better than so says nothing.
LEAST_KNOWN = 0.5


@dataclass(frozen=True)
class Pointed:
    """What a backbone points to.

    Attributes
    ----------
    friction, elastic : tuple of str
        Formulas.
    pendulum : bool
        Whether frequency and amplitude are those of a pendulum.
    """

    friction: tuple[str, ...] = ()
    elastic: tuple[str, ...] = ()
    pendulum: bool = False

    @property
    def formulas(self) -> tuple[str, ...]:
        """Formulas of the forces that are identified."""
        return (*self.friction, *self.elastic)

    @property
    def sentence(self) -> str:
        """What is pointed to, in words; nothing if nothing is."""
        parts = []
        if self.friction:
            parts.append(f"damping as of {_listed([FRICTION[formula] for formula in self.friction])}")
        if self.pendulum:
            parts.append("amplitude and frequency as of a pendulum under gravity")
        elif self.elastic:
            parts.append(f"frequency as of {_listed([ELASTIC[formula] for formula in self.elastic])}")
        return "; ".join(parts)


def pointed_to(curves: BackboneCurves, library: ForceLibrary, *, angle: bool) -> Pointed:
    """The forces that a backbone points to.

    Parameters
    ----------
    curves : BackboneCurves
        Of `backbone_curves`.
    library : ForceLibrary
        Of forces of these formulas.
    angle : bool
        Whether the signal is an angle in rad: else nothing is a pendulum.

    Notes
    -----
    Of damping the fewest of dry friction, viscous friction and drag, none negative, that stay within the
    band; all that have a part in the best sum where none do. Of frequency nothing where a constant stays
    within the band; a pendulum where w0 pi/(2 K(sin(a/2))) does; else the fewest elastic forces.
    """
    a = np.exp(curves.log_amplitude)
    tables = {
        formula: averages(force, a, {})
        for formula in (*FRICTION, *ELASTIC)
        if (force := library.role(formula)) is not None
    }
    damping = {formula: -tables[formula][0] / a for formula in FRICTION if formula in tables}
    frequency, half = curves.by_name["frequency"].mean, curves.half_width("frequency")
    shift = np.abs(frequency - np.average(frequency, weights=half**-2.0))
    ratio = curves.by_name["damping_ratio"].mean
    width = curves.half_width("damping_ratio") + OF_SHIFT * shift / frequency * np.abs(ratio)
    known = np.min(width / np.abs(ratio)) < LEAST_KNOWN
    friction = _fewest(damping, ratio, width, np.empty((len(a), 0))) if known else ()
    if _within({}, frequency, half, np.ones((len(a), 1))):
        return Pointed(friction)
    swing = np.pi / (2.0 * ellipk(np.sin(0.5 * np.minimum(a, 3.1)) ** 2))
    half = half + OPEN_PART * shift
    if angle and a[-1] < np.pi and _within({}, frequency, half, swing[:, None]):
        return Pointed(friction, pendulum=True)
    shifts = {formula: tables[formula][1] / a for formula in ELASTIC if formula in tables}
    return Pointed(friction, _fewest(shifts, frequency, half, np.ones((len(a), 1))))


def _fewest(columns: Mapping[str, Array], curve: Array, half: Array, always: Array) -> tuple[str, ...]:
    """The fewest columns whose sum stays within the band; those of the best sum where none do."""
    for count in range(1, len(columns) + 1):
        within = {
            names: part
            for names in combinations(columns, count)
            if (part := _within({name: columns[name] for name in names}, curve, half, always))
        }
        if within:
            return min(within, key=lambda names: within[names])
    _, weights = _fit(columns, curve, half, always)
    return tuple(name for name, weight in zip(columns, weights, strict=False) if weight)


def _within(columns: Mapping[str, Array], curve: Array, half: Array, always: Array) -> float:
    """The largest deviation of the best sum in half widths, 0 where that is outside of the band."""
    deviation, _ = _fit(columns, curve, half, always)
    return deviation if deviation <= 1.0 else 0.0


def _fit(columns: Mapping[str, Array], curve: Array, half: Array, always: Array) -> tuple[float, Array]:
    """Largest deviation in half widths, and weights of the columns: none negative without others."""
    table = np.column_stack([*columns.values(), always]) / half[:, None]
    if always.size:
        weights = lsq_linear(table, curve / half).x
    else:
        weights, _ = nnls(table, curve / half)
    return float(np.max(np.abs(table @ weights - curve / half))), weights


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
