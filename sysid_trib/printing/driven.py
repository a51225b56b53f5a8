"""Driven records in words, tables and plain data: the answer, both methods, predictions, forced responses."""

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.physics.si_units import MASS, STIFFNESS, per_input
from sysid_trib.printing.blocks import ALWAYS, Block, Layer
from sysid_trib.printing.exported import equation_text
from sysid_trib.printing.layout import (
    COEFFICIENT,
    by_label,
    coefficient_cell,
    mapped,
    number,
    quantity,
    same,
    text_table,
    value_with_error,
)
from sysid_trib.results.schema import library_of
from sysid_trib.results.variables import record_groups, signal_units

W = "reference_frequency"
RESIDUAL_SIZES = ("residual_rms", "residual_over_noise", "residual_over_motion", "residual_p_value")
ERRORS = (
    "Errors: where what is left is white, by its size; else by blocks of the record (trajectory), or by "
    "rows two periods apart or the random force that stands for what the model lacks (direct). "
    "Differences are over the larger error of both."
)
# Motions of the printed table in each sweep, evenly apart, beside the largest.
PRINTED = 4
RESPONSE_COLUMNS = ("amplitude", "amplitude_low", "amplitude_high", "phase")
CHECKS = ("check_frequency", "check_amplitude", "simulated_amplitude")


def driven_blocks(tree: xr.DataTree, record: Sequence[str] = ()) -> list[Block]:
    """What is said of an identification with inputs, in its order; `record` says what was read."""
    compared, unit = tree["comparison"].to_dataset(), signal_units(tree)
    answer, verdict = compared.attrs["answer"], compared.attrs["verdict_on_record"]
    best = compared.sel(model=answer)
    unexplained = f"{best.residual_rms.item():.3g} {unit}, {100.0 * best.residual_over_motion.item():.2g} %"
    first = {
        "explained": "The record is explained: what its motion leaves is white.",
        "approximate": f"The model follows the record to {unexplained} (RMS); more than noise is left.",
        "not explained": f"The model does not explain the record: its motion leaves {unexplained} (RMS).",
    }[verdict]
    results = {name: tree[name].to_dataset() for name in compared.model.values.tolist()}
    others = [f"whose motion leaves less than that of {name}" for name in results if name != answer]
    why = (others or ["since no motion by the other method follows the record"])[0]
    table = _table(results, compared, unit)
    return [
        Block([first, f"The answer is {answer}'s, {why}."], ALWAYS),
        Block(record),
        Block([ERRORS], Layer.EXPLAIN, "Forces", table, figures="driven"),
        Block(table=table, layers=Layer.QUIET | Layer.DEFAULT),
        Block([f"Equation: {equation_text(results[answer])}."]),
        Block(_in_its_unit(results[answer], tree)),
    ]


def _in_its_unit(result: xr.Dataset, tree: xr.DataTree) -> list[str]:
    """Mass, stiffness and forces in the unit of the input."""
    scaled = per_input(result)
    if scaled is None:
        return []
    record, name, unit = tree[record_groups(tree)[0]], scaled.attrs["input"], signal_units(tree)
    units = record[name].attrs.get("units") or name
    powers = {MASS: f" {units}/({unit}/s^2)", STIFFNESS: f" {units}/{unit}"}
    library = library_of(result)
    parts = []
    for quantity_name, row in by_label(scaled, "quantity").items():
        text = value_with_error(row.value.item(), row.standard_error.item())
        if quantity_name in powers:
            parts.append(f"{quantity_name} {text}{powers[quantity_name]}")
            continue
        q = library[quantity_name].speed_degree or 0.0
        rate = "" if not q else f"/({unit}/s)" if q == 1 else f"/({unit}/s)^{q:g}"
        parts.append(f"{quantity_name} {text} {units}{rate}")
    return [f"In the unit of the input {name}: {', '.join(parts)}."]


def _table(results: dict[str, xr.Dataset], compared: xr.Dataset, unit: str) -> Any:
    """Coefficients by both methods with their errors."""
    symbols = list(dict.fromkeys(s for result in results.values() for s in result.force.values.tolist()))
    rows = []
    for symbol in symbols:
        force = next(r for r in results.values() if symbol in r.force).sel(force=symbol)
        of_unit = "" if force.unit.item() == "1" else f" ({force.unit.item()})"
        cells = [coefficient_cell(result, symbol) for result in results.values()]
        rows.append(
            [
                symbol,
                f"{force['name'].item()}{of_unit}",
                force["formula"].item(),
                *cells,
                _z(compared, symbol),
            ]
        )
    # Where it is held, that at vanishing amplitude is of the forces, whose differences are above.
    fitted = any(result[f"{W}_standard_error"].item() for result in results.values())
    z = _z(compared, "asymptotic_frequency") if fitted else ""
    cells = [quantity(result, W) for result in results.values()]
    rows.append(["w (rad/s)", "reference frequency", "", *cells, z])
    sizes = [f"{compared.residual_rms.sel(model=name).item():.3g}" for name in results]
    rows.append([f"left ({unit})", "RMS of record minus motion", "", *sizes, ""])
    heads = ["force", "", "formula", *results, "difference / error"]
    return text_table(heads, rows, numbers=tuple(range(3, len(heads))))


def _z(compared: xr.Dataset, label: str) -> str:
    z = compared.z.sel(quantity=label).item() if "z" in compared and label in compared.quantity else np.nan
    return f"{z:+.1f}" if np.isfinite(z) and z else ""


