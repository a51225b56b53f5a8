"""Formulas of forces, evaluated on any kind of number.

One tree serves NumPy arrays, slots of a program and SymPy symbols: `Formula.evaluate` takes the values of
the names and a table of functions. Where a formula changes branch (`sign`, `abs`, `min`, `max`) it has a
switching surface; given the signs of these surfaces, `evaluate` follows one branch, which is analytic.
"""

import ast
import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import Any, TypeAlias

import numpy as np

Names: TypeAlias = Mapping[str, Any]
Functions: TypeAlias = Mapping[str, Callable[..., Any]]
# Arguments: names, functions and signs of the surfaces.
Program: TypeAlias = Callable[[Names, Functions, Names | None], Any]

# Powers up to this one are computed as products.
LARGEST_PRODUCT = 5
SWITCHING = ("sign", "abs", "min", "max")
SMOOTH = ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh")


def divided(first: Any, second: Any) -> Any:
    """Divide; the result of a division by zero is not finite, without an exception."""
    if isinstance(first, int | float) and isinstance(second, int | float):
        with np.errstate(all="ignore"):
            return np.divide(first, second)
    return first / second


def power(base: Any, exponent: Any) -> Any:
    """Raise to a power; small integer powers are computed as products, about a hundred times faster."""
    if isinstance(exponent, int | float) and exponent in range(1, LARGEST_PRODUCT + 1):
        return reduce(operator.mul, [base] * int(exponent))
    return np.power(base, exponent)


OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: divided,
}
NUMPY: Functions = {
    "min": np.minimum,
    "max": np.maximum,
    "power": power,
    **{name: getattr(np, name) for name in ("sign", "abs", *SMOOTH)},
}
# The branch follows from the real part: on one branch every formula is analytic.
ANALYTIC: Functions = {
    **NUMPY,
    "sign": lambda u: np.sign(np.real(u)),
    "abs": lambda u: np.sign(np.real(u)) * u,
    "min": lambda a, b: np.where(np.real(a) < np.real(b), a, b),
    "max": lambda a, b: np.where(np.real(a) > np.real(b), a, b),
}
# The branch follows from the sign of the surface, if it is known.
ON_BRANCH: Functions = {
    "sign": lambda sign, u: sign,
    "abs": lambda sign, u: sign * u,
    "min": lambda sign, a, b: 0.5 * (a + b) - 0.5 * sign * (a - b),
    "max": lambda sign, a, b: 0.5 * (a + b) + 0.5 * sign * (a - b),
}
IMAGINARY_STEP = 1e-100


