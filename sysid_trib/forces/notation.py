"""Notation of forces: whitelist of formulas, TOML, LaTeX, powers of units and of the reference frequency.

Text is never executed: only permitted nodes of its tree are copied, and all other code uses this copy.
"""

import ast
import itertools
import json
import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from sysid_trib.errors import LibraryError
from sysid_trib.forces.formulas import OPERATORS, SMOOTH, SWITCHING, Formula

if TYPE_CHECKING:
    from sysid_trib.forces.force import Force

MAX_LENGTH = 500
MAX_DEPTH = 30
MAX_EXPONENT = 20
# Above this, arithmetic would overflow.
LARGEST_CONSTANT = 1e100
RESERVED_NAMES = frozenset(("x", "v", "t", "pi", *SWITCHING, *SMOOTH))


def parse(text: object, allowed: frozenset[str], exponents: frozenset[str], where: str) -> Formula:
    """Parse and check a formula.

    Parameters
    ----------
    text : object
        The formula as written in a library.
    allowed : set of str
        Names of variables that it may contain, besides `pi`.
    exponents : set of str
        Names among them that may be an exponent (shape parameters).
    where : str
        File and force, for the message.

    Returns
    -------
    Formula

    Raises
    ------
    LibraryError
        The text is not a permitted formula; nothing is executed.
    """
    if not isinstance(text, str) or not text.strip():
        raise LibraryError(f"{where}: a formula must be a non-empty text in quotes, not {text!r}.")
    if len(text) > MAX_LENGTH:
        raise LibraryError(f"{where}: the formula is longer than {MAX_LENGTH} characters; shorten it.")
    try:
        tree = ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        reason = f"{where}: '{short(text)}' is not a formula; check its brackets and operators."
        raise LibraryError(reason) from None
    tree = _checked(tree, allowed, exponents, f"{where}: '{short(text)}'", 0)
    return Formula(text.strip(), tree)


def _checked(
    node: ast.AST, allowed: frozenset[str], exponents: frozenset[str], where: str, depth: int
) -> ast.expr:
    """Copy the permitted nodes of a tree; raise an error for any other node."""
    if depth > MAX_DEPTH:
        raise LibraryError(f"{where} is nested deeper than {MAX_DEPTH} levels; simplify it.")

    def inner(child: ast.AST) -> ast.expr:
        return _checked(child, allowed, exponents, where, depth + 1)

    match node:
        case ast.Constant(value=bool()):
            pass
        case ast.Constant(value=int() | float() as value):
            if value > LARGEST_CONSTANT:
                raise LibraryError(f"{where} contains a number above 1e100; rescale the formula.")
            return ast.Constant(float(value))
        case ast.Name(id=name):
            if name in allowed or name == "pi":
                return ast.Name(name)
            known = ", ".join(sorted(allowed))
            raise LibraryError(f"{where} contains the unknown name '{short(name)}'; known are {known}, pi.")
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as op, operand=operand):
            return ast.UnaryOp(op, inner(operand))
        case ast.BinOp(op=ast.Pow(), right=right) if not _is_exponent(right, exponents):
            raise LibraryError(
                f"{where}: an exponent must be a number up to {MAX_EXPONENT} or a shape parameter."
            )
        case ast.BinOp(left=left, op=op, right=right) if type(op) in OPERATORS or isinstance(op, ast.Pow):
            return ast.BinOp(inner(left), op, inner(right))
        case ast.Call(func=ast.Name(id=name), args=args, keywords=[]):
            if name in ("min", "max") and len(args) >= 2:
                first, *rest = [inner(arg) for arg in args]
                for other in rest:
                    first = _switch(name, [first, other], ast.BinOp(first, ast.Sub(), other))
                return first
            if name in ("sign", "abs") and len(args) == 1:
                argument = inner(args[0])
                return _switch(name, [argument], argument)
            if name in SMOOTH and len(args) == 1:
                return ast.Call(ast.Name(name), [inner(args[0])], [])
            if name in RESERVED_NAMES:
                raise LibraryError(
                    f"{where}: '{name}' got {len(args)} arguments; min, max take two, others one."
                )
    advice = ""
    match node:
        case ast.BinOp(op=ast.BitXor()) | ast.Call(func=ast.Name(id="sgn")):
            advice = " (write ** for a power, sign for sgn)"
    wrong = f"{where} contains something other than numbers, names, + - * / ** and functions"
    raise LibraryError(f"{wrong} {' '.join((*SWITCHING, *SMOOTH))}{advice}.")


