"""Exported numbers of a result: a table (CSV), a table for LaTeX, and a methods section."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from sysid_trib._version import __version__
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.notation import symbol_latex
from sysid_trib.printing import equation, layout, verdict
from sysid_trib.results import judged, kinds, models, variables
from sysid_trib.results.kinds import GIVEN, MU, si_of

# Column of the LaTeX table other than the methods: a key of the column `method` of the CSV table.
SI_COLUMN = "SI units"
DIFFERENCE_ROWS = "first minus second"
RECORD_ROWS = "record"
# If there are more methods, they are in rows.
MOST_COLUMNS = 3
LATEX_ESCAPES = {letter: f"\\{letter}" for letter in "{}$&#_%"}
LATEX_ESCAPES |= {"\\": r"\backslash ", "^": r"\wedge ", "~": r"\sim "}
LATEX_TEXT = {"\\": r"\textbackslash{}", "^": r"\^{}", "~": r"\~{}"}
FREQUENCIES_LATEX = {"reference_frequency": r"\omega", "asymptotic_frequency": r"\omega_\infty"}
# Description of each method in a methods section.
IN_WORDS = {
    "direct": (
        "regression of the equation of motion in weak form with refined instrumental variables"
        r"~\cite{young2011}"
    ),
    "averaging": r"averaging, amplitude decay and frequency shift~\cite{lebot2019}",
    "trajectory": "maximum likelihood of the motion, simulated with its exact switchings",
}
BIBLIOGRAPHY = Path(__file__).with_name("citations.bib")


def forces_latex(library: ForceLibrary) -> str:
    r"""Return the forces of a library with their states as a table (`booktabs`) for LaTeX."""
    rows = []
    for force in library:
        formulas = {f: equation.formula_latex(f)[0] for f in force.formulas}
        states = [rf"\dot{{{name}}}/\omega = {formulas[rate]}" for name, rate in force.state.items()]
        held = [rf"{name} := {formulas[value]}" for name, value in force.memory.items()]
        equations = f"${', '.join([formulas[force.formula], *states, *held])}$"
        rows.append([f"${force.latex_symbol}$", plain_latex(force.name), equations])
    return str(pd.DataFrame(rows, columns=["symbol", "force", "formula"]).to_latex(index=False))


def about_the_record(tree: xr.DataTree) -> dict[str, str]:
    """Return the facts on the record and the verdict for a table, by name."""
    records = [tree[group] for group in variables.record_groups(tree)]
    windows = [f"{float(r.time.values[0]):.6g} to {float(r.time.values[-1]):.6g} s" for r in records]
    samples = [str(record.sizes["time"]) for record in records]
    details = {"window": ", ".join(windows), "samples": ", ".join(samples)}
    details["units"] = variables.signal_units(tree)
    kind = kinds.kind_of(tree)
    if kind == "difference":
        return {"verdict": str(tree.attrs["verdict"])} | details
    details["noise"] = f"{judged.record_noise(tree):.2g} {details['units']}"
    if kind == "compare":
        best = str(tree["comparison"].attrs["best"])
        rows = judged.comparison_of(tree).sel(model=best)
        parts = {"residual": rows.residual_over_noise, "residual held out": rows.holdout_over_noise}
        written = {name: f"{ratio.item():.3g} times the noise" for name, ratio in parts.items()}
        return {"predicts best": best} | details | written
    if kind == "discover":
        said = {"verdict": judged.verdict_of(tree), "search": str(tree.attrs[judged.SEARCH_OUTCOME])}
        model = "after"
    else:
        model = judged.preferred_of(tree)
        said = {"verdict": judged.verdict_of(tree), "answer": model}
    ratio = judged.residual_over_noise(tree, model)
    residual = f"{ratio:.3g} times the noise" if np.isfinite(ratio) else "the motion diverges from the record"
    return said | details | {"residual": residual}


def csv_text(tree: xr.DataTree) -> str:
    """Return rows of coefficients and frequencies with total errors and their parts; then the record."""
    details = ({"quantity": name, "value": text} for name, text in about_the_record(tree).items())
    rows = (*_rows(tree), *({"method": RECORD_ROWS} | row for row in details))
    return layout.csv_of(["method", *list(layout.COLUMNS)[:-1]], rows)


def _rows(tree: xr.DataTree) -> Iterator[dict[str, Any]]:
    """Yield quantities by each method, in SI units with the values used, and differences of samples."""
    for method, result in judged.given_results(tree).items():
        yield from ({"method": method} | row for row in layout.quantities(judged.with_error_parts(result)))
    if (values := si_of(tree)) is not None:
        words = {"method": f"{values.attrs['of_method']} in {SI_COLUMN}"}
        for symbol, force in layout.by_label(values, "force").items():
            own = words | {"quantity": symbol, "formula": force["multiplies"].item()}
            yield own | _number(force, "coefficient") | {"unit": force["unit"].item()}
            if np.isfinite(force.get(MU, np.nan)):
                yield own | _number(force, MU) | {"name": MU.replace("_", " "), "unit": "1"}
        for name in (name for name in GIVEN if name in values):
            yield words | {"quantity": name, "unit": values[name].attrs["units"]} | _number(values, name)
    if kinds.kind_of(tree) == "difference":
        for symbol, row in layout.by_label(tree.to_dataset(), "force").items():
            tested = {name: row[name].item() for name in ("standard_error", "z", "p_value")}
            yield {"method": DIFFERENCE_ROWS, "quantity": symbol, "value": row.difference.item()} | tested


def _number(data: xr.Dataset, name: str) -> dict[str, float]:
    return {"value": data[name].item(), "standard_error": data[layout.error_of(name)].item()}


def latex_text(tree: xr.DataTree) -> str:
    r"""Return a table (`booktabs`) of coefficients with errors, and the main identification's equation."""
    named = judged.given_results(tree)
    letters = {f.symbol: f.latex_symbol for result in named.values() for f in models.library_of(result)}
    cells: dict[str, dict[str, str]] = {}
    # In the order of the methods, with all their forces.
    heads: dict[str, None] = {}
    for row in _rows(tree):
        if row["quantity"] in GIVEN:
            continue
        quantity, (number, mark) = row["quantity"], layout.number_and_mark(row)
        column = SI_COLUMN if row["method"].endswith(SI_COLUMN) else row["method"]
        column = "difference" if column == DIFFERENCE_ROWS else column
        letter = letters.get(quantity) or FREQUENCIES_LATEX.get(quantity) or symbol_latex(quantity)
        head = rf"$\mu_{{{letter}}}$" if row.get("name") == MU.replace("_", " ") else f"${letter}$"
        head += " (rad/s)" * (quantity in FREQUENCIES_LATEX)
        has_unit = quantity in letters and row.get("unit", "1") != "1"
        unit = f" {unit_in_latex(row['unit'])}" if has_unit else ""
        z = f", $z = {row['z']:.1f}$" if np.isfinite(row.get("z", np.nan)) else ""
        heads |= {column: None}
        cells.setdefault(head, {})[column] = f"{in_latex(number)}{unit}{mark}{z}"
    table = pd.DataFrame(list(cells.values()), list(cells), list(heads)).fillna("--")
    table = table.rename(columns=lambda name: name.replace("_", " "))
    table = table.T if len(heads) > MOST_COLUMNS else table
    tabular = table.to_latex(column_format=f"l{'c' * table.shape[1]}").rstrip()
    caption = rf"\caption{{{_caption(tree, named)}}}"
    lines = [r"\begin{table}", r"\centering", caption, tabular, r"\end{table}"]
    if kinds.kind_of(tree) != "difference":
        main = judged.main_result(tree)
        lines += ["", "% no method gave a model" if main is None else equation.equation_latex(main)]
    return "\n".join([*lines, ""])


