"""The numbers of a result that leave the program: the equation, a table (CSV), and both for LaTeX."""

import csv
import io
import re
from collections.abc import Iterator, Mapping
from math import floor, log10
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.formulas import Formula
from sysid_trib.forces.notation import symbol_latex
from sysid_trib.physics.si_units import GIVEN, MU, si_of
from sysid_trib.printing.layout import (
    by_label,
    constraint_mark,
    error_of,
    quantity,
    reference_sentence,
    shape_and_mark,
    value_with_error,
)
from sysid_trib.results.files import kind_of
from sysid_trib.results.schema import library_of, shape_values_of
from sysid_trib.results.variables import record_groups, signal_symbol, signal_units
from sysid_trib.validation.findings import (
    answer_of,
    given_results,
    main_result,
    residual_over_noise,
    verdict_of,
    with_error_parts,
)
from sysid_trib.validation.verdict import record_noise

# Digits of a number without an error, and of an error.
DIGITS, DIGITS_OF_ERROR = 6, 2
# Names of formulas in LaTeX; x is the angle, v its rate over w.
NAMES = {"x": r"\theta", "v": r"\frac{\dot{\theta}}{\omega}", "t": "t"}
# Columns of the table, and the variables of a force that they hold.
COLUMNS = {
    "method": "",
    "quantity": "force",
    "name": "name",
    "formula": "formula",
    "value": "coefficient",
    "standard_error": "standard_error",
    "unit": "unit",
    "refers_to": "refers_to",
    "error_of_noise": "error_of_noise",
    "error_of_model": "error_of_model",
    "error_of_calibration": "error_of_calibration",
    "constraint": "constraint",
    "z": "z",
    "p_value": "p_value",
}
# More methods than this are rows.
MOST_COLUMNS = 3
# Signs by which a spreadsheet knows a formula.
FORMULA_SIGNS = ("=", "+", "-", "@")
LATEX_ESCAPES = {letter: f"\\{letter}" for letter in "{}$&#_%"}
LATEX_ESCAPES |= {"\\": r"\backslash ", "^": r"\wedge ", "~": r"\sim "}
LATEX_TEXT = {"\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}"}
FREQUENCIES_LATEX = {"reference_frequency": r"\omega", "asymptotic_frequency": r"\omega_\infty"}


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
    r"""The equation of motion for LaTeX, between `\begin{equation}` and `\end{equation}`."""
    import sympy

    # A displacement is no angle.
    x = signal_symbol(signal_units(result))
    names = {name: sympy.Symbol(latex.replace(r"\theta", x)) for name, latex in NAMES.items()}
    forces, _ = _terms(result)
    parts = []
    for number, formula in forces:
        with sympy.evaluate(False):
            expression = sympy.sympify(_expression(formula, names))
            written = sympy.latex(expression)
        if expression.is_Add or written.startswith("-"):
            # It is multiplied whole.
            written = rf"\left({written}\right)"
        # A number beside a number would read as one.
        times = "\\cdot" if written[:1].isdigit() else "\\,"
        parts.append(f"{_signed(power_of_ten(number))}{times} {written}")
    w = rounded(result.reference_frequency.item(), result.reference_frequency_standard_error.item())
    right = r" \\" "\n" r"    &\quad ".join([x, *parts])
    values = [rf"\omega &= {w}\,\mathrm{{rad/s}}"]
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


def forces_latex(library: ForceLibrary) -> str:
    r"""The forces of a library with their states as a table (`booktabs`) for LaTeX."""
    import sympy

    symbols = {name: sympy.Symbol(latex) for name, latex in NAMES.items()}
    rows = []
    for force in library:
        own = {name: sympy.Symbol(name) for formula in force.formulas for name in formula.names}
        known = own | symbols

        def written(formula: Formula, known: Mapping[str, object] = known) -> str:
            with sympy.evaluate(False):
                return str(sympy.latex(sympy.sympify(_expression(formula.text, known))))

        states = [rf"\dot{{{name}}}/\omega = {written(rate)}" for name, rate in force.state.items()]
        held = [rf"{name} := {written(value)}" for name, value in force.memory.items()]
        cells = f"${', '.join([written(force.formula), *states, *held])}$"
        rows.append(rf"${force.latex_symbol}$ & {_plain(force.name)} & {cells} \\")
    head = [r"\begin{tabular}{lll}", r"\toprule", r"symbol & force & formula \\", r"\midrule"]
    return "\n".join([*head, *rows, r"\bottomrule", r"\end{tabular}", ""])


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
            if force.run is not None:
                # Each run's own stands once, by its index.
                if force.run > 1:
                    continue
                number = f"{force.symbol.removesuffix('_1')}_i"
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


def _expression(formula: str, names: Mapping[str, object]) -> object:
    """A formula of a library as sympy has it."""
    import sympy

    known = {"abs": sympy.Abs, "sign": sympy.sign, "max": sympy.Max, "min": sympy.Min, **names}
    # Formulas were checked when they were read: names, numbers and a few functions.
    return sympy.parse_expr(formula, local_dict=known)


