"""Forces as data: a force is declared by lines of TOML, everything else is derived from its formula."""

import itertools
import json
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid_trib.errors import UsageError
from sysid_trib.forces.formulas import Formula, Surface, parse


@dataclass(frozen=True)
class Shape:
    """A shape parameter: a number inside a formula that does not enter linearly."""

    default: float
    low: float
    high: float
    meaning: str = ""


@dataclass(frozen=True)
class Force:
    """One term h(x, v, t, z, m) of f = sum of coefficient * h, or one term of the sensor.

    `x` = theta (rad), `v` = theta'/w (rad), `t` = seconds since the first sample, `state` z obeys
    dz/d(w t) = formula, `memory` m is held between reversals (v = 0) and replaced there.

    Parameters
    ----------
    symbol : the coefficient's name.
    name : shown in tables.
    formula : h (rad).
    family, meaning, source : words, shown in tables.
    kind : `force`, or `sensor`: the measured angle is then x + coefficient * h.
    state : right side of each internal state.
    memory : what replaces each held value at a reversal.
    start : first value of states and memory, from x, v and t at the first sample; zero where left out.
    shape : parameters that do not enter linearly.
    passive : whether it can only store or lose energy, so that its coefficient is not negative.
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

    def __hash__(self) -> int:
        return hash((self.symbol, self.formula))

    @property
    def formulas(self) -> tuple[Formula, ...]:
        """All right sides: of the force, its states and its memory."""
        return (self.formula, *self.state.values(), *self.memory.values())

    @property
    def memoryless(self) -> bool:
        """Whether the force is a function of x, v and t alone."""
        return not self.state and not self.memory

    @property
    def surfaces(self) -> tuple[Surface, ...]:
        """Switching surfaces of the motion: of the force and of its states."""
        found = {s.text: s for f in (self.formula, *self.state.values()) for s in f.surfaces}
        return tuple(found.values())

    @property
    def holds_time(self) -> bool:
        """Whether any of its formulas holds `t`."""
        return any("t" in f.names for f in self.formulas)

    def shape_values(self, shapes: Mapping[str, float] | None = None) -> dict[str, float]:
        """Value of each shape parameter: from `shapes` (`{"dahl.s": 0.02}`), else the default."""
        given = shapes or {}
        return {k: float(given.get(f"{self.symbol}.{k}", s.default)) for k, s in self.shape.items()}

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
        shapes: Mapping[str, float] | None = None,
        hidden: Mapping[str, ArrayLike] | None = None,
    ) -> NDArray[np.float64]:
        """Value of h at the given points (rad); `hidden` holds the states and memory, zero if left out."""
        given = {"x": x, "v": v, "t": t, **dict.fromkeys((*self.state, *self.memory), 0.0), **(hidden or {})}
        arrays = {k: np.asarray(a, dtype=float) for k, a in given.items()}
        names: dict[str, Any] = arrays | self.shape_values(shapes)
        with np.errstate(all="ignore"):
            found = self.formula.evaluate(names)
        shape = np.broadcast_shapes(names["x"].shape, names["v"].shape, np.shape(found))
        return np.broadcast_to(found, shape)

    def matches(self, formula: str) -> bool:
        """Whether this is the memoryless force of the given formula: a role known by what it does."""
        if not self.memoryless or self.kind != "force" or self.shape:
            return False
        other = parse(formula, frozenset("xvt"), frozenset(), formula)
        points = self.test_points
        return bool(np.allclose(self._at(points), other.evaluate(points), rtol=1e-12, atol=1e-14))

    @cached_property
    def parity(self) -> str:
        """`odd`, `even` or `mixed` under (x, v) -> (-x, -v), states and memory following."""
        hidden = (*self.state, *self.memory)
        for signs in itertools.product((-1.0, 1.0), repeat=len(hidden)):
            flipped = self.test_points | {"x": -self.test_points["x"], "v": -self.test_points["v"]}
            flipped |= {k: s * self.test_points[k] for k, s in zip(hidden, signs, strict=True)}
            rest = zip((*self.state.values(), *self.memory.values()), signs, strict=True)
            if not all(
                _same(f.evaluate(flipped), s * np.asarray(f.evaluate(self.test_points))) for f, s in rest
            ):
                continue
            here, there = self._at(self.test_points), self._at(flipped)
            if _same(there, -here):
                return "odd"
            if _same(there, here):
                return "even"
        return "mixed"

    @cached_property
    def character(self) -> str:
        """`dissipative` or `conservative` type by time reversal (v -> -v), else `mixed`.

        A force with states or memory depends on its past, which has no time reversal: `mixed`.
        """
        if not self.memoryless or self.kind == "sensor":
            return "sensor" if self.kind == "sensor" else "mixed"
        here, there = self._at(self.test_points), self._at(self.test_points | {"v": -self.test_points["v"]})
        return "conservative" if _same(there, here) else "dissipative" if _same(there, -here) else "mixed"

    @cached_property
    def degree(self) -> float | None:
        """Degree q of homogeneity in (x, v) together, None if there is none or if it has a past."""
        return None if not self.memoryless or self.shape or self.holds_time else self._degree_in("x", "v")

    @cached_property
    def speed_degree(self) -> float | None:
        """Degree of homogeneity in v alone (0 without v), None if there is none or if it has states.

        A degree that depends on a shape parameter, as that of abs(v)**p, is none.
        """
        ends = [{k: getattr(s, end) for k, s in self.shape.items()} for end in ("default", "low", "high")]
        degrees = {self._degree_in("v", shapes=shapes) for shapes in ends}
        return None if self.state or len(degrees) > 1 else degrees.pop()

    @cached_property
    def units(self) -> str:
        """Unit of the coefficient: `1` (dimensionless, angles in rad), or a power of s where t enters."""
        degree = self._degree_in("t") if self.memoryless else None
        return "1" if not degree else "s-1" if degree == 1 else f"s{-degree:g}"

    @cached_property
    def latex(self) -> str:
        """The formula in LaTeX, with theta and theta' = dtheta/d(w t)."""
        import sympy

        names = {k: sympy.Symbol(k, real=True) for f in self.formulas for k in f.names}
        names |= {"x": sympy.Symbol(r"\theta", real=True), "v": sympy.Symbol(r"\theta'", real=True)}
        functions = {n: getattr(sympy, n) for n in ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh")}
        functions |= {"abs": sympy.Abs, "min": sympy.Min, "max": sympy.Max, "power": _sympy_power}
        functions["sign"] = sympy.Function(r"\operatorname{sgn}")
        expression = sympy.nsimplify(self.formula.evaluate(names, functions), rational=True)
        return str(sympy.latex(expression, mul_symbol=r"\,"))

    @property
    def latex_symbol(self) -> str:
        """The coefficient's symbol in LaTeX."""
        import sympy

        return str(sympy.latex(sympy.Symbol(self.symbol)))

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
        return points | {"t": random.uniform(0.5, 20.0, 64)} | self.shape_values()

    def _at(self, names: Mapping[str, Any]) -> NDArray[np.float64]:
        with np.errstate(all="ignore"):
            return np.broadcast_to(self.formula.evaluate(names), (64,))

    def _degree_in(self, *variables: str, shapes: Mapping[str, float] | None = None) -> float | None:
        points = self.test_points | dict(shapes or {})
        here = self._at(points)
        used = np.abs(here) > 1e-12
        if not used.any():
            return None
        degree = None
        # Over many scales: tanh(v/s) is as good as sign(v) on one of them.
        for factor in (2.0, 4.0, 1e-3, 1e-6):
            there = self._at(points | {k: factor * points[k] for k in variables})
            if not np.all(np.isfinite(there)):
                return None
            if degree is None:
                ratio = np.abs(there[used] / here[used])
                # Rounded to a tidy number so that a degree of 2 is 2 and not 1.9999999999.
                degree = round(float(np.median(np.log2(np.maximum(ratio, 1e-300)))), 9) + 0.0
            scaled = factor**degree * here
            if not np.allclose(there, scaled, rtol=1e-9, atol=1e-12 * np.abs(scaled).max()):
                return None
        return degree


@dataclass(frozen=True)
class ForceLibrary:
    """An ordered set of forces, by symbol or in turn.

    Parameters
    ----------
    title : what the library is.
    forces : in their order, each with a symbol of its own.
    source : the file that it is from.
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
        raise UsageError(f"Library '{self.title}' has no force '{symbol}'; it has {known}.")

    @property
    def symbols(self) -> tuple[str, ...]:
        """Symbols in the library's order."""
        return tuple(force.symbol for force in self.forces)

    def select(self, symbols: Iterable[str]) -> "ForceLibrary":
        """The library of these forces alone, in the order given; UsageError for an unknown one."""
        return replace(self, forces=tuple(self[symbol] for symbol in dict.fromkeys(symbols)))

    def role(self, formula: str) -> Force | None:
        """The force of this formula if the library has one."""
        return next((force for force in self.forces if force.matches(formula)), None)

    def to_toml(self) -> str:
        """The library as text in the format it is read from."""
        blocks = "".join(f"\n[[force]]\n{_toml(force)}" for force in self.forces)
        return f"title = {json.dumps(self.title)}\n{blocks}"


def _toml(force: Force) -> str:
    # A JSON string is a TOML string, and a number's repr reads back as the same number.
    lines = {
        k: json.dumps(w)
        for k in ("symbol", "name", "family", "meaning", "source")
        if (w := getattr(force, k))
    }
    lines["formula"] = json.dumps(force.formula.text)
    if force.kind != "force":
        lines["kind"] = json.dumps(force.kind)
    for key in ("state", "memory", "start"):
        if table := getattr(force, key):
            lines[key] = "{ " + ", ".join(f"{k} = {json.dumps(f.text)}" for k, f in table.items()) + " }"
    if force.shape:
        shapes = (
            f"{k} = {{ default = {s.default!r}, low = {s.low!r}, high = {s.high!r}, "
            f"meaning = {json.dumps(s.meaning)} }}"
            for k, s in force.shape.items()
        )
        lines["shape"] = "{ " + ", ".join(shapes) + " }"
    if force.passive:
        lines["passive"] = "true"
    return "".join(f"{k} = {line}\n" for k, line in lines.items())


def _same(first: Any, second: Any) -> bool:
    return bool(np.allclose(first, second, rtol=1e-9, atol=1e-12))


def _sympy_power(base: Any, exponent: Any) -> Any:
    import sympy

    return base ** sympy.nsimplify(exponent)
