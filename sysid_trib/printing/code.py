"""The equation of an identification as a function for other programs."""

import re
from collections.abc import Mapping

import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.forces.formulas import SMOOTH, Formula
from sysid_trib.printing.equation import equation_text, from_template
from sysid_trib.results.models import library_of
from sysid_trib.results.schema import model_of
from sysid_trib.results.variables import signal_units

IN_NUMPY = {name: f"np.{name}" for name in ("sign", "abs", "pi", *SMOOTH)}
IN_NUMPY |= {"min": "np.minimum", "max": "np.maximum"}
IN_SYMPY = {name: f"sympy.{name}" for name in ("sign", "pi", *SMOOTH)}
IN_SYMPY |= {"abs": "sympy.Abs", "min": "sympy.Min", "max": "sympy.Max"}
# Names used by the exported programs.
NAMES_OF_TEXTS = {"t", "x", "v", "y", "dy", "w", "W", "f", "force", "start", "rate", "rates", "np", "sympy"}
# Formats of `export` that contain parameters instead of a program.
PARAMETER_LANGUAGES = ("toml", "json")
# Templates by language.
FUNCTION_NAMES: dict[str, Mapping[str, str]] = {"python": IN_NUMPY, "sympy": IN_SYMPY, "simulink": {}}


def model_code(result: xr.Dataset, language: str) -> str:
    """Return the equation of an identification as program text, with all digits of its numbers.

    Parameters
    ----------
    result : Dataset
        An identification.
    language : {"python", "sympy", "simulink"}
        A function `f(t, y)` for NumPy; `rates` for sympy; the body of a MATLAB function block.

    Raises
    ------
    UsageError
        The language is unknown, or a force has memory that changes at reversals, so that the model is not an
        equation in x, v and states.
    """
    if language not in FUNCTION_NAMES:
        offered = ", ".join((*FUNCTION_NAMES, *PARAMETER_LANGUAGES))
        raise UsageError(f"'{language}' is not a language of export; choose {offered}.")
    _check_is_equation(result)
    model = model_of(result).bound
    functions = FUNCTION_NAMES[language]
    terms = list[str]()
    states = dict[str, str]()
    starts = list[str]()
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
            # Units are words of files: remove characters that would end a comment or a docstring.
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


def _check_is_equation(result: xr.Dataset) -> None:
    """Raise an error for a model that is not one equation in x, v and states."""
    model = model_of(result)
    if runs := [force.symbol for force in library_of(result) if force.run is not None]:
        raise UsageError(
            f"{', '.join(runs)} have one value for each run, but an equation has one value; identify "
            "one run alone."
        )
    if taken := NAMES_OF_TEXTS & {channel.name for channel in model.driven}:
        raise UsageError(
            f"The input {', '.join(sorted(taken))} has a name that the exported program already uses; "
            "rename it in the library and in --input."
        )
    if hysteretic := [force.symbol for force in model.forces if force.memory]:
        raise UsageError(
            f"{', '.join(hysteretic)} keeps values from its reversals, so the model is not an equation in x, "
            "v and states; use sysid-trib simulate, or predict in Python."
        )


def _one_line(text: str) -> str:
    return re.sub(r'["\\\\]', "'", " ".join(text.split()))


def _renamed(formula: Formula, known: Mapping[str, str]) -> str:
    """Return a formula with the function names of another language."""
    return re.sub(r"\b[^\W\d]\w*", lambda word: known.get(word[0], word[0]), formula.text)
