"""Driven records in words, tables and plain data: the answer, both methods, predictions, forced responses."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table

from sysid_trib.physics.si_units import MASS, STIFFNESS, per_input
from sysid_trib.printing import ALWAYS, Block, Layer
from sysid_trib.printing.equation import equation_text
from sysid_trib.printing.layout import (
    FREQUENCY_ROWS,
    KEYS,
    by_label,
    coefficient_table,
    csv_of,
    mapped,
    per_label,
    text_table,
    value_with_error,
)
from sysid_trib.printing.sureness import sureness_blocks
from sysid_trib.results.schema import library_of
from sysid_trib.results.variables import record_groups, signal_units

ERRORS = (
    "Errors: where what is left is white, by its size; else by blocks of the record (trajectory), or by "
    "rows two periods apart or the random force that stands for what the model lacks (direct). "
    "Differences are over the larger error of both."
)
DRIVEN_VERDICTS = {
    "explained": "The record is explained: what its motion leaves is white.",
    "approximate": "The model follows the record to {} (RMS); more than noise is left.",
    "not explained": "The model does not explain the record: its motion leaves {} (RMS).",
}
# Motions of the printed table in each sweep, evenly apart, beside the largest.
PRINTED = 4
CURVE_VALUES = ("frequency", "frequency_ratio", "amplitude", "amplitude_low", "amplitude_high", "phase")


def driven_blocks(tree: xr.DataTree, record: Sequence[str] = ()) -> list[Block]:
    """What is said of an identification with inputs, in its order; `record` says what was read."""
    compared, unit = tree["comparison"].to_dataset(), signal_units(tree)
    answer = compared.attrs["answer"]
    best = compared.sel(model=answer)
    remains = f"{best.residual_rms.item():.3g} {unit}, {100.0 * best.residual_over_motion.item():.2g} %"
    first = DRIVEN_VERDICTS[compared.attrs["verdict_on_record"]].format(remains)
    results = {name: tree[name].to_dataset() for name in compared.model.values.tolist()}
    others = [f"whose motion leaves less than that of {name}" for name in results if name != answer]
    why = (others or ["since no motion by the other method follows the record"])[0]
    table = _table(results, compared, unit)
    return [
        Block([first, f"The answer is {answer}'s, {why}."], ALWAYS),
        Block(record),
        Block(title="At a glance"),
        Block([ERRORS], Layer.EXPLAIN, "Forces", table),
        Block(table=table, layers=Layer.QUIET | Layer.DEFAULT),
        Block([f"Equation: {equation_text(results[answer])}."]),
        Block(_in_its_unit(results[answer], tree)),
        *sureness_blocks(tree),
    ]


def _in_its_unit(result: xr.Dataset, tree: xr.DataTree) -> list[str]:
    """Mass, stiffness and forces in the unit of the input."""
    scaled = per_input(result)
    if scaled is None:
        return []
    name, unit = scaled.attrs["input"], signal_units(tree)
    units = tree[record_groups(tree)[0]][name].attrs.get("units") or name
    of_each = {MASS: f"{units}/({unit}/s^2)", STIFFNESS: f"{units}/{unit}"}
    for force in library_of(result):
        q = force.speed_degree or 0.0
        rate = "" if not q else f"/({unit}/s)" if q == 1 else f"/({unit}/s)^{q:g}"
        of_each[force.symbol] = f"{units}{rate}"
    parts = [
        f"{what} {value_with_error(row.value.item(), row.standard_error.item())} {of_each[what]}"
        for what, row in by_label(scaled, "quantity").items()
    ]
    return [f"In the unit of the input {name}: {', '.join(parts)}."]


def _table(results: dict[str, xr.Dataset], compared: xr.Dataset, unit: str) -> Table:
    """Coefficients by both methods with their errors."""
    # Where it is held, that at vanishing amplitude is of the forces, whose differences are above.
    fitted = any(result.reference_frequency_standard_error.item() for result in results.values())
    tested = dict(compared.z.to_series()) if "z" in compared else {}
    z = {label: value if value else np.nan for label, value in tested.items()}
    for name in FREQUENCY_ROWS:
        z[name.replace("_", " ")] = z.get(name, np.nan) if fitted else np.nan
    sizes = {name: f"{compared.residual_rms.sel(model=name).item():.3g}" for name in results}
    what = {"force": f"left ({unit})", "formula": "RMS of record minus motion"}
    return coefficient_table(results, z, [what | sizes])


def driven_json(tree: xr.DataTree) -> dict[str, Any]:
    """A driven result as plain data."""
    compared = tree["comparison"].to_dataset()
    scaled = per_input(tree[compared.attrs["answer"]].to_dataset())
    return {
        **mapped(compared, {"answer": "@answer", "verdict_on_record": "@verdict_on_record"}),
        "methods": {
            name: mapped(tree[name].to_dataset(), KEYS["driven"]) | mapped(row, KEYS["driven_motion"])
            for name, row in by_label(compared, "model").items()
        },
        "per_input": {} if scaled is None else per_label(scaled, "quantity", KEYS["per_input"]),
    }


def prediction_sentences(predicted: Sequence[xr.Dataset]) -> list[str]:
    """How near a free run comes to each record, its start fitted there (see `predict`)."""
    sentences = []
    for record in predicted:
        warm_up, unit = float(record.attrs["warm_up"]), record.residual_rms.attrs["units"]
        start = f"to its first {warm_up:g} s, which do not count" if warm_up else "to all of it"
        sentences.append(
            f"Predicted: {record.attrs.get('source', 'record')}, its start fitted {start}: "
            f"{record.residual_rms.item():.3g} {unit} are left (RMS), "
            f"{100.0 * record.residual_over_motion.item():.2g} % of its motion."
        )
    return sentences


def prediction_json(predicted: Sequence[xr.Dataset]) -> dict[str, Any]:
    """A prediction as plain data, under `test`; nothing where nothing was predicted."""
    table = KEYS["prediction"] | {"source": lambda record: record.attrs.get("source", "")}
    return {"test": [mapped(record, table) for record in predicted]} if predicted else {}


def response_blocks(response: xr.Dataset) -> list[Block]:
    """What the command `response` prints of a result of `forced_response`."""
    rows = []
    for sweep, curve in by_label(response, "sweep").items():
        motions = curve.dropna("frequency", subset=["amplitude"])
        if count := motions.sizes["frequency"]:
            apart = np.linspace(0, count - 1, PRINTED + 1).round().astype(int)
            places = {*apart.tolist(), int(np.argmax(motions.amplitude.values))}
            rows += [_row(motions.isel(frequency=at), sweep) for at in sorted(places)]
    # By how much simulations differ, and what the bands hold.
    limit, ratio = response.left_open.item(), response.simulated_amplitude / response.check_amplitude
    off = np.abs(ratio - 1.0).values
    if not len(off):
        said = ["With this drive the model has no steady motion here: friction holds it, or it grows."]
    else:
        said = [
            f"{np.sum(off <= limit)} of {len(off)} simulated motions keep their amplitude, within "
            f"{100.0 * limit:.2g} %, which the bands hold in addition to errors of the coefficients.",
            "Beyond the amplitudes of the record the forces may have another form.",
        ]
    return [*([Block(table=text_table(rows, ("sweep",)))] if rows else []), Block(said)]


def _row(motion: xr.Dataset, sweep: str) -> dict[str, str]:
    return {
        "sweep": sweep,
        "frequency (rad/s)": f"{motion.frequency.item():.5g}",
        "over w_inf": f"{motion.frequency_ratio.item():.4f}",
        f"amplitude ({motion.amplitude.attrs['units']})": f"{motion.amplitude.item():.4g}",
        "95 % band": f"{motion.amplitude_low.item():.4g} to {motion.amplitude_high.item():.4g}",
        "phase (rad)": f"{motion.phase.item():.3f}",
    }


def response_csv(response: xr.Dataset) -> str:
    """A row for each sweep and frequency."""
    columns = ("frequency_rad_s", *CURVE_VALUES[1:])
    rows = []
    for sweep, curve in by_label(response, "sweep").items():
        motions = curve.dropna("frequency", subset=["amplitude"])
        words = {"sweep": sweep, "unit": response.amplitude.attrs["units"]}
        table = zip(*(motions[name].values.tolist() for name in CURVE_VALUES), strict=True)
        rows += [words | dict(zip(columns, values, strict=True)) for values in table]
    return csv_of(["sweep", *columns[:2], "unit", *columns[2:]], rows)


def response_json(response: xr.Dataset) -> dict[str, Any]:
    """The curves as plain data, null where a sweep has no such motion."""
    return mapped(response, KEYS["response"])
