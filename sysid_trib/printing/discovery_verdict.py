"""The verdict of a discovery in sentences: is the record explained, and what remains."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.printing.discovery_tables import (
    effect_with_ties,
    force_type_sentences,
    residual_text,
    steps_of,
    times_noise,
)
from sysid_trib.printing.equation import equation_text
from sysid_trib.printing.layout import coefficient_text, p_value_text, quantity
from sysid_trib.printing.verdict import constraint_sentences, heterogeneity_sentences
from sysid_trib.records.decay import RECORD_PARTS
from sysid_trib.records.inputs import inputs_of
from sysid_trib.results.effects import PAIRS, added_effects, determines, error_widening, misnamed_effects
from sysid_trib.results.variables import record_groups, signal_units
from sysid_trib.validation.findings import held_out_excess, record_noise

# Forces of the omnibus test, and candidates, that are named where they stand out.
MOST_NAMED = 3
UNDECIDED = (
    "The record decides nothing: no coefficient of the model differs from zero, and no candidate stands out. "
    "A longer motion, from a larger amplitude, would."
)
# Noise levels above which a gap is shown.
SHOWN_RATIO = 2.0
UNSEEN = "An effect that is weaker than its detectable coefficient may be present and unseen."
IMITATED = "a force that is no candidate may be imitated"


def verdict_sentences(tree: xr.DataTree) -> list[str]:
    """The verdict of a result of `discover` in its first sentence, then what remains and the model."""
    after = tree["after"].to_dataset()
    return [
        *(_unknown_effect(tree) if tree.attrs["verdict"] == "unknown effect" else _closed(tree)),
        *_ended_early(tree),
        *_outstanding(tree),
        *_stability(tree),
        *heterogeneity_sentences(tree),
        _model(tree),
        *constraint_sentences([after]),
        f"Equation: {equation_text(after)}.",
    ]


def _closed(tree: xr.DataTree) -> list[str]:
    """Nothing more stands out of the residual."""
    effects = " and ".join(effect_with_ties(step) for step in steps_of(tree))
    after, residual = tree["after"].to_dataset(), residual_text(tree)
    if not determines(after):
        return [UNDECIDED, UNSEEN]
    if closing := tree.attrs.get("closing_effect"):
        most = tree.attrs["max_effects"]
        asked = f"{most} effect{'s were' if most > 1 else ' was'} asked for (--max-effects)"
        return [
            f"Explained but for the limit that ended the search: with {effects} {residual}; with {closing} "
            f"it would close, but no more than {asked}.{_unpredicted(tree)}"
        ]
    level = tree["ranking"].significance_level.item()
    stochastic = ", as a random force leaves it" if float(np.min(after.random_force_p_value)) < level else ""
    headline = f"Explained: with {effects}" if effects else "No missing effect was found:"
    tests = "the omnibus test"
    if not _last(tree, "ranking").significant.any():
        tests = f"the {'other ' if effects else ''}candidates or by {tests}"
    absent = f"No further departure was found by {tests} (significance level {level:.2g})."
    return [
        f"{headline} {residual}{stochastic}.{_unpredicted(tree)} {absent}",
        UNSEEN,
        *_high_but_not_significant(tree),
    ]


def _unpredicted(tree: xr.DataTree) -> str:
    """That the final model leaves more than noise of what it was not fitted to."""
    ratio, held = held_out_excess(tree), tree.attrs["held_out"]
    return f" But it leaves {times_noise(ratio)} of what was held out ({held})." if ratio else ""


def _unknown_effect(tree: xr.DataTree) -> list[str]:
    """What remains was not named, or was named by effects that may imitate another."""
    residual, omnibus, added = residual_text(tree), _last(tree, "omnibus"), added_effects(tree)
    said = f"Unknown effect: {residual}, but"
    if misnamed := misnamed_effects(tree):
        known = " and ".join(f"{symbol} {value:g}" for symbol, value in misnamed.items())
        physics = f"the coefficient is not the one that physics knows ({known})"
        return [f"{said} {physics}: {IMITATED}.", *_unexplained(tree)]
    imitate = _imitation(_marked(tree, "collinear"))
    if omnibus.significant:
        return [*_not_explained(tree, residual, imitate), _omnibus(tree, omnibus)]
    if imitate:
        return [f"{said} {imitate}"]
    refuted = _marked(tree, "worsens_holdout")
    if refuted and not _last(tree, "ranking").significant.any():
        better = f"the model before {refuted[0]} was added predicts what was held out better"
        return [f"{said} {better}: {IMITATED}."]
    names = f"with {' and '.join(added)} " if added else ""
    if tree.attrs["converged"] != "True":
        rivals = "all that may stand in their place were" if added else "all candidates were"
        return [f"Unknown effect: {names}{residual}, but not {rivals} compared."]
    # The final model leaves more than noise of the sensor and a random force without cause.
    if float(tree.attrs.get("noise_p_value", 1.0)) < tree["ranking"].significance_level.item():
        driven = inputs_of(tree[record_groups(tree)[0]].to_dataset())
        why = "and no random force leaves it so: what is left goes with angle, speed or time"
        why = "as forces leave it that are missing, or coloured noise of the sensor" if driven else why
        return [f"Unknown effect: {names}{residual}, {why}.", *_unexplained(tree)]
    return _not_explained(tree, residual, "")


def _not_explained(tree: xr.DataTree, residual: str, imitate: str) -> list[str]:
    named = "the named effects do" if added_effects(tree) else "the model does"
    return [
        f"Unknown effect: {named} not explain the record; {residual}.",
        *force_type_sentences(tree, "discrepancy_after"),
        *_unexplained(tree),
        *([f"Of the effects that were added, {imitate}"] if imitate else []),
    ]


def _omnibus(tree: xr.DataTree, omnibus: xr.Dataset) -> str:
    return (
        f"The omnibus test rejects that nothing is missing (p {p_value_text(omnibus.p_value.item())}). "
        f"Its highest scores, by amplitude r and phase phi: {_highest(omnibus.z)}. "
        "What is missing moves coefficients too: errors are widened by the RMS of these scores, "
        f"{error_widening(tree):.3g}."
    )


def _imitation(effects: Sequence[str]) -> str:
    """That effects which are not separately identifiable may imitate another; empty without any."""
    if not effects:
        return ""
    several = len(effects) > 1
    return (
        f"{' and '.join(effects)} nearly cancel{'' if several else 's'} other forces of the model: "
        f"{'they' if several else 'it'} may imitate a force that is no candidate."
    )


def _marked(tree: xr.DataTree, mark: str) -> list[str]:
    """Symbols of the added effects of which a variable is true."""
    return [step.symbol.item() for step in steps_of(tree) if step[mark].item()]


def _last(tree: xr.DataTree, group: str) -> xr.Dataset:
    """The tests of a group after the last step."""
    return tree[group].to_dataset().isel(selection_step=-1)


def _ended_early(tree: xr.DataTree) -> list[str]:
    """That the search has not converged, and why."""
    if tree.attrs["converged"] == "True":
        return []
    limit = tree.attrs["out_of_time"]
    why = f"at its time limit of {limit}" if limit else "after as many fits as its settings allow"
    return [f"The search ended {why}, before it had converged."]


def _high_but_not_significant(tree: xr.DataTree) -> list[str]:
    """Candidates above the threshold of one test each, of many rows, that are not significant."""
    last = _last(tree, "ranking")
    limit = last.threshold.item()
    high = last.isel(candidate=(abs(last.z.values) > limit) & ~last.significant.values)
    if not high.sizes["candidate"]:
        return []
    named = ", ".join(f"{symbol} ({abs(z):.3g})" for symbol, z in high.z.to_series().items())
    why = "many frequencies were tried, or few swings tell how strong a random force is there"
    return [f"Above the threshold of {limit:.3g}, but not significant ({why}): {named}."]


def _unexplained(tree: xr.DataTree) -> list[str]:
    """At which amplitudes, and by the force map where in a cycle, what no candidate explains is largest."""
    after, units = tree["discrepancy_after"].to_dataset(), signal_units(tree)
    ratio, amplitude = after.rms.values / record_noise(tree), after.amplitude.values
    high, most = ratio > SHOWN_RATIO, int(np.argmax(ratio))
    if not high.any():
        return []
    where = (
        f"What no candidate explains is more than {SHOWN_RATIO:g} times the noise at amplitudes of "
        f"{amplitude[high].min():.3g} to {amplitude[high].max():.3g} {units}, and most at "
        f"{amplitude[most]:.3g} {units}, {ratio[most]:.3g} times."
    )
    cells = (after.force / after.standard_error).where(abs(after.force) > 0.0).to_series().dropna()
    if not len(cells):
        return [where]
    x, v = cells.abs().idxmax()
    return [
        f"{where} The force that is missing stands out most near x = {x:.2g}, v = {v:.2g} {units}: "
        f"{after.force.sel(x=x, v=v).item():.2g} {units} times I w^2."
    ]


def _highest(z: xr.DataArray) -> str:
    """The largest scores, and what they are of."""
    highest = z.to_series().sort_values(key=np.abs, ascending=False)[:MOST_NAMED]
    return ", ".join(f"{name} (z = {score:.3g})" for name, score in highest.items())


def _outstanding(tree: xr.DataTree) -> list[str]:
    """Candidates whose scores stand out at the end, and why none was added."""
    last = _last(tree, "ranking")
    strong = last.isel(candidate=last.significant.values)
    if not strong.sizes["candidate"]:
        return []
    most, refused = tree.attrs["max_effects"], tree.attrs.get("not_improving")
    reason = (
        f"no more than {most} effects were asked for (--max-effects)"
        if tree["steps"].attrs["count"] >= most
        else "the search ended before they were fitted"
        if tree.attrs["converged"] != "True"
        else f"{refused} is the likeliest, but in the model it does not improve what was held out"
        if refused
        else "fitted in full, none reduces the gap as its score promises"
    )
    return [f"By their scores, these candidates stand out: {_highest(strong.z)}; {reason}."]


def _stability(tree: xr.DataTree) -> list[str]:
    """In how many parts of the record each name stands, and what is likelier where it does not."""
    if not added_effects(tree):
        return []
    texts = []
    for step in steps_of(tree):
        symbol, others = step.symbol.item(), Counter(step.likeliest_in_parts.item().split(PAIRS))
        del others[symbol]
        likelier = ", ".join(f"{name or 'no force'} is likelier in {count}" for name, count in others.items())
        stands = f"{symbol} in {step.stands_in.item()} of {len(RECORD_PARTS)}"
        texts.append(f"{stands} ({likelier})" if likelier else stands)
    parts = ", ".join(RECORD_PARTS)
    return [f"Looked at again on parts of the record ({parts}), these names stand: {'; '.join(texts)}."]


def _model(tree: xr.DataTree) -> str:
    """Frequency and forces of the final model that no step has named."""
    after, effects = tree["after"].to_dataset(), added_effects(tree)
    values = [f"w = {quantity(after, 'reference_frequency', ' rad/s')}"]
    for symbol in after.force.values.tolist():
        if symbol not in effects:
            values.append(f"{symbol} = {coefficient_text(after.sel(force=symbol))}")
    return f"The model has {'besides ' if effects else ''}{', '.join(values)}."
