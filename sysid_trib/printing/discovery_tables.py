"""A discovery as a table and as plain data for JSON."""

import json
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.printing.homogeneity import homogeneity_json
from sysid_trib.printing.layout import number, text_table
from sysid_trib.printing.residual import noise_of, residual_of
from sysid_trib.results.discoveries import added_effects, candidates_of, credible_set, shapes_of
from sysid_trib.results.per_run import record_groups

if TYPE_CHECKING:
    from rich.table import Table

# Candidates in the table: the strongest in any scan, and those in the last.
ROWS = 10
LAST = 3
RANKING = "Named and strongest candidates, |z| before each step and at the end (-: in the model, or untested)"
NUMBERS = ("coefficient", "standard_error", "z", "p_value", "residual_before", "residual_after")
# Keys of the JSON where they differ from the names of the variables.
SPANS = {"residual_over_noise": "gap_over_noise"}
WORDS = ("symbol", "name", "formula", "family", "kind", "unit")


def ranking_table(tree: xr.DataTree) -> "Table":
    """|z| of named and best candidates before each step and after the last; those in the model have none."""
    found = tree["ranking"].to_dataset()
    named = [symbol for symbol in added_effects(tree) if symbol in found.candidate]
    last = strongest(found.isel(selection_step=[-1]), LAST)
    chosen = list(dict.fromkeys([*named, *strongest(found, ROWS), *last]))
    count = found.sizes["selection_step"]
    heads = ["candidate", "name", *(f"step {at + 1}" for at in range(count - 1)), "end"]
    rows = []
    for symbol in chosen:
        one = found.sel(candidate=symbol)
        cells = [f"{abs(z):.3g}" if np.isfinite(z) else "-" for z in one.z.values]
        rows.append([symbol, one["name"].item(), *cells])
    rows.append(["threshold", "", *(f"{z:.3g}" for z in found.threshold.values)])
    return text_table(heads, rows, whole=(0,), numbers=tuple(range(2, count + 2)))


def strongest(found: xr.Dataset, count: int) -> list[str]:
    """Candidates of the highest |z| in any scan, by that of the first."""
    size = np.nan_to_num(np.abs(found.z.values), nan=-1.0)
    order = np.argsort(-size.max(axis=0), kind="stable")[:count].tolist()
    chosen = [i for i in order if size[:, i].max() >= 0.0]
    return [str(found.candidate.values[i]) for i in sorted(chosen, key=lambda i: -size[0, i])]


def discovery_json(tree: xr.DataTree) -> dict[str, Any]:
    """The result as plain data; residuals are RMS in rad, non-finite numbers are None."""
    records = [
        {k: v for k, v in tree[group].attrs.items() if isinstance(v, str | int | float)}
        for group in record_groups(tree)
    ]
    held, generic = tree["holdout"].to_dataset(), tree["omnibus"].to_dataset()
    forecast = tree["detectability_after"].to_dataset()
    found: dict[str, Any] = {
        "record": records[0],
        "disagreement": _disagreement(tree["discrepancy"].to_dataset()),
        "steps": [_step(tree, at) for at in range(tree["steps"].attrs["count"])],
        "verdict": tree.attrs["verdict"],
        "noise": number(noise_of(tree)),
        "residual": number(residual_of(tree, "after")),
        "model": _model(tree["after"].to_dataset()),
        "start_model": _model(tree["before"].to_dataset()),
        "disagreement_after": _disagreement(tree["discrepancy_after"].to_dataset()),
        "holdout": {
            "what": tree.attrs["held_out"],
            "rms": [number(x) for x in held.rms.values.tolist()],
            "gap_above_noise": [number(x) for x in held.residual_above_noise.values.tolist()],
        },
        "generic_p_value": number(float(generic.p_value.values[-1])),
        "detectable": {
            s: number(forecast.detectable.sel(candidate=s).item()) for s in forecast.candidate.values.tolist()
        },
        "not_testable": {
            s: r
            for s, r in zip(forecast.candidate.values.tolist(), forecast.reason.values.tolist(), strict=True)
            if r
        },
        **{key: list(tree.attrs[key]) for key in ("left_out", "failed_fits")},
        "options": json.loads(tree.attrs["options"]),
    }
    return found | homogeneity_json(tree) | ({"records": records} if len(records) > 1 else {})


def _disagreement(found: xr.Dataset) -> dict[str, Any]:
    spans = {
        SPANS.get(str(name), str(name)): [number(x) for x in column.values.tolist()]
        for name, column in found.data_vars.items()
        if column.dims == ("span",)
    }
    return {
        "departure_time": number(found.departure_time.item()),
        "departure_run": found.departure_run.item(),
        "parts": ", ".join(found.attrs["parts"]),
        "where": found.attrs["where"],
        "spans": spans,
    }


def _step(tree: xr.DataTree, at: int) -> dict[str, Any]:
    step = tree["steps"].to_dataset().isel(step=at)
    offered = candidates_of(tree)
    held = tree["holdout"].rms.values
    likely = {symbol: number(round(probability, 4)) for symbol, probability in credible_set(step).items()}
    symbol = step.symbol.item()
    return {
        **{name: step[name].item() for name in WORDS},
        **{name: number(step[name].item()) for name in NUMBERS},
        "shapes": {k: number(v) for k, v in shapes_of(step, symbol).items()},
        "probability": likely.pop(symbol),
        "indistinguishable_from": [
            {
                "symbol": other,
                "name": offered[other].name,
                "formula": offered[other].formula.text,
                "probability": probability,
            }
            for other, probability in likely.items()
        ],
        "holdout_before": number(float(held[at])),
        "holdout_after": number(float(held[at + 1])),
        "worsens_holdout": bool(step.worsens_holdout.item()),
        "leans": bool(step.collinear.item()),
    }


def _model(result: xr.Dataset) -> dict[str, Any]:
    each = zip(result.coefficient.values.tolist(), result.standard_error.values.tolist(), strict=True)
    coefficients = {
        symbol: {"value": number(value), "standard_error": number(error)}
        for symbol, (value, error) in zip(result.force.values.tolist(), each, strict=True)
    }
    scalars = {
        name: number(result[name].item())
        for frequency in ("reference_frequency", "asymptotic_frequency")
        for name in (frequency, f"{frequency}_standard_error")
    }
    shapes = {}
    if "shape" in result:
        shapes = {
            name: {"value": number(value), "standard_error": number(error)}
            for name, value, error in zip(
                result.shape_parameter.values.tolist(),
                result["shape"].values.tolist(),
                result.shape_standard_error.values.tolist(),
                strict=True,
            )
        }
    return {"coefficients": coefficients, **scalars, "shapes": shapes}