def _is_exponent(node: ast.AST, exponents: frozenset[str]) -> bool:
    match node:
        case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=operand):
            return _is_exponent(operand, exponents)
        case ast.Constant(value=int() | float() as value):
            return not isinstance(value, bool) and abs(value) <= MAX_EXPONENT
        case ast.Name(id=name):
            return name in exponents
    return False


def _switch(name: str, args: list[ast.expr], surface: ast.expr) -> ast.Call:
    """Return a call that changes branch where `surface` is zero; the surface is stored with the call."""
    call = ast.Call(ast.Name(name), args, [])
    call.surface = Formula(ast.unparse(surface), surface)  # type: ignore[attr-defined]
    return call


def short(text: str) -> str:
    """Shorten a text to one line of at most 60 characters."""
    text = " ".join(text.split())
    return text if len(text) <= 60 else text[:57] + "..."


def with_instead(formula: Formula, name: str, text: str, over: float = 1.0) -> Formula:
    """Replace a name in a formula by an expression divided by a number."""
    names, whole = formula.names | {name}, re.sub(rf"\b{name}\b", f"({text})", formula.text)
    return parse(whole if over == 1.0 else f"({whole})/{over!r}", names, names, formula.text)


def toml(force: "Force") -> str:
    """Return the lines of a force in a library file."""
    words = {k: getattr(force, k) for k in ("symbol", "name", "family", "meaning", "source", "curve")}
    words |= {"formula": force.formula.text, "kind": force.kind if force.kind != "force" else ""}
    tables: dict[str, Any] = {
        k: {name: f.text for name, f in getattr(force, k).items()} for k in ("state", "memory", "start")
    }
    tables["shape"] = {name: vars(shape) for name, shape in force.shape.items()}
    values = {**words, **tables, "passive": force.passive, "coefficient": force.coefficient}
    values |= {"run": force.run, "uses": list(force.uses)}
    return "".join(f"{k} = {toml_value(value)}\n" for k, value in values.items() if value)


