"""The identified equation of motion with its numbers, as a line of text and for LaTeX."""

from math import floor, log10

import numpy as np
import xarray as xr

from sysid_trib.results.schema import library_of, shape_values_of
from sysid_trib.results.signal_units import signal_symbol, signal_units

# Digits of a number without an error, and of an error.
DIGITS, DIGITS_OF_ERROR = 6, 2
# Names of formulas in LaTeX; x is the angle, v its rate over w.
NAMES = {"x": r"\theta", "v": r"\frac{\dot{\theta}}{\omega}", "t": "t"}


def equation_text(result: xr.Dataset) -> str:
    """The equation of motion of an identification in one line, x the angle and v its rate over w.

    Parameters
    ----------
    result : Dataset
        An identification.
    """
    forces, sensors = _terms(result)
    w = rounded(result.reference_frequency.item(), result.reference_frequency_standard_error.item())
    text = f"x'' = -w^2 (x{_sum(forces)}), v = x'/w, w = {w} rad/s"
    shapes = ", ".join(f"{name} = {value:.6g}" for name, value in shape_values_of(result).items())
    measured = f"; the sensor shows x{_sum(sensors)}" if sensors else ""
    return f"{text}{f', {shapes}' if shapes else ''}{measured}"


def equation_latex(result: xr.Dataset) -> str:
    r"""The same for LaTeX, between `\begin{equation}` and `\end{equation}`."""
    import sympy

    # A displacement is no angle.
    x = signal_symbol(signal_units(result))
    names = {name: sympy.Symbol(latex.replace(r"\theta", x)) for name, latex in NAMES.items()}
    forces, _ = _terms(result)
    parts = []
    for number, formula in forces:
        with sympy.evaluate(False):
            written = sympy.latex(_expression(formula, names))
        # A number beside a number would read as one.
        times = "\\cdot" if written[:1].isdigit() else "\\,"
        parts.append(f"{_signed(power_of_ten(number))}{times} {written}")
    w = rounded(result.reference_frequency.item(), result.reference_frequency_standard_error.item())
    right = r" \\" "\n" r"    &\quad ".join([x, *parts])
    return "\n".join(
        [
            r"\begin{equation}",
            r"  \begin{aligned}",
            rf"    \ddot{{{x}}} &= -\omega^2 \Bigl[" + right + r" \Bigr], \\",
            rf"    \omega &= {w}\,\mathrm{{rad/s}}",
            r"  \end{aligned}",
            r"\end{equation}",
        ]
    )


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


def _terms(result: xr.Dataset) -> tuple[list[tuple[str, str]], list[tuple[str, str]]]:
    """Numbers and formulas of the active forces, and of the sensor's terms.

    A stiffness that refers to another frequency, that without contact, is in w already.
    """
    forces: list[tuple[str, str]] = []
    sensors: list[tuple[str, str]] = []
    for force in library_of(result):
        of_force = result.sel(force=force.symbol)
        in_model = np.isclose(of_force.refers_to, result.reference_frequency, rtol=1e-12)
        if of_force.active.item() and in_model and of_force.coefficient.item() != 0.0:
            number = rounded(of_force.coefficient.item(), of_force.standard_error.item())
            (sensors if force.kind == "sensor" else forces).append((number, force.formula.text))
    return forces, sensors


def _sum(terms: list[tuple[str, str]]) -> str:
    return "".join(f" {_term(number, _factor(formula))}" for number, formula in terms)


def _term(number: str, factor: str) -> str:
    """A summand; the sign of a formula goes to its number."""
    if factor.startswith("-"):
        return _term(number[1:] if number.startswith("-") else f"-{number}", factor[1:])
    return f"{_signed(number)}*{factor}"


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


def _expression(formula: str, names: dict[str, object]) -> object:
    """A formula of a library as sympy has it."""
    import sympy

    known = {"abs": sympy.Abs, "sign": sympy.sign, "max": sympy.Max, "min": sympy.Min, **names}
    # Formulas were checked when they were read: names, numbers and a few functions.
    return sympy.parse_expr(formula, local_dict=known)
