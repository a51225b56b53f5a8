"""What a user asks of parameters: values held fixed, bounds, and ties of one parameter to others."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.forces.force import ForceLibrary, ShapeValues
from sysid_trib.forces.ties import Tie, parse_tie

T = TypeVar("T")
PARAMETER = re.compile(r"[A-Za-z]\w*(\.[A-Za-z_]\w*)?", re.ASCII)


@dataclass(frozen=True)
class Constraints:
    """Constraints on coefficients (`lambda`) and shape parameters (`dahl.s`).

    Parameters
    ----------
    fixed : mapping of str to float
        Value of each parameter that is held.
    bounds : mapping of str to (float, float)
        Lowest and highest value of a parameter; infinite where it has none.
    ties : mapping of str to str
        Formula of a parameter in terms of others, `{"nu": "-2.356*delta"}`.

    Raises
    ------
    UsageError
        A parameter is constrained twice, is tied to itself, or a value is not a number or out of its bounds.
    """

    fixed: Mapping[str, float] = field(default_factory=dict)
    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    ties: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, value in self.fixed.items():
            if not np.isfinite(value):
                raise UsageError(f"Parameter {name} cannot be fixed at {value}; give a finite number.")
            low, high = self.bounds.get(name, (-np.inf, np.inf))
            if not low <= value <= high:
                raise UsageError(
                    f"Parameter {name} is fixed at {value:g}, outside of its bounds {low:g}:{high:g}."
                )
        for name, (low, high) in self.bounds.items():
            if not low < high:
                raise UsageError(f"The bounds {low:g}:{high:g} of {name} must rise from the low to the high.")
        for name in self.ties:
            if name in self.fixed or name in self.bounds:
                other = "fixed" if name in self.fixed else "bounded"
                raise UsageError(f"Parameter {name} is both tied and {other}; choose one.")

    def __bool__(self) -> bool:
        return bool(self.fixed or self.bounds or self.ties)

    def of_each_run(self, symbols: Iterable[str], runs: int) -> "Constraints":
        """The same for forces whose coefficient is each run's own (see `ForceLibrary.with_own`)."""
        names = {symbol: [f"{symbol}_{run}" for run in range(1, runs + 1)] for symbol in symbols}

        def copied(table: Mapping[str, T]) -> dict[str, T]:
            return {name: value for key, value in table.items() for name in names.get(key, [key])}

        return Constraints(copied(self.fixed), copied(self.bounds), copied(self.ties))

    @classmethod
    def from_texts(
        cls, fix: Iterable[str] = (), bound: Iterable[str] = (), tie: Iterable[str] = ()
    ) -> "Constraints":
        """Read constraints as they are written on the command line.

        Parameters
        ----------
        fix : iterable of str
            `lambda=0`.
        bound : iterable of str
            `zeta=0:`, `zeta=:1` or `zeta=0:1`.
        tie : iterable of str
            `nu=-2.356*delta`.

        Returns
        -------
        Constraints

        Raises
        ------
        UsageError
            A text is not of this form, or names a parameter for the second time.
        """
        fixed = {k: _number(v, f"--fix '{k}={v}'") for k, v in _pairs(fix, "--fix", "lambda=0").items()}
        bounds = {k: _range(v, f"--bound '{k}={v}'") for k, v in _pairs(bound, "--bound", "zeta=0:1").items()}
        return cls(fixed, bounds, _pairs(tie, "--tie", '"nu=-2.356*delta"'))

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that are constrained."""
        return tuple(dict.fromkeys((*self.fixed, *self.bounds, *self.ties)))

    def kinds(self, symbols: Iterable[str], at_bound: Iterable[str] = ()) -> list[str]:
        """How each coefficient is constrained, for the coordinate `constraint(force)` of a result.

        Parameters
        ----------
        symbols : iterable of str
            The coefficients.
        at_bound : iterable of str
            Those that a fit holds at one of their bounds.

        Returns
        -------
        list of str
            `fixed`, `at its bound`, the formula of a tie (`nu=-2.356*delta`), or nothing.
        """
        held = dict.fromkeys(at_bound, "at its bound") | dict.fromkeys(self.fixed, "fixed")
        held |= {name: f"{name}={text}" for name, text in self.ties.items()}
        return [held.get(symbol, "") for symbol in symbols]

    def check(self, library: ForceLibrary) -> None:
        """Refuse what does not fit to the parameters of a library.

        Raises
        ------
        UsageError
            A name is not a parameter of the library, a formula cannot be read, or ties go in a circle.
        """
        known = parameters_of(library)
        for name in self.names:
            if name not in known:
                raise UsageError(f"No parameter '{name}' can be constrained; there are {', '.join(known)}.")
        self.formulas(library)

    def formulas(self, library: ForceLibrary) -> dict[str, Tie]:
        """The ties, each after those that its formula needs.

        Raises
        ------
        UsageError
            A formula cannot be read, or ties go in a circle.
        """
        known = parameters_of(library)
        waiting = {name: parse_tie(name, text, known) for name, text in self.ties.items()}
        ordered: dict[str, Tie] = {}
        while waiting:
            ready = [name for name, tie in waiting.items() if not set(tie.names) & set(waiting)]
            if not ready:
                raise UsageError(
                    f"The ties of {' and '.join(waiting)} go in a circle; leave one parameter free."
                )
            ordered |= {name: waiting.pop(name) for name in ready}
        return ordered

    def linear_map(
        self, library: ForceLibrary, shapes: ShapeValues | None = None
    ) -> tuple[tuple[str, ...], Array, Array]:
        """Coefficients as a linear map of the free ones; all shape parameters are held.

        Parameters
        ----------
        library : ForceLibrary
            The forces, in the order of the coefficients.
        shapes : mapping of str to float, optional
            Held shape parameters; the library's defaults where left out.

        Returns
        -------
        free : tuple of str
            Coefficients that are neither fixed nor tied.
        matrix : (coefficient, free) array of float
            Derivative of each coefficient by each free one.
        constant : (coefficient,) array of float
            Each coefficient where the free ones are zero.

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
                raise UsageError(f"Shape parameter {name} is tied, which only a trajectory fit can do.")
            affine = tie.linear(held)
            if affine is None:
                raise UsageError(
                    f"The tie '{tie}' is not linear in the coefficients, which only a trajectory fit can do."
                )
            constant, slopes = affine
            rows[name] = sum((a * rows[s] for s, a in slopes.items()), np.zeros(len(free) + 1))
            rows[name][-1] += constant
        table = np.stack([rows[s] for s in symbols])
        return free, table[:, :-1], table[:, -1]


def parameters_of(library: ForceLibrary) -> tuple[str, ...]:
    """Names of the coefficients of a library, then of its shape parameters."""
    return (*library.symbols, *library.shape_values())


def _pairs(texts: Iterable[str], option: str, example: str) -> dict[str, str]:
    pairs: dict[str, str] = {}
    for text in texts:
        name, sign, value = (part.strip() for part in text.partition("="))
        if not sign or not value or not PARAMETER.fullmatch(name):
            raise UsageError(f"{option} '{text}' must be of the form {example}.")
        if name in pairs:
            raise UsageError(f"{option} is given twice for {name}; choose one.")
        pairs[name] = value
    return pairs


def _range(text: str, where: str) -> tuple[float, float]:
    low, sign, high = (part.strip() for part in text.partition(":"))
    if not sign or not (low or high):
        raise UsageError(f"{where} must be LOW:HIGH, of which one side may be empty.")
    return _number(low, where) if low else -np.inf, _number(high, where) if high else np.inf


def _number(text: str, where: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise UsageError(f"{where}: '{text}' is not a number.") from None
