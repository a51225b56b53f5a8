"""Forces as data: a force is declared by lines of TOML, everything else is derived from its formula."""

import itertools
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid_trib.errors import UsageError, did_you_mean
from sysid_trib.forces import notation
from sysid_trib.forces.formulas import Formula, parse

# By name with the force's symbol, `dahl.s`.
ShapeValues: TypeAlias = Mapping[str, float]


@dataclass(frozen=True)
class Shape:
    """A shape parameter: a number inside a formula that does not enter linearly.

    Parameters
    ----------
    default : float
        Its value unless another is given.
    low, high : float
        The range in which it is fitted.
    meaning : str
        Shown in tables.
    """

    default: float
    low: float
    high: float
    meaning: str = ""


# What an input may be, other than any quantity of its own, and the power of 1/w with which formulas then
# see it, as they see theta' over w.
INPUT_KINDS = {"": 0, "displacement": 0, "rate": 1, "acceleration": 2}
# Derivatives of an input that formulas may hold: `u` and `du`.
ORDERS = (0, 1)


class Channel(NamedTuple):
    """What a formula sees of an input u(t): `u`, or `du`, its derivative by tau = w t.

    Attributes
    ----------
    input : str
        Its name.
    order : int
        Of the derivative.
    kind : str
        One of `INPUT_KINDS`; other than "" it is in the unit of the signal, or that over s or s^2.
    """

    input: str
    order: int = 0
    kind: str = ""

    @property
    def name(self) -> str:
        """As formulas write it."""
        return "d" * self.order + self.input

    @property
    def power(self) -> int:
        """Power of 1/w with which the derivative by time is seen."""
        return INPUT_KINDS[self.kind] + self.order


