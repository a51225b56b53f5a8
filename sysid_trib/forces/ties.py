"""A tie: the formula of one parameter in terms of others, read by the whitelist of force formulas."""

import ast
import cmath
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.formulas import OPERATORS, SMOOTH, SWITCHING, Formula, parse

# A word, with the shape parameter behind a point: not the exponent of a number such as 1e-3.
WORD = re.compile(r"(?<![\w.])[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)?", re.ASCII)
# So small a step sideways in the complex plane has no rounding error, and no error of truncation.
COMPLEX_STEP = 1e-30


def _signed(value: complex) -> complex:
    return value if value.real >= 0.0 else -value


COMPLEX: dict[str, Any] = {
    **{name: getattr(cmath, name) for name in SMOOTH},
    "abs": _signed,
    "sign": lambda value: complex(np.sign(value.real)),
    "min": lambda *values: min(values, key=lambda value: value.real),
    "max": lambda *values: max(values, key=lambda value: value.real),
    "power": lambda base, exponent: base**exponent,
}


@dataclass(frozen=True)
class Tie:
    """One parameter as a function of others.

    Parameters
    ----------
    name : str
        The parameter that is tied.
    text : str
        The formula as written.
    formula : Formula
        The formula over stand-ins of the parameters' names, which need not be words of Python.
    names : tuple of str
        The parameters it holds; the stand-in of the first is `p0`.
    """

    name: str
    text: str
    formula: Formula
    names: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.name}={self.text}"

    def value(self, values: Mapping[str, float]) -> float:
        """Value at the given parameters; nan where it has none.

        Parameters
        ----------
        values : mapping of str to float
            Value of each parameter that the formula holds.
        """
        return self._evaluate({name: complex(values[name]) for name in self.names}).real

    def derivatives(self, values: Mapping[str, float]) -> dict[str, float]:
        """Derivative by each parameter that the formula holds.

        Parameters
        ----------
        values : mapping of str to float
            Value of each of these parameters.
        """
        start = {name: complex(values[name]) for name in self.names}
        return {
            name: self._evaluate(start | {name: start[name] + 1j * COMPLEX_STEP}).imag / COMPLEX_STEP
            for name in self.names
        }

    def linear(self, known: Mapping[str, float] | None = None) -> tuple[float, dict[str, float]] | None:
        """Constant and factor of each parameter, if the formula is linear; else None.

        Parameters
        ----------
        known : mapping of str to float, optional
            Values of parameters that count as constants.
        """
        known = known or {}
        variables = {f"p{i}": name for i, name in enumerate(self.names) if name not in known}
        values = {f"p{i}": known.get(name, np.nan) for i, name in enumerate(self.names)}
        return _linear(self.formula.tree, variables, values)

    def _evaluate(self, values: Mapping[str, complex]) -> complex:
        stand_ins = {f"p{i}": values[name] for i, name in enumerate(self.names)}
        try:
            return complex(self.formula.evaluate(stand_ins, COMPLEX))
        except (ArithmeticError, ValueError):  # of cmath, at poles and where numbers overflow
            return complex(np.nan, np.nan)


def parse_tie(name: str, text: str, known: Sequence[str]) -> Tie:
    """Read a tie.

    Parameters
    ----------
    name : str
        The parameter that is tied.
    text : str
        Its formula.
    known : sequence of str
        Parameters that the formula may hold.

    Raises
    ------
    UsageError
        The formula holds another name, the tied parameter itself, or is not of the whitelist.
    """
    words = list(dict.fromkeys(WORD.findall(text)))
    names = tuple(word for word in words if word in known)
    strangers = [word for word in words if word not in (*names, "pi", *SWITCHING, *SMOOTH)]
    if strangers:
        raise UsageError(
            f"The tie '{name}={text}' holds '{strangers[0]}', which is no parameter; "
            f"there are {', '.join(known)}."
        )
    if name in names:
        raise UsageError(f"The tie '{name}={text}' ties {name} to itself; use other parameters.")
    stand_ins = {word: f"p{i}" for i, word in enumerate(names)}
    replaced = WORD.sub(lambda word: stand_ins.get(word[0], word[0]), text)
    shapes = frozenset(p for word, p in stand_ins.items() if "." in word)
    try:
        formula = parse(replaced, frozenset(stand_ins.values()), shapes, name)
    except LibraryError:
        raise UsageError(
            f"The tie '{name}={text}' is not a formula of numbers, parameters, + - * / ** and the functions "
            f"{' '.join((*SWITCHING, *SMOOTH))}."
        ) from None
    return Tie(name, text, formula, names)


def _linear(
    tree: ast.AST, variables: Mapping[str, str], values: Mapping[str, float]
) -> tuple[float, dict[str, float]] | None:
    """Constant and factors of a checked tree in the variables; None if it is not linear in them."""
    if not any(isinstance(node, ast.Name) and node.id in variables for node in ast.walk(tree)):
        return float(Formula("", tree).evaluate(values)), {}  # type: ignore[arg-type]
    match tree:
        case ast.Name(id=name):
            return 0.0, {variables[name]: 1.0}
        case ast.UnaryOp(op=op, operand=operand):
            inner = _linear(operand, variables, values)
            return _scaled(inner, -1.0 if isinstance(op, ast.USub) else 1.0)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub() as op, right=right):
            first, second = _linear(left, variables, values), _linear(right, variables, values)
            second = _scaled(second, -1.0 if isinstance(op, ast.Sub) else 1.0)
            if first is None or second is None:
                return None
            names = dict.fromkeys((*first[1], *second[1]))
            return first[0] + second[0], {k: first[1].get(k, 0.0) + second[1].get(k, 0.0) for k in names}
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right):
            first, second = _linear(left, variables, values), _linear(right, variables, values)
            if second is not None and not second[1] and (second[0] or isinstance(op, ast.Mult)):
                return _scaled(first, OPERATORS[type(op)](1.0, second[0]))
            if first is not None and not first[1] and isinstance(op, ast.Mult):
                return _scaled(second, first[0])
    return None


def _scaled(
    linear: tuple[float, dict[str, float]] | None, factor: float
) -> tuple[float, dict[str, float]] | None:
    if linear is None:
        return None
    return factor * linear[0], {name: factor * slope for name, slope in linear[1].items()}
