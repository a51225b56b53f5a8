"""Model of laws: named forces, curves, and fixed forces."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.forces.constraints import Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import is_free_to_move, with_shipped
from sysid_trib.forces.systems import System
from sysid_trib.results.law_curves import NAME_IN_FORMULAS, VARIABLE_OF_LAW
from sysid_trib.smooth_laws import curves

# Forces without penalty if no system is named, and one that is always included: a jump at rest.
USUAL, JUMP = ("lambda", "zeta", "delta", "nu", "epsilon"), "sign(v)"
# With fewer half periods, or if amplitudes change by less than this factor, no curve is determined.
FEWEST_OF_A_CURVE, SMALLEST_RANGE = 8, 1.15
# Lower limit of a law of averaging, relative to the smallest amplitude: below, averages contain nothing.
BELOW_SMALLEST = 0.5


@dataclass(frozen=True)
class LawModel:
    """Model of laws: named forces, curves, and fixed forces.

    Attributes
    ----------
    named : ForceLibrary
        Forces without penalty, and fixed forces.
    constraints : mapping
        Constraints of coefficients.
    odd, even : tuple of str
        Curves of `libraries/curves.toml`; none if the record determines no curve.
    own : tuple of str
        Laws that are separate for each run, `friction` or `restoring`, and symbols of such named forces.
    reason : str
        Reason why the record determines no curve, or empty.
    """

    named: ForceLibrary
    constraints: ConstraintTable
    odd: tuple[str, ...] = curves.ODD_CURVES
    even: tuple[str, ...] = ()
    own: tuple[str, ...] = ()
    reason: str = ""

    def library(
        self, runs: Sequence[xr.Dataset], lowest: float = 0.0, frequency: float | None = None
    ) -> ForceLibrary:
        """Return all forces, with basis functions over the range of the runs at a frequency (rad/s)."""
        ranges = curves.ranges(runs, frequency)
        return curves.with_curves(self.named, (*self.odd, *self.even), ranges, lowest)

    def own_symbols(self, library: ForceLibrary) -> tuple[str, ...]:
        """Return the forces of a library whose coefficients are separate for each run."""
        of_laws = {NAME_IN_FORMULAS[VARIABLE_OF_LAW[law]] for law in self.own if law in VARIABLE_OF_LAW}
        return tuple(
            force.symbol
            for force in library
            if force.symbol in self.own or any(force.depends_only_on(of) for of in of_laws)
        )

    @property
    def without_curves(self) -> "LawModel":
        """The named forces alone."""
        return replace(self, odd=(), even=())

    @property
    def of_odd_forces(self) -> "LawModel":
        """The model without the forces whose average over a cycle is zero."""
        seen = self.named.select(force.symbol for force in self.named if force.parity != "even")
        return replace(self, named=seen, even=())

    @property
    def is_free_to_move(self) -> bool:
        """True if the body has no restoring force."""
        return is_free_to_move(self.named, Constraints(self.constraints).fixed)


def law_model(system: System, asked: Constraints, library: ForceLibrary | None) -> LawModel:
    """Return the forces without penalty, and the fixed ones."""
    whole = library or load_library()
    symbols = list(dict.fromkeys((*(system.symbols or USUAL), *asked.names)))
    whole = with_shipped(whole, symbols)
    named = with_jump(whole.select(symbols), whole)
    held = {symbol: value for symbol, value in system.held.items() if symbol not in asked.names}
    return LawModel(named, {**held, **asked.table})


def with_jump(named: ForceLibrary, offered: ForceLibrary) -> ForceLibrary:
    """Return the forces with one that jumps at rest, from the given library or from the package."""
    jump = offered.role(JUMP) or load_library().role(JUMP)
    if jump is None or named.role(JUMP) is not None:
        return named
    return replace(named, forces=(jump, *named.forces))


def smallest_part(amplitudes: Array) -> float:
    """Return the lower limit of a law of averaging, as a fraction of the largest amplitude."""
    return BELOW_SMALLEST * float(amplitudes.min() / amplitudes.max())


def why_no_curve(amplitudes: Array) -> str:
    """Return the reason why the amplitudes determine no curve, or an empty text."""
    if len(amplitudes) < FEWEST_OF_A_CURVE:
        return (
            f"{len(amplitudes)} half periods are too few for a curve (it takes {FEWEST_OF_A_CURVE}): the "
            "laws are those of the named forces."
        )
    ratio = float(amplitudes.max() / max(amplitudes.min(), 1e-300))
    if ratio < SMALLEST_RANGE:
        return (
            f"The amplitude changes by a factor of {ratio:.3g} only, too little for a curve (it takes "
            f"{SMALLEST_RANGE:g}): the laws are those of the named forces."
        )
    return ""
