"""A result as text for others: its equation for programs, and a paragraph for the methods of a paper."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import xarray as xr

from sysid_trib._version import __version__
from sysid_trib.errors import UsageError
from sysid_trib.forces.formulas import SMOOTH, Formula
from sysid_trib.printing.exported import (
    about_the_record,
    equation_latex,
    equation_text,
    power_of_ten,
    rounded,
)
from sysid_trib.results.schema import library_of, model_of
from sysid_trib.results.variables import record_groups, signal_units
from sysid_trib.validation.findings import kept_results, main_result, residual_over_noise
from sysid_trib.validation.verdict import record_noise

IN_NUMPY = {name: f"np.{name}" for name in ("sign", "abs", "pi", *SMOOTH)}
IN_NUMPY |= {"min": "np.minimum", "max": "np.maximum"}
IN_SYMPY = {name: f"sympy.{name}" for name in ("sign", "pi", *SMOOTH)}
IN_SYMPY |= {"abs": "sympy.Abs", "min": "sympy.Min", "max": "sympy.Max"}
# Names that the texts have for what is theirs.
NAMES_OF_TEXTS = {"t", "x", "v", "y", "dy", "w", "W", "f", "force", "start", "rate", "rates", "np", "sympy"}
PYTHON_TEXT = '''"""{equation}

x in {unit} about the equilibrium, without the sensor's zero and errors; t in s since the first sample.
Start and zero of a record are to be fitted, with rtol=1e-9. Dry friction does not hold it at rest: end there.
"""

import numpy as np

W = {w!r}  # rad/s


def f(t, y{inputs}):
    """Rates of y = [{states}] by time, as scipy.integrate.solve_ivp takes them."""
    x, v = y[0], y[1] / W
{scaled}    force = (
        {force}
    )
    return np.array([y[1], -W**2 * (x + force){rates}])


def start(x, rate, t=0.0):
    """The states y of a motion that begins at x with a rate (1/s)."""
    v = rate / W
    return np.array([x, rate{starts}])
'''
SYMPY_TEXT = """# {equation}
# x in {unit}, v = x'/w, t in s since the first sample of the record.
import sympy

