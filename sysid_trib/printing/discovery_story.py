"""A discovery as a story in plain sentences: where the gap is, what closes it, what could have been seen."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.printing.detectability import detectability_sentences, remedy
from sysid_trib.printing.discovery_tables import RANKING, ranking_table
from sysid_trib.printing.homogeneity import heterogeneity_sentences, step_heterogeneity_sentences
from sysid_trib.printing.layers import Block, Layer
from sysid_trib.printing.layout import p_value_text, value_with_error
from sysid_trib.printing.residual import in_mrad, noise_of, residual_of, residual_sentences, times_noise
from sysid_trib.results.discoveries import (
    added_effects,
    candidates_of,
    credible_set,
    failed_competitors,
    shapes_of,
)

# Generic shapes and candidates that are named where they stand out.
MOST = 3
# Twins of an effect that are named, the likeliest; a file has all.
TWINS = 10
UNSEEN = "Effects below the strengths that follow may be there unseen."


def discovery_story(tree: xr.DataTree) -> dict[str, list[str]]:
    """The result of `discover` as headings with sentences, in the order of the work."""
    story = {"Where model and record disagree": _start_told(tree)}
    steps = [line for at in range(tree["steps"].attrs["count"]) for line in _step_told(tree, at)]
    if steps:
        story["What is missing"] = steps
    story["Verdict"] = _verdict_told(tree)
    story["What this record can show"] = detectability_sentences(tree)
    return story


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
    story = discovery_story(tree)
    return [
        Block([story["Verdict"][0]], Layer.QUIET),
        Block(sources),
        *(Block(sentences, title=title) for title, sentences in story.items()),
        Block(ranking_table(tree), title=RANKING),
    ]


def _start_told(tree: xr.DataTree) -> list[str]:
    gap, noise = residual_of(tree, "before"), noise_of(tree)
    forces = ", ".join(tree["before"].force.values.tolist())
    told = [
        f"The start model ({forces}) leaves {in_mrad(gap)} (RMS): {times_noise(gap, noise)} "
        f"of {in_mrad(noise)}."
    ]
    return told + residual_sentences(tree, "discrepancy")


def _step_told(tree: xr.DataTree, at: int) -> list[str]:
    step = tree["steps"].to_dataset().isel(step=at)
    shapes = shapes_of(step, step.symbol.item())
    shaped = "".join(f", {name} = {value:.3g}" for name, value in shapes.items())
    what = "error of the sensor" if step.kind.item() == "sensor" else step.family.item()
    what = f" ({what})" if what else ""
    told = [
        f"{at + 1}. {step.symbol.item()}, {step['name'].item()} {step.formula.item()}{shaped}{what}: "
        f"{_valued(step)}, z = {step.z.item():.3g} (of the coefficient), "
        f"corrected p {p_value_text(step.p_value.item())} (of what it explains)."
    ]
    told.append(f"   Adding it takes the gap from {_shrinking(tree, at)}.")
    if not step.significant:
        told.append("   In the final model its coefficient is not significant.")
    told += [f"   {one}" for one in step_heterogeneity_sentences(tree, at)]
    if step.worsens_holdout.item():
        told.append("   It makes the prediction of what was held out worse: do not trust it yet.")
    likely = credible_set(step)
    tied = list(likely)[1:]
    if tied:
        offered = candidates_of(tree)
        named = ", ".join(f"{s} ({offered[s].formula.text})" for s in tied[:TWINS])
        others = f", and {len(tied) - TWINS} more" if len(tied) > TWINS else ""
        told.append(f"   It cannot be told from: {named}{others}.")
        first = list(likely.items())[: TWINS + 1]
        each = ", ".join(f"{symbol} {probability:.2f}" for symbol, probability in first)
        told.append(f"   If all candidates were as likely before, the probabilities are: {each}.")
        told.append(f"   {remedy([offered[s] for s in (step.symbol.item(), *tied)])}")
    if failed := failed_competitors(step):
        told.append(f"   In its place these were tried, but their fits did not settle: {', '.join(failed)}.")
    return told


def _shrinking(tree: xr.DataTree, at: int) -> str:
    """From the gap before a step to that after it, on the fit and on the hold-out."""
    step, held, noise = tree["steps"].isel(step=at), tree["holdout"].rms.values, noise_of(tree)
    fitted = step.residual_before.item(), step.residual_after.item()
    told = _pair(*fitted, noise)
    if np.all(np.isfinite(held[at : at + 2])):
        what = f" ({tree.attrs['held_out']})" if at == 0 else ""
        told += f", on the hold-out{what} from {_pair(held[at], held[at + 1], noise)}"
    return told


def _pair(before: float, after: float, noise: float) -> str:
    return (
        f"{before / noise:.3g} to {after / noise:.3g} times the noise "
        f"({1e3 * before:.3g} to {1e3 * after:.3g} mrad)"
    )


def _verdict_told(tree: xr.DataTree) -> list[str]:
    said = {"explained": _explained, "nothing missing": _nothing, "unknown effect": _unknown}
    return [*said[tree.attrs["verdict"]](tree), *heterogeneity_sentences(tree), _model_told(tree)]


def _model_told(tree: xr.DataTree) -> str:
    """Frequency and forces of the final model that no step has told."""
    after, named = tree["after"].to_dataset(), added_effects(tree)
    w = value_with_error(after.reference_frequency.item(), after.reference_frequency_standard_error.item())
    values = [f"w = {w} rad/s"]
    for symbol in after.force.values.tolist():
        if symbol not in named:
            values.append(f"{symbol} = {_valued(after.sel(force=symbol))}")
    return f"The model {'has besides' if named else 'has'}: {', '.join(values)}."


def _valued(one: xr.Dataset) -> str:
    """A coefficient with its error and unit."""
    value = value_with_error(one.coefficient.item(), one.standard_error.item())
    return value if one.unit.item() == "1" else f"{value} {one.unit.item()}"


def _explained(tree: xr.DataTree) -> list[str]:
    gap, noise = residual_of(tree, "after"), noise_of(tree)
    named = " and ".join(added_effects(tree))
    quiet, but = _quiet(tree, "no other candidate")
    return [f"Explained: with {named} the model leaves {times_noise(gap, noise)}; {quiet} {UNSEEN}", *but]


def _nothing(tree: xr.DataTree) -> list[str]:
    noise = times_noise(residual_of(tree, "after"), noise_of(tree))
    quiet, but = _quiet(tree, "no candidate")
    return [f"Nothing is missing: the model leaves {noise}; {quiet} {UNSEEN}", *but]


def _quiet(tree: xr.DataTree, candidates: str) -> tuple[str, list[str]]:
    """What does not stand out of what is left, and the candidates that seem to by their scores."""
    nearest = _nearest_told(tree)
    quiet = "no generic force" if nearest else f"{candidates} and no generic force"
    return (
        f"{quiet} stands out of it (chance of error {_level(tree):.2g}).",
        [*_high_by_chance(tree), *nearest],
    )


def _high_by_chance(tree: xr.DataTree) -> list[str]:
    """Candidates above the threshold of one test each that are looked for at many frequencies."""
    last = tree["ranking"].to_dataset().isel(selection_step=-1)
    limit = last.threshold.item()
    high = last.isel(candidate=(abs(last.z.values) > limit) & ~last.significant.values)
    if not high.sizes["candidate"]:
        return []
    pairs = zip(high.candidate.values.tolist(), abs(high.z.values).tolist(), strict=True)
    told = ", ".join(f"{symbol} ({z:.3g})" for symbol, z in pairs)
    return [f"Above the threshold of {limit:.3g} but, of so many frequencies tried, by chance: {told}."]


def _unknown(tree: xr.DataTree) -> list[str]:
    gap, noise = residual_of(tree, "after"), noise_of(tree)
    generic = tree["omnibus"].to_dataset().isel(selection_step=-1)
    flagged = bool(generic.significant)
    leaning = " and ".join(_leaning(tree))
    cancel = "nearly cancel others of the model, and so may imitate a force that is not among the candidates."
    if flagged or not leaning:
        told = [
            f"Unknown effect: something is left that was not named; the gap is {times_noise(gap, noise)}."
        ]
        told += residual_sentences(tree, "discrepancy_after")
        told += [f"Of the effects that were added, {leaning} {cancel}"] if leaning else []
    else:
        told = [f"Unknown effect: the gap is {times_noise(gap, noise)}, but {leaning} {cancel}"]
    if flagged:
        order = np.argsort(-np.abs(generic.z.values))[:MOST]
        shapes = ", ".join(
            f"{generic['trial_force'].values[i]} (z = {generic.z.values[i]:.3g})" for i in order
        )
        told.append(
            f"Generic forces of amplitude r and phase phi that it resembles: {shapes}; chance that nothing "
            f"is left {p_value_text(generic.p_value.item())}."
        )
    return told + _nearest_told(tree)


def _nearest_told(tree: xr.DataTree) -> list[str]:
    """Candidates whose scores stand out at the end, and why none was added."""
    last = tree["ranking"].to_dataset().isel(selection_step=-1)
    strong = np.flatnonzero(last.significant.values)
    if not len(strong):
        return []
    order = strong[np.argsort(-np.abs(last.z.values[strong]))][:MOST]
    named = ", ".join(f"{last.candidate.values[i]} (z = {last.z.values[i]:.3g})" for i in order)
    most = tree.attrs["max_effects"]
    full = tree["steps"].attrs["count"] >= most
    reason = (
        f"no more than {most} effects were asked for (--max-effects)"
        if full
        else "fitted in full, none takes from the gap what its score promises"
    )
    return [f"By their scores these candidates stand out: {named}; {reason}."]


def _leaning(tree: xr.DataTree) -> list[str]:
    """Symbols of the effects whose names do not stand by themselves."""
    if not tree["steps"].attrs["count"]:
        return []
    steps = tree["steps"].to_dataset()
    return [str(symbol) for symbol in steps.symbol.values[steps.collinear.values]]


def _level(tree: xr.DataTree) -> float:
    return float(tree["ranking"].significance_level.item())
