"""The numbers of a result as a table for spreadsheets (CSV), and for LaTeX with the equation."""

import csv
import io
import re

import xarray as xr

from sysid_trib.printing.comparison_sentences import method_widenings
from sysid_trib.printing.equation import equation_latex, power_of_ten
from sysid_trib.printing.layout import by_label, value_with_error
from sysid_trib.printing.model_verdict import kept_results, widenings
from sysid_trib.results.schema import library_of
from sysid_trib.validation.comparison_table import applied_methods

HEADS = ("method", "quantity", "name", "formula", "value", "standard_error", "unit", "refers_to", "widening")
# More methods than this are rows.
MOST_COLUMNS = 3
# Signs by which a spreadsheet knows a formula.
FORMULA_SIGNS = ("=", "+", "-", "@")
LATEX_ESCAPES = {letter: f"\\{letter}" for letter in "{}$&#_%"}
LATEX_ESCAPES |= {"\\": r"\backslash ", "^": r"\wedge ", "~": r"\sim "}
FREQUENCIES_LATEX = {"reference_frequency": r"\omega", "asymptotic_frequency": r"\omega_\infty"}


def identified(tree: xr.DataTree) -> dict[str, tuple[xr.Dataset, float]]:
    """The identifications of a result without methods that failed, and by how much errors are widened.

    Parameters
    ----------
    tree : DataTree
        Result of `cross_check`, `compare` or `discover`.
    """
    if "steps" in tree.children:
        names = {"start model": "before", "final model": "after"}
        return {name: (tree[group].to_dataset(), 1.0) for name, group in names.items()}
    if "best" in tree["comparison"].attrs:
        labels = applied_methods(tree["comparison"].to_dataset()).method.values.tolist()
        factors = method_widenings(tree)
        return {label: (tree[label].to_dataset(), factors[label]) for label in labels}
    results = kept_results(tree)
    return {name: (results[name], factor) for name, factor in widenings(tree, results).items()}


def csv_text(tree: xr.DataTree) -> str:
    """All coefficients and frequencies, a row each, with stated errors and how far they are to be widened."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(HEADS)
    for name, (result, factor) in identified(tree).items():
        for symbol, force in by_label(result, "force").items():
            words = [name, symbol, force["name"].item(), force["formula"].item()]
            numbers = [force.coefficient.item(), force.standard_error.item()]
            row = [*words, *numbers, force.unit.item(), force.refers_to.item(), factor]
            writer.writerow(map(_as_text, row))
        for quantity in FREQUENCIES_LATEX:
            words = [name, quantity, quantity.replace("_", " "), ""]
            numbers = [result[quantity].item(), result[f"{quantity}_standard_error"].item()]
            writer.writerow(map(_as_text, [*words, *numbers, "rad/s", "", factor]))
    return buffer.getvalue()


def latex_text(tree: xr.DataTree) -> str:
    r"""A table (`booktabs`) of all coefficients with errors, and the equation of the main identification."""
    named = identified(tree)
    cells: dict[str, dict[str, str]] = {}
    for name, (result, factor) in named.items():
        library = library_of(result)
        for symbol, force in by_label(result, "force").items():
            text = value_with_error(force.coefficient.item(), factor * force.standard_error.item())
            unit = "" if force.unit.item() == "1" else f" {unit_in_latex(force.unit.item())}"
            cells.setdefault(f"${library[symbol].latex_symbol}$", {})[name] = f"{_in_latex(text)}{unit}"
        for quantity, symbol in FREQUENCIES_LATEX.items():
            error = factor * result[f"{quantity}_standard_error"].item()
            text = _in_latex(value_with_error(result[quantity].item(), error))
            cells.setdefault(f"${symbol}$ (rad/s)", {})[name] = text
    table = [[head, *(row.get(name, "--") for name in named)] for head, row in cells.items()]
    table.insert(0, ["", *(name.replace("_", " ") for name in named)])
    if len(named) > MOST_COLUMNS:
        table = [list(row) for row in zip(*table, strict=True)]
    head, *rows = (f"{' & '.join(row)} \\\\" for row in table)
    begin = rf"\begin{{tabular}}{{l{'c' * (len(table[0]) - 1)}}}"
    lines = [begin, r"\toprule", head, r"\midrule", *rows, r"\bottomrule", r"\end{tabular}"]
    main = main_identification(tree)
    return "\n".join([*lines, "", "% no method gave a model" if main is None else equation_latex(main), ""])


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


def main_identification(tree: xr.DataTree) -> xr.Dataset | None:
    """The identification that stands for a result: the best, the final or the second; none if all failed."""
    named = identified(tree)
    best = tree["comparison"].attrs.get("best") if "comparison" in tree.children else None
    return named[best][0] if best else next((result for result, _ in reversed(named.values())), None)


def _in_latex(text: str) -> str:
    """`(-2.3 ± 0.3)e-05` as LaTeX writes it."""
    return f"${power_of_ten(text.replace('±', chr(92) + 'pm'))}$"
