"""Forces as data: a force is declared in lines of TOML; all other properties follow from its formula."""

import itertools
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid_trib.errors import UsageError, did_you_mean
from sysid_trib.forces import notation, symmetry
from sysid_trib.forces.formulas import Formula
from sysid_trib.forces.symmetry import Channel as Channel, Shape as Shape, ShapeValues as ShapeValues


@dataclass(frozen=True)
class Force:
    """One term h(x, v, t, z, m) of f = sum of coefficient * h, or one term of the sensor.

    `x` = theta (rad), `v` = theta'/w (rad), `t` = seconds since the first sample, `state` z obeys
    dz/d(w t) = formula, `memory` m is constant between reversals (v = 0) and gets a new value there.

    Parameters
    ----------
    symbol : str
        Symbol of the coefficient.
    name : str
        Name in tables.
    formula : Formula
        h (rad).
    family, meaning, source : str
        Texts for tables.
    kind : str
        `force`, or `sensor`: the measured angle is then x + coefficient * h.
    state : mapping of str to Formula
        Right-hand side of the equation of each internal state.
    memory : mapping of str to Formula
        New value of each memory at a reversal.
    start : mapping of str to Formula
        Initial value of states and memory, from x, v and t at the first sample; zero if omitted.
    shape : mapping of str to Shape
        Parameters that enter nonlinearly.
    passive : bool
        True if the force can only store or dissipate energy, so that its coefficient is not negative.
    coefficient : float, optional
        Coefficient, if it is known from physics, such as 1 for gravity; with another value it is another
        force.
    channels : tuple of Channel
        Inputs in the formulas.
    run : int, optional
        The only run, counted from 1, in which the force acts: the coefficient belongs to this run.
    uses : tuple of str
        Symbols of other forces whose coefficients are in the formula, such as the torque of a motor in its
        friction. A coefficient that is not in the model is zero.
    curve : str
        Name of the smooth curve to which the force belongs. The coefficients of a curve are penalised: they
        are random effects with one variance, which is estimated from the data. Empty for a separate force.

    Examples
    --------
    Forces come from a library; their properties follow from the formula.

    >>> import sysid_trib as st
    >>> force = st.load_library("contact_forces")["delta"]
    >>> force.name, force.formula.text, force.parity, force.character
    ('quadratic friction', 'v*abs(v)', 'odd', 'dissipative')
    >>> force.degree, force.units, force.memoryless
    (2.0, '1', True)
    >>> force.value(x=0.0, v=[-2.0, 1.0]).tolist()
    [-4.0, 1.0]
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
    uses: tuple[str, ...] = ()
    curve: str = ""

    def __post_init__(self) -> None:
        if isinstance(self.formula, str):
            raise UsageError(
                f"The formula of the force '{self.symbol}' is a text; write st.library({self.symbol}="
                f"'{self.formula}'), which reads it."
            )

    def __hash__(self) -> int:
        return hash((self.symbol, self.formula))

    def acts_as(self, other: "Force") -> bool:
        """Return true if two forces differ at most in the texts of tables."""
        words = {name: getattr(self, name) for name in ("name", "family", "meaning", "source")}
        return replace(other, **words) == self

    def renamed(self, symbol: str) -> "Force":
        """Return the force with another symbol.

        Examples
        --------
        >>> import sysid_trib as st
        >>> st.load_library("contact_forces")["lambda"].renamed("dry").symbol
        'dry'
        """
        return replace(self, symbol=symbol, name=symbol if self.name == self.symbol else self.name)

    # Properties that follow from the formulas alone.
    test_points = cached_property(symmetry.test_points)
    parity = cached_property(symmetry.parity)
    character = cached_property(symmetry.character)
    degree = cached_property(symmetry.degree)
    speed_degree = cached_property(symmetry.speed_degree)
    units = cached_property(symmetry.units)
    units_with = symmetry.units_with
    matches = symmetry.matches

    @property
    def formulas(self) -> tuple[Formula, ...]:
        """All right-hand sides: of the force, its states and its memory."""
        return (self.formula, *self.state.values(), *self.memory.values())

    @property
    def memoryless(self) -> bool:
        """True if the force is a function of x, v and t alone."""
        return not self.state and not self.memory

    def depends_only_on(self, name: str) -> bool:
        """Return True if the force is a function of x, or of v, alone.

        Examples
        --------
        >>> import sysid_trib as st
        >>> [force.symbol for force in st.load_library("contact_forces") if force.depends_only_on("v")]
        ['lambda', 'zeta', 'delta']
        """
        if self.kind != "force" or not self.memoryless or self.channels or self.holds_time:
            return False
        return {"x", "v"} & set(self.formula.names) == {name}

    @property
    def holds_time(self) -> bool:
        """True if any formula contains `t`."""
        return any("t" in f.names for f in self.formulas)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs in the formulas."""
        return tuple(dict.fromkeys(channel.input for channel in self.channels))

    def shape_values(self, shapes: ShapeValues | None = None) -> dict[str, float]:
        """Return the value of each shape parameter: from `shapes` (`{"dahl.s": 0.02}`), else the default.

        Examples
        --------
        >>> import sysid_trib as st
        >>> dahl = st.load_library("candidate_effects")["dahl"]
        >>> dahl.shape_values({"dahl.s": 0.02}), dahl.shape["s"].meaning
        ({'s': 0.02}, 'presliding length (rad)')
        """
        given = shapes or {}
        return {k: float(given.get(f"{self.symbol}.{k}", s.default)) for k, s in self.shape.items()}

    def bound(self, coefficients: Mapping[str, float]) -> "Force":
        """Return the force with the coefficients in its formula given as numbers, as shape parameters."""
        if not self.uses:
            return self
        values = ((symbol, float(coefficients.get(symbol, 0.0))) for symbol in self.uses)
        held = {symbol: Shape(value, -np.inf, np.inf) for symbol, value in values}
        return replace(self, shape={**self.shape, **held}, uses=())

    @cached_property
    def surfaces(self) -> tuple[Formula, ...]:
        """Switching surfaces of the motion: of the force and of its states."""
        formulas = (self.formula, *self.state.values())
        return tuple(dict.fromkeys(surface for f in formulas for surface in f.surfaces))

    def with_numbers(self, coefficients: Mapping[str, float]) -> "Force":
        """Return the force with numbers in place of the coefficients in its formula."""
        written = self
        for symbol in self.uses:
            written = written.with_instead(symbol, f"{coefficients.get(symbol, 0.0):.6g}")
        return replace(written, uses=())

    def with_instead(self, name: str, text: str, over: float = 1.0) -> "Force":
        """Return the force with a name replaced by an expression; rates of states are divided by a number."""
        state, memory, start = (
            {key: notation.with_instead(formula, name, text, by) for key, formula in table.items()}
            for table, by in ((self.state, over), (self.memory, 1.0), (self.start, 1.0))
        )
        formula = notation.with_instead(self.formula, name, text)
        return replace(self, formula=formula, state=state, memory=memory, start=start)

    def counted_from(self, seconds: float) -> "Force":
        """Return the force with `t` in its formulas shifted, for a motion that starts later."""
        if seconds == 0.0 or not any("t" in f.names for f in (*self.formulas, *self.start.values())):
            return self
        return self.with_instead("t", f"t + {seconds!r}")

    def start_values(self, names: Mapping[str, Any]) -> dict[str, Any]:
        """Return the initial value of each state and memory, from x, v, t and shape parameters in `names`."""
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
        """Return the value of h at the given points.

        Parameters
        ----------
        x, v : array of float, rad
            Angle and dx/dtau.
        t : array of float, s
            Time since the first sample.
        shapes : mapping of str to float, optional
            Shape parameters, `{"dahl.s": 0.02}`; omitted ones have their defaults.
        hidden : mapping of str to array of float, optional
            States, memory, inputs and coefficients of other forces, by their names in formulas; zero if
            omitted.

        Returns
        -------
        array of float, rad

        Examples
        --------
        >>> import sysid_trib as st
        >>> st.load_library("contact_forces")["epsilon"].value(x=[0.1, 0.2], v=0.0).round(4).tolist()
        [0.001, 0.008]
        """
        absent = (*self.state, *self.memory, *(channel.name for channel in self.channels), *self.uses)
        given = {"x": x, "v": v, "t": t, **dict.fromkeys(absent, 0.0), **(hidden or {})}
        arrays = {k: np.asarray(a, dtype=float) for k, a in given.items()}
        with np.errstate(all="ignore"):
            h = self.formula.evaluate({**arrays, **self.shape_values(shapes)})
        return np.broadcast_to(h, np.broadcast_shapes(arrays["x"].shape, arrays["v"].shape, np.shape(h)))

    @cached_property
    def latex(self) -> str:
        """Formula in LaTeX, with theta and theta' = dtheta/d(w t)."""
        return notation.formula_latex(self)

    @property
    def latex_symbol(self) -> str:
        """Symbol of the coefficient in LaTeX."""
        return notation.symbol_latex(self.symbol)


