"""Verdict of a discovery in sentences: is the record explained, and what remains."""

from collections import Counter
from collections.abc import Iterator

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.printing import discovery_tables as tables, layout, verdict
from sysid_trib.printing.equation import equation_text
from sysid_trib.results import judged
from sysid_trib.results.effects import (
    added_effects,
    determines,
    error_widening,
    misnamed_effects,
    steps_taken,
)
from sysid_trib.results.judged import held_out_excess, record_noise
from sysid_trib.results.kinds import has_input
from sysid_trib.results.variables import PARTS_OF_RECORD, record_groups, signal_units

# Words for the verdict of the judge, for a search that found nothing more.
UNEXPLAINED_WORDS = {
    "approximate": "The model is approximate",
    "not explained": "The model does not explain the record",
}
# Largest number of named force terms of the omnibus test, and of named candidates.
MOST_NAMED = 3
UNDECIDED = (
    "The record does not determine the forces: no coefficient of the model differs from zero, and no "
    "candidate is significant. A longer motion from a larger amplitude would help."
)
# Ratio to the noise above which a residual is shown.
SHOWN_RATIO = 2.0
UNSEEN = "An effect weaker than its detectable coefficient may still be present."
IMITATED = "the model may imitate a force that is not among the candidates"


def verdict_sentences(tree: xr.DataTree) -> list[str]:
    """Describe the verdict of a result of `discover`, the residual, and the model."""
    return [
        *(_unknown_effect(tree) if judged.has_unknown_effect(tree) else _closed(tree)),
        *_search(tree),
        *verdict.heterogeneity_sentences(tree),
        *_model(tree),
    ]


def _closed(tree: xr.DataTree) -> Iterator[str]:
    """State that the residual contains nothing more; the first word is the judge's verdict."""
    effects = " and ".join(map(tables.effect_with_ties, steps_taken(tree)))
    after, residual, ratio = tree["after"].to_dataset(), tables.residual_text(tree), held_out_excess(tree)
    held = f"{tables.times_noise(ratio)} on the held-out part ({tree.attrs['held_out']})" if ratio else ""
    unpredicted = f" But the residual is {held}." if held else ""
    word = judged.verdict_of(tree)
    if not determines(after):
        yield UNDECIDED
        yield UNSEEN
    elif closing := tree.attrs.get("closing_effect"):
        most = tree.attrs["max_effects"]
        asked = f"{most} effect{'s were' if most > 1 else ' was'} asked for (--max-effects)"
        yield (
            f"Explained except for one effect: with {effects} {residual}. With {closing} the residual would "
            f"be noise, but no more than {asked}.{unpredicted}"
        )
    else:
        level, ranking = tree["ranking"].significance_level.item(), _last(tree, "ranking")
        stochastic = word == "explained with a random force"
        headline = f"Explained: with {effects}" if effects else "No missing effect was found:"
        if judged.is_unexplained(tree):
            what = f"with {effects}" if effects else "no missing effect was found;"
            headline = f"{UNEXPLAINED_WORDS[word]}: {what}"
        tests = "neither the candidates nor the omnibus test finds" * (not ranking.significant.any())
        tests = tests or "the omnibus test does not find"
        nothing = f"{tests.capitalize()} a further effect (significance level {level:.2g})."
        if np.isnan(_last(tree, "omnibus").p_value):
            # A search by motions ends at a residual that is noise.
            nothing = f"The residual is noise, so that no further effect is needed (level {level:.2g})."
        yield (
            f"{headline} {residual}{', as expected with a random force' * stochastic}.{unpredicted} {nothing}"
        )
        yield UNSEEN
        yield from _high_but_not_significant(ranking)


