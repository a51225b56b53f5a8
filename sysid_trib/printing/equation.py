"""The equation of an identification in one line, and in LaTeX."""

from collections.abc import Iterator, Mapping
from math import floor, log10
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.forces.formulas import Formula
from sysid_trib.forces.notation import symbol_latex
from sysid_trib.results.models import in_model, library_of, shape_values_of
from sysid_trib.results.variables import signal_symbol, signal_units

# Digits of a number without an error, and digits of an error.
DIGITS = 6
DIGITS_OF_ERROR = 2
# Names of formulas in LaTeX; x is the angle, v its rate over w.
NAMES = {"x": r"\theta", "v": r"\frac{\dot{\theta}}{\omega}", "t": "t"}


def equation_text(result: xr.Dataset) -> str:
    """Return the equation of motion of an identification in one line, x the angle and v its rate over w.

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
    r"""Return the equation of motion for LaTeX, between `\begin{equation}` and `\end{equation}`."""
    # A displacement has another symbol than an angle.
    x = signal_symbol(signal_units(result))
    names = {name: latex.replace(r"\theta", x) for name, latex in NAMES.items()}
    parts = [x]
    for number, formula in _terms(result):
        written, is_sum = formula_latex(formula, names)
        if is_sum or written.startswith("-"):
            # A sum is multiplied as a whole, so it is bracketed.
            written = rf"\left({written}\right)"
        # Two adjacent numbers would be read as one.
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
    """Return a formula of a library for LaTeX, letters by `names`, and whether it is a sum."""
    import sympy

    known = {"abs": sympy.Abs, "sign": sympy.sign, "max": sympy.Max, "min": sympy.Min}
    known |= {name: sympy.Symbol(names.get(name, name)) for name in formula.names}
    with sympy.evaluate(False):
        # Formulas were checked on reading: they contain names, numbers and a few functions.
        expression = sympy.parse_expr(formula.text, local_dict=known)
        return str(sympy.latex(expression)), bool(expression.is_Add)


def power_of_ten(number: str) -> str:
    """Format a number for LaTeX, with an explicit power of ten."""
    digits, _, power = number.partition("e")
    return f"{digits} \\times 10^{{{int(power)}}}" if power else digits


def rounded(value: float, error: float) -> str:
    """Return a number with two digits of its error, or six digits without an error."""
    if not (np.isfinite(error) and error > 0.0) or value == 0.0:
        return f"{value:.{DIGITS}g}"
    digits = floor(log10(abs(value))) - floor(log10(error)) + DIGITS_OF_ERROR
    return f"{value:#.{max(1, digits)}g}".replace(".e", "e").rstrip(".")


def frequency_text(result: xr.Dataset) -> str:
    """Return the reference frequency with two digits of its error, rad/s."""
    return rounded(result.reference_frequency.item(), result.reference_frequency_standard_error.item())


def _terms(result: xr.Dataset, of_sensor: bool = False) -> Iterator[tuple[str, Formula]]:
    """Yield numbers and formulas of the active forces, or of the terms of the sensor.

    A stiffness that refers to the frequency without contact is already contained in w.
    """
    for force in library_of(result):
        row = result.sel(force=force.symbol)
        acts = row.active.item() and row.coefficient.item() != 0.0 and in_model(result, force.symbol)
        # The force of each run is written once, with its index.
        if acts and (force.run or 1) == 1 and (force.kind == "sensor") is of_sensor:
            number = rounded(row.coefficient.item(), row.standard_error.item())
            number = number if force.run is None else f"{force.symbol.removesuffix('_1')}_i"
            yield number, force.formula


def _sum(result: xr.Dataset, *, of_sensor: bool = False) -> str:
    """Return numbers times formulas; the sign of a formula is moved to its number."""
    text = ""
    for number, formula in _terms(result, of_sensor):
        factor = _factor(formula.text)
        if factor.startswith("-"):
            number = number[1:] if number.startswith("-") else f"-{number}"
            factor = factor[1:]
        text += f" {_signed(number)}*{factor}"
    return text


def _signed(number: str) -> str:
    return f"- {number[1:]}" if number.startswith("-") else f"+ {number}"


def _factor(formula: str) -> str:
    """Return a formula as a factor: in brackets if it is a sum."""
    depth = 0
    for at, letter in enumerate(formula):
        depth += (letter == "(") - (letter == ")")
        if depth == 0 and at and letter in "+-" and formula[at - 1] == " ":
            return f"({formula})"
    return formula


def from_template(name: str, values: Mapping[str, Any]) -> str:
    """Return a file of the folder `templates` with values inserted."""
    from jinja2 import Environment, PackageLoader

    there = PackageLoader("sysid_trib", "printing/templates")
    environment = Environment(loader=there, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True)
    return environment.get_template(name).render(values)
