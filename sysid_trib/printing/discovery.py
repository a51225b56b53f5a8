"""Blocks of a discovery: residuals, missing effects, detectable effects; and its plain data."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.forces.force import Force
from sysid_trib.printing import ALWAYS, Block, Layer, discovery_tables as tables, layout
from sysid_trib.printing.discovery_verdict import verdict_sentences
from sysid_trib.printing.verdict import GROUP, step_heterogeneity_sentences
from sysid_trib.results import effects
from sysid_trib.results.judged import (
    LARGE,
    given_results,
    has_unknown_effect,
    record_noise,
    residual_of,
    verdict_of,
)
from sysid_trib.results.variables import signal_units

# Largest number of named competing effects, the most probable ones, and of pairs of them; a file has all.
COMPETING, COMPETING_PAIRS = 10, 3
# Odds at which the less probable of two is outside of their 95 % credible set.
OUTSIDE_OF_SET = 19.0
DIFFER, MISSING, REMAINS = "Residual of the start model", "Missing effects", "Residual of the final model"
CANDIDATES, SHOWS = "Models and candidates", "Detectable effects"
PARTS_CAPTION = "Record minus model, in components: the largest value, its time, values at two amplitudes"


def discovery_blocks(tree: xr.DataTree, sources: Sequence[str] = ()) -> list[Block]:
    """Return the blocks of a result of `discover`; `sources` describe the records."""
    (verdict, *sentences), details = verdict_sentences(tree), Layer.EXPLAIN
    remarks = [line for at, step in enumerate(effects.steps_taken(tree)) for line in _remarks(tree, at, step)]
    held = (
        "Effects in the order in which they were added. Residuals over the noise, before to after: on the "
        f"fitted part (fitted) and on {tree.attrs['held_out']} (held out)"
    )
    after, remains = "discrepancy_after", has_unknown_effect(tree)
    parts = tables.residual_table(tree, after) if remains else None
    return [
        Block([verdict], ALWAYS),
        Block(sources),
        Block((), Layer.QUIET | Layer.DEFAULT, table=tables.effects_table(tree), caption=held),
        Block([*remarks, *sentences], Layer.DEFAULT),
        Block(sentences, details),
        Block(title="At a glance"),
        Block([*_start(tree)], details, DIFFER, tables.residual_table(tree, "discrepancy"), PARTS_CAPTION),
        Block((), details, MISSING, tables.effects_table(tree, details=True), held),
        Block(remarks, details, MISSING),
        Block((), details, CANDIDATES, layout.coefficient_table(given_results(tree)), "Coefficients"),
        Block((), details, CANDIDATES, tables.ranking_table(tree), tables.RANKING),
        Block([*tables.residual_sentences(tree, after)] * remains, details, REMAINS, parts, PARTS_CAPTION),
        Block([*_detectability(tree)], details, SHOWS),
    ]


def _start(tree: xr.DataTree) -> Iterator[str]:
    """Describe the residual of the start model and its parts."""
    residual, noise, units = residual_of(tree, "before"), record_noise(tree), signal_units(tree)
    model = f"start model ({', '.join(tree['before'].force.values.tolist())})"
    if np.isfinite(residual):
        size = f"{tables.times_noise(residual / noise)} ({layout.in_small_units(noise, units)})"
        yield f"The residual of the {model} is {layout.in_small_units(residual, units)} (RMS), {size}."
    else:
        yield f"The simulated motion of the {model} diverges from the record."
    whole = float(tree["holdout"].residual_noise)
    if whole > LARGE * noise:
        yield (
            "The sensor's noise is coloured: including its slow part, it is "
            f"{layout.in_small_units(whole, units)} per sample, {tables.times_noise(whole / noise)}."
        )
    yield from tables.residual_sentences(tree, "discrepancy")
    yield from tables.force_type_sentences(tree, "discrepancy")


def _remarks(tree: xr.DataTree, at: int, step: xr.Dataset) -> Iterator[str]:
    """Describe doubts about an effect, and the competing effects."""
    symbol, pairs = step.symbol.item(), effects.replacing_pairs(step)
    if not step.significant:
        yield f"In the final model, the coefficient of {symbol} is not significant."
    yield from step_heterogeneity_sentences(tree, at)
    if step.worsens_holdout.item():
        yield (
            f"The model without {symbol} predicts the held-out part better "
            f"(z = {step.prediction_z.item():.2g})."
        )
    yield from _competing(tree, step)
    if pairs:
        more = f", {len(pairs) - COMPETING_PAIRS} more pairs" if len(pairs) > COMPETING_PAIRS else ""
        odds = step.pair_odds.item()
        how = "better than" if odds > OUTSIDE_OF_SET else "as well as"
        named = f"{', '.join(map(' and '.join, pairs[:COMPETING_PAIRS]))}{more}"
        yield (
            f"These pairs would explain the record {how} {symbol}: {named}; the odds of the first pair to "
            f"{symbol} are {odds:.2g}, with equal prior probabilities."
        )
    if (probability := step.chance_probability.item()) > 0.0:
        yield (
            f"The probability of no force in place of {symbol}, with the residual attributed to a random "
            f"force, is {_probability(probability)}."
        )
    if failed := effects.failed_competitors(step):
        yield f"The fits of these alternatives to {symbol} failed: {', '.join(failed)}."


def _competing(tree: xr.DataTree, step: xr.Dataset) -> Iterator[str]:
    """Describe the credible set of an effect, each member's probability, and what would separate them."""
    probabilities = effects.credible_set(step)
    symbol, *others = probabilities
    if not others:
        return
    offered = effects.candidates_of(tree)
    named = ", ".join(f"{s} ({offered[s].formula.text})" for s in others[:COMPETING])
    more = f", and {len(others) - COMPETING} more" if len(others) > COMPETING else ""
    likely = ", ".join(f"{s} {_probability(p)}" for s, p in [*probabilities.items()][: COMPETING + 1])
    yield f"{symbol} cannot be separated from: {named}{more}."
    yield f"Probabilities (all candidates equally probable beforehand): {likely}."
    # List the forces that no run separates, and the measurement that would separate the others.
    groups = effects.inseparable_groups(step)
    for group in groups:
        if len(group) > 1:
            why = "their averages over a cycle are equal at every amplitude"
            yield f"No run of this kind separates {' and '.join(group)}: {why}."
    if len(groups) > 1:
        yield remedy([offered[group[0]] for group in groups])