def about_the_record(tree: xr.DataTree) -> dict[str, str]:
    """What a table carries of its record and of the verdict on it, by name."""
    records = [tree[group] for group in record_groups(tree)]
    windows = [f"{float(r.time.values[0]):.6g} to {float(r.time.values[-1]):.6g} s" for r in records]
    samples = [str(record.sizes["time"]) for record in records]
    details = {"window": ", ".join(windows), "samples": ", ".join(samples)}
    details["units"] = signal_units(tree)
    kind = kind_of(tree)
    if kind == "compare":
        best = str(tree["comparison"].attrs["best"])
        rows = tree["comparison"].to_dataset().sel({"method": best})
        noise = f"{record_noise(tree):.2g} {details['units']}"
        parts = {"residual": rows.residual_over_noise, "residual held out": rows.holdout_over_noise}
        written = {name: f"{ratio.item():.3g} times the noise" for name, ratio in parts.items()}
        return {"predicts best": best} | details | {"noise": noise} | written
    if kind == "difference":
        return {"verdict": str(tree.attrs["verdict"])} | details
    if kind == "discover":
        said, model = {"verdict": str(tree.attrs["verdict"])}, "after"
    else:
        model = answer_of(tree)
        said = {"verdict": verdict_of(tree), "answer": model}
    ratio = residual_over_noise(tree, model)
    residual = f"{ratio:.3g} times the noise" if np.isfinite(ratio) else "the motion leaves the record"
    noise = f"{record_noise(tree):.2g} {details['units']}"
    return said | details | {"noise": noise, "residual": residual}


