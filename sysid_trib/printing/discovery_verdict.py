"""The verdict of a discovery in sentences: is the record explained, and what remains."""

from collections import Counter
from collections.abc import Iterator

import numpy as np
import xarray as xr

from sysid_trib.printing import discovery_tables as tables, layout, verdict
from sysid_trib.printing.equation import equation_text
from sysid_trib.records.decay import RECORD_PARTS
from sysid_trib.records.inputs import inputs_of
from sysid_trib.results.effects import (
    PAIRS,
    added_effects,
    determines,
    error_widening,
    misnamed_effects,
    steps_taken,
)
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
    return [
        *(_unknown_effect(tree) if tree.attrs["verdict"] == "unknown effect" else _closed(tree)),
        *_search(tree),
        *verdict.heterogeneity_sentences(tree),
        *_model(tree),
    ]


def _closed(tree: xr.DataTree) -> Iterator[str]:
    """Report that the residual contains nothing more."""
    effects = " and ".join(map(tables.effect_with_ties, steps_taken(tree)))
    after, residual, ratio = tree["after"].to_dataset(), tables.residual_text(tree), held_out_excess(tree)
    held = f"{tables.times_noise(ratio)} of what was held out ({tree.attrs['held_out']})" if ratio else ""
    unpredicted = f" But it leaves {held}." if held else ""
    if not determines(after):
        yield UNDECIDED
        yield UNSEEN
    elif closing := tree.attrs.get("closing_effect"):
        most = tree.attrs["max_effects"]
        asked = f"{most} effect{'s were' if most > 1 else ' was'} asked for (--max-effects)"
        yield (
            f"Explained but for the limit that ended the search: with {effects} {residual}; with {closing} "
            f"it would close, but no more than {asked}.{unpredicted}"
        )
    else:
        level, ranking = tree["ranking"].significance_level.item(), _last(tree, "ranking")
        stochastic = float(np.min(after.random_force_p_value)) < level
        headline = f"Explained: with {effects}" if effects else "No missing effect was found:"
        candidates = f"the {'other ' if effects else ''}candidates or by " * (not ranking.significant.any())
        yield (
            f"{headline} {residual}{', as a random force leaves it' * stochastic}.{unpredicted} No further "
            f"departure was found by {candidates}the omnibus test (significance level {level:.2g})."
        )
        yield UNSEEN
        yield from _high_but_not_significant(ranking)


def _unknown_effect(tree: xr.DataTree) -> Iterator[str]:
    """Describe a residual without a name, or with names that may imitate another effect."""
    residual, omnibus, added = tables.residual_text(tree), _last(tree, "omnibus"), added_effects(tree)
    imitating, refuted = _marked(tree, "collinear"), _marked(tree, "worsens_holdout")
    nothing, names = f"Unknown effect: {residual}, but", f"with {' and '.join(added)} " if added else ""
    several, level = len(imitating) > 1, tree["ranking"].significance_level.item()
    imitation = (
        f"{' and '.join(imitating)} nearly cancel{'' if several else 's'} other forces of the model: "
        f"{'they' if several else 'it'} may imitate a force that is no candidate."
    )
    if refused := tree.attrs.get("refused_by_laws"):
        yield (
            f"Unknown effect: {residual}. The names {refused} predict the held-out part worse than smooth "
            "laws of friction and restoring force, which need no name: they were not added."
        )
        yield from _unexplained(tree)
    elif misnamed := misnamed_effects(tree):
        known = " and ".join(f"{symbol} {value:g}" for symbol, value in misnamed.items())
        yield f"{nothing} the coefficient is not the one that physics knows ({known}): {IMITATED}."
        yield from _unexplained(tree)
    elif omnibus.significant:
        yield from _not_explained(tree, residual)
        if imitating:
            yield f"Of the effects that were added, {imitation}"
        yield (
            f"The omnibus test rejects that nothing is missing (p "
            f"{layout.p_value_text(omnibus.p_value.item())}). Its highest scores, by amplitude r and phase "
            f"phi: {_highest(omnibus.z)}. What is missing moves coefficients too: errors are widened by the "
            f"RMS of these scores, {error_widening(tree):.3g}."
        )
    elif imitating:
        yield f"{nothing} {imitation}"
    elif refuted and not _last(tree, "ranking").significant.any():
        better = f"the model before {refuted[0]} was added predicts what was held out better"
        yield f"{nothing} {better}: {IMITATED}."
    elif tree.attrs["converged"] != "True":
        rivals = "all that may stand in their place were" if added else "all candidates were"
        yield f"Unknown effect: {names}{residual}, but not {rivals} compared."
    # The final model leaves more than noise of the sensor and a random force without cause.
    elif float(tree.attrs.get("noise_p_value", 1.0)) < level:
        driven = inputs_of(tree[record_groups(tree)[0]].to_dataset())
        why = "and no random force leaves it so: what is left goes with angle, speed or time"
        why = "as forces leave it that are missing, or coloured noise of the sensor" if driven else why
        yield f"Unknown effect: {names}{residual}, {why}."
        yield from _unexplained(tree)
    else:
        yield from _not_explained(tree, residual)