def _probability(value: float) -> str:
    """Format a probability with two digits; it is never written as zero."""
    return "< 0.01" if value < 0.01 else f"{value:.2f}"


def remedy(tied: Sequence[Force]) -> str:
    """Return the measurement that would separate forces, by how they differ."""
    if any(force.inputs for force in tied):
        what = "Runs with another load, gain or motion of the inputs"
        why = "there the variables of these formulas differ"
    elif len({force.kind == "sensor" for force in tied}) > 1:
        what = "Another inertia, or a second sensor,"
        why = "the error of the sensor stays the same, but the coefficient of a force changes"
    elif len({force.holds_time for force in tied}) > 1:
        what = "A second run, released at 0.6 times this amplitude,"
        why = "a drift depends on time, but the others on amplitude"
    elif len({force.memoryless for force in tied}) > 1:
        what = "A run released at 0.2 times this amplitude, or with another inertia,"
        why = "a history-dependent force changes differently"
    elif any(force.shape or force.character != "conservative" for force in tied):
        what, why = "A run released at 0.2 times this amplitude", "there they differ most"
    else:
        what, why = "A run released at a larger amplitude", "there they differ most"
    return f"{what} would separate them: {why}."


def _detectability(tree: xr.DataTree) -> Iterator[str]:
    """Describe candidates that are inseparable, cannot be tested, or were not offered."""
    candidates = tree["detectability_after"].to_dataset()
    symbols = candidates.candidate.values.tolist()
    pairs = candidates.alike.sel(other=symbols).transpose("candidate", "other").to_pandas()
    groups = effects.grouped(symbols, lambda first, symbol: bool(pairs.at[symbol, first]))
    if alike := "; ".join(", ".join(group) for group in groups if len(group) > 1):
        yield (
            f"This record cannot separate the forces of a group, even at a coefficient of {effects.NAMED:g} "
            f"standard errors. The groups: {alike}."
        )
    # The reason may contain these words already.
    reasons = candidates.reason.to_series().str.removeprefix("not testable on this record: ").str.rstrip(".")
    for reason, untested in reasons[reasons != ""].groupby(reasons, sort=False):
        yield f"Not testable on this record: {', '.join(untested.index)} ({reason})."
    if left_out := tree.attrs["left_out"]:
        yield f"Not offered, because the model has them: {', '.join(left_out)}."
    if failed := tree.attrs["failed_fits"]:
        yield f"Not fitted, because their motions could not be computed: {', '.join(failed)}."


