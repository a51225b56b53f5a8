"""The equation of an identification in one line, for LaTeX, and as a function of other programs."""

import re
from collections.abc import Iterator, Mapping
from math import floor, log10
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.forces.formulas import SMOOTH, Formula
from sysid_trib.forces.notation import symbol_latex
from sysid_trib.results.references import in_model
from sysid_trib.results.schema import library_of, model_of, shape_values_of
from sysid_trib.results.variables import signal_symbol, signal_units

# Digits of a number without an error, and of an error.
DIGITS, DIGITS_OF_ERROR = 6, 2
# Names of formulas in LaTeX; x is the angle, v its rate over w.
NAMES = {"x": r"\theta", "v": r"\frac{\dot{\theta}}{\omega}", "t": "t"}
IN_NUMPY = {name: f"np.{name}" for name in ("sign", "abs", "pi", *SMOOTH)}
IN_NUMPY |= {"min": "np.minimum", "max": "np.maximum"}
IN_SYMPY = {name: f"sympy.{name}" for name in ("sign", "pi", *SMOOTH)}
IN_SYMPY |= {"abs": "sympy.Abs", "min": "sympy.Min", "max": "sympy.Max"}
# Names that the texts have for what is theirs.
NAMES_OF_TEXTS = {"t", "x", "v", "y", "dy", "w", "W", "f", "force", "start", "rate", "rates", "np", "sympy"}
# Languages of `export` that hold the parameters, no program.
PARAMETER_LANGUAGES = ("toml", "json")
# By language, for which there is a template.
FUNCTION_NAMES: dict[str, Mapping[str, str]] = {"python": IN_NUMPY, "sympy": IN_SYMPY, "simulink": {}}


def equation_text(result: xr.Dataset) -> str:
    """The equation of motion of an identification in one line, x the angle and v its rate over w.

    Parameters
    ----------
    result : Dataset
        An identification.
    """
    text = f"x'' = -w^2 (x{_sum(result)}), v = x'/w, w = {frequency_text(result)} rad/s"
    shapes = ", ".join(f"{name} = {value:.6g}" for name, value in shape_values_of(result).items())
    sensor = _sum(result, of_sensor=True)
    measured = f"; the sensor shows x{sensor}" if sensor else ""
    return f"{text}{f', {shapes}' if shapes else ''}{measured}"


def equation_latex(result: xr.Dataset) -> str:
    r"""The equation of motion for LaTeX, between `\begin{equation}` and `\end{equation}`."""
    # A displacement is no angle.
    x = signal_symbol(signal_units(result))
    names = {name: latex.replace(r"\theta", x) for name, latex in NAMES.items()}
    parts = [x]
    for number, formula in _terms(result):
        written, is_sum = formula_latex(formula, names)
        if is_sum or written.startswith("-"):
            # It is multiplied whole.
            written = rf"\left({written}\right)"
        # A number beside a number would read as one.
        times = "\\cdot" if written[:1].isdigit() else "\\,"
        parts.append(f"{_signed(power_of_ten(number))}{times} {written}")
    right = r" \\" "\n" r"    &\quad ".join(parts)
    values = [rf"\omega &= {frequency_text(result)}\,\mathrm{{rad/s}}"]
    for name, value in shape_values_of(result).items():
        values.append(f"{symbol_latex(name.partition('.')[2])} &= {power_of_ten(f'{value:.6g}')}")
    return "\n".join(
        [
            r"\begin{equation}",
            r"  \begin{aligned}",
            rf"    \ddot{{{x}}} &= -\omega^2 \Bigl[" + right + r" \Bigr], \\",
            ", \\\\\n".join(f"    {value}" for value in values),
            r"  \end{aligned}",
            r"\end{equation}",
        ]
    )


def formula_latex(formula: Formula, names: Mapping[str, str] = NAMES) -> tuple[str, bool]:
    """A formula of a library for LaTeX, letters by `names`, and whether it is a sum."""
    import sympy

    known = {"abs": sympy.Abs, "sign": sympy.sign, "max": sympy.Max, "min": sympy.Min}
    known |= {name: sympy.Symbol(names.get(name, name)) for name in formula.names}
    with sympy.evaluate(False):
        # Formulas were checked when they were read: names, numbers and a few functions.
        expression = sympy.parse_expr(formula.text, local_dict=known)
        return str(sympy.latex(expression)), bool(expression.is_Add)


def power_of_ten(number: str) -> str:
    """A number as LaTeX writes it: its power of ten is no e."""
    digits, _, power = number.partition("e")
    return f"{digits} \\times 10^{{{int(power)}}}" if power else digits


def rounded(value: float, error: float) -> str:
    """A number to two digits of its error; to six without one."""
    if not (np.isfinite(error) and error > 0.0) or value == 0.0:
        return f"{value:.{DIGITS}g}"
    digits = floor(log10(abs(value))) - floor(log10(error)) + DIGITS_OF_ERROR
    return f"{value:#.{max(1, digits)}g}".replace(".e", "e").rstrip(".")


