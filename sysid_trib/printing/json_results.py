"""Results of `cross_check`, `compare` and `discover` as plain data for JSON: tables of keys."""

import json
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.likelihood.random_force import random_force_of
from sysid_trib.physics.si_units import MU, SI, si_of
from sysid_trib.printing.discovery_tables import steps_of
from sysid_trib.printing.identification import consequences
from sysid_trib.printing.layout import (
    KEYS,
    Source,
    mapped,
    number,
    per_label,
    records_json,
)
from sysid_trib.printing.physics import physics_json
from sysid_trib.printing.verdict import GROUP
from sysid_trib.records.decay import RECORD_PARTS, root_mean_square
from sysid_trib.results import effects
from sysid_trib.results.variables import group_names, record_groups
from sysid_trib.validation import findings
from sysid_trib.validation.verdict import p_value_of_dependence

# Keys of the JSON where they differ from the names of the variables.
SPAN_KEYS = {"residual_over_noise": "gap_over_noise"}
SPANS = KEYS["spans"] | {
    "parts": lambda spans: ", ".join(spans.attrs["parts"]),
    "spans": lambda spans: {
        SPAN_KEYS.get(str(name), str(name)): number(column.values.tolist())
        for name, column in spans.data_vars.items()
        if column.dims == ("span",)
    },
}
DISCOVERY: dict[str, Source] = KEYS["discover"] | {
    "disagreement": ("discrepancy", SPANS),
    "steps": lambda tree: [_step(tree, at, step) for at, step in enumerate(steps_of(tree))],
    "converged": lambda tree: tree.attrs["converged"] == "True",
    "closing_effect": lambda tree: tree.attrs.get("closing_effect") or None,
    "not_improving": lambda tree: tree.attrs.get("not_improving") or None,
    "noise_p_value": lambda tree: number(float(tree.attrs.get("noise_p_value", "nan"))),
    "noise": lambda tree: number(findings.record_noise(tree)),
    "residual_noise": lambda tree: number(findings.record_noise(tree)),
    "residual": lambda tree: number(findings.residual_of(tree, "after")),
    "disagreement_after": ("discrepancy_after", SPANS),
    "generic_p_value": lambda tree: number(tree["omnibus"].p_value.values[-1].item()),
    "error_widening": lambda tree: number(effects.error_widening(tree)),
    "not_testable": ("detectability_after", lambda candidates: _reasons(candidates)),
    "options": lambda tree: json.loads(tree.attrs["options"]),
}


def identification_json(tree: xr.DataTree) -> dict[str, Any]:
    """A result of `cross_check` as plain data, see `identification_blocks`."""
    checked, failed, answer = (
        tree["comparison"].to_dataset(),
        findings.failures(tree),
        findings.answer_of(tree),
    )
    si, methods, models = si_of(tree), {}, {}
    held_out = {"held_out_rms": lambda result: number(float(result.get("held_out_rms", np.nan)))}
    table = KEYS["identification"] | held_out
    withheld = dict.fromkeys(table) | {"coefficients": {}}
    for name in (checked.attrs["first"], checked.attrs["second"]):
        given = (
            withheld if name in failed else mapped(findings.with_error_parts(tree[name].to_dataset()), table)
        )
        methods[name] = given | {"failed": failed.get(name, "")}
        models[name] = mapped(checked.sel(model=name), KEYS["motion"]) | {
            "residual_rms": number(findings.residual_of(tree, name)),
            "residual_over_noise": number(findings.residual_over_noise(tree, name)),
        }
    if findings.holds(tree):
        result, at = tree[answer].to_dataset(), findings.times_of_amplitudes(tree)
        follows = physics_json(result, findings.amplitudes(tree), si, time=at)
    else:
        follows = {"refused": consequences(tree)[0]}
    data = {
        **records_json(tree),
        **random_force_json(tree),
        "answer": None if answer in failed else answer,
        "methods": methods,
        "cross_check": mapped(checked, KEYS["cross_check"])
        | {"models": models, "noise": findings.record_noise(tree)}
        | checked.attrs,
        "consequences": follows,
        "sufficient_forces": [
            {s: {"value": value, "standard_error": error} for s, (value, error) in forces.items()}
            for forces in findings.fewer_forces(tree)
        ],
    }
    if "runs" in tree:
        data["runs"] = runs_json(tree["runs"].to_dataset())
    if si is not None:
        friction = {MU: f"{MU}±"} if MU in si else {}
        data[SI] = per_label(si, "force", KEYS["si"] | friction)
    return data


