"""Channels of inputs in formulas, and the symmetries of a force under changes of sign and scale."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid_trib.arrays import Array
from sysid_trib.forces.notation import parse

if TYPE_CHECKING:
    from sysid_trib.forces.force import Force

# Values by names that contain the force's symbol, `dahl.s`.
ShapeValues: TypeAlias = Mapping[str, float]


@dataclass(frozen=True)
class Shape:
    """A shape parameter: a number inside a formula that enters nonlinearly.

    Parameters
    ----------
    default : float
        Value used if no other is given.
    low, high : float
        Range for the fit.
    meaning : str
        Text for tables.
    """

    default: float
    low: float
    high: float
    meaning: str = ""

    @property
    def is_logarithmic(self) -> bool:
        """True if the range spans more than a decade, so that positions in it are logarithmic."""
        return self.low > 0.0 and self.high > 10.0 * self.low

    def position(self, value: float) -> float:
        """Return the position of a value in the range, from 0 to 1."""
        low, high = self._uniform(self.low), self._uniform(self.high)
        return (self._uniform(value) - low) / (high - low)

    def at(self, position: ArrayLike) -> Array:
        """Return the values at positions in the range."""
        low, high = self._uniform(self.low), self._uniform(self.high)
        values = low + np.asarray(position) * (high - low)
        return np.asarray(np.clip(np.exp(values), self.low, self.high) if self.is_logarithmic else values)

    def slope(self, value: float) -> float:
        """Return the derivative of a value with respect to its position in the range."""
        return value * float(np.log(self.high / self.low)) if self.is_logarithmic else self.high - self.low

    def _uniform(self, value: float) -> float:
        """Return the coordinate (value or logarithm) that is uniform over the range."""
        return float(np.log(value)) if self.is_logarithmic else value


# Kinds of an input ("" is a separate quantity), and the powers of 1/w in formulas, as in theta' over w.
INPUT_KINDS = {"": 0, "displacement": 0, "rate": 1, "acceleration": 2}
# Derivatives of an input in formulas: `u` and `du`.
ORDERS = (0, 1)


class Channel(NamedTuple):
    """Input u(t) in a formula: `u`, or `du`, its derivative with respect to tau = w t.

    Attributes
    ----------
    input : str
        Name of the input.
    order : int
        Order of the derivative.
    kind : str
        One of `INPUT_KINDS`; unless it is "", the input is in the unit of the signal, or that per s or s^2.
    """

    input: str
    order: int = 0
    kind: str = ""

    @property
    def name(self) -> str:
        """Name in formulas."""
        return "d" * self.order + self.input

    @property
    def power(self) -> int:
        """Power of 1/w by which the input or its derivative in time is multiplied."""
        return INPUT_KINDS[self.kind] + self.order


def matches(force: "Force", formula: str) -> bool:
    """Return true if this is the force of the given formula, without history or shape parameters.

    Parameters
    ----------
    formula : str
        A formula in x, v and t. Forces are recognised by their effect, not by their symbols.

    Examples
    --------
    >>> import sysid_trib as st
    >>> st.library(drag="abs(v)*v")["drag"].matches("v*abs(v)")
    True
    """
    if not force.memoryless or force.kind != "force" or force.shape or force.uses:
        return False
    expected = parse(formula, frozenset("xvt"), frozenset(), formula).evaluate(force.test_points)
    return bool(np.allclose(_at(force, force.test_points), expected, rtol=1e-12, atol=1e-14))


def parity(force: "Force") -> str:
    """Return `odd`, `even` or `mixed` under (x, v) -> (-x, -v), including states and memory."""
    hidden, points = (*force.state, *force.memory), force.test_points
    rates = (*force.state.values(), *force.memory.values())
    for signs in itertools.product((-1.0, 1.0), repeat=len(hidden)):
        factors = dict(zip(hidden, signs, strict=True))
        flipped = points | {k: s * points[k] for k, s in ({"x": -1.0, "v": -1.0} | factors).items()}
        pairs = zip(rates, signs, strict=True)
        if not all(_same(f.evaluate(flipped), s * np.asarray(f.evaluate(points))) for f, s in pairs):
            continue
        here, there = _at(force, points), _at(force, flipped)
        if _same(there, -here):
            return "odd"
        if _same(there, here):
            return "even"
    return "mixed"


def character(force: "Force") -> str:
    """Return the character under time reversal (v -> -v): `dissipative`, `conservative`, or `mixed`.

    A force with states or memory depends on history and has no time reversal: `mixed`.
    """
    if not force.memoryless or force.channels or force.kind == "sensor":
        return "sensor" if force.kind == "sensor" else "mixed"
    points = force.test_points
    here, there = _at(force, points), _at(force, points | {"v": -points["v"]})
    return "conservative" if _same(there, here) else "dissipative" if _same(there, -here) else "mixed"


def degree(force: "Force") -> float | None:
    """Return degree q of homogeneity in (x, v) together; None without one, or with history, time, input."""
    other = force.shape or force.holds_time or force.channels or force.uses
    return None if not force.memoryless or other else _degree_in(force, {"x": 1.0, "v": 1.0})


def speed_degree(force: "Force") -> float | None:
    """Return the degree of homogeneity in v alone (0 without v); None without one, or with states.

    A degree that depends on a shape parameter, as in abs(v)**p, counts as none. Inputs divided by w count as
    v, those divided by w^2 as its square.
    """
    ends = [{k: getattr(s, end) for k, s in force.shape.items()} for end in ("default", "low", "high")]
    over_w = {channel.name: float(channel.power) for channel in force.channels if channel.power}
    degrees = {_degree_in(force, {"v": 1.0} | over_w, shapes) for shapes in ends}
    return None if force.state or len(degrees) > 1 else degrees.pop()


def units(force: "Force") -> str:
    """Return the unit of the coefficient: `1` (dimensionless, angles in rad), or a power of s if t enters."""
    power = _degree_in(force, {"t": 1.0}) if force.memoryless else None
    return "1" if not power else "s-1" if power == 1 else f"s{-power:g}"


def as_factor(unit: str) -> str:
    """Return a unit to which a power or a `/` can be appended: `(% of tank width)`, `(m/V)`, but `mm`."""
    return f"({unit})" if set("*/· ") & set(unit) else unit


def units_with(force: "Force", inputs: Mapping[str, str]) -> str:
    """Return the unit of the coefficient for inputs with units of their own, by name: `1/V`.

    For an input without a unit its name is used: `1/u`.
    """
    text = force.units
    with_unit = [
        channel for channel in force.channels if not channel.kind and inputs.get(channel.input) != "1"
    ]
    raw = dict.fromkeys(channel.input for channel in with_unit if channel.input in inputs)
    for name in raw:
        of_input = {channel.name: 1.0 for channel in force.channels if channel.input == name}
        if power := _degree_in(force, of_input):
            unit = as_factor(inputs[name] or name)
            text += f"/{unit}" if power == 1 else f"/{unit}^{power:g}"
    return text


def test_points(force: "Force") -> dict[str, Any]:
    """Return points at which formulas are compared; deterministic, and not on the axes.

    Some are near zero: tanh(v/s) with a small s equals sign(v) everywhere else.
    """
    random = np.random.default_rng(20190417)
    sides = random.choice((-1.0, 1.0), size=(2, 64))
    large, small = random.uniform(0.05, 1.2, (2, 40)), 10.0 ** random.uniform(-5.0, -1.3, (2, 24))
    sizes = random.permuted(np.concatenate((large, small), axis=1), axis=1)
    points = dict(zip("xv", sides * sizes, strict=True))
    points |= {k: random.uniform(-0.5, 0.5, 64) for k in (*force.state, *force.memory)}
    points |= {"t": random.uniform(0.5, 20.0, 64)} | force.shape_values()
    # Different values: forces that contain a coefficient may equal others at a particular value of it.
    points |= {symbol: 0.7 + 0.3 * at for at, symbol in enumerate(force.uses)}
    return points | {
        c.name: random.choice((-1.0, 1.0), 64) * random.uniform(0.05, 1.2, 64) for c in force.channels
    }


def _at(force: "Force", names: Mapping[str, Any]) -> NDArray[np.float64]:
    with np.errstate(all="ignore"):
        return np.broadcast_to(force.formula.evaluate(names), (64,))


def _degree_in(
    force: "Force", powers: Mapping[str, float], shapes: ShapeValues | None = None
) -> float | None:
    """Return the degree if variables scale with these powers of a factor; None if there is none, or for 0."""
    points = force.test_points | dict(shapes or {})
    # The factors cover many scales: at a single scale, tanh(v/s) cannot be distinguished from sign(v).
    degree = force.formula.degree_in(powers, points, (2.0, 4.0, 1e-3, 1e-6))
    return None if degree == np.inf else degree


def _same(first: Any, second: Any) -> bool:
    return bool(np.allclose(first, second, rtol=1e-9, atol=1e-12))