def _caption(tree: xr.DataTree, named: Mapping[str, xr.Dataset]) -> str:
    """Describe the contents of the table of a result, its record, and the verdict."""
    details = "; ".join(f"{name}: {text}" for name, text in about_the_record(tree).items())
    by = " and ".join(", ".join(named).rsplit(", ", 1)).replace("_", " ")
    refers = "".join(verdict.reference_sentence(result) for result in list(named.values())[-1:])
    si = "".join(
        f"; {row['quantity']}: {in_latex(layout.number_and_mark(row)[0])} {unit_in_latex(row['unit'])}"
        for row in _rows(tree)
        if row["quantity"] in GIVEN
    )
    refers = plain_latex(refers).replace(" w ", r" $\omega$ ")
    details = plain_latex(f"{details[:1].upper()}{details[1:]}")
    return f"Coefficients by {by} with standard errors. {refers} {details}{si}."


def in_latex(text: str) -> str:
    """Format `(-2.3 ± 0.3)e-05` for LaTeX."""
    return f"${equation.power_of_ten(text.replace('±', chr(92) + 'pm'))}$"


def plain_latex(text: str) -> str:
    """Escape a text of a result for LaTeX, so that it contains no command."""
    return re.sub(r"[{}$&#_%\\^~]", lambda letter: LATEX_TEXT.get(letter[0], f"\\{letter[0]}"), text)


