"""Driven records, forced responses and plans of runs, as sentences, tables and plain data."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from sysid_trib.forces.symmetry import as_factor
from sysid_trib.printing import ALWAYS, Block, Layer, layout
from sysid_trib.printing.equation import equation_text
from sysid_trib.printing.sureness import sureness_blocks
from sysid_trib.records.roles import constants_of
from sysid_trib.results.kinds import MASS, PER_INPUT, REFITTED_SENSORS, STIFFNESS
from sysid_trib.results.models import library_of
from sysid_trib.results.variables import record_groups, signal_units

ERRORS = (
    "Standard errors follow from the size of the residual if it is white. If a random force explains the "
    "record, they follow from both noises, and from the bias of the input coefficient if that force is noise "
    "of the measured input. Otherwise they follow from blocks of the record (trajectory) or rows two periods "
    "apart (direct), and from the distance to the fit with a random force. Differences are divided by the "
    "larger error of both."
)
DRIVEN_VERDICTS = {
    "explained": "The model explains the record: the residual is white.",
    "explained with a random force": (
        "The model explains the record with a random force, such as noise of the measured input: the "
        "one-step prediction errors are white. The residual of the free motion is {} (RMS)."
    ),
    "approximate": "The model is approximate: the residual is {} (RMS), which is more than noise.",
    "not explained": "The model does not explain the record: the residual is {} (RMS).",
    "undetermined": "The record does not determine the forces: no coefficient differs from zero. The "
    "residual is {} (RMS).",
}
# A coefficient below this multiple of its error may be zero.
SIGNIFICANT = 2.0
BEYOND = "Beyond the amplitudes of the record the forces may have a different form."
NO_MOTION = "With this drive the model has no steady motion at these frequencies: it sticks, or it grows."
# Number of rows in the printed table of each sweep, evenly spaced, in addition to the largest motion.
PRINTED = 4
CURVE_VALUES = ("frequency_ratio", "amplitude", "amplitude_low", "amplitude_high", "phase")


def driven_blocks(tree: xr.DataTree, record: Sequence[str] = ()) -> list[Block]:
    """Return the blocks of an identification with inputs; `record` describes the record."""
    compared, unit = tree["judged"].to_dataset(), signal_units(tree)
    answer = compared.attrs["preferred"]
    best = compared.sel(model=answer)
    remains = f"{best.residual_rms.item():.3g} {unit}, {100.0 * best.residual_over_motion.item():.2g} %"
    first = DRIVEN_VERDICTS[compared.attrs["verdict"]].format(remains)
    results = {name: tree[name].to_dataset() for name in compared.model.values.tolist()}
    others = [name for name in results if name != answer]
    why = f"its residual is smaller than that of {others[0]}" if others else ""
    if others and compared.attrs["verdict"] == "explained with a random force":
        why = "it does not need a free motion that follows the record"
    own = results[answer].attrs.get("compared_in", "")
    if own and not others:
        why = f"it is fitted to the {own} itself"
    why = why or "the motion of the other method does not follow the record"
    # If the reference is fixed, the asymptotic frequency follows from the forces, whose differences are
    # above.
    fitted = any(result.reference_frequency_standard_error.item() for result in results.values())
    tested = dict(tree["agreement"].z.to_series()) if "agreement" in tree.children else {}
    z = {label: value if value else np.nan for label, value in tested.items()}
    for name in layout.FREQUENCY_ROWS:
        z[name.replace("_", " ")] = z.get(name, np.nan) if fitted else np.nan
    sizes = {name: f"{compared.residual_rms.sel(model=name).item():.3g}" for name in results}
    over = ("", " over w", " over w^2")[int(tree[record_groups(tree)[0]].attrs.get("integrations", 0))]
    compared_with = f"RMS of {own}{over} minus motion" if own else "RMS of record minus motion"
    what = {"force": f"residual ({unit})", "formula": compared_with}
    table = layout.coefficient_table(results, z, [what | sizes])
    return [
        Block([first, f"Preferred method: {answer} ({why}).", *_negative_damping(results[answer])], ALWAYS),
        Block(_not_separated(tree), ALWAYS),
        Block(record),
        _constants_block(tree),
        Block(title="At a glance"),
        Block([ERRORS], Layer.EXPLAIN, "Forces", table),
        Block(table=table, layers=Layer.QUIET | Layer.DEFAULT),
        Block([f"Equation: {equation_text(results[answer])}."]),
        Block(_in_its_unit(results[answer], tree)),
        *sureness_blocks(tree),
    ]


def _negative_damping(result: xr.Dataset) -> Iterator[str]:
    """State that the damping ratio is negative, so that the model adds energy to the motion."""
    for symbol in library_of(result).damping_factors:
        of_force = result.sel(force=symbol)
        value, error = of_force.coefficient.item(), of_force.standard_error.item()
        if value >= 0.0:
            continue
        said = f"The damping is negative: {symbol} = {layout.value_with_error(value, error)}"
        if value > -SIGNIFICANT * error:
            yield f"{said}, but not significantly; --bound {symbol}=0: excludes it."
        else:
            yield (
                f"{said}, as if the motion gained energy. Check whether the input is delayed (offer "
                f"gain_delay) or friction is missing, or exclude it: --bound {symbol}=0:."
            )


def _not_separated(tree: xr.DataTree) -> list[str]:
    """Name the parameters that the motions cannot separate."""
    if "identifiability" not in tree.children:
        return []
    return str(tree["identifiability"].attrs["sentences"]).splitlines()


def _constants_block(tree: xr.DataTree) -> Block:
    """Return a table of the known constants, one row per run; empty if there are none."""
    groups = record_groups(tree)
    rows = {name: constants_of(tree[name].to_dataset()) for name in groups}
    if not any(rows.values()):
        return Block()
    names = list(dict.fromkeys(name for row in rows.values() for name in row))
    cells = [
        {"run": str(tree[group].attrs.get("source", group))}
        | {name: f"{row[name]:g}" for name in names if name in row}
        for group, row in rows.items()
    ]
    return Block(table=layout.text_table(cells, ["run"]), caption="Known constants of the runs:")


def _in_its_unit(result: xr.Dataset, tree: xr.DataTree) -> list[str]:
    """Return the mass, stiffness and forces in the unit of the input."""
    if PER_INPUT not in tree.children:
        return []
    scaled = tree[PER_INPUT].to_dataset()
    name, unit = scaled.attrs["input"], signal_units(tree)
    units = tree[record_groups(tree)[0]][name].attrs.get("units") or name
    own = as_factor(unit)
    of_each = {MASS: f"{units}/({own}/s^2)", STIFFNESS: f"{units}/{own}"}
    for force in library_of(result):
        q = force.speed_degree or 0.0
        rate = "" if not q else f"/({own}/s)" if q == 1 else f"/({own}/s)^{q:g}"
        of_each[force.symbol] = f"{units}{rate}"
    parts = [
        f"{what} {layout.value_with_error(row.value.item(), row.standard_error.item())} {of_each[what]}"
        for what, row in layout.by_label(scaled, "quantity").items()
    ]
    return [f"In the unit of the input {name}: {', '.join(parts)}."]


def driven_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return a driven result as plain data."""
    has_unit = PER_INPUT in tree.children
    compared = tree["judged"].to_dataset()
    return {
        "verdict": compared.attrs["verdict"],
        "answer": compared.attrs["preferred"],
        "methods": {
            name: layout.mapped(tree[name].to_dataset(), "driven") for name in compared.model.values.tolist()
        },
        **layout.judged_json(tree),
        "per_input": layout.mapped(tree[PER_INPUT].to_dataset(), "per_input") if has_unit else {},
    }