def driven_json(tree: xr.DataTree) -> dict[str, Any]:
    """A driven result as plain data."""
    compared = tree["comparison"].to_dataset()
    methods = {}
    for name in compared.model.values.tolist():
        result = tree[name].to_dataset()
        coefficients = {
            symbol: mapped(force, COEFFICIENT | same("unit"))
            for symbol, force in by_label(result, "force").items()
        }
        scalars = {key: number(result[key].item()) for key in (W, f"{W}_standard_error", "noise")}
        sizes = {key: number(compared[key].sel(model=name).item()) for key in RESIDUAL_SIZES}
        methods[name] = {"coefficients": coefficients, **scalars, **sizes}
    scaled = per_input(tree[compared.attrs["answer"]].to_dataset())
    rows = {} if scaled is None else by_label(scaled, "quantity")
    of_input = {k: mapped(row, same("value", "standard_error")) for k, row in rows.items()}
    said = {key: compared.attrs[key] for key in ("answer", "verdict_on_record")}
    return {**said, "methods": methods, "per_input": of_input}


def prediction_sentences(predicted: Sequence[xr.Dataset]) -> list[str]:
    """How near a free run comes to each record, its start fitted there (see `predict`)."""
    sentences = []
    for record in predicted:
        warm_up = float(record.attrs["warm_up"])
        start = f"to its first {warm_up:g} s, which do not count" if warm_up else "to all of it"
        unit = record.residual_rms.attrs["units"]
        part = 100.0 * record.residual_over_motion.item()
        sentences.append(
            f"Predicted: {record.attrs.get('source', 'record')}, its start fitted {start}: "
            f"{record.residual_rms.item():.3g} {unit} are left (RMS), {part:.2g} % of its motion."
        )
    return sentences


def prediction_json(predicted: Sequence[xr.Dataset]) -> dict[str, Any]:
    """A prediction as plain data, under `test`; nothing where nothing was predicted."""
    rows = [
        {"source": record.attrs.get("source", ""), "warm_up": record.attrs["warm_up"]}
        | mapped(record, same("residual_rms", "residual_over_motion"))
        for record in predicted
    ]
    return {"test": rows} if rows else {}


def response_blocks(response: xr.Dataset) -> list[Block]:
    """What the command `response` prints of a result of `forced_response`."""
    unit, heads = response.amplitude.attrs["units"], ["sweep", "frequency (rad/s)", "over w_inf"]
    rows = []
    for sweep in response.sweep.values.tolist():
        motions = response.sel(sweep=sweep)
        there = np.flatnonzero(motions.amplitude.notnull().values)
        if len(there):
            apart = there[np.linspace(0, len(there) - 1, PRINTED + 1).round().astype(int)]
            largest = there[int(np.argmax(motions.amplitude.values[there]))]
            rows += [
                _row(motions.isel(frequency=at), sweep) for at in sorted({*apart.tolist(), int(largest)})
            ]
    heads += [f"amplitude ({unit})", "95 % band", "phase (rad)"]
    table = text_table(heads, rows, numbers=(1, 2, 3, 4, 5))
    return [Block(table=table), Block(_sentences(response))]


def _row(motion: xr.Dataset, sweep: str) -> list[str]:
    ends = (motion.amplitude_low.item(), motion.amplitude_high.item())
    return [
        sweep,
        f"{motion.frequency.item():.5g}",
        f"{motion.frequency_ratio.item():.4f}",
        f"{motion.amplitude.item():.4g}",
        "{:.4g} to {:.4g}".format(*ends),
        f"{motion.phase.item():.3f}",
    ]


def _sentences(response: xr.Dataset) -> list[str]:
    """Sentences on how much simulations differ, and on what the bands hold."""
    off = np.abs(response.simulated_amplitude / response.check_amplitude - 1.0).values
    count, kept = len(off), int(np.sum(off <= response.left_open.item()))
    if not count:
        return ["With this drive the model has no steady motion here: friction holds it, or it grows."]
    said = (
        f"{kept} of {count} simulated motions keep their amplitude, within "
        f"{100.0 * response.left_open.item():.2g} %, which the bands hold in addition to "
        "errors of the coefficients."
    )
    caution = "Beyond the amplitudes of the record the forces may have another form."
    return [said, caution]


def response_csv(response: xr.Dataset) -> str:
    """A row for each sweep and frequency."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["sweep", "frequency_rad_s", "frequency_ratio", "unit", *RESPONSE_COLUMNS])
    for sweep in response.sweep.values.tolist():
        motions = response.sel(sweep=sweep).dropna("frequency", subset=["amplitude"])
        table = np.column_stack(
            [motions[name].values for name in ("frequency", "frequency_ratio", *RESPONSE_COLUMNS)]
        )
        unit = response.amplitude.attrs["units"]
        writer.writerows([sweep, *row[:2], unit, *row[2:]] for row in table.tolist())
    return buffer.getvalue()


def response_json(response: xr.Dataset) -> dict[str, Any]:
    """The curves as plain data, null where a sweep has no such motion."""
    curves: Sequence[str] = ("frequency", "frequency_ratio", *RESPONSE_COLUMNS)
    sweeps = {str(sweep): mapped(response.sel(sweep=sweep), same(*curves)) for sweep in response.sweep.values}
    unit = {"unit": response.amplitude.attrs["units"]}
    return unit | {"sweeps": sweeps} | mapped(response, same("left_open", *CHECKS))
