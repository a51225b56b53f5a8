"""The numbers of a result as a table for spreadsheets (CSV), and for LaTeX with the equation."""

import csv
import io
import re

import xarray as xr

from sysid_trib.printing.equation import equation_latex, power_of_ten
from sysid_trib.printing.layout import by_label, value_with_error
from sysid_trib.printing.model_verdict import answer_of, kept_results, residual_over_noise, verdict_of
from sysid_trib.results.per_run import record_groups
from sysid_trib.results.schema import library_of
from sysid_trib.validation.comparison_table import applied_methods
from sysid_trib.validation.model_error import error_parts

HEADS = (
    "method",
    "quantity",
    "name",
    "formula",
    "value",
    "standard_error",
    "unit",
    "refers_to",
    "error_of_noise",
    "error_of_model",
)
# More methods than this are rows.
MOST_COLUMNS = 3
# Signs by which a spreadsheet knows a formula.
FORMULA_SIGNS = ("=", "+", "-", "@")
LATEX_ESCAPES = {letter: f"\\{letter}" for letter in "{}$&#_%"}
LATEX_ESCAPES |= {"\\": r"\backslash ", "^": r"\wedge ", "~": r"\sim "}
FREQUENCIES_LATEX = {"reference_frequency": r"\omega", "asymptotic_frequency": r"\omega_\infty"}


def identified(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """The identifications of a result without methods that failed.

    Parameters
    ----------
    tree : DataTree
        Result of `cross_check`, `compare` or `discover`.
    """
    if "steps" in tree.children:
        names = {"start model": "before", "final model": "after"}
        return {name: tree[group].to_dataset() for name, group in names.items()}
    if "best" in tree["comparison"].attrs:
        labels = applied_methods(tree["comparison"].to_dataset()).method.values.tolist()
        return {label: tree[label].to_dataset() for label in labels}
    return kept_results(tree)


def about_the_record(tree: xr.DataTree) -> dict[str, str]:
    """What a table carries of its record and of the verdict on it, by name."""
    records = [tree[group] for group in record_groups(tree)]
    windows = [f"{float(r.time.values[0]):.6g} to {float(r.time.values[-1]):.6g} s" for r in records]
    details = {
        "window": ", ".join(windows),
        "samples": ", ".join(str(record.sizes["time"]) for record in records),
    }
    if "steps" in tree.children:
        return {"verdict": str(tree.attrs["verdict"])} | details
    checked = tree["comparison"].attrs
    if "best" in checked:
        return {"predicts best": str(checked["best"])} | details
    answer = answer_of(tree)
    residual = f"{residual_over_noise(tree, answer):.3g} times the noise"
    return {"verdict": verdict_of(tree), "answer": answer} | details | {"residual": residual}


def csv_text(tree: xr.DataTree) -> str:
    """All coefficients and frequencies, a row each, with total errors and their parts; then the record."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(HEADS)
    for name, result in identified(tree).items():
        parts = zip(*error_parts(result), strict=True)
        for (symbol, force), errors in zip(by_label(result, "force").items(), parts, strict=True):
            words = [name, symbol, force["name"].item(), force["formula"].item()]
            numbers = [force.coefficient.item(), force.standard_error.item()]
            row = [*words, *numbers, force.unit.item(), force.refers_to.item(), *errors]
            writer.writerow(map(_as_text, row))
        for quantity in FREQUENCIES_LATEX:
            words = [name, quantity, quantity.replace("_", " "), ""]
            numbers = [result[quantity].item(), result[f"{quantity}_standard_error"].item()]
            writer.writerow(map(_as_text, [*words, *numbers, "rad/s", "", "", ""]))
    for name, text in about_the_record(tree).items():
        writer.writerow(map(_as_text, ["record", name, "", "", text, *([""] * 5)]))
    return buffer.getvalue()


def latex_text(tree: xr.DataTree) -> str:
    r"""A table (`booktabs`) of all coefficients with errors, and the equation of the main identification."""
    named = identified(tree)
    cells: dict[str, dict[str, str]] = {}
    for name, result in named.items():
        library = library_of(result)
        for symbol, force in by_label(result, "force").items():
            text = value_with_error(force.coefficient.item(), force.standard_error.item())
            unit = "" if force.unit.item() == "1" else f" {unit_in_latex(force.unit.item())}"
            cells.setdefault(f"${library[symbol].latex_symbol}$", {})[name] = f"{_in_latex(text)}{unit}"
        for quantity, symbol in FREQUENCIES_LATEX.items():
            error = result[f"{quantity}_standard_error"].item()
            text = _in_latex(value_with_error(result[quantity].item(), error))
            cells.setdefault(f"${symbol}$ (rad/s)", {})[name] = text
    table = [[head, *(row.get(name, "--") for name in named)] for head, row in cells.items()]
    table.insert(0, ["", *(name.replace("_", " ") for name in named)])
    if len(named) > MOST_COLUMNS:
        table = [list(row) for row in zip(*table, strict=True)]
    head, *rows = (f"{' & '.join(row)} \\\\" for row in table)
    begin = rf"\begin{{tabular}}{{l{'c' * (len(table[0]) - 1)}}}"
    details = "; ".join(f"{name}: {text}" for name, text in about_the_record(tree).items())
    note = rf"\multicolumn{{{len(table[0])}}}{{l}}{{\footnotesize {details}}} \\"
    lines = [begin, r"\toprule", head, r"\midrule", *rows, r"\bottomrule", note, r"\end{tabular}"]
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
    if best or "steps" in tree.children:
        return named[best or "final model"]
    return named.get(answer_of(tree), next(reversed(named.values()), None))


def _in_latex(text: str) -> str:
    """`(-2.3 ± 0.3)e-05` as LaTeX writes it."""
    return f"${power_of_ten(text.replace('±', chr(92) + 'pm'))}$"