def toml_value(value: Any) -> str:
    """Return a text, number, boolean or table of these in TOML."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {toml_value(v)}" for k, v in value.items()) + " }"
    # Texts, numbers and booleans have the same form in JSON and TOML, and numbers read back unchanged.
    # Letters are not escaped: TOML has no surrogate pairs for those above U+FFFF.
    return json.dumps(value, ensure_ascii=False)


def symbol_latex(symbol: str) -> str:
    """Return a symbol in LaTeX: Latin or Greek letters with an index, or an upright word without one."""
    import sympy

    written = str(sympy.latex(sympy.Symbol(symbol)))
    letter = written.split("_")[0]
    if len(letter) == 1 or letter.startswith("\\"):
        return written
    words = symbol.replace("_", r"\ ")
    return rf"\mathrm{{{words}}}"


def formula_latex(force: "Force") -> str:
    """Return the formula in LaTeX, with theta and theta' = dtheta/d(w t)."""
    import sympy

    names = {k: sympy.Symbol(k, real=True) for f in force.formulas for k in f.names}
    names |= {"x": sympy.Symbol(r"\theta", real=True), "v": sympy.Symbol(r"\theta'", real=True)}

    def power(base: Any, exponent: Any) -> Any:
        return base ** sympy.nsimplify(exponent)

    functions = {n: getattr(sympy, n) for n in ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh")}
    functions |= {"abs": sympy.Abs, "min": sympy.Min, "max": sympy.Max, "power": power}
    functions["sign"] = sympy.Function(r"\operatorname{sgn}")
    expression = sympy.nsimplify(force.formula.evaluate(names, functions), rational=True)
    return str(sympy.latex(expression, mul_symbol=r"\,"))


FACTORS = (2.0, 0.125)
# Possible powers of the signal's unit in shape parameters, states and memory.
SHAPE_POWERS = (0.0, 1.0, -1.0, -2.0)
HIDDEN_POWERS = (1.0, 0.0, 2.0)
# Possible powers of the reference frequency in them, and what is added to these for rates, d/d(w t).
REFERENCE_POWERS = (0.0, -1.0, 1.0, -2.0, 2.0)
OF_RATES = -1.0
# Powers of the coefficient, under the name "", and of each shape parameter, by its name.
Powers: TypeAlias = dict[str, float]


@lru_cache(maxsize=1024)
def signal_powers(force: "Force") -> Powers | None:
    """Return powers of the signal's unit in a coefficient and its shape parameters; None without a degree.

    Parameters
    ----------
    force : Force
        For a force of degree p in the signal, with states and shape parameters scaled accordingly, the
        coefficient is in unit^(1-p). `sin(x) - x` has no degree, because its angles are in radians.
        `tanh(v/s)` has degree 0, with s of power 1. A degree that depends on a shape parameter, as in
        abs(v)**p, counts as none.
    """
    of_signal = {channel.name: 1.0 for channel in force.channels if channel.kind}
    return _powers(force, {"x": 1.0, "v": 1.0} | of_signal, SHAPE_POWERS, HIDDEN_POWERS, 0.0, 1.0)


@lru_cache(maxsize=1024)
def reference_powers(force: "Force") -> Powers | None:
    """Return powers of the reference frequency w in a coefficient and its shapes; None without a degree.

    Parameters
    ----------
    force : Force
        -w^2 c f(x, v) with v = x'/w: for `v` the coefficient scales as 1/w, for `sin(x) - x` as 1/w^2. A
        natural frequency in units of w scales as 1/w, a relaxation time as w. None for abs(v)**p, as in
        `signal_powers`.
    """
    over_w = {channel.name: -float(channel.power) for channel in force.channels if channel.power}
    whole = 0.0 if force.kind == "sensor" else -2.0
    return _powers(force, {"v": -1.0} | over_w, REFERENCE_POWERS, REFERENCE_POWERS, OF_RATES, whole)


def _powers(
    force: "Force",
    motion: Mapping[str, float],
    of_shapes: Sequence[float],
    of_hidden: Sequence[float],
    of_rates: float,
    whole: float,
) -> Powers | None:
    """Return powers of coefficient and shapes that give the power `whole` if x and v scale as given."""
    hidden = (*force.state, *force.memory)
    for shape_powers in itertools.product(of_shapes, repeat=len(force.shape)):
        shapes = dict(zip(force.shape, shape_powers, strict=True))
        for hidden_powers in itertools.product(of_hidden, repeat=len(hidden)):
            powers = {**motion, **shapes, **dict(zip(hidden, hidden_powers, strict=True))}
            degrees = {_degree(force, powers, points, of_rates) for points in _points(force, shapes)}
            if None not in degrees and len(degrees) == 1:
                return {"": whole - float(degrees.pop() or 0.0), **shapes}
    return None


def _points(force: "Force", shapes: dict[str, float]) -> list[dict[str, Any]]:
    """Return test points with dimensionless shape parameters at their default and at both limits."""
    ends = ("default", "low", "high")
    pure = [{k: getattr(force.shape[k], end) for k, p in shapes.items() if p == 0.0} for end in ends]
    return [force.test_points | values for values in (pure if pure[0] else pure[:1])]


def _degree(
    force: "Force", powers: dict[str, float], points: dict[str, Any], of_rates: float
) -> float | None:
    """Return the degree of the force if states and memory have these powers, else None."""
    rates = [(formula, powers[name] + of_rates) for name, formula in force.state.items()]
    values = [(f, powers[name]) for name, f in (*force.memory.items(), *force.start.items())]
    if any(f.degree_in(powers, points, FACTORS) not in (power, np.inf) for f, power in rates + values):
        return None
    degree = force.formula.degree_in(powers, points, FACTORS)
    return None if degree == np.inf else degree