{names} = sympy.symbols("{names}", real=True)
w = sympy.Float({w!r})  # rad/s
{scaled}force = (
    {force}
)
# Derivatives by time.
rates = {{x: w * v, v: -w * (x + force){rates}}}
"""
SIMULINK_TEXT = """function dy = f(t, y{inputs})
%#codegen
% {equation}
% y = [{states}], x in {unit}, t in s since the first sample of the record; dy goes to an integrator.
% First values of the states beyond x and its rate: [{starts}].
W = {w!r}; % rad/s
x = y(1); v = y(2)/W;
{scaled}force = {force};
dy = [y(2); -W^2*(x + force){rates}];
end
"""
# What each method is, in the words of a methods section.
IN_WORDS = {
    "direct": (
        "regression of the equation of motion in weak form with refined instrumental variables"
        r"~\cite{young2011}"
    ),
    "averaging": r"averaging, amplitude decay and frequency shift~\cite{lebot2019}",
    "trajectory": "maximum likelihood of the motion, simulated with its exact switchings",
}
BIBLIOGRAPHY = Path(__file__).with_name("citations.bib")


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
    if language not in LANGUAGES:
        raise UsageError(f"'{language}' is no language of export; choose {', '.join(LANGUAGES)}.")
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
    heading = {
        # Units are words of files: what ends a comment or a docstring is no part of them here.
        "equation": _one_line(equation_text(result)),
        "unit": _one_line(signal_units(result)),
        "w": float(model.reference_frequency),
    }
    return LANGUAGES[language](result, heading)


def _one_line(text: str) -> str:
    return re.sub(r'["\\\\]', "'", " ".join(text.split()))


def _written(formula: Formula, known: Mapping[str, str]) -> str:
    """A formula with the names of another language."""
    return re.sub(r"\b[^\W\d]\w*", lambda word: known.get(word[0], word[0]), formula.text)


def _parts(result: xr.Dataset, functions: Mapping[str, str]) -> tuple[list[str], dict[str, tuple[str, str]]]:
    """The terms of the force, and of each state its rate by w t and its first value."""
    model, terms = model_of(result), list[str]()
    states: dict[str, tuple[str, str]] = {}
    for force in model.forces:
        known = dict(functions)
        for name, shape in force.shape.items():
            known[name] = f"({float(model.shapes.get(f'{force.symbol}.{name}', shape.default))!r})"
        known |= {name: f"{force.symbol}_{name}" for name in force.state}
        terms.append(f"{float(model.coefficients[force.symbol])!r} * ({_written(force.formula, known)})")
        for name, rate in force.state.items():
            first = _written(force.start[name], known) if name in force.start else "0.0"
            states[known[name]] = _written(rate, known), first
    return terms or ["0.0"], states


def _inputs(result: xr.Dataset, line: str) -> tuple[list[str], str]:
    """Names of inputs and their derivatives by time, and the lines that scale them as formulas see them."""
    channels = model_of(result).driven
    scaled = [line.format(name=channel.name, power=channel.power) for channel in channels if channel.power]
    return [channel.name for channel in channels], "".join(scaled)


def _python(result: xr.Dataset, heading: Mapping[str, object]) -> str:
    terms, states = _parts(result, IN_NUMPY)
    inputs, scaled = _inputs(result, "    {name} = {name} / W**{power}\n")
    scaled += "".join(f"    {name} = y[{at}]\n" for at, name in enumerate(states, 2))
    return PYTHON_TEXT.format(
        inputs="".join(f", {name}=0.0" for name in inputs),
        states=", ".join(["x", "x'", *states]),
        scaled=scaled,
        force="\n        + ".join(terms),
        rates="".join(f", W * ({rate})" for rate, _ in states.values()),
        starts="".join(f", {first}" for _, first in states.values()),
        **heading,
    )


def _sympy(result: xr.Dataset, heading: Mapping[str, object]) -> str:
    terms, states = _parts(result, IN_SYMPY)
    inputs, scaled = _inputs(result, "{name} = {name} / w**{power}\n")
    return SYMPY_TEXT.format(
        names=", ".join(["t", "x", "v", *states, *inputs]),
        scaled=scaled,
        force="\n    + ".join(terms),
        rates="".join(f", {name}: w * ({rate})" for name, (rate, _) in states.items()),
        **heading,
    )


def _simulink(result: xr.Dataset, heading: Mapping[str, object]) -> str:
    terms, states = _parts(result, {})
    inputs, scaled = _inputs(result, "{name} = {name}/W^{power};\n")
    scaled += "".join(f"{name} = y({at});\n" for at, name in enumerate(states, 3))
    return SIMULINK_TEXT.format(
        inputs="".join(f", {name}" for name in inputs),
        states="; ".join(["x", "x'", *states]),
        scaled=scaled,
        force=" ...\n    + ".join(terms),
        rates="".join(f"; W*({rate})" for rate, _ in states.values()),
        starts="; ".join(first for _, first in states.values()),
        **heading,
    ).replace("**", "^")


LANGUAGES: dict[str, Callable[[xr.Dataset, Mapping[str, object]], str]] = {
    "python": _python,
    "sympy": _sympy,
    "simulink": _simulink,
}


def methods_text(tree: xr.DataTree) -> str:
    """A paragraph in LaTeX on a result of `identify`, and the equation of its answer."""
    main = main_result(tree)
    records, unit = [tree[group] for group in record_groups(tree)], signal_units(tree)
    rate = 1.0 / float(np.median(np.diff(records[0].time.values)))
    samples = ", ".join(f"{record.sizes['time']:,}" for record in records)
    first = (
        f"{'Free decays' if len(records) > 1 else 'A free decay'} of {samples} samples at {rate:.4g} Hz "
        f"({about_the_record(tree)['window']}) {'were' if len(records) > 1 else 'was'} identified."
    )
    if main is None:
        return f"{first}\nNo method gave a model that follows the record.\n"
    named = kept_results(tree)
    others = [name for name in named if name != main.attrs["method"]]
    # A library is its user's: no letter of a name is a command.
    forces = ", ".join(re.sub(r"[^\w ,().-]", " ", force.name) for force in library_of(main))
    said = [
        first,
        rf"The equation of motion~\cite{{lebot2019}} has the forces {forces}; their coefficients "
        f"come from {IN_WORDS.get(main.attrs['method'], main.attrs['method'])}, in PySINDy's optimisers"
        r"~\cite{kaptanoglu2022} where it is linear.",
    ]
    z = tree["comparison"].z if "z" in tree["comparison"] else None
    if others and z is not None:
        said.append(
            f"They were cross-checked by {IN_WORDS.get(others[0], others[0])}: the largest difference is "
            f"{float(np.nanmax(np.abs(z.values))):.2g} of its error."
        )
    noise = power_of_ten(f"{record_noise(tree):.2g}")
    ratio = residual_over_noise(tree, main.attrs["method"])
    said.append(
        f"The motion of the model leaves {ratio:.3g} times the sensor's noise of ${noise}$ {unit} (RMS)."
        if np.isfinite(ratio)
        else "The motion of the model leaves the record."
    )
    said.append(_errors(main))
    w = rounded(main.reference_frequency.item(), main.reference_frequency_standard_error.item())
    said.append(rf"The coefficients refer to $\omega = {w}$ rad/s; computed with sysid\_trib {__version__}.")
    return "\n".join([*said, "", equation_latex(main), ""])


def _errors(main: xr.Dataset) -> str:
    """What the standard errors hold."""
    if "error_of_model" not in main:
        return "Standard errors are those of the noise."
    return (
        "Standard errors are those of the noise and of the model, the latter by the movement of the "
        r"coefficients between the first, middle and last 70\,\% of the record~\cite{hausman1978}."
    )


def cited(text: str) -> str:
    """The entries of BibTeX that a text cites."""
    entries = BIBLIOGRAPHY.read_text(encoding="utf-8").split("\n\n")
    return "\n\n".join(e.strip() for e in entries if e[e.find("{") + 1 : e.find(",")] in text) + "\n"