def prediction_block(predicted: Sequence[xr.Dataset]) -> Block:
    """Return the residuals of predicted records, whose starts are fitted (see `predict`)."""
    sentences = []
    for record in predicted:
        warm_up, unit = float(record.attrs["warm_up"]), record.residual_rms.attrs["units"]
        start = f"fitted to its first {warm_up:g} s (not counted)" if warm_up else "fitted to all of it"
        start = "as measured" if record.attrs.get("starts") == "measured" else start
        ratio = record.residual_over_motion.item()
        of_motion = f", {100.0 * ratio:.2g} % of its motion" if math.isfinite(ratio) else ""
        sentences.append(
            f"Prediction of {record.attrs.get('source', 'record')}, with its start {start}: residual "
            f"{record.residual_rms.item():.3g} {unit} (RMS){of_motion}."
        )
        if terms := record.attrs.get(REFITTED_SENSORS):
            sentences.append(f"The errors of its sensor ({terms}) were fitted to this record too.")
        if note := record.attrs.get("note"):
            sentences.append(f"{note}.")
    return Block(sentences, ALWAYS)


def prediction_json(predicted: Sequence[xr.Dataset]) -> dict[str, Any]:
    """Return a prediction as plain data, at the key `test`; empty if nothing was predicted."""
    rows = []
    for record in predicted:
        row = layout.mapped(record, "prediction", {"source": record.attrs.get("source", "")})
        said = {name: record.attrs.get(name, "") for name in ("note", REFITTED_SENSORS)}
        rows.append(row | {name: text for name, text in said.items() if text})
    return {"test": rows} if rows else {}