def random_force_json(tree: xr.DataTree) -> dict[str, Any]:
    """`verdict`, `random_force` and `innovations` as plain data; None where there is no random force."""
    result = findings.second_of(tree)
    data: dict[str, Any] = {"verdict": findings.verdict_of(tree), "random_force": None, "innovations": None}
    force = random_force_of(result)
    if not force:
        return data
    tested = tree["random_force"].to_dataset() if "random_force" in tree.children else None
    data["random_force"] = {
        "density": force.density,
        "standard_error": number(force.standard_error),
        "relative": force.relative(float(result.reference_frequency)),
        "p_value": number(force.p_value),
        "dependence_p_value": None if tested is None else number(p_value_of_dependence(tested)),
        "density_p_value": None if tested is None else number(float(tested.density_p_value.min())),
    }
    groups = group_names("innovations", len(record_groups(tree)))
    if followed := [tree[group].to_dataset() for group in groups if group in tree.children]:
        # Of runs whose lengths differ, records too short for all lags have fewer.
        lags = min(run.sizes["lag"] for run in followed)
        correlations = [run.autocorrelation.values[:lags] for run in followed]
        data["innovations"] = {
            "rms": root_mean_square([run.innovation_rms.item() for run in followed]),
            "autocorrelation": np.mean(correlations, axis=0).tolist(),
        }
    return data


def runs_json(runs: xr.Dataset) -> dict[str, Any]:
    """The test of runs of one experiment as plain data."""
    densities = {"random_force": KEYS["densities"]} if "density_verdict" in runs.attrs else {}
    return mapped(runs, KEYS["runs"] | densities)


def discovery_json(tree: xr.DataTree) -> dict[str, Any]:
    """A result of `discover` as plain data."""
    several = {"run_differences": (GROUP, KEYS["run_differences"])} if GROUP in tree.children else {}
    return records_json(tree) | mapped(tree, DISCOVERY | several)


def _step(tree: xr.DataTree, at: int, step: xr.Dataset) -> dict[str, Any]:
    """An effect with what it cannot be separated from, on what was held out, and in parts of the record."""
    held, offered = number(tree["holdout"].rms.values.tolist()), effects.candidates_of(tree)
    probabilities = {
        s: number(round(probability, 4)) for s, probability in effects.credible_set(step).items()
    }
    likeliest = step.likeliest_in_parts.item().split(effects.PAIRS)
    pairs = effects.replacing_pairs(step)
    computed = {
        "shapes": effects.shapes_of(step, step.symbol.item()),
        "shape_errors": effects.shapes_of(step, step.symbol.item(), "shape_standard_error"),
        "indistinguishable_pairs": [pair.split(effects.PAIR) for pair in pairs],
        "pair_odds": number(step.pair_odds.item()) if pairs else None,
        "probability_of_chance": number(round(step.chance_probability.item(), 4)),
    }
    known = mapped(step, {key: source for key, source in KEYS["step"].items() if key not in computed})
    return {key: (known | computed)[key] for key in KEYS["step"]} | {
        "probability": probabilities.pop(step.symbol.item()),
        "holdout_before": held[at],
        "holdout_after": held[at + 1],
        "stands_in": int(step.stands_in),
        "parts": len(likeliest),
        "likeliest_in": dict(zip(RECORD_PARTS, likeliest, strict=True)),
        "indistinguishable_from": [
            {"symbol": s, "name": offered[s].name, "formula": offered[s].formula.text, "probability": p}
            for s, p in probabilities.items()
        ],
    }


def _reasons(candidates: xr.Dataset) -> dict[str, str]:
    """Why candidates cannot be tested, of those that cannot."""
    return {s: reason for s, reason in per_label(candidates, "candidate", "reason").items() if reason}


def comparison_json(tree: xr.DataTree) -> dict[str, Any]:
    """A result of `compare` as plain data."""
    table, groups = tree["comparison"].to_dataset(), record_groups(tree)
    several = len(groups) > 1
    starts = [number(tree[group].holdout_start.item()) for group in groups]
    data = {
        **records_json(tree),
        "holdout_start": starts[0],
        **mapped(table, {name: name for name in ("common_frequency", "noise")}),
        **table.attrs,
        "methods": per_label(table, "method", KEYS["compare"] | (KEYS["compare_runs"] if several else {})),
    }
    if several:
        data |= {"holdout_starts": starts, **mapped(table, {"run_noises": "run_noise"})}
    return data
