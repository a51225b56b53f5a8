"""A discovery as a story in plain sentences: where the gap is, what closes it, what could have been seen."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.noise.random_force import DENSITY_UNITS
from sysid_trib.printing.detectability import detectability_sentences, remedy
from sysid_trib.printing.discovery_tables import (
    RANKING,
    effect_name,
    effects_table,
    formula_text,
    ranking_table,
)
from sysid_trib.printing.discovery_verdict import verdict_sentences
from sysid_trib.printing.layers import ALWAYS, Block, Layer
from sysid_trib.printing.layout import coefficient_text, p_value_text
from sysid_trib.printing.residual import (
    in_small_units,
    noise_of,
    residual_of,
    residual_sentences,
    slow_noise_sentences,
    times_noise,
)
from sysid_trib.printing.runs import step_heterogeneity_sentences
from sysid_trib.results.discoveries import (
    candidates_of,
    credible_set,
    failed_competitors,
    pairs_in_place,
)
from sysid_trib.results.signal_units import signal_units, small_units

# Competing effects that are named, the most probable; a file has all.
COMPETING = 10
# And pairs of them.
COMPETING_PAIRS = 3
# Odds at which one of two is outside of their 95 % credible set.
OUTSIDE_OF_SET = 19.0


def discovery_blocks(tree: xr.DataTree, sources: Sequence[str]) -> list[Block]:
    """What the command `discover` prints, in layers.

    Parameters
    ----------
    tree : DataTree
        Result of `discover`.
    sources : sequence of str
        What each record is.

    Returns
    -------
    list of Block
    """
    verdict, *sentences = verdict_sentences(tree, details=False)
    remarks = [line for at in range(tree["steps"].attrs["count"]) for line in _step_remarks(tree, at)]
    story = {
        title if title != "Verdict" else "What remains": [line for line in lines if line != verdict]
        for title, lines in discovery_story(tree).items()
    }
    blocks = [Block([verdict], ALWAYS), Block(sources)]
    if tree["steps"].attrs["count"]:
        blocks.append(Block(effects_table(tree), ALWAYS))
    return [
        *blocks,
        Block([*remarks, *sentences], Layer.DEFAULT),
        *(Block(lines, Layer.EXPLAIN, title) for title, lines in story.items()),
        Block(ranking_table(tree), Layer.EXPLAIN, RANKING),
    ]


def discovery_story(tree: xr.DataTree) -> dict[str, list[str]]:
    """The result of `discover` as headings with sentences, in the order of the work."""
    story = {"Where model and record disagree": _start(tree)}
    steps = [line for at in range(tree["steps"].attrs["count"]) for line in _step(tree, at)]
    if steps:
        story["What is missing"] = steps
    story["Verdict"] = verdict_sentences(tree)
    story["What this record can show"] = detectability_sentences(tree)
    return story


def _start(tree: xr.DataTree) -> list[str]:
    residual, noise, units = residual_of(tree, "before"), noise_of(tree), signal_units(tree)
    forces = ", ".join(tree["before"].force.values.tolist())
    return [
        f"The start model ({forces}) leaves a gap of {in_small_units(residual, units)} (RMS): "
        f"{times_noise(residual, noise)} of {in_small_units(noise, units)}.",
        *slow_noise_sentences(tree),
        *residual_sentences(tree, "discrepancy"),
    ]


def _step(tree: xr.DataTree, at: int) -> list[str]:
    """An effect, how far it closes the gap, and what to mind of it."""
    step = tree["steps"].to_dataset().isel(step=at)
    family = "error of the sensor" if step.kind.item() == "sensor" else step.family.item()
    what = f" ({family})" if family else ""
    return [
        f"{at + 1}. {effect_name(step)}, {step['name'].item()} {formula_text(step)}{what}: "
        f"{coefficient_text(step)}, z = {step.z.item():.3g}, "
        f"corrected p {p_value_text(step.p_value.item())}.",
        f"   Adding it takes the gap from {_shrinking(tree, at)}.",
        f"   {_random_force(step)}",
        *(f"   {remark}" for remark in _step_remarks(tree, at)),
    ]


def _random_force(step: xr.Dataset) -> str:
    """What the effect leaves of the random force."""
    units = step.random_force_before.attrs.get("units", DENSITY_UNITS)
    before, after = step.random_force_before.item(), step.random_force_after.item()
    lowered = step.gain.item()
    if lowered <= 0.0:
        return "It explains nothing before the effects below are added."
    gain = f"It lowers the deviance by {lowered:.3g}"
    if before == 0.0:
        return f"{gain}; no random force was blamed for it." if after == 0.0 else f"{gain}."
    if after == 0.0:
        return f"{gain}, and the random force that was blamed for it vanishes."
    way = "shrinks" if after < before else "grows"
    return f"{gain}; the random force {way} from {before:.2g} to {after:.2g} {units}."


def _step_remarks(tree: xr.DataTree, at: int) -> list[str]:
    """What to mind of an effect: doubts, and what competes with it."""
    step = tree["steps"].to_dataset().isel(step=at)
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
    if failed := failed_competitors(step):
        remarks.append(f"In place of {symbol} these were tried, but their fits failed: {', '.join(failed)}.")
    return remarks


def _competing(tree: xr.DataTree, step: xr.Dataset) -> list[str]:
    """The credible set of an effect, how probable each member is, and what would separate them."""
    probabilities = credible_set(step)
    symbol, *others = probabilities
    if not others:
        return []
    offered = candidates_of(tree)
    named = ", ".join(f"{s} ({offered[s].formula.text})" for s in others[:COMPETING])
    more = f", and {len(others) - COMPETING} more" if len(others) > COMPETING else ""
    pairs = list(probabilities.items())[: COMPETING + 1]
    return [
        f"{symbol} cannot be separated from: {named}{more}.",
        f"With equal prior probabilities: {', '.join(f'{s} {_probability(p)}' for s, p in pairs)}.",
        remedy([offered[s] for s in probabilities]),
    ]


def _competing_pairs(step: xr.Dataset) -> list[str]:
    """Pairs of candidates that explain together what an effect does, and how probable the likeliest is."""
    pairs = pairs_in_place(step)
    if not pairs:
        return []
    more = f", {len(pairs) - COMPETING_PAIRS} more pairs" if len(pairs) > COMPETING_PAIRS else ""
    odds = step.pair_odds.item()
    how = "better" if odds > OUTSIDE_OF_SET else "as well"
    return [
        f"Two together would do {how} in the place of {step.symbol.item()}: "
        f"{', '.join(pairs[:COMPETING_PAIRS])}{more}; the first with odds of {odds:.2g} to "
        "it if they were as likely before."
    ]


def _probability(value: float) -> str:
    """A probability of two digits, which is never nought."""
    return "< 0.01" if value < 0.01 else f"{value:.2f}"


def _shrinking(tree: xr.DataTree, at: int) -> str:
    """From the gap before a step to that after it, on the fit and on the hold-out."""
    step, held, noise = tree["steps"].isel(step=at), tree["holdout"].rms.values, noise_of(tree)
    units = signal_units(tree)
    text = _before_and_after(step.residual_before.item(), step.residual_after.item(), noise, units)
    if np.all(np.isfinite(held[at : at + 2])):
        what = f" ({tree.attrs['held_out']})" if at == 0 else ""
        text += f", on the hold-out{what} from {_before_and_after(held[at], held[at + 1], noise, units)}"
    return text


def _before_and_after(before: float, after: float, noise: float, units: str) -> str:
    factor, unit = small_units(units)
    return (
        f"{before / noise:.3g} to {after / noise:.3g} times the noise "
        f"({factor * before:.3g} to {factor * after:.3g} {unit})"
    )