def response_blocks(response: xr.Dataset) -> Iterator[Block]:
    """Return the blocks of the command `response`."""
    rows = []
    for sweep, curve in layout.by_label(response, "sweep").items():
        motions = curve.dropna("frequency", subset=["amplitude"])
        if count := motions.sizes["frequency"]:
            apart = np.linspace(0, count - 1, PRINTED + 1).round().astype(int)
            places = {*apart.tolist(), int(np.argmax(motions.amplitude.values))}
            rows += [_row(motions.isel(frequency=at), sweep) for at in sorted(places)]
    # Difference from the simulated motions, which the bands include.
    limit, ratio = response.left_open.item(), response.simulated_amplitude / response.check_amplitude
    off = np.abs(ratio - 1.0).values
    keep = (
        f"{np.sum(off <= limit)} of {len(off)} simulated motions have the computed amplitude "
        f"within {100.0 * limit:.2g} %. The bands include this and the errors of the coefficients."
    )
    if rows:
        yield Block(table=layout.text_table(rows, ("sweep",)))
    yield Block([keep, BEYOND] if len(off) else [NO_MOTION])


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
    """Return a row for each sweep and frequency."""
    table = response[[*CURVE_VALUES]].to_dataframe(dim_order=["sweep", "frequency"]).reset_index()
    table = table.dropna(subset="amplitude").rename(columns={"frequency": "frequency_rad_s"})
    rows = table.assign(unit=response.amplitude.attrs["units"]).to_dict("records")
    return layout.csv_of(["sweep", "frequency_rad_s", CURVE_VALUES[0], "unit", *CURVE_VALUES[1:]], rows)


# Number of runs in the table, and the head of one of its columns.
MOST_RUNS, DURATION = 8, "duration (s)"
PLAN_CAPTION = "Runs within the limits (--amplitude, --duration), the best first"


def plan_blocks(data: xr.Dataset) -> list[Block]:
    """Return the blocks of a plan of runs."""
    rows = _rows(data)
    said = [*_next_run(data, data.sizes["run"] - len(rows))]
    table = layout.text_table(rows[:MOST_RUNS])
    return [Block(said, ALWAYS), Block((), ALWAYS, table=table, caption=PLAN_CAPTION)]


def _next_run(data: xr.Dataset, equal: int) -> Iterator[str]:
    """Describe the best run, its expected information, and the number of omitted equivalent runs."""
    best, unit, repeats = data.isel(run=0), data.amplitude.attrs["units"], int(data.attrs["repeats"])
    run = f"Release at {_size(best)} {unit} and record {best.duration.item():.3g} s"
    run += f", {repeats} times" if repeats > 1 else ""
    models, wanted = list(np.atleast_1d(data.attrs["models"])), data.wanted.to_series().dropna().to_dict()
    if len(models) > 1:
        yield (
            f"{run}: the right one of {', '.join(models[:-1])} and {models[-1]} will then have odds of "
            f"{data.attrs['odds']:g} to 1 against each other model, with probability "
            f"{best.probability.item():.2f}."
        )
    if wanted or len(models) == 1:
        parts = [
            f"{symbol} {best.standard_error.sel(force=symbol).item():.2g} "
            f"(now {data.stated_error.sel(force=symbol).item():.2g})"
            for symbol in [*wanted] or data.force.values.tolist()
        ]
        yield f"{run}. Standard errors from all records together: {', '.join(parts)}."
    errors = data.error_of_model.to_series()
    if errors.any():
        listed = ", ".join(f"{symbol} {error:.2g}" for symbol, error in errors.items())
        yield f"The model error ({listed}) is included; more data cannot reduce it."
    if wanted and not best.meets.item():
        asked = ", ".join(f"{symbol} ± {limit:g}" for symbol, limit in wanted.items())
        yield f"No run within the limits reaches {asked}; widen them, or repeat the run."
    if equal:
        runs = f"{equal} longer run{'s' if equal > 1 else ''}"
        yield f"Not shown: {runs} with the same numbers as a shorter one."


def _size(run: xr.Dataset) -> str:
    """Return the release of a run with three digits; also micrometres are without a power of ten."""
    return np.format_float_positional(run.amplitude.item(), 3, fractional=False, trim="-")


def _rows(data: xr.Dataset) -> list[dict[str, str]]:
    """Return the table rows of runs: release, duration, and expected information."""
    release, several, rows = (
        f"release ({data.amplitude.attrs['units']})",
        np.size(data.attrs["models"]) > 1,
        [],
    )
    units = dict(zip(data.force.values.tolist(), data.unit.values.tolist(), strict=True))
    heads = [layout.name_and_unit(f"error of {symbol}", unit) for symbol, unit in units.items()]
    for run in layout.by_label(data, "run").values():
        row = {release: _size(run), DURATION: f"{run.duration.item():.3g}"}
        if several:
            row |= {"probability": f"{run.probability.item():.2f}", "entropy": f"{run.entropy.item():.3f}"}
        errors = (f"{error:.2g}" for error in run.standard_error.values)
        rows.append(row | dict(zip(heads, errors, strict=True)))
    # Of runs with the same numbers, the shorter one is kept, which comes first.
    table = pd.DataFrame(rows)
    return list(table.drop_duplicates(table.columns.drop([release, DURATION])).to_dict("records"))


def plan_json(data: xr.Dataset) -> dict[str, Any]:
    """Return a plan as plain data, all runs."""
    models = dict(zip(data.attrs["models"], data.attrs["probabilities"], strict=True))
    return {"models": models, "odds": data.attrs["odds"], "runs": list(layout.mapped(data, "plan").values())}
