"""A discovery: where the gap is, what closes it, what remains, and what could have been seen."""

import json
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np
import xarray as xr

from sysid_trib.cycles.signatures import inseparable
from sysid_trib.forces.force import Force
from sysid_trib.printing import ALWAYS, Block, Layer
from sysid_trib.printing.discovery_tables import (
    RANKING,
    effects_table,
    force_type_sentences,
    ranking_table,
    residual_sentences,
    residual_table,
    slow_noise_sentences,
    steps_of,
    times_noise,
)
from sysid_trib.printing.discovery_verdict import verdict_sentences
from sysid_trib.printing.layout import (
    KEYS,
    Source,
    coefficient_table,
    in_small_units,
    mapped,
    number,
    per_label,
    records_json,
)
from sysid_trib.printing.verdict import GROUP, step_heterogeneity_sentences
from sysid_trib.records.decay import RECORD_PARTS
from sysid_trib.results import effects
from sysid_trib.results.variables import record_groups, signal_units
from sysid_trib.validation.findings import given_results, record_noise, residual_of

Item = TypeVar("Item")
# Competing effects that are named, the most probable; a file has all. And pairs of them.
COMPETING, COMPETING_PAIRS = 10, 3
# Odds at which one of two is outside of their 95 % credible set.
OUTSIDE_OF_SET = 19.0
DIFFER, MISSING, REMAINS = "Where model and record disagree", "What is missing", "What remains"
CANDIDATES, SHOWS = "Models and candidates", "What this record can show"
PARTS_CAPTION = "Record minus model, by its parts"
EFFECTS_CAPTION = "Effects in the order in which they were added; held out: {}"


def discovery_blocks(tree: xr.DataTree, sources: Sequence[str] = ()) -> list[Block]:
    """What is shown of a result of `discover`.

    Parameters
    ----------
    tree : DataTree
        The result.
    sources : sequence of str
        What each record is.

    Returns
    -------
    list of Block
    """
    (verdict, *sentences), details, steps = verdict_sentences(tree), Layer.EXPLAIN, steps_of(tree)
    remarks = [line for at, step in enumerate(steps) for line in _remarks(tree, at, step)]
    coefficients = coefficient_table(given_results(tree))
    blocks = [
        Block([verdict], ALWAYS),
        Block(sources),
        *([Block((), Layer.QUIET | Layer.DEFAULT, table=effects_table(tree))] if steps else []),
        Block([*remarks, *sentences], Layer.DEFAULT),
        Block(sentences, details),
        Block(title="At a glance"),
        Block(_start(tree), details, DIFFER, residual_table(tree, "discrepancy"), PARTS_CAPTION),
    ]
    if steps:
        held = EFFECTS_CAPTION.format(tree.attrs["held_out"])
        blocks.append(Block((), details, MISSING, effects_table(tree, details=True), held))
        blocks.append(Block(remarks, details, MISSING))
    blocks += [
        Block((), details, CANDIDATES, coefficients, "Coefficients"),
        Block((), details, CANDIDATES, ranking_table(tree), RANKING),
    ]
    if tree.attrs["verdict"] == "unknown effect":
        remains = residual_sentences(tree, after := "discrepancy_after")
        blocks.append(Block(remains, details, REMAINS, residual_table(tree, after), PARTS_CAPTION))
    return [*blocks, Block(_detectability(tree), details, SHOWS)]


def _start(tree: xr.DataTree) -> list[str]:
    residual, noise, units = residual_of(tree, "before"), record_noise(tree), signal_units(tree)
    model = f"start model ({', '.join(tree['before'].force.values.tolist())})"
    sentence = f"The motion of the {model} leaves the record."
    if np.isfinite(residual):
        size = f"{times_noise(residual / noise)} of {in_small_units(noise, units)}"
        sentence = f"The {model} leaves a gap of {in_small_units(residual, units)} (RMS): {size}."
    differ = [*residual_sentences(tree, "discrepancy"), *force_type_sentences(tree, "discrepancy")]
    return [sentence, *slow_noise_sentences(tree), *differ]


def _remarks(tree: xr.DataTree, at: int, step: xr.Dataset) -> list[str]:
    """What to mind of an effect: doubts, and what competes with it."""
    symbol = step.symbol.item()
    remarks = []
    if not step.significant:
        remarks.append(f"In the final model, the coefficient of {symbol} is not significant.")
    remarks += step_heterogeneity_sentences(tree, at)
    if step.worsens_holdout.item():
        remarks.append(
            f"{symbol} is in the fit only: the model before it predicts what was held out better "
            f"(z = {step.prediction_z.item():.2g})."
        )
    remarks += [*_competing(tree, step), *_competing_pairs(step)]
    if (probability := step.chance_probability.item()) > 0.0:
        remarks.append(
            "No force in its place, a random force taking the blame, has the probability "
            f"{_probability(probability)}."
        )
    if failed := effects.failed_competitors(step):
        remarks.append(f"In place of {symbol} these were tried, but their fits failed: {', '.join(failed)}.")
    return remarks