def unit_in_latex(unit: str) -> str:
    r"""Format `px^-1 s-1` as `$\mathrm{px}^{-1}\,\mathrm{s}^{-1}$`."""
    parts = []
    for part in unit.split():
        match = re.fullmatch(r"(.*?[^\d^.-])\^?(-?[\d.]+)?", part)
        base, power = match.groups() if match else (part, None)
        # A unit is read from a file, so its letters are escaped.
        escaped = "".join(LATEX_ESCAPES.get(letter, letter) for letter in base)
        parts.append(rf"\mathrm{{{escaped}}}" + (f"^{{{power}}}" if power else ""))
    return "$" + r"\,".join(parts) + "$"


def methods_text(tree: xr.DataTree) -> str:
    """Return a paragraph in LaTeX on a result of `identify`, and the equation of the preferred model."""
    main = judged.main_result(tree)
    records = [tree[group] for group in variables.record_groups(tree)]
    values: dict[str, Any] = {
        "several": len(records) > 1,
        "rate": 1.0 / float(np.median(np.diff(records[0].time.values))),
        "samples": ", ".join(f"{record.sizes['time']:,}" for record in records),
        "window": about_the_record(tree)["window"],
        "version": __version__,
    }
    if main is not None:
        method = main.attrs["method"]
        ratio = judged.residual_over_noise(tree, main.attrs["method"])
        others = [name for name in judged.kept_results(tree) if name != method]
        if others and "agreement" in tree.children:
            values["other"] = IN_WORDS.get(others[0], others[0])
            values["largest"] = float(np.nanmax(np.abs(tree["agreement"].z.values)))
        names = (force.name for force in models.library_of(main))
        values |= {
            # The library may be a user's, so characters with a meaning in LaTeX are removed.
            "forces": ", ".join(re.sub(r"[^\w ,().-]", " ", name) for name in names),
            "by": IN_WORDS.get(method, method),
            "left": f"{ratio:.3g}" if np.isfinite(ratio) else "",
            "noise": equation.power_of_ten(f"{judged.record_noise(tree):.2g}"),
            "unit": variables.signal_units(tree),
            "of_model": "error_of_model" in main,
            "frequency": equation.frequency_text(main),
            "equation": equation.equation_latex(main),
        }
    return equation.from_template("methods.txt", values)


def cited(text: str) -> str:
    """Return the entries of BibTeX that a text cites."""
    entries = BIBLIOGRAPHY.read_text(encoding="utf-8").split("\n\n")
    kept = []
    for entry in entries:
        key = entry[entry.find("{") + 1 : entry.find(",")]
        if key in text:
            kept.append(entry.strip())
    return "\n\n".join(kept) + "\n"
