"""A force as text: TOML and LaTeX."""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid_trib.forces.force import Force


def toml(force: "Force") -> str:
    """The lines of a force in a library's file."""
    words = {k: getattr(force, k) for k in ("symbol", "name", "family", "meaning", "source")}
    words |= {"formula": force.formula.text, "kind": force.kind if force.kind != "force" else ""}
    tables: dict[str, Any] = {
        k: {name: f.text for name, f in getattr(force, k).items()} for k in ("state", "memory", "start")
    }
    tables["shape"] = {name: vars(shape) for name, shape in force.shape.items()}
    values = {**words, **tables, "passive": force.passive, "coefficient": force.coefficient}
    values["run"] = force.run
    return "".join(f"{k} = {toml_value(value)}\n" for k, value in values.items() if value)


def toml_value(value: Any) -> str:
    """A text, number, truth value or table of these in TOML."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{k} = {toml_value(v)}" for k, v in value.items()) + " }"
    # Texts, numbers and truth values of JSON are those of TOML; a number reads back as the same number.
    # Letters as they are: TOML knows no pairs of escapes for those above U+FFFF.
    return json.dumps(value, ensure_ascii=False)


def symbol_latex(symbol: str) -> str:
    """A symbol in LaTeX: letters, Greek too, with their index; a word stands upright, without one."""
    import sympy

    written = str(sympy.latex(sympy.Symbol(symbol)))
    letter = written.split("_")[0]
    if len(letter) == 1 or letter.startswith("\\"):
        return written
    words = symbol.replace("_", r"\ ")
    return rf"\mathrm{{{words}}}"


def formula_latex(force: "Force") -> str:
    """The formula in LaTeX, with theta and theta' = dtheta/d(w t)."""
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