def csv_text(tree: xr.DataTree) -> str:
    """All coefficients and frequencies, a row each, with total errors and their parts; then the record."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(COLUMNS), lineterminator="\n")
    writer.writeheader()
    for row in _rows(tree):
        writer.writerow({column: _as_text(cell) for column, cell in row.items()})
    return buffer.getvalue()


def _rows(tree: xr.DataTree) -> Iterator[dict[str, Any]]:
    for method, result in given_results(tree).items():
        for force in by_label(with_error_parts(result), "force").values():
            cells = {column: force[name].item() for column, name in COLUMNS.items() if name in force}
            yield {"method": method} | cells
        for name in _shapes(result):
            shape = result.sel(shape_parameter=name)
            value, error = shape["shape"].item(), shape.shape_standard_error.item()
            words = {"method": method, "quantity": name, "name": "shape", "value": value}
            yield words | ({"constraint": "fixed"} if np.isnan(error) else {"standard_error": error})
        for name in FREQUENCIES_LATEX:
            value, error = (result[key].item() for key in (name, error_of(name)))
            words = {"method": method, "quantity": name, "name": name.replace("_", " "), "unit": "rad/s"}
            yield words | {"value": value, "standard_error": error}
    if (converted := si_of(tree)) is not None:
        yield from _si_rows(converted)
    for symbol, row in _contrasts(tree).items():
        words = {"method": "first minus second", "quantity": symbol, "value": row.difference.item()}
        yield words | {name: row[name].item() for name in ("standard_error", "z", "p_value")}
    for name, text in about_the_record(tree).items():
        yield {"method": "record", "quantity": name, "value": text}


def _shapes(result: xr.Dataset) -> list[str]:
    """Names of the shape parameters of an identification."""
    return result.shape_parameter.values.tolist() if "shape" in result else []


def _si_rows(values: xr.Dataset) -> Iterator[dict[str, Any]]:
    """Coefficients and friction in SI units, and what they were made with."""
    method = f"{values.attrs['of_method']} in SI units"
    for symbol, force in by_label(values, "force").items():
        words = {"method": method, "quantity": symbol, "formula": force["multiplies"].item()}
        value, error = force.coefficient.item(), force.standard_error.item()
        yield words | {"value": value, "standard_error": error, "unit": force["unit"].item()}
        if np.isfinite(force.get(MU, np.nan)):
            value, error = (force[name].item() for name in (MU, error_of(MU)))
            words |= {"name": MU.replace("_", " "), "unit": "1"}
            yield words | {"value": value, "standard_error": error}
    for name in (name for name in GIVEN if name in values):
        words = {"method": method, "quantity": name, "unit": values[name].attrs["units"]}
        yield words | {"value": values[name].item(), "standard_error": values[error_of(name)].item()}


def _contrasts(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """The differences of two samples by force; nothing of another result."""
    return by_label(tree.to_dataset(), "force") if kind_of(tree) == "difference" else {}


def latex_text(tree: xr.DataTree) -> str:
    r"""A table (`booktabs`) of all coefficients with errors, and the equation of the main identification."""
    named = given_results(tree)
    cells: dict[str, dict[str, str]] = {}
    for method, result in named.items():
        library = library_of(result)
        for symbol, force in by_label(result, "force").items():
            unit = "" if force.unit.item() == "1" else f" {unit_in_latex(force.unit.item())}"
            text = f"{_in_latex(quantity(force, 'coefficient'))}{unit}{constraint_mark(force)}"
            cells.setdefault(f"${library[symbol].latex_symbol}$", {})[method] = text
        for name in _shapes(result):
            number, mark = shape_and_mark(result, name)
            cells.setdefault(f"${symbol_latex(name)}$", {})[method] = f"{_in_latex(number)}{mark}"
        for name, symbol in FREQUENCIES_LATEX.items():
            cells.setdefault(f"${symbol}$ (rad/s)", {})[method] = _in_latex(quantity(result, name))
    heads, contrasts = [*named], _contrasts(tree)
    if (values := si_of(tree)) is not None:
        heads.append("SI units")
        library = library_of(named[values.attrs["of_method"]])
        for symbol, force in by_label(values, "force").items():
            letter = library[symbol].latex_symbol
            text = f"{_in_latex(quantity(force, 'coefficient'))} {unit_in_latex(force['unit'].item())}"
            cells[f"${letter}$"]["SI units"] = text
            if np.isfinite(force.get(MU, np.nan)):
                cells[rf"$\mu_{{{letter}}}$"] = {"SI units": _in_latex(quantity(force, MU))}
    heads += ["difference"] if contrasts else []
    for symbol, row in contrasts.items():
        own = next(library_of(result)[symbol] for result in named.values() if symbol in result.force)
        text = value_with_error(row.difference.item(), row.standard_error.item())
        of_force = cells.setdefault(f"${own.latex_symbol}$", {})
        z = f", $z = {row.z.item():.1f}$" if np.isfinite(row.z) else ""
        of_force["difference"] = f"{_in_latex(text)}{z}"
    table = [[head, *(row.get(name, "--") for name in heads)] for head, row in cells.items()]
    table.insert(0, ["", *(name.replace("_", " ") for name in heads)])
    if len(heads) > MOST_COLUMNS:
        table = [list(row) for row in zip(*table, strict=True)]
    head, *rows = (f"{' & '.join(row)} \\\\" for row in table)
    begin = rf"\begin{{tabular}}{{l{'c' * (len(table[0]) - 1)}}}"
    lines = [begin, r"\toprule", head, r"\midrule", *rows, r"\bottomrule", r"\end{tabular}"]
    caption = rf"\caption{{{_caption(tree, named)}}}"
    lines = [r"\begin{table}", r"\centering", caption, *lines, r"\end{table}"]
    if contrasts:
        return "\n".join([*lines, ""])
    main = main_result(tree)
    return "\n".join([*lines, "", "% no method gave a model" if main is None else equation_latex(main), ""])


def _caption(tree: xr.DataTree, named: Mapping[str, xr.Dataset]) -> str:
    """What the table of a result holds, of which record, and how far it is explained."""
    details = "; ".join(f"{name}: {text}" for name, text in about_the_record(tree).items())
    by = " and ".join(", ".join(named).rsplit(", ", 1)).replace("_", " ")
    refers = "".join(reference_sentence(result) for result in list(named.values())[-1:])
    converted = si_of(tree)
    given = xr.Dataset() if converted is None else converted
    si = "".join(
        f"; {name}: {_in_latex(quantity(given, name))} {unit_in_latex(given[name].attrs['units'])}"
        for name in GIVEN
        if name in given
    )
    refers = _plain(refers).replace(" w ", r" $\omega$ ")
    details = _plain(f"{details[:1].upper()}{details[1:]}")
    return f"Coefficients by {by} with standard errors. {refers} {details}{si}."


def _plain(text: str) -> str:
    """A text of a result as LaTeX writes it: none of its letters is a command."""
    return re.sub(r"[{}$&#_%\\^~]", lambda letter: LATEX_TEXT.get(letter[0], f"\\{letter[0]}"), text)


def unit_in_latex(unit: str) -> str:
    r"""`px^-1 s-1` as `$\mathrm{px}^{-1}\,\mathrm{s}^{-1}$`."""
    parts = []
    for part in unit.split():
        match = re.fullmatch(r"(.*?[^\d^.-])\^?(-?[\d.]+)?", part)
        base, power = match.groups() if match else (part, None)
        parts.append(rf"\mathrm{{{_escaped(base)}}}" + (f"^{{{power}}}" if power else ""))
    return "$" + r"\,".join(parts) + "$"


def _escaped(text: str) -> str:
    """A text of a file within mathematics of LaTeX: none of its letters is a command."""
    return "".join(LATEX_ESCAPES.get(letter, letter) for letter in text)


def _as_text(cell: object) -> object:
    """A cell of a spreadsheet, which would execute a text that begins as a formula does."""
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(FORMULA_SIGNS) else cell


def _in_latex(text: str) -> str:
    """`(-2.3 ± 0.3)e-05` as LaTeX writes it."""
    return f"${power_of_ten(text.replace('±', chr(92) + 'pm'))}$"
