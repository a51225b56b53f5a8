"""A cross-checked identification as a table, in layers, and as plain data for JSON."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.printing.cross_check import (
    agreement_sentences,
    amplitudes,
    consequences,
    times_of_amplitudes,
)
from sysid_trib.printing.equation import equation_text
from sysid_trib.printing.layers import ALWAYS, USUALLY, Block, Layer
from sysid_trib.printing.layout import (
    by_label,
    coefficient_json,
    number,
    numbers,
    quantity,
    records_json,
    text_table,
)
from sysid_trib.printing.model_verdict import (
    answer_of,
    effective_sentences,
    error_sentences,
    failure_sentences,
    failures,
    fewer_forces,
    holds,
    kept_results,
    line_sentences,
    separation_sentences,
    test_sentence,
    verdict_of,
    verdict_sentence,
)
from sysid_trib.printing.physics import physics_json, weight_sentences
from sysid_trib.printing.random_force import random_force_json
from sysid_trib.printing.residual import residual_of
from sysid_trib.printing.runs import runs_json, runs_sentences, runs_table
from sysid_trib.results.signal_units import signal_units
from sysid_trib.validation.breakdown import record_noise
from sysid_trib.validation.model_error import FREQUENCIES, error_parts

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.table import Table


def identification_blocks(
    tree: xr.DataTree, sources: "Sequence[str]", inertia: float | None = None
) -> list[Block]:
    """What the command `identify` prints, in layers.

    Parameters
    ----------
    tree : DataTree
        Result of `cross_check`, with the group `runs` if there are several.
    sources : sequence of str
        What each record is.
    inertia : float, kg m^2, optional
        Adds SI units.

    Returns
    -------
    list of Block
    """
    key, details = agreement_sentences(tree), agreement_sentences(tree, details=True)
    results = kept_results(tree)
    if holds(tree) and answer_of(tree) in results:
        at = times_of_amplitudes(tree)
        key += weight_sentences(results[answer_of(tree)], amplitudes(tree), time=at)
    blocks = [
        Block([verdict_sentence(tree)], ALWAYS),
        Block(sources),
        Block([*line_sentences(tree), *failure_sentences(tree), *effective_sentences(tree)], ALWAYS),
    ]
    if results:
        blocks.append(Block(identification_table(tree), ALWAYS))
        equation = equation_text(results.get(answer_of(tree), next(reversed(results.values()))))
        blocks.append(Block([f"{_answer(tree)}Equation: {equation}."], USUALLY))
    blocks += [
        Block(separation_sentences(tree), ALWAYS),
        Block(key, Layer.DEFAULT),
        Block([test_sentence(tree), *error_sentences(tree), *details], Layer.EXPLAIN),
        Block(consequences(tree, inertia), Layer.EXPLAIN),
    ]
    if "runs" in tree:
        runs = tree["runs"].to_dataset()
        blocks += [Block(runs_table(runs), Layer.EXPLAIN), Block(runs_sentences(runs), USUALLY)]
    return blocks


def identification_table(tree: xr.DataTree) -> "Table":
    """Coefficients by both methods with errors, and how many errors apart they are.

    A method that failed has no column. Errors are the total ones, of the noise and of the model.
    """
    checked, results = tree["comparison"].ds, kept_results(tree)
    unit, noise = signal_units(tree), record_noise(tree)
    symbols = list(dict.fromkeys(s for r in results.values() for s in r.force.values.tolist()))
    width = max([8, *map(len, symbols)])
    rows = []
    for symbol in symbols:
        named = next(r for r in results.values() if symbol in r.force).sel(force=symbol)
        of_unit = "" if named.unit.item() == "1" else f" ({named.unit.item()})"
        heads = [f"{symbol:{width}} {named['name'].item()}{of_unit}", named["formula"].item()]
        cells = [coefficient_cell(result, symbol) for result in results.values()]
        rows.append([*heads, *cells, _difference(checked, symbol, results)])
    for name, title in zip(FREQUENCIES, ("w (rad/s)", "w_inf (rad/s)"), strict=True):
        label = name.replace("_", " ")
        cells = [quantity(result, name) for result in results.values()]
        rows.append([title, label, *cells, _difference(checked, label, results)])
    residuals = {name: residual_of(tree, name) for name in results}
    cells = [f"{residual / noise:.3g} x noise" for residual in residuals.values()]
    rows.append(["residual (RMS)", f"noise: {noise:.2g} {unit}", *cells, ""])
    heads = ["force", "formula", *results, "difference / error"]
    if len(results) < 2:
        # There is no difference.
        heads, rows = heads[:-1], [row[:-1] for row in rows]
    return text_table(heads, rows, numbers=tuple(range(2, len(heads))))


def _names(tree: xr.DataTree) -> tuple[str, str]:
    checked = tree["comparison"].attrs
    return checked["first"], checked["second"]


def _difference(checked: xr.Dataset, label: str, results: Mapping[str, xr.Dataset]) -> str:
    """Difference of both methods over its error; nothing where one failed."""
    z = checked.z.sel(quantity=label).item() if label in checked.quantity and len(results) > 1 else np.nan
    return f"{z:+.1f}" if np.isfinite(z) else ""


def identification_json(tree: xr.DataTree, inertia: float | None = None) -> dict[str, Any]:
    """The result as plain data; non-finite numbers are None."""
    checked, results = tree["comparison"].ds, {n: tree[n].to_dataset() for n in _names(tree)}
    failed = failures(tree)
    methods = {
        name: (_withheld() if name in failed else _method_json(result)) | {"failed": failed.get(name, "")}
        for name, result in results.items()
    }
    differences = ("difference", "expected_difference", "standard_error", "z")
    tested = ("departure_time", "residual_p_value", "line_frequency", "line_amplitude")
    check = {
        **numbers(checked, ("chi_square", "degrees_of_freedom", "p_value")),
        "differences": {
            q: numbers(checked.sel(quantity=q), differences) for q in checked.quantity.values.tolist()
        },
        "models": {
            name: numbers(checked.sel(model=name), tested) | _residual_json(tree, name) for name in methods
        },
        "noise": record_noise(tree),
        **checked.attrs,
    }
    data = {
        **records_json(tree),
        **random_force_json(tree),
        "answer": None if answer_of(tree) in failed else answer_of(tree),
        "methods": methods,
        "cross_check": check,
    }
    refused = consequences(tree, inertia) if not holds(tree) else []
    data["consequences"] = (
        {"refused": refused[0]}
        if refused
        else physics_json(results[answer_of(tree)], amplitudes(tree), inertia, time=times_of_amplitudes(tree))
    )
    data["sufficient_forces"] = [
        {symbol: dict(zip(("value", "standard_error"), pair, strict=True)) for symbol, pair in forces.items()}
        for forces in fewer_forces(tree)
    ]
    if "runs" in tree:
        data["runs"] = runs_json(tree["runs"].to_dataset())
    return data


def _residual_json(tree: xr.DataTree, name: str) -> dict[str, Any]:
    """RMS of record minus model, rad and over the noise of the record."""
    rms = residual_of(tree, name)
    return {"residual_rms": number(rms), "residual_over_noise": number(rms / record_noise(tree))}


def _answer(tree: xr.DataTree) -> str:
    """Which of two methods the result stands by, where a test decides it."""
    if verdict_of(tree) not in ("approximate", "not explained") or len(kept_results(tree)) < 2:
        return ""
    return f"Answer: {answer_of(tree)}, by its prediction of parts that were held out. "


def _withheld() -> dict[str, Any]:
    """A method that failed: no number of it is given."""
    names = (
        *FREQUENCIES,
        "noise",
        *(f"{name}_standard_error" for name in FREQUENCIES),
        "misfit",
        "held_out_rms",
    )
    return {"coefficients": {}, **dict.fromkeys(names)}


def _method_json(result: xr.Dataset) -> dict[str, Any]:
    noise, model = error_parts(result)
    coefficients = {
        symbol: {
            **coefficient_json(force),
            "error_of_noise": number(noise[at]),
            "error_of_model": number(model[at]),
            "active": bool(force.active.item()),
            "refers_to": number(force.refers_to.item()),
            "unit": force.unit.item(),
        }
        for at, (symbol, force) in enumerate(by_label(result, "force").items())
    }
    names = (*FREQUENCIES, "noise", *(f"{name}_standard_error" for name in FREQUENCIES))
    return {
        "coefficients": coefficients,
        **numbers(result, names),
        "misfit": number(result.birge_ratio.item()),
        "held_out_rms": number(float(result.get("held_out_rms", np.nan))),
    }


def coefficient_cell(result: xr.Dataset, symbol: str) -> str:
    """A coefficient with its error, or why there is none."""
    if symbol not in result.force:
        return "-"
    force = result.sel(force=symbol)
    if not force.active.item():
        return f"dropped (± {force.standard_error.item():.2g})"
    kind = force.constraint.item() if "constraint" in force.coords else ""
    mark = {"": "", "fixed": " (fixed)", "at its bound": " (bound)"}.get(kind, " (tied)")
    return f"{quantity(force, 'coefficient')}{mark}"