def _not_explained(tree: xr.DataTree, residual: str) -> Iterator[str]:
    named = "the named effects do" if added_effects(tree) else "the model does"
    yield f"Unknown effect: {named} not explain the record; {residual}."
    yield from tables.force_type_sentences(tree, "discrepancy_after")
    yield from _unexplained(tree)


def _marked(tree: xr.DataTree, mark: str) -> list[str]:
    """Symbols of the added effects of which a variable is true."""
    return [step.symbol.item() for step in steps_taken(tree) if step[mark].item()]


def _last(tree: xr.DataTree, group: str) -> xr.Dataset:
    """The tests of a group after the last step."""
    return tree[group].to_dataset().isel(selection_step=-1)


def _high_but_not_significant(last: xr.Dataset) -> Iterator[str]:
    """Candidates above the threshold of one test each, of many rows, that are not significant."""
    limit = last.threshold.item()
    high = last.isel(candidate=(abs(last.z.values) > limit) & ~last.significant.values)
    if high.sizes["candidate"]:
        named = ", ".join(f"{symbol} ({abs(z):.3g})" for symbol, z in high.z.to_series().items())
        why = "many frequencies were tried, or few swings tell how strong a random force is there"
        yield f"Above the threshold of {limit:.3g}, but not significant ({why}): {named}."


def _unexplained(tree: xr.DataTree) -> Iterator[str]:
    """Describe at which amplitudes, and where in a cycle, the unexplained residual is largest."""
    after, units = tree["discrepancy_after"].to_dataset(), signal_units(tree)
    ratio, amplitude = after.rms.values / record_noise(tree), after.amplitude.values
    high, most = ratio > SHOWN_RATIO, int(np.argmax(ratio))
    if not high.any():
        return
    cells = (after.force / after.standard_error).where(abs(after.force) > 0.0).to_series().dropna()
    where = ""
    if len(cells):
        x, v = cells.abs().idxmax()
        where = (
            f" The force that is missing stands out most near x = {x:.2g}, v = {v:.2g} {units}: "
            f"{after.force.sel(x=x, v=v).item():.2g} {units} times I w^2."
        )
    yield (
        f"What no candidate explains is more than {SHOWN_RATIO:g} times the noise at amplitudes of "
        f"{amplitude[high].min():.3g} to {amplitude[high].max():.3g} {units}, and most at "
        f"{amplitude[most]:.3g} {units}, {ratio[most]:.3g} times.{where}"
    )


def _highest(z: xr.DataArray) -> str:
    """The largest scores, and what they are of."""
    highest = z.to_series().sort_values(key=np.abs, ascending=False)[:MOST_NAMED]
    return ", ".join(f"{name} (z = {score:.3g})" for name, score in highest.items())


def _search(tree: xr.DataTree) -> Iterator[str]:
    """Describe the end of the search, remaining candidates, and the parts in which each name remains."""
    attrs, last, stands = tree.attrs, _last(tree, "ranking"), list[str]()
    converged, limit, most = attrs["converged"] == "True", attrs["out_of_time"], attrs["max_effects"]
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
            else f"{refused} is the likeliest, but in the model it does not improve what was held out"
            if refused
            else "fitted in full, none reduces the gap as its score promises"
        )
        strong = _highest(last.isel(candidate=last.significant.values).z)
        yield f"By their scores, these candidates stand out: {strong}; {reason}."
    for step in steps_taken(tree):
        symbol, others = step.symbol.item(), Counter(step.likeliest_in_parts.item().split(PAIRS))
        del others[symbol]
        likelier = ", ".join(f"{name or 'no force'} is likelier in {count}" for name, count in others.items())
        stands.append(f"{symbol} in {step.stands_in.item()} of {len(RECORD_PARTS)}")
        stands[-1] += f" ({likelier})" if likelier else ""
    if stands:
        parts = ", ".join(RECORD_PARTS)
        yield f"Looked at again on parts of the record ({parts}), these names stand: {'; '.join(stands)}."


def _model(tree: xr.DataTree) -> Iterator[str]:
    """Frequency and forces of the final model that no step has named, and its equation."""
    after, effects = tree["after"].to_dataset(), added_effects(tree)
    own = after.drop_sel(force=effects)
    values = [
        f", {symbol} = {layout.coefficient_text(f)}" for symbol, f in layout.by_label(own, "force").items()
    ]
    w = layout.quantity(after, "reference_frequency", " rad/s")
    yield f"The model has {'besides ' if effects else ''}w = {w}{''.join(values)}."
    yield from verdict.constraint_sentences([after])
    yield f"Equation: {equation_text(after)}."
