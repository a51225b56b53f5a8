"""A discovery as plain data for JSON."""

import json
from typing import Any

import xarray as xr

from sysid_trib.printing.layout import (
    by_label,
    coefficient_json,
    number,
    numbers,
    quantity_json,
    records_json,
)
from sysid_trib.printing.residual import noise_of, residual_of
from sysid_trib.printing.runs import homogeneity_json
from sysid_trib.printing.stability import stability_json
from sysid_trib.results.discoveries import (
    PAIR,
    candidates_of,
    credible_set,
    error_widening,
    pairs_in_place,
    shapes_of,
)

STEP_NUMBERS = ("coefficient", "standard_error", "z", "p_value", "residual_before", "residual_after")
STEP_WORDS = ("symbol", "name", "formula", "family", "kind", "unit")
# Keys of the JSON where they differ from the names of the variables.
SPAN_KEYS = {"residual_over_noise": "gap_over_noise"}


def discovery_json(tree: xr.DataTree) -> dict[str, Any]:
    """The result as plain data; residuals are RMS in rad, non-finite numbers are None."""
    held, candidates = tree["holdout"].to_dataset(), tree["detectability_after"].to_dataset()
    return {
        **records_json(tree),
        "disagreement": _spans_json(tree["discrepancy"].to_dataset()),
        "steps": [_step_json(tree, at) for at in range(tree["steps"].attrs["count"])],
        "verdict": tree.attrs["verdict"],
        "converged": tree.attrs["converged"] == "True",
        "closing_effect": tree.attrs.get("closing_effect") or None,
        "not_improving": tree.attrs.get("not_improving") or None,
        "noise_p_value": number(float(tree.attrs.get("noise_p_value", "nan"))),
        "noise": number(noise_of(tree)),
        "residual_noise": number(noise_of(tree)),
        "noise_with_its_colour": number(tree["holdout"].residual_noise.item()),
        "residual": number(residual_of(tree, "after")),
        "model": _model_json(tree["after"].to_dataset()),
        "start_model": _model_json(tree["before"].to_dataset()),
        "disagreement_after": _spans_json(tree["discrepancy_after"].to_dataset()),
        "holdout": {
            "what": tree.attrs["held_out"],
            "rms": number(held.rms.values.tolist()),
            "gap_above_noise": number(held.residual_above_noise.values.tolist()),
        },
        "generic_p_value": number(tree["omnibus"].p_value.values[-1].item()),
        "error_widening": number(error_widening(tree)),
        "detectable": {s: number(value) for s, value in candidates.detectable.to_series().items()},
        "not_testable": {s: reason for s, reason in candidates.reason.to_series().items() if reason},
        **{key: list(tree.attrs[key]) for key in ("left_out", "failed_fits")},
        "options": json.loads(tree.attrs["options"]),
        **homogeneity_json(tree),
    }


def _spans_json(spans: xr.Dataset) -> dict[str, Any]:
    names = [str(name) for name, column in spans.data_vars.items() if column.dims == ("span",)]
    return {
        **numbers(spans, ["departure_time"]),
        "departure_run": spans.departure_run.item(),
        "parts": ", ".join(spans.attrs["parts"]),
        "where": spans.attrs["where"],
        "spans": {SPAN_KEYS.get(name, name): values for name, values in numbers(spans, names).items()},
    }


def _step_json(tree: xr.DataTree, at: int) -> dict[str, Any]:
    step, offered = tree["steps"].to_dataset().isel(step=at), candidates_of(tree)
    held = number(tree["holdout"].rms.values.tolist())
    probabilities = {s: number(round(probability, 4)) for s, probability in credible_set(step).items()}
    symbol, pairs = step.symbol.item(), pairs_in_place(step)
    errors = shapes_of(step, symbol, "shape_standard_error")
    return {
        **{name: step[name].item() for name in STEP_WORDS},
        **numbers(step, STEP_NUMBERS),
        "p_value": number(step.p_value.item()),
        "shapes": {name: number(value) for name, value in shapes_of(step, symbol).items()},
        "shape_errors": {name: number(value) for name, value in errors.items()},
        "probability": probabilities.pop(symbol),
        "indistinguishable_from": [
            {
                "symbol": other,
                "name": offered[other].name,
                "formula": offered[other].formula.text,
                "probability": probability,
            }
            for other, probability in probabilities.items()
        ],
        "indistinguishable_pairs": [pair.split(PAIR) for pair in pairs],
        "pair_odds": number(step.pair_odds.item()) if pairs else None,
        "holdout_before": held[at],
        "holdout_after": held[at + 1],
        "worsens_holdout": bool(step.worsens_holdout.item()),
        **stability_json(step),
        **numbers(step, ("gain", "prediction_z", "random_force_before", "random_force_after")),
        "probability_of_chance": number(round(step.chance_probability.item(), 4)),
        "leans": bool(step.collinear.item()),
    }


def _model_json(result: xr.Dataset) -> dict[str, Any]:
    names = [n for f in ("reference_frequency", "asymptotic_frequency") for n in (f, f"{f}_standard_error")]
    forces = by_label(result, "force")
    shapes = by_label(result, "shape_parameter") if "shape" in result else {}
    return {
        "coefficients": {s: coefficient_json(force) for s, force in forces.items()},
        **numbers(result, names),
        "shapes": {name: quantity_json(shape, "shape") for name, shape in shapes.items()},
    }