def frequency_text(result: xr.Dataset) -> str:
    """The reference frequency to two digits of its error, rad/s."""
    return rounded(result.reference_frequency.item(), result.reference_frequency_standard_error.item())


def _terms(result: xr.Dataset, of_sensor: bool = False) -> Iterator[tuple[str, Formula]]:
    """Numbers and formulas of the active forces, or of what the sensor adds.

    A stiffness that refers to another frequency, that without contact, is in w already.
    """
    for force in library_of(result):
        row = result.sel(force=force.symbol)
        acts = row.active.item() and row.coefficient.item() != 0.0 and in_model(result, force.symbol)
        # Each run's own stands once, by its index.
        if acts and (force.run or 1) == 1 and (force.kind == "sensor") is of_sensor:
            number = rounded(row.coefficient.item(), row.standard_error.item())
            number = number if force.run is None else f"{force.symbol.removesuffix('_1')}_i"
            yield number, force.formula


def _sum(result: xr.Dataset, *, of_sensor: bool = False) -> str:
    """Numbers times formulas; the sign of a formula goes to its number."""
    text = ""
    for number, formula in _terms(result, of_sensor):
        factor = _factor(formula.text)
        if factor.startswith("-"):
            number, factor = number[1:] if number.startswith("-") else f"-{number}", factor[1:]
        text += f" {_signed(number)}*{factor}"
    return text


def _signed(number: str) -> str:
    return f"- {number[1:]}" if number.startswith("-") else f"+ {number}"


def _factor(formula: str) -> str:
    """A formula as a factor: in brackets if it is a sum."""
    depth = 0
    for at, letter in enumerate(formula):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and at and letter in "+-" and formula[at - 1] == " ":
            return f"({formula})"
    return formula


def model_code(result: xr.Dataset, language: str) -> str:
    """The equation of an identification as program text, with its numbers to all their digits.

    Parameters
    ----------
    result : Dataset
        An identification.
    language : {"python", "sympy", "simulink"}
        A function `f(t, y)` of NumPy; `rates` of sympy; the body of a MATLAB function block.

    Raises
    ------
    UsageError
        Another language, or a force whose memory changes at reversals: it is no equation in x, v, states.
    """
    if language not in FUNCTION_NAMES:
        offered = ", ".join((*FUNCTION_NAMES, *PARAMETER_LANGUAGES))
        raise UsageError(f"'{language}' is no language of export; choose {offered}.")
    _check_is_equation(result)
    model, functions = model_of(result).bound, FUNCTION_NAMES[language]
    terms, states, starts = list[str](), dict[str, str](), list[str]()
    for force in model.forces:
        shapes = {name: f"({value!r})" for name, value in force.shape_values(model.shapes).items()}
        known = {**functions, **shapes, **{name: f"{force.symbol}_{name}" for name in force.state}}
        terms.append(f"{float(model.coefficients[force.symbol])!r} * ({_renamed(force.formula, known)})")
        for name, rate in force.state.items():
            states[known[name]] = _renamed(rate, known)
            starts.append(_renamed(force.start[name], known) if name in force.start else "0.0")
    text = from_template(
        f"{language}.txt",
        {
            # Units are words of files: what ends a comment or a docstring is no part of them here.
            "equation": _one_line(equation_text(result)),
            "unit": _one_line(signal_units(result)),
            "w": repr(float(model.reference_frequency)),
            "inputs": model.driven,
            "terms": terms or ["0.0"],
            "states": states,
            "starts": starts,
        },
    )
    return text.replace("**", "^") if language == "simulink" else text


def from_template(name: str, values: Mapping[str, Any]) -> str:
    """A text of the folder `templates` with values in their places."""
    from jinja2 import Environment, PackageLoader

    there = PackageLoader("sysid_trib", "printing/templates")
    environment = Environment(loader=there, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    return environment.get_template(name).render(values)


def _check_is_equation(result: xr.Dataset) -> None:
    """Refuse what no one equation in x, v and states has."""
    model = model_of(result)
    if runs := [force.symbol for force in library_of(result) if force.run is not None]:
        raise UsageError(
            f"{', '.join(runs)} are of one run each, an equation has one of them; identify that run alone."
        )
    if taken := NAMES_OF_TEXTS & {channel.name for channel in model.driven}:
        raise UsageError(
            f"The input {', '.join(sorted(taken))} has a name that the exported text has for its own; give "
            "it another in the library and in --input."
        )
    if hysteretic := [force.symbol for force in model.forces if force.memory]:
        raise UsageError(
            f"{', '.join(hysteretic)} holds values between reversals and is no equation in x, v and states; "
            "use sysid-trib simulate, or predict in Python."
        )


def _one_line(text: str) -> str:
    return re.sub(r'["\\\\]', "'", " ".join(text.split()))


def _renamed(formula: Formula, known: Mapping[str, str]) -> str:
    """A formula with the names of another language."""
    return re.sub(r"\b[^\W\d]\w*", lambda word: known.get(word[0], word[0]), formula.text)