def _competing(tree: xr.DataTree, step: xr.Dataset) -> list[str]:
    """The credible set of an effect, how probable each member is, and what would separate them."""
    probabilities = effects.credible_set(step)
    symbol, *others = probabilities
    if not others:
        return []
    offered = effects.candidates_of(tree)
    named = ", ".join(f"{s} ({offered[s].formula.text})" for s in others[:COMPETING])
    more = f", and {len(others) - COMPETING} more" if len(others) > COMPETING else ""
    likely = ", ".join(f"{s} {_probability(p)}" for s, p in [*probabilities.items()][: COMPETING + 1])
    sentences = [
        f"{symbol} cannot be separated from: {named}{more}.",
        f"With equal prior probabilities: {likely}.",
    ]
    # Which forces no run separates, and the measurement that would separate the others.
    size = max(float(np.abs(tree[group].angle).max()) for group in record_groups(tree))
    fitted = [step[name].to_series().dropna() for name in ("shape", "competing_shape") if name in step]
    shapes = {name: value for part in fitted for name, value in part.items()}
    tied = [offered[s] for s in probabilities]
    groups = _grouped(tied, lambda first, force: inseparable(first, force, size, shapes))
    for group in groups:
        if len(group) > 1:
            names = " and ".join(force.symbol for force in group)
            why = "averaged over a cycle, they do the same at every amplitude"
            sentences.append(f"No run of this kind separates {names}: {why}.")
    return [*sentences, *([remedy([group[0] for group in groups])] if len(groups) > 1 else [])]


def _grouped(items: Iterable[Item], alike: Callable[[Item, Item], bool]) -> list[list[Item]]:
    """Groups in which each is like each: a chain of neighbours may have ends that are far apart."""
    groups: list[list[Item]] = []
    for item in items:
        home = next((group for group in groups if all(alike(other, item) for other in group)), None)
        if home is None:
            groups.append([item])
        else:
            home.append(item)
    return groups


def _competing_pairs(step: xr.Dataset) -> list[str]:
    """Pairs of candidates that explain together what an effect does, and how probable the likeliest is."""
    pairs = effects.replacing_pairs(step)
    if not pairs:
        return []
    more = f", {len(pairs) - COMPETING_PAIRS} more pairs" if len(pairs) > COMPETING_PAIRS else ""
    odds = step.pair_odds.item()
    return [
        f"Two together would do {'better' if odds > OUTSIDE_OF_SET else 'as well'} in the place of "
        f"{step.symbol.item()}: {', '.join(pairs[:COMPETING_PAIRS])}{more}; the first with odds of "
        f"{odds:.2g} to it if they were as likely before."
    ]


def _probability(value: float) -> str:
    """A probability of two digits, which is never nought."""
    return "< 0.01" if value < 0.01 else f"{value:.2f}"


def remedy(tied: Sequence[Force]) -> str:
    """The measurement that would separate forces, by how they differ."""
    if len({force.kind == "sensor" for force in tied}) > 1:
        what = "Another inertia, or a second sensor,"
        why = "an error of the sensor stays the same, a force changes"
    elif len({force.holds_time for force in tied}) > 1:
        what = "A second release at 0.6 of the amplitude"
        why = "a drift depends on time, the others depend on amplitude"
    elif len({force.memoryless for force in tied}) > 1:
        what = "A low release at 0.2 of the amplitude, or another inertia,"
        why = "a history-dependent force changes in another way"
    elif any(force.shape or force.character != "conservative" for force in tied):
        what, why = "A low release at 0.2 of the amplitude", "there they differ most"
    else:
        what, why = "A release at a larger amplitude", "there they differ most"
    return f"{what} would separate them: {why}."


def _detectability(tree: xr.DataTree) -> list[str]:
    """Candidates that look alike, cannot be tested, or were not offered."""
    candidates, sentences = tree["detectability_after"].to_dataset(), []
    symbols = candidates.candidate.values.tolist()
    pairs = candidates.alike.sel(other=symbols).transpose("candidate", "other").to_pandas()
    groups = _grouped(symbols, lambda first, symbol: bool(pairs.at[symbol, first]))
    if alike := "; ".join(", ".join(group) for group in groups if len(group) > 1):
        sentences.append(
            f"On this record, these look alike even at {effects.NAMED:g} standard errors: {alike}."
        )
    # The reason may name the record already.
    reasons = candidates.reason.to_series().str.removeprefix("not testable on this record: ").str.rstrip(".")
    for reason, untested in reasons[reasons != ""].groupby(reasons, sort=False):
        sentences.append(f"Not testable on this record: {', '.join(untested.index)} ({reason}).")
    if left_out := tree.attrs["left_out"]:
        sentences.append(f"Not offered, because the model has them: {', '.join(left_out)}.")
    if failed := tree.attrs["failed_fits"]:
        sentences.append(f"Tried, but not fitted: their motions could not be computed: {', '.join(failed)}.")
    return sentences


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
    "noise": lambda tree: number(record_noise(tree)),
    "residual_noise": lambda tree: number(record_noise(tree)),
    "residual": lambda tree: number(residual_of(tree, "after")),
    "disagreement_after": ("discrepancy_after", SPANS),
    "generic_p_value": lambda tree: number(tree["omnibus"].p_value.values[-1].item()),
    "error_widening": lambda tree: number(effects.error_widening(tree)),
    "not_testable": ("detectability_after", lambda candidates: _reasons(candidates)),
    "options": lambda tree: json.loads(tree.attrs["options"]),
}


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