def _unknown_effect(tree: xr.DataTree) -> Iterator[str]:
    """Describe a residual without a name, or with names that may stand for another effect."""
    residual, omnibus, added = tables.residual_text(tree), _last(tree, "omnibus"), added_effects(tree)
    imitating, refuted = _marked(tree, "collinear"), _marked(tree, "worsens_holdout")
    nothing, names = f"Unknown effect: {residual}, but", f"with {' and '.join(added)} " if added else ""
    several, level = len(imitating) > 1, tree["ranking"].significance_level.item()
    imitation = (
        f"{' and '.join(imitating)} nearly cancel{'' if several else 's'} other forces of the model and may "
        "imitate a force that is not among the candidates."
    )
    if refused := tree.attrs.get("refused_by_laws"):
        yield (
            f"Unknown effect: {residual}. The effects {refused} predict the held-out part worse than smooth "
            "laws of friction and restoring force. They were not added."
        )
        yield from _unexplained(tree)
    elif misnamed := misnamed_effects(tree):
        known = " and ".join(f"{symbol} {value:g}" for symbol, value in misnamed.items())
        yield f"{nothing} the coefficient differs from its physical value ({known}): {IMITATED}."
        yield from _unexplained(tree)
    elif omnibus.significant:
        yield from _not_explained(tree, residual)
        if imitating:
            yield f"Among the added effects, {imitation}"
        yield (
            f"The omnibus test shows that an effect is missing (p "
            f"{layout.p_value_text(omnibus.p_value.item())}). Its largest scores, of force terms "
            f"in amplitude r and phase phi: {_highest(omnibus.z)}. The missing effect also biases the "
            "coefficients: standard errors are multiplied by the RMS of all scores of this test, "
            f"{error_widening(tree):.3g}."
        )
    elif imitating:
        yield f"{nothing} {imitation}"
    elif refuted and not _last(tree, "ranking").significant.any():
        better = f"the model without {refuted[0]} predicts the held-out part better"
        yield f"{nothing} {better}: {IMITATED}."
    elif not tree["converged"]:
        rivals = "alternatives to these effects" if added else "candidates"
        yield f"Unknown effect: {names}{residual}, but not all {rivals} were compared."
    # The residual of the final model exceeds noise of the sensor and an unexplained random force.
    elif float(tree.attrs.get("noise_p_value", 1.0)) < level:
        driven = has_input(tree[record_groups(tree)[0]].to_dataset())
        why = "The residual depends on angle, speed or time, so it is not a random force"
        why = "A force is missing, or the sensor's noise is coloured" if driven else why
        yield f"Unknown effect: {names}{residual}. {why}."
        yield from _unexplained(tree)
    else:
        yield from _not_explained(tree, residual)


def _not_explained(tree: xr.DataTree, residual: str) -> Iterator[str]:
    named = f"with {' and '.join(added)} " if (added := added_effects(tree)) else ""
    how = "is approximate" if judged.verdict_of(tree) == "approximate" else "does not explain the record"
    yield f"Unknown effect: {named}the model {how}; {residual}."
    yield from tables.force_type_sentences(tree, "discrepancy_after")
    yield from _unexplained(tree)


def _marked(tree: xr.DataTree, mark: str) -> list[str]:
    """Return the symbols of the added effects of which a variable is true."""
    return [step.symbol.item() for step in steps_taken(tree) if step[mark].item()]


def _last(tree: xr.DataTree, group: str) -> xr.Dataset:
    """Return the tests of a group after the last step."""
    return tree[group].to_dataset().isel(selection_step=-1)


def _high_but_not_significant(last: xr.Dataset) -> Iterator[str]:
    """Name the candidates whose score is high for a single test but not significant among all."""
    limit = last.threshold.item()
    high = last.isel(candidate=(abs(last.z.values) > limit) & ~last.significant.values)
    if high.sizes["candidate"]:
        named = ", ".join(f"{symbol} ({abs(z):.3g})" for symbol, z in high.z.to_series().items())
        why = "many frequencies were tried, or few swings determine the random force there"
        yield f"Not significant although |z| exceeds {limit:.3g} ({why}): {named}."


