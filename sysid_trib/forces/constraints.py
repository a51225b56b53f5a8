"""Constraints on parameters: fixed values, bounds, and ties of one parameter to others."""

import ast
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from graphlib import CycleError, TopologicalSorter
from types import MappingProxyType
from typing import Any, TypeAlias

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.force import ForceLibrary, ShapeValues
from sysid_trib.forces.formulas import SMOOTH, SWITCHING, Formula
from sysid_trib.forces.notation import parse

Bounds: TypeAlias = tuple[float | None, float | None]
# A number fixes a parameter, a pair bounds it, and a formula ties it to other parameters.
Constraint: TypeAlias = float | Bounds | str
ConstraintTable: TypeAlias = Mapping[str, Constraint]
NO_CONSTRAINTS: ConstraintTable = MappingProxyType({})


@dataclass(frozen=True)
class Constraints:
    """Constraints on coefficients (`lambda`) and shape parameters (`dahl.s`), in one table.

    Parameters
    ----------
    table : mapping of str to float, (float, float) or str
        `{"lambda": 0, "zeta": (0, None), "nu": "-2.356*delta"}`: a fixed value, the lowest and highest value
        (None for no limit), or a formula of other parameters.

    Raises
    ------
    UsageError
        A value has none of these forms or is not finite, or bounds do not increase.
    """

    table: ConstraintTable = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value in self.fixed.items():
            if not np.isfinite(value):
                raise UsageError(f"Parameter {name} cannot be fixed at {value}; give a finite number.")
        for name, (low, high) in self.bounds.items():
            if not low < high:
                raise UsageError(f"The bounds {low:g}:{high:g} of {name} must increase from low to high.")
        for name, given in self.table.items():
            if name not in self.names:
                wrong = f"{name} cannot be constrained by {given!r}"
                raise UsageError(f"{wrong}; give a number, a pair (low, high), or a formula of others.")

    def __bool__(self) -> bool:
        return bool(self.table)

    @cached_property
    def fixed(self) -> dict[str, float]:
        """Value of each fixed parameter."""
        numbers = (int, float, np.number)
        return {name: float(value) for name, value in self.table.items() if isinstance(value, numbers)}

    @cached_property
    def bounds(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest value of each bounded parameter; infinite for no limit."""
        return {
            name: (-np.inf if value[0] is None else value[0], np.inf if value[1] is None else value[1])
            for name, value in self.table.items()
            if isinstance(value, tuple | list) and len(value) == 2
        }

    @cached_property
    def ties(self) -> dict[str, str]:
        """Formula of each parameter that is tied to others."""
        return {name: value for name, value in self.table.items() if isinstance(value, str)}

    def holding(self, values: Mapping[str, float]) -> "Constraints":
        """Return these constraints with further fixed parameters, which replace other constraints on them."""
        return Constraints({**self.table, **values})

    @classmethod
    def merged(
        cls,
        fixed: Mapping[str, float] | None = None,
        bounds: Mapping[str, Bounds] | None = None,
        ties: Mapping[str, str] | None = None,
    ) -> "Constraints":
        """Return one table from three tables of one kind each; a fixed value within its bounds replaces them.

        Raises
        ------
        UsageError
            A parameter is fixed outside of its bounds, or is tied and also has another constraint.
        """
        fixed, bounds, ties = dict(fixed or {}), dict(bounds or {}), dict(ties or {})
        limits = cls(bounds).bounds
        for name, value in cls(fixed).fixed.items():
            low, high = limits.get(name, (-np.inf, np.inf))
            if not low <= value <= high:
                raise UsageError(f"{name} is fixed at {value:g}, outside of its bounds {low:g}:{high:g}.")
        for name in ties:
            if name in fixed or name in bounds:
                other = "fixed" if name in fixed else "bounded"
                raise UsageError(f"Parameter {name} is both tied and {other}; choose one.")
        return cls({**bounds, **fixed, **ties})

    def of_each_run(self, symbols: Iterable[str], runs: int) -> "Constraints":
        """Return the constraints of forces with one coefficient per run (see `ForceLibrary.with_own`)."""
        own = {symbol: [f"{symbol}_{run}" for run in range(1, runs + 1)] for symbol in symbols}
        return Constraints({name: given for key, given in self.table.items() for name in own.get(key, [key])})

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that are constrained."""
        return (*self.fixed, *self.bounds, *self.ties)

    def marked(self, result: Any, at_bound: Iterable[str] = ()) -> Any:
        """Add `constraint(force)` to a result if any coefficient is constrained.

        Parameters
        ----------
        result : Dataset
            An identification.
        at_bound : iterable of str
            Coefficients that a fit leaves at one of their bounds.

        Returns
        -------
        Dataset
            The coordinate contains `fixed`, `at its bound`, the formula of a tie (`nu=-2.356*delta`), or an
            empty text.
        """
        if not self:
            return result
        held = dict.fromkeys(at_bound, "at its bound") | dict.fromkeys(self.fixed, "fixed")
        held |= {name: f"{name}={text}" for name, text in self.ties.items()}
        kinds = [held.get(symbol, "") for symbol in result.force.values.tolist()]
        return result.assign_coords(constraint=("force", kinds))

    def check(self, library: ForceLibrary) -> None:
        """Raise an error for a constraint that does not fit the parameters of a library.

        Raises
        ------
        UsageError
            A name is not a parameter of the library, a formula cannot be read, or ties are circular.
        """
        known = parameters_of(library)
        for name in self.names:
            if name not in known:
                raise UsageError(
                    f"There is no parameter '{name}' to constrain; there are {', '.join(known)}."
                )
        self.formulas(library)

    def formulas(self, library: ForceLibrary) -> dict[str, Formula]:
        """Return the ties, ordered so that each follows the ties that its formula needs.

        Raises
        ------
        UsageError
            A formula cannot be read, or ties are circular.
        """
        known = parameters_of(library)
        ties = {name: parse_tie(name, text, known) for name, text in self.ties.items()}
        needs = {name: ties.keys() & tie.names for name, tie in ties.items()}
        try:
            return {name: ties[name] for name in TopologicalSorter(needs).static_order()}
        except CycleError as error:
            circle = " and ".join(error.args[1][1:])
            raise UsageError(f"The ties of {circle} are circular; leave one parameter free.") from None

    def linear_map(
        self, library: ForceLibrary, shapes: ShapeValues | None = None
    ) -> tuple[tuple[str, ...], Array, Array]:
        """Return coefficients as a linear map of the free ones; all shape parameters are fixed.

        Parameters
        ----------
        library : ForceLibrary
            The forces, in the order of the coefficients.
        shapes : mapping of str to float, optional
            Fixed shape parameters; omitted ones have the library's defaults.

        Returns
        -------
        free : tuple of str
            Coefficients that are neither fixed nor tied.
        matrix : (coefficient, free) array of float
            Derivatives of the coefficients with respect to the free ones.
        constant : (coefficient,) array of float
            Values of the coefficients if the free ones are zero.

        Raises
        ------
        UsageError
            A shape parameter is tied, or a tie is not linear in the coefficients.
        """
        symbols = library.symbols
        free = tuple(s for s in symbols if s not in self.fixed and s not in self.ties)
        rows: dict[str, Array] = dict(zip(free, np.eye(len(free), len(free) + 1), strict=True))
        rows |= {s: np.append(np.zeros(len(free)), self.fixed[s]) for s in symbols if s in self.fixed}
        held = library.shape_values(shapes)
        held |= {name: value for name, value in self.fixed.items() if name in held}
        for name, tie in self.formulas(library).items():
            if name in held:
                raise UsageError(f"Shape parameter {name} is tied; only a trajectory fit supports this.")
            affine = _affine(tie, held)
            if affine is None:
                raise UsageError(
                    f"The tie '{name}={tie.text}' is not linear in the coefficients; only a trajectory "
                    "fit supports this."
                )
            constant, slopes = affine
            rows[name] = sum((a * rows[s] for s, a in slopes.items()), np.zeros(len(free) + 1))
            rows[name][-1] += constant
        table = np.stack([rows[s] for s in symbols])
        return free, table[:, :-1], table[:, -1]


def parameters_of(library: ForceLibrary) -> tuple[str, ...]:
    """Return the names of the coefficients of a library, then of its shape parameters."""
    return (*library.symbols, *library.shape_values())


# A word, with the shape parameter after a dot: not the exponent of a number such as 1e-3.
WORD = re.compile(r"(?<![\w.])[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)?", re.ASCII)


def parse_tie(name: str, text: str, known: Sequence[str]) -> Formula:
    """Read a tie: a formula of other parameters, which it contains by name.

    Parameters
    ----------
    name, text : str
        The tied parameter, and its formula.
    known : sequence of str
        Parameters that the formula may contain.

    Raises
    ------
    UsageError
        The formula contains another name or the tied parameter itself, or an operation that is not allowed.
    """
    words = list(dict.fromkeys(WORD.findall(text)))
    names = [word for word in words if word in known]
    strangers = [word for word in words if word not in (*names, "pi", *SWITCHING, *SMOOTH)]
    if strangers:
        wrong = f"The tie '{name}={text}' contains '{strangers[0]}', which is not a parameter"
        raise UsageError(f"{wrong}; there are {', '.join(known)}.")
    if name in names:
        raise UsageError(f"The tie '{name}={text}' ties {name} to itself; use other parameters.")
    # `lambda` and `dahl.s` are not parsed as names, so placeholders replace them.
    stand_ins = {word: f"p{i}" for i, word in enumerate(names)}
    replaced = WORD.sub(lambda word: stand_ins.get(word[0], word[0]), text)
    shapes = frozenset(p for word, p in stand_ins.items() if "." in word)
    try:
        tree = parse(replaced, frozenset(stand_ins.values()), shapes, name).tree
    except LibraryError:
        raise UsageError(
            f"The tie '{name}={text}' is not a formula of numbers, parameters, + - * / ** and the functions "
            f"{' '.join((*SWITCHING, *SMOOTH))}."
        ) from None
    meant = {stand_in: word for word, stand_in in stand_ins.items()}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            node.id = meant.get(node.id, node.id)
    return Formula(text, tree)


def tied_value(tie: Formula, values: Mapping[str, float]) -> float:
    """Return the value of a tied parameter from the parameters; nan if it cannot be computed."""
    with np.errstate(all="ignore"):
        value = float(tie.evaluate(values))
    return value if np.isfinite(value) else np.nan


def tied_slopes(tie: Formula, values: Mapping[str, float]) -> dict[str, float]:
    """Return the derivatives of a tied parameter with respect to the parameters in its formula."""
    # With NumPy numbers, a division by zero is not finite instead of raising an exception.
    held = {name: np.float64(values[name]) for name in sorted(tie.names)}
    with np.errstate(all="ignore"):
        return {name: float(tie.derivative(held, name)) for name in held}


def _affine(tie: Formula, known: Mapping[str, float]) -> tuple[float, dict[str, float]] | None:
    """Return constant and factor for each unknown parameter if a tie is linear in these, else None."""
    free = sorted(tie.names - known.keys())

    def value(numbers: Array) -> float:
        return tied_value(tie, {**known, **dict(zip(free, numbers.tolist(), strict=True))})

    constant = value(np.zeros(len(free)))
    slopes = np.array([value(unit) - constant for unit in np.eye(len(free))])
    random = np.random.default_rng(20190417)
    shape = (16, len(free))
    points = random.choice((-1.0, 1.0), shape) * random.uniform(1e-3, 30.0, shape)
    # Test by values: a formula of any form may be linear.
    same = np.isclose([value(point) for point in points], constant + points @ slopes, rtol=1e-9)
    return (constant, dict(zip(free, slopes.tolist(), strict=True))) if same.all() else None