@dataclass(frozen=True)
class Force:
    """One term h(x, v, t, z, m) of f = sum of coefficient * h, or one term of the sensor.

    `x` = theta (rad), `v` = theta'/w (rad), `t` = seconds since the first sample, `state` z obeys
    dz/d(w t) = formula, `memory` m is held between reversals (v = 0) and replaced there.

    Parameters
    ----------
    symbol : str
        The coefficient's name.
    name : str
        Shown in tables.
    formula : Formula
        h (rad).
    family, meaning, source : str
        Shown in tables.
    kind : str
        `force`, or `sensor`: the measured angle is then x + coefficient * h.
    state : mapping of str to Formula
        Right side of each internal state.
    memory : mapping of str to Formula
        What replaces each held value at a reversal.
    start : mapping of str to Formula
        First value of states and memory, from x, v and t at the first sample; zero where left out.
    shape : mapping of str to Shape
        Parameters that do not enter linearly.
    passive : bool
        Whether it can only store or lose energy, so that its coefficient is not negative.
    coefficient : float, optional
        Its coefficient where physics knows it, as 1 of gravity: with another one it is another force.
    channels : tuple of Channel
        What its formulas hold of inputs.
    run : int, optional
        Of several runs, from 1, the only one in which it acts: its coefficient is that run's own.
    """

    symbol: str
    name: str
    formula: Formula
    family: str = ""
    meaning: str = ""
    source: str = ""
    kind: str = "force"
    state: Mapping[str, Formula] = field(default_factory=dict)
    memory: Mapping[str, Formula] = field(default_factory=dict)
    start: Mapping[str, Formula] = field(default_factory=dict)
    shape: Mapping[str, Shape] = field(default_factory=dict)
    passive: bool = False
    coefficient: float | None = None
    channels: tuple[Channel, ...] = ()
    run: int | None = None

    def __hash__(self) -> int:
        return hash((self.symbol, self.formula))

    @property
    def formulas(self) -> tuple[Formula, ...]:
        """All right sides: of the force, its states and its memory."""
        return (self.formula, *self.state.values(), *self.memory.values())

    @property
    def memoryless(self) -> bool:
        """True if the force is a function of x, v and t alone."""
        return not self.state and not self.memory

    @cached_property
    def surfaces(self) -> tuple[Formula, ...]:
        """Switching surfaces of the motion: of the force and of its states."""
        formulas = (self.formula, *self.state.values())
        return tuple(dict.fromkeys(surface for f in formulas for surface in f.surfaces))

    @property
    def holds_time(self) -> bool:
        """True if any of its formulas holds `t`."""
        return any("t" in f.names for f in self.formulas)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs that its formulas hold."""
        return tuple(dict.fromkeys(channel.input for channel in self.channels))

    def shape_values(self, shapes: ShapeValues | None = None) -> dict[str, float]:
        """Value of each shape parameter: from `shapes` (`{"dahl.s": 0.02}`), else the default."""
        given = shapes or {}
        return {k: float(given.get(f"{self.symbol}.{k}", s.default)) for k, s in self.shape.items()}

    def with_instead(self, name: str, text: str, over: float = 1.0) -> "Force":
        """The force with an expression in the place of a name; rates of states are divided by a number."""
        state, memory, start = (
            {key: formula.with_instead(name, text, by) for key, formula in table.items()}
            for table, by in ((self.state, over), (self.memory, 1.0), (self.start, 1.0))
        )
        formula = self.formula.with_instead(name, text)
        return replace(self, formula=formula, state=state, memory=memory, start=start)

    def start_values(self, names: Mapping[str, Any]) -> dict[str, Any]:
        """First value of each state and memory, from x, v, t and the shape parameters in `names`."""
        values = dict.fromkeys((*self.state, *self.memory), 0.0)
        return values | {k: formula.evaluate(names) for k, formula in self.start.items()}

    def value(
        self,
        x: ArrayLike,
        v: ArrayLike,
        t: ArrayLike = 0.0,
        *,
        shapes: ShapeValues | None = None,
        hidden: Mapping[str, ArrayLike] | None = None,
    ) -> NDArray[np.float64]:
        """Value of h at the given points.

        Parameters
        ----------
        x, v : array of float, rad
            Angle and dx/dtau.
        t : array of float, s
            Time since the first sample.
        shapes : mapping of str to float, optional
            Shape parameters, `{"dahl.s": 0.02}`; defaults where left out.
        hidden : mapping of str to array of float, optional
            States, memory, and inputs as formulas name them; zero where left out.

        Returns
        -------
        array of float, rad
        """
        absent = (*self.state, *self.memory, *(channel.name for channel in self.channels))
        given = {"x": x, "v": v, "t": t, **dict.fromkeys(absent, 0.0), **(hidden or {})}
        arrays = {k: np.asarray(a, dtype=float) for k, a in given.items()}
        with np.errstate(all="ignore"):
            h = self.formula.evaluate({**arrays, **self.shape_values(shapes)})
        return np.broadcast_to(h, np.broadcast_shapes(arrays["x"].shape, arrays["v"].shape, np.shape(h)))

    def matches(self, formula: str) -> bool:
        """True if this is the force of the given formula, without history or shape parameters.

        Parameters
        ----------
        formula : str
            A formula in x, v and t. Forces are known by what they do, not by their symbols.
        """
        if not self.memoryless or self.kind != "force" or self.shape:
            return False
        expected = parse(formula, frozenset("xvt"), frozenset(), formula).evaluate(self.test_points)
        return bool(np.allclose(self._at(self.test_points), expected, rtol=1e-12, atol=1e-14))

    @cached_property
    def parity(self) -> str:
        """`odd`, `even` or `mixed` under (x, v) -> (-x, -v), states and memory following."""
        hidden, points = (*self.state, *self.memory), self.test_points
        rates = (*self.state.values(), *self.memory.values())
        for signs in itertools.product((-1.0, 1.0), repeat=len(hidden)):
            factors = dict(zip(hidden, signs, strict=True))
            flipped = points | {k: s * points[k] for k, s in ({"x": -1.0, "v": -1.0} | factors).items()}
            pairs = zip(rates, signs, strict=True)
            if not all(_same(f.evaluate(flipped), s * np.asarray(f.evaluate(points))) for f, s in pairs):
                continue
            here, there = self._at(points), self._at(flipped)
            if _same(there, -here):
                return "odd"
            if _same(there, here):
                return "even"
        return "mixed"

    @cached_property
    def character(self) -> str:
        """`dissipative` or `conservative` type by time reversal (v -> -v), else `mixed`.

        A force with states or memory depends on history, which has no time reversal: `mixed`.
        """
        if not self.memoryless or self.channels or self.kind == "sensor":
            return "sensor" if self.kind == "sensor" else "mixed"
        here, there = self._at(self.test_points), self._at(self.test_points | {"v": -self.test_points["v"]})
        return "conservative" if _same(there, here) else "dissipative" if _same(there, -here) else "mixed"

    @cached_property
    def degree(self) -> float | None:
        """Degree q of homogeneity in (x, v) together; None without one, of history, time and inputs."""
        other = self.shape or self.holds_time or self.channels
        return None if not self.memoryless or other else self._degree_in({"x": 1.0, "v": 1.0})

    @cached_property
    def speed_degree(self) -> float | None:
        """Degree of homogeneity in v alone (0 without v), None if there is none or if it has states.

        A degree that depends on a shape parameter, as that of abs(v)**p, is none. Inputs that are seen over w
        count as v, over w^2 as its square.
        """
        ends = [{k: getattr(s, end) for k, s in self.shape.items()} for end in ("default", "low", "high")]
        over_w = {channel.name: float(channel.power) for channel in self.channels if channel.power}
        degrees = {self._degree_in({"v": 1.0} | over_w, shapes) for shapes in ends}
        return None if self.state or len(degrees) > 1 else degrees.pop()

    @cached_property
    def units(self) -> str:
        """Unit of the coefficient: `1` (dimensionless, angles in rad), or a power of s where t enters."""
        degree = self._degree_in({"t": 1.0}) if self.memoryless else None
        return "1" if not degree else "s-1" if degree == 1 else f"s{-degree:g}"

    def units_with(self, inputs: Mapping[str, str]) -> str:
        """Unit of the coefficient with inputs in units of their own, by their names: `1/V`.

        Of an input that has none its name stands for it: `1/u`.
        """
        text = self.units
        raw = dict.fromkeys(c.input for c in self.channels if not c.kind and c.input in inputs)
        for name in raw:
            of_input = {channel.name: 1.0 for channel in self.channels if channel.input == name}
            if degree := self._degree_in(of_input):
                unit = inputs[name] or name
                unit = f"({unit})" if set("*/") & set(unit) else unit
                text += f"/{unit}" if degree == 1 else f"/{unit}^{degree:g}"
        return text

    @cached_property
    def latex(self) -> str:
        """The formula in LaTeX, with theta and theta' = dtheta/d(w t)."""
        return notation.formula_latex(self)

    @property
    def latex_symbol(self) -> str:
        """The coefficient's symbol in LaTeX."""
        return notation.symbol_latex(self.symbol)

    @cached_property
    def test_points(self) -> dict[str, Any]:
        """Points at which formulas are compared; deterministic, off the axes.

        Some are near zero: tanh(v/s) with a small s is sign(v) everywhere else.
        """
        random = np.random.default_rng(20190417)
        sides = random.choice((-1.0, 1.0), size=(2, 64))
        large, small = random.uniform(0.05, 1.2, (2, 40)), 10.0 ** random.uniform(-5.0, -1.3, (2, 24))
        sizes = random.permuted(np.concatenate((large, small), axis=1), axis=1)
        points = dict(zip("xv", sides * sizes, strict=True))
        points |= {k: random.uniform(-0.5, 0.5, 64) for k in (*self.state, *self.memory)}
        points |= {"t": random.uniform(0.5, 20.0, 64)} | self.shape_values()
        return points | {
            c.name: random.choice((-1.0, 1.0), 64) * random.uniform(0.05, 1.2, 64) for c in self.channels
        }

    def _at(self, names: Mapping[str, Any]) -> NDArray[np.float64]:
        with np.errstate(all="ignore"):
            return np.broadcast_to(self.formula.evaluate(names), (64,))

    def _degree_in(self, powers: Mapping[str, float], shapes: ShapeValues | None = None) -> float | None:
        """Degree as variables grow with these powers of one factor; None without one, and of zero."""
        points = self.test_points | dict(shapes or {})
        # Over many scales: tanh(v/s) is as good as sign(v) on one of them.
        degree = self.formula.degree_in(powers, points, (2.0, 4.0, 1e-3, 1e-6))
        return None if degree == np.inf else degree