def _unexplained(tree: xr.DataTree) -> Iterator[str]:
    """Describe the amplitudes and the phase of the cycle at which the unexplained residual is largest."""
    after, units = tree["discrepancy_after"].to_dataset(), signal_units(tree)
    ratio, amplitude = after.rms.values / record_noise(tree), after.amplitude.values
    high, most = ratio > SHOWN_RATIO, int(np.argmax(ratio))
    if not high.any():
        return
    cells = (after.force / after.force_standard_error).where(abs(after.force) > 0.0).to_series().dropna()
    where = ""
    if len(cells):
        x, v = cells.abs().idxmax()
        where = (
            f" The missing force is most significant near x = {x:.2g}, v = {v:.2g} {units}: it is "
            f"{after.force.sel(x=x, v=v).item():.2g} {units} there, times I w^2."
        )
    yield (
        f"No candidate explains the residual {_between(amplitude[high], units)}; it is largest at "
        f"{amplitude[most]:.3g} {units}, {ratio[most]:.3g} times the noise.{where}"
    )


def _between(amplitude: Array, units: str) -> str:
    """Return the range of amplitudes in words."""
    low, high = (f"{end(amplitude):.3g}" for end in (np.min, np.max))
    return f"at {low} {units}" if low == high else f"between {low} and {high} {units}"


def _highest(z: xr.DataArray) -> str:
    """Return the largest scores and their candidates."""
    highest = z.to_series().sort_values(key=np.abs, ascending=False)[:MOST_NAMED]
    return ", ".join(f"{name} (z = {score:.3g})" for name, score in highest.items())


def _search(tree: xr.DataTree) -> Iterator[str]:
    """Describe the end of the search, remaining candidates, and the parts in which each name remains."""
    attrs, last, stands = tree.attrs, _last(tree, "ranking"), list[str]()
    converged, limit, most = bool(tree["converged"]), attrs["out_of_time"], attrs["max_effects"]
    if not converged:
        why = f"at its time limit of {limit}" if limit else "after as many fits as its settings allow"
        yield f"The search ended {why}, before it had converged."
    if last.significant.any():
        refused = attrs.get("not_improving")
        reason = (
            f"no more than {most} effects were asked for (--max-effects)"
            if tree["steps"].attrs["count"] >= most
            else "the search ended before they were fitted"
            if not converged
            else f"the best of them, {refused}, does not improve the held-out prediction and was not added"
            if refused
            else "fitted in full, none reduces the residual as expected from its score"
        )
        strong = _highest(last.isel(candidate=last.significant.values).z)
        yield f"Candidates with significant scores: {strong}; {reason}."
    # A search by motions compares runs, not parts of a record.
    for step in (step for step in steps_taken(tree) if "likeliest_in_parts" in step):
        symbol, others = step.symbol.item(), Counter(step.likeliest_in_parts.values.tolist())
        del others[symbol]
        likelier = ", ".join(
            f"{name or 'no force'} more probable in {count}" for name, count in others.items()
        )
        stands.append(f"{symbol} in {step.stands_in.item()} of {len(PARTS_OF_RECORD)}")
        stands[-1] += f" ({likelier})" if likelier else ""
    if stands:
        parts = ", ".join(PARTS_OF_RECORD)
        yield f"In parts of the record ({parts}), the 95 % credible set contains {'; '.join(stands)}."


def _model(tree: xr.DataTree) -> Iterator[str]:
    """Describe frequency and unnamed forces of the final model, and its equation."""
    after, effects = tree["after"].to_dataset(), added_effects(tree)
    own = after.drop_sel(force=effects)
    values = [
        f", {symbol} = {layout.coefficient_text(f)}" for symbol, f in layout.by_label(own, "force").items()
    ]
    w = layout.quantity(after, "reference_frequency", " rad/s")
    yield f"{'Other parameters' if effects else 'Parameters'} of the model: w = {w}{''.join(values)}."
    yield from verdict.constraint_sentences([after])
    yield f"Equation: {equation_text(after)}."