def discovery_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return a result of `discover` as plain data."""
    attrs, noise = tree.attrs, record_noise(tree)
    reasons = layout.per_label(tree["detectability_after"].to_dataset(), "candidate", "reason")
    computed = {
        "disagreement": _spans(tree["discrepancy"].to_dataset()),
        "steps": [_step(tree, at, step) for at, step in enumerate(effects.steps_taken(tree))],
        "verdict": verdict_of(tree),
        "converged": bool(tree["converged"]),
        **{name: attrs.get(name) or None for name in ("closing_effect", "not_improving", "refused_by_laws")},
        "laws_held_out_rms": attrs.get("laws_held_out_rms", float("nan")),
        "noise_p_value": attrs.get("noise_p_value", np.nan),
        **{"noise": noise, "residual": residual_of(tree, "after")},
        "disagreement_after": _spans(tree["discrepancy_after"].to_dataset()),
        "omnibus": {"p_value": tree["omnibus"].p_value[-1], "widening": effects.error_widening(tree)},
        "not_testable": {symbol: reason for symbol, reason in reasons.items() if reason.item()},
        "options": json.loads(attrs["options"]),
    }
    said = layout.records_json(tree) | layout.mapped(tree, "discover", computed) | layout.judged_json(tree)
    if GROUP in tree.children:
        said[GROUP] = layout.mapped(tree[GROUP].to_dataset(), GROUP)
    return said


def _spans(spans: xr.Dataset) -> dict[str, Any]:
    """Return the residual by its spans."""
    return layout.mapped(spans, "spans", {"parts": ", ".join(spans.attrs["parts"])})


def _step(tree: xr.DataTree, at: int, step: xr.Dataset) -> dict[str, Any]:
    """Return an effect with its competing effects, on held-out data, and in parts of the record."""
    held, offered = tree["holdout"].rms, effects.candidates_of(tree)
    probabilities = {s: round(p, 4) for s, p in effects.credible_set(step).items()}
    in_parts = "likeliest_in_parts" in step
    likeliest = layout.per_label(step, "part", "likeliest_in_parts") if in_parts else {}
    symbol, pairs = step.symbol.item(), effects.replacing_pairs(step)
    computed = {
        "shapes": effects.shapes_of(step, symbol),
        "shape_standard_error": effects.shapes_of(step, symbol, "shape_standard_error"),
        "pairs": pairs,
        "pair_odds": step.pair_odds if pairs else None,
        "chance_probability": step.chance_probability.round(4),
        "probability": probabilities.pop(symbol),
        "holdout_before": held[at],
        "holdout_after": held[at + 1],
        "stands_in": step.stands_in if in_parts else None,
        "parts": len(likeliest),
        "likeliest_in_parts": likeliest,
        "indistinguishable_from": [
            {"symbol": s, "name": offered[s].name, "formula": offered[s].formula.text, "probability": p}
            for s, p in probabilities.items()
        ],
    }
    return layout.mapped(step, "step", computed)