def channels_of(forces: Iterable[Force]) -> tuple[Channel, ...]:
    """What forces hold of inputs, each once."""
    return tuple(dict.fromkeys(channel for force in forces for channel in force.channels))


@dataclass(frozen=True)
class ForceLibrary:
    """An ordered set of forces, by symbol or in turn.

    Parameters
    ----------
    title : str
        What the library is.
    forces : tuple of Force
        In their order, each with a symbol of its own.
    source : str
        The file that it is from.
    """

    title: str
    forces: tuple[Force, ...]
    source: str = ""

    def __iter__(self) -> Iterator[Force]:
        return iter(self.forces)

    def __len__(self) -> int:
        return len(self.forces)

    def __getitem__(self, symbol: str) -> Force:
        for force in self.forces:
            if force.symbol == symbol:
                return force
        known = ", ".join(self.symbols)
        nearest = did_you_mean(symbol, self.symbols)
        raise UsageError(f"Library '{self.title}' has no force '{symbol}'; it has {known}.{nearest}")

    @property
    def symbols(self) -> tuple[str, ...]:
        """Symbols in the library's order."""
        return tuple(force.symbol for force in self.forces)

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What its forces hold of inputs, each once."""
        return channels_of(self.forces)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs that its forces hold."""
        return tuple(dict.fromkeys(channel.input for channel in self.channels))

    def shape_values(self, shapes: ShapeValues | None = None) -> dict[str, float]:
        """Value of each shape parameter by name, `dahl.s`: from `shapes`, else the default."""
        return {f"{f.symbol}.{k}": value for f in self for k, value in f.shape_values(shapes).items()}

    def select(self, symbols: Iterable[str]) -> "ForceLibrary":
        """The library of these forces alone, in the order given; UsageError for an unknown one."""
        return replace(self, forces=tuple(self[symbol] for symbol in dict.fromkeys(symbols)))

    def in_run(self, run: int) -> "ForceLibrary":
        """The forces that act in a run, by its number from 1."""
        return replace(self, forces=tuple(force for force in self if force.run in (None, run)))

    def with_own(self, symbols: Iterable[str], runs: int) -> "ForceLibrary":
        """The library with a force of its own for each run in the place of each of these: `lambda_1`, ..."""
        own = {self[symbol].symbol for symbol in symbols}

        def copy(force: Force, run: int) -> Force:
            return replace(force, symbol=f"{force.symbol}_{run}", name=f"{force.name}, run {run}", run=run)

        numbers = range(1, runs + 1)
        copies = [[copy(f, run) for run in numbers] if f.symbol in own else [f] for f in self]
        return replace(self, forces=tuple(itertools.chain.from_iterable(copies)))

    def role(self, formula: str) -> Force | None:
        """The force of this formula if the library has one."""
        return next((force for force in self.forces if force.matches(formula)), None)

    @property
    def damping_factors(self) -> dict[str, float]:
        """The damping ratio that a unit of each viscous force makes, by symbol."""
        factors = {"2*v": 1.0, "v": 0.5}
        return {force.symbol: factors[f] for f in factors if (force := self.role(f)) is not None}

    def to_toml(self) -> str:
        """The library as text in the format it is read from."""
        blocks = "".join(f"\n[[force]]\n{notation.toml(force)}" for force in self.forces)
        kinds = {channel.input: channel.kind for channel in self.channels}
        inputs = f"inputs = {notation.toml_value(kinds)}\n" if kinds else ""
        return f"title = {notation.toml_value(self.title)}\n{inputs}{blocks}"


def _same(first: Any, second: Any) -> bool:
    return bool(np.allclose(first, second, rtol=1e-9, atol=1e-12))