@dataclass(frozen=True)
class Formula:
    """A parsed formula; two formulas are equal if their texts are.

    Parameters
    ----------
    text : str
        The formula as written.
    tree : ast.expr
        The parsed and checked formula.
    """

    text: str
    tree: ast.expr = field(compare=False, repr=False)

    def __getstate__(self) -> dict[str, Any]:
        # Nested functions cannot be sent to another process; they are made again there.
        return {"text": self.text, "tree": self.tree}

    @cached_property
    def names(self) -> frozenset[str]:
        """Names of the variables in the formula."""
        calls = {id(n.func) for n in ast.walk(self.tree) if isinstance(n, ast.Call)}
        return frozenset(n.id for n in ast.walk(self.tree) if isinstance(n, ast.Name) and id(n) not in calls)

    @cached_property
    def surfaces(self) -> tuple["Formula", ...]:
        """Expressions at whose zeros the formula changes branch, without duplicates, innermost first."""
        return tuple(dict.fromkeys(n.surface for n in _bottom_up(self.tree) if hasattr(n, "surface")))

    def order_in(self, name: str) -> float:
        """Return the degree in a variable of a formula written as a polynomial in it; else infinity."""
        return _order_in(self.tree, name)

    def degree_in(self, powers: Mapping[str, float], points: Names, factors: Sequence[float]) -> float | None:
        """Return the power of a factor with which the formula scales if variables scale with powers of it.

        Parameters
        ----------
        powers : mapping of str to float
            Power of each variable that scales.
        points : mapping of str to (point,) array of float
            Values of the variables.
        factors : sequence of float
            Factors at which this is tested.

        Returns
        -------
        float or None
            Infinite for the formula zero, which has every power; None if there is no such power.
        """
        with np.errstate(all="ignore"):
            here = np.asarray(self.evaluate(points), dtype=float)
            used = np.abs(here) > 1e-12
            if not used.any():
                return np.inf
            there = []
            for c in factors:
                grown = {k: c**p * np.asarray(points[k]) for k, p in powers.items() if k in points}
                there.append(np.broadcast_to(self.evaluate({**points, **grown}), here.shape))
            ratio = np.abs(there[0][used] / here[used])
            # Rounded, so that a degree of 2 is 2 and not 1.9999999999.
            degree = round(float(np.median(np.log(ratio)) / np.log(factors[0])), 9) + 0.0
        if not np.isfinite(degree):
            return None
        for c, values in zip(factors, there, strict=True):
            expected = c**degree * here
            if not np.allclose(values, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max()):
                return None
        return degree

    def evaluate(self, names: Names, functions: Functions = NUMPY, signs: Names | None = None) -> Any:
        """Return the value of the formula.

        Parameters
        ----------
        names : mapping of str to number
            Value of each variable; arrays, slots of a program, SymPy expressions.
        functions : mapping of str to callable
            Table of functions, with `power`.
        signs : mapping of str to number, optional
            Sign of each switching surface, by its text. If given, the selected branch is evaluated and
            `sign`, `abs`, `min`, `max` are not called.

        Returns
        -------
        number
            Same type as in `names`.
        """
        return self._program(names, functions, signs)

    @cached_property
    def _program(self) -> Program:
        return _program_of(self.tree)

    def derivative(self, names: Names, name: str) -> Any:
        """Return the derivative by a variable, on the branch of its value; see `with_derivative`."""
        return self.with_derivative(names, name)[1]

    def with_derivative(self, names: Names, name: str) -> tuple[Any, Any]:
        """Return the value of the formula and its derivative by one variable, on the branch of the value.

        Parameters
        ----------
        names : mapping of str to array of float
            Value of each variable.
        name : str
            Variable of the derivative.

        Returns
        -------
        value, derivative : array of float

        Notes
        -----
        The imaginary part of the value at z + i e is e times the derivative, without a difference of nearly
        equal numbers (Squire and Trapp 1998).
        """
        stepped = {**names, name: names[name] + 1j * IMAGINARY_STEP}
        both = self.evaluate(stepped, ANALYTIC)
        return np.real(both), np.imag(both) / IMAGINARY_STEP


def _order_in(tree: ast.AST, name: str) -> float:
    match tree:
        case ast.Name(id=other):
            return float(other == name)
        case ast.UnaryOp(operand=operand):
            return _order_in(operand, name)
        case ast.BinOp(left=left, op=op, right=right):
            first, second = _order_in(left, name), _order_in(right, name)
            if isinstance(op, ast.Mult):
                return first + second
            if isinstance(op, ast.Add | ast.Sub):
                return max(first, second)
            return first if not second and (not first or isinstance(op, ast.Div)) else np.inf
        case ast.Call(args=args):
            return np.inf if any(_order_in(arg, name) for arg in args) else 0.0
    return 0.0


def _program_of(tree: ast.AST) -> Program:
    """Compile a checked tree into nested functions (see `Formula.evaluate`), for repeated evaluation."""
    match tree:
        case ast.Constant(value=value):
            return lambda names, functions, signs: value
        case ast.Name(id="pi"):
            return lambda names, functions, signs: np.pi
        case ast.Name(id=name):
            return lambda names, functions, signs: names[name]
        case ast.UnaryOp(op=op, operand=operand):
            inner = _program_of(operand)
            return (lambda *given: -inner(*given)) if isinstance(op, ast.USub) else inner
        case ast.BinOp(left=left, op=ast.Pow(), right=right):
            base, exponent = _program_of(left), _program_of(right)
            return lambda *given: given[1]["power"](base(*given), exponent(*given))
        case ast.BinOp(left=left, op=op, right=right):
            operate, first, second = OPERATORS[type(op)], _program_of(left), _program_of(right)
            return lambda *given: operate(first(*given), second(*given))
        case ast.Call(func=ast.Name(id=name), args=args):
            return _call(name, [_program_of(arg) for arg in args], getattr(tree, "surface", None))
    raise AssertionError(f"unchecked tree: {ast.dump(tree)}")


def _call(name: str, args: list[Program], surface: Formula | None) -> Program:
    """Return a function of arguments, on the branch of the sign of its switching surface, if given."""

    def value(names: Names, functions: Functions, signs: Names | None) -> Any:
        values = [arg(names, functions, signs) for arg in args]
        if signs is None or surface is None:
            return functions[name](*values)
        return ON_BRANCH[name](signs[surface.text], *values)

    return value


def _bottom_up(tree: ast.AST) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(tree):
        yield from _bottom_up(child)
    yield tree