def channels_of(forces: Iterable[Force]) -> tuple[Channel, ...]:
    """Return the input channels of forces, without duplicates."""
    return tuple(dict.fromkeys(channel for force in forces for channel in force.channels))


@dataclass(frozen=True, repr=False)
class ForceLibrary:
    """An ordered set of forces, accessed by symbol or by iteration.

    Parameters
    ----------
    title : str
        Title of the library.
    forces : tuple of Force
        Forces in order, each with a different symbol.
    source : str
        File from which the library was read.

    Examples
    --------
    >>> import sysid_trib as st
    >>> library = st.load_library("contact_forces")
    >>> library["nu"].formula.text, len(library), "zeta" in library
    ('x*abs(x)', 6, True)
    >>> (library[["zeta", "nu"]] + st.library(quintic="x**5")).symbols
    ('zeta', 'nu', 'quintic')
    """

    title: str
    forces: tuple[Force, ...]
    source: str = ""

    def __repr__(self) -> str:
        return f"<ForceLibrary {self.title!r}: {', '.join(self.symbols)}>"

    def __iter__(self) -> Iterator[Force]:
        return iter(self.forces)

    def __contains__(self, force: object) -> bool:
        return force in (self.symbols if isinstance(force, str) else self.forces)

    def __add__(self, other: "ForceLibrary | Force") -> "ForceLibrary":
        """Return the forces of both without duplicates; texts are those of the first."""
        if not isinstance(other, ForceLibrary | Force):
            return NotImplemented
        offered = [other] if isinstance(other, Force) else other.forces
        for force in offered:
            if force.symbol in self.symbols and not force.acts_as(self[force.symbol]):
                formulas = f"{self[force.symbol].formula.text} and {force.formula.text}"
                raise UsageError(
                    f"Two different forces have the symbol '{force.symbol}' ({formulas}); give one of them "
                    f"another symbol: st.library(other_{force.symbol}=force)."
                )
        added = [force for force in offered if force.symbol not in self.symbols]
        if not added:
            return self
        if isinstance(other, Force):
            return replace(self, forces=(*self.forces, other))
        titles, sources = ([getattr(part, name) for part in (self, other)] for name in ("title", "source"))
        return ForceLibrary(
            " and ".join(dict.fromkeys(filter(None, titles))),
            (*self.forces, *added),
            " + ".join(dict.fromkeys(filter(None, sources))),
        )

    def __len__(self) -> int:
        return len(self.forces)

    @overload
    def __getitem__(self, symbol: str) -> Force: ...

    @overload
    def __getitem__(self, symbol: list[str]) -> "ForceLibrary": ...

    def __getitem__(self, symbol: str | list[str]) -> "Force | ForceLibrary":
        if isinstance(symbol, list):
            return self.select(symbol)
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
        """Input channels of the forces, without duplicates."""
        return channels_of(self.forces)

    @property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs in the forces."""
        return tuple(dict.fromkeys(channel.input for channel in self.channels))

    def shape_values(self, shapes: ShapeValues | None = None) -> dict[str, float]:
        """Return the value of each shape parameter by name, `dahl.s`: from `shapes`, else the default.

        Examples
        --------
        >>> import sysid_trib as st
        >>> st.load_library("candidate_effects")[["dahl", "stribeck"]].shape_values({"dahl.s": 0.02})
        {'dahl.s': 0.02, 'stribeck.s': 0.05}
        """
        return {f"{f.symbol}.{k}": value for f in self for k, value in f.shape_values(shapes).items()}

    def bound(self, coefficients: Mapping[str, float]) -> "ForceLibrary":
        """Return the library with the coefficients in formulas given as numbers (see `Force.bound`)."""
        if not self.used:
            return self
        return replace(self, forces=tuple(force.bound(coefficients) for force in self))

    @property
    def used(self) -> tuple[str, ...]:
        """Symbols of the coefficients in formulas of the forces, without duplicates."""
        return tuple(dict.fromkeys(symbol for force in self for symbol in force.uses))

    def select(self, symbols: Iterable[str]) -> "ForceLibrary":
        """Return a library of only these forces, in this order; raise a UsageError for an unknown one.

        Examples
        --------
        >>> import sysid_trib as st
        >>> st.load_library("contact_forces").select(["zeta", "nu"]).symbols
        ('zeta', 'nu')
        """
        return replace(self, forces=tuple(self[symbol] for symbol in dict.fromkeys(symbols)))

    @property
    def in_curves(self) -> NDArray[np.bool_]:
        """Mask of the forces that belong to a smooth curve, (force,)."""
        return np.array([bool(force.curve) for force in self.forces])

    def curves_among(self, symbols: Sequence[str]) -> dict[str, NDArray[np.intp]]:
        """Return the positions of each curve's forces in a list of symbols, by the name of the curve."""
        names = [self[symbol].curve for symbol in symbols]
        curves = dict.fromkeys(name for name in names if name)
        return {curve: np.flatnonzero([name == curve for name in names]) for curve in curves}

    def counted_from(self, seconds: float) -> "ForceLibrary":
        """Return the forces with `t` in their formulas shifted (see `Force.counted_from`)."""
        return replace(self, forces=tuple(force.counted_from(seconds) for force in self))

    def in_run(self, run: int) -> "ForceLibrary":
        """Return the forces that act in a run, by its number counted from 1.

        Examples
        --------
        >>> import sysid_trib as st
        >>> st.library("lambda,zeta").with_own(["lambda"], runs=2).in_run(2).symbols
        ('lambda_2', 'zeta')
        """
        return replace(self, forces=tuple(force for force in self if force.run in (None, run)))

    def with_own(self, symbols: Iterable[str], runs: int) -> "ForceLibrary":
        """Return the library with one force per run in place of each of these: `lambda_1`, ...

        Examples
        --------
        >>> import sysid_trib as st
        >>> st.library("lambda,zeta").with_own(["lambda"], runs=2).symbols
        ('lambda_1', 'lambda_2', 'zeta')
        """
        own = {self[symbol].symbol for symbol in symbols}
        if both := own & {*self.used}:
            symbol = min(both)
            raise UsageError(
                f"The coefficient {symbol} cannot be each run's own (--own): the formula of another force "
                "holds it; leave it out of --own."
            )

        def copy(force: Force, run: int) -> Force:
            return replace(force, symbol=f"{force.symbol}_{run}", name=f"{force.name}, run {run}", run=run)

        numbers = range(1, runs + 1)
        copies = [[copy(f, run) for run in numbers] if f.symbol in own else [f] for f in self]
        return replace(self, forces=tuple(itertools.chain.from_iterable(copies)))

    def role(self, formula: str) -> Force | None:
        """Return the force of this formula if the library has one.

        Examples
        --------
        >>> import sysid_trib as st
        >>> st.library(drag="v*abs(v)", spring="x**3").role("v*abs(v)").symbol
        'drag'
        """
        return next((force for force in self.forces if force.matches(formula)), None)

    @property
    def has_common_zero(self) -> bool:
        """True if a constant sensor term is the zero in all runs, so that no run has its own zero."""
        return any(force.kind == "sensor" and not force.formula.names for force in self.forces)

    @property
    def damping_factors(self) -> dict[str, float]:
        """Damping ratio of a unit coefficient of each viscous force, by symbol."""
        factors = {"2*v": 1.0, "v": 0.5}
        return {force.symbol: factors[f] for f in factors if (force := self.role(f)) is not None}

    def to_toml(self) -> str:
        """Return the library as text in the format of library files.

        Examples
        --------
        >>> import sysid_trib as st
        >>> print(st.library(quintic="x**5").to_toml())
        title = "quintic"
        <BLANKLINE>
        [[force]]
        symbol = "quintic"
        name = "quintic"
        formula = "x**5"
        """
        blocks = "".join(f"\n[[force]]\n{notation.toml(force)}" for force in self.forces)
        kinds = {channel.input: channel.kind for channel in self.channels}
        inputs = f"inputs = {notation.toml_value(kinds)}\n" if kinds else ""
        return f"title = {notation.toml_value(self.title)}\n{inputs}{blocks}"


# A formula, or a force as a table of the library format, with keys such as formula, name, state, shape.
ForceTable: TypeAlias = str | Force | Mapping[str, Any]
# Forms of a library: a library, its name or file, a force, formulas by symbol, or several of these.
LibraryLike: TypeAlias = (
    ForceLibrary | str | Path | Force | Mapping[str, ForceTable] | Sequence[str | Force | ForceLibrary]
)
