"""The verdict of a discovery in sentences: is the record explained, and what remains."""

import numpy as np
import xarray as xr

from sysid_trib.printing.discovery_tables import effect_with_ties
from sysid_trib.printing.equation import equation_text
from sysid_trib.printing.layout import coefficient_text, constraint_sentences, p_value_text, quantity
from sysid_trib.printing.residual import (
    force_type_sentences,
    noise_of,
    residual_of,
    residual_sentences,
    times_noise,
)
from sysid_trib.printing.runs import heterogeneity_sentences
from sysid_trib.printing.stability import stability_sentences
from sysid_trib.results.discoveries import added_effects, error_widening, misnamed_effects
from sysid_trib.results.signal_units import signal_units
from sysid_trib.results.significance import determines

# Forces of the omnibus test, and candidates, that are named where they stand out.
MOST_NAMED = 3
UNDECIDED = (
    "The record decides nothing: no coefficient of the model differs from zero, and no candidate stands out. "
    "A longer motion, from a larger amplitude, would."
)
# Noise levels above which a gap is shown.
SHOWN_RATIO = 2.0
UNSEEN = "An effect that is weaker than its detectable coefficient may be present and unseen."


def verdict_sentences(tree: xr.DataTree, *, details: bool = True) -> list[str]:
    """The verdict in its first sentence, then what remains and the model.

    Parameters
    ----------
    tree : DataTree
        Result of `discover`.
    details : bool
        Say also where the final model and the record differ.

    Returns
    -------
    list of str
    """
    sentences = _unknown_effect(tree, details) if tree.attrs["verdict"] == "unknown effect" else _closed(tree)
    return [
        *sentences,
        *_ended_early(tree),
        *_outstanding(tree),
        *stability_sentences(tree),
        *heterogeneity_sentences(tree),
        _model(tree),
        *constraint_sentences([tree["after"].to_dataset()]),
        f"Equation: {equation_text(tree['after'].to_dataset())}.",
    ]


def _ended_early(tree: xr.DataTree) -> list[str]:
    """That the search has not converged, and why."""
    if tree.attrs["converged"] == "True":
        return []
    limit = tree.attrs["out_of_time"]
    why = f"at its time limit of {limit}" if limit else "after as many fits as its settings allow"
    return [f"The search ended {why}, before it had converged."]


def _last(tree: xr.DataTree, group: str) -> xr.Dataset:
    """The tests of a group after the last step."""
    return tree[group].to_dataset().isel(selection_step=-1)


def _closed(tree: xr.DataTree) -> list[str]:
    """Nothing more stands out of the residual."""
    residual = times_noise(residual_of(tree, "after"), noise_of(tree))
    steps = tree["steps"].to_dataset()
    effects = [effect_with_ties(steps.isel(step=at)) for at in range(steps.attrs["count"])]
    after = tree["after"].to_dataset()
    if not determines(after):
        return [UNDECIDED, UNSEEN]
    level = tree["ranking"].significance_level.item()
    by_noise = float(np.min(after.random_force_p_value))
    pushed = ", as a random force leaves it" if by_noise < level else ""
    if closing := tree.attrs.get("closing_effect"):
        most = tree.attrs["max_effects"]
        return [
            f"Explained but for the limit that ended the search: with {' and '.join(effects)} the gap is "
            f"{residual}; with {closing} it would close, but no more than {most} effect{'s' * (most > 1)} "
            f"{'were' if most > 1 else 'was'} asked for (--max-effects)."
        ]
    headline = (
        f"Explained: with {' and '.join(effects)} the gap is {residual}{pushed}."
        if effects
        else f"No missing effect was found: the gap is {residual}{pushed}."
    )
    tests = ["the omnibus test"]
    if not _last(tree, "ranking").significant.any():
        tests.insert(0, "the other candidates" if effects else "the candidates")
    absent = f"No further departure was found by {' or by '.join(tests)} (significance level {level:.2g})."
    return [f"{headline} {absent}", UNSEEN, *_high_but_not_significant(tree)]


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


def _unknown_effect(tree: xr.DataTree, details: bool) -> list[str]:
    """What remains was not named, or was named by effects that may imitate another."""
    residual = times_noise(residual_of(tree, "after"), noise_of(tree))
    omnibus = _last(tree, "omnibus")
    effects = _collinear(tree)
    collinear, several = " and ".join(effects), len(effects) > 1
    imitate = (
        f"{collinear} nearly cancel{'' if several else 's'} other forces of the model: "
        f"{'they' if several else 'it'} may imitate a force that is no candidate."
    )
    if misnamed := misnamed_effects(tree):
        known = " and ".join(f"{symbol} {value:g}" for symbol, value in misnamed.items())
        return [
            f"Unknown effect: the gap is {residual}, but the coefficient is not the one that physics knows "
            f"({known}): a force that is no candidate may be imitated.",
            *_unexplained(tree),
        ]
    if collinear and not omnibus.significant:
        return [f"Unknown effect: the gap is {residual}, but {imitate}"]
    refuted = _refuted(tree)
    added = added_effects(tree)
    if refuted and not omnibus.significant and not _last(tree, "ranking").significant.any():
        return [
            f"Unknown effect: the gap is {residual}, but the model before {refuted[0]} was added predicts "
            "what was held out better: a force that is no candidate may be imitated."
        ]
    if tree.attrs["converged"] != "True" and not omnibus.significant:
        names = f"with {' and '.join(added)} " if added else ""
        rivals = "all that may stand in their place were" if added else "all candidates were"
        return [f"Unknown effect: {names}the gap is {residual}, but not {rivals} compared."]
    if _is_no_noise(tree) and not omnibus.significant:
        names = f"with {' and '.join(added)} " if added else ""
        return [
            f"Unknown effect: {names}the gap is {residual}, and no random force leaves it so: what is left "
            "goes with angle, speed or time.",
            *_unexplained(tree),
        ]
    named = "the named effects do" if added else "the model does"
    sentences = [f"Unknown effect: {named} not explain the record; the gap is {residual}."]
    sentences += (residual_sentences if details else force_type_sentences)(tree, "discrepancy_after")
    sentences += _unexplained(tree)
    if collinear:
        sentences.append(f"Of the effects that were added, {imitate}")
    if omnibus.significant:
        sentences.append(
            f"The omnibus test rejects that nothing is missing (p {p_value_text(omnibus.p_value.item())}). "
            f"Its highest scores, by amplitude r and phase phi: {_highest(omnibus.z)}. "
            "What is missing moves coefficients too: errors are widened by the RMS of these scores, "
            f"{error_widening(tree):.3g}."
        )
    return sentences


def _is_no_noise(tree: xr.DataTree) -> bool:
    """Whether the final model leaves more than noise of the sensor and a random force without cause."""
    return float(tree.attrs.get("noise_p_value", 1.0)) < tree["ranking"].significance_level.item()


def _unexplained(tree: xr.DataTree) -> list[str]:
    """At which amplitudes, and by the force map where in a cycle, what no candidate explains is largest."""
    after, units = tree["discrepancy_after"].to_dataset(), signal_units(tree)
    ratio, amplitude = after.rms.values / noise_of(tree), after.amplitude.values
    high, most = ratio > SHOWN_RATIO, int(np.argmax(ratio))
    if not high.any():
        return []
    cells = (after.force / after.standard_error).where(abs(after.force) > 0.0).to_series().dropna()
    cell = cells.abs().idxmax() if len(cells) else None
    force = (
        ""
        if cell is None
        else (
            f" The force that is missing stands out most near x = {cell[0]:.2g}, v = {cell[1]:.2g} {units}: "
            f"{after.force.sel(x=cell[0], v=cell[1]).item():.2g} {units} times I w^2."
        )
    )
    return [
        f"What no candidate explains is more than {SHOWN_RATIO:g} times the noise at amplitudes of "
        f"{amplitude[high].min():.3g} to {amplitude[high].max():.3g} {units}, and most at "
        f"{amplitude[most]:.3g} {units}, {ratio[most]:.3g} times.{force}"
    ]


def _collinear(tree: xr.DataTree) -> list[str]:
    """Symbols of the added effects that are not separately identifiable."""
    if not tree["steps"].attrs["count"]:
        return []
    steps = tree["steps"].to_dataset()
    return [str(symbol) for symbol in steps.symbol.values[steps.collinear.values]]


def _refuted(tree: xr.DataTree) -> list[str]:
    """Symbols of the added effects before which the model predicted what was held out better."""
    if not tree["steps"].attrs["count"]:
        return []
    steps = tree["steps"].to_dataset()
    return [str(symbol) for symbol in steps.symbol.values[steps.worsens_holdout.values.astype(bool)]]


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


def _model(tree: xr.DataTree) -> str:
    """Frequency and forces of the final model that no step has named."""
    after, effects = tree["after"].to_dataset(), added_effects(tree)
    values = [f"w = {quantity(after, 'reference_frequency', ' rad/s')}"]
    for symbol in after.force.values.tolist():
        if symbol not in effects:
            values.append(f"{symbol} = {coefficient_text(after.sel(force=symbol))}")
    return f"The model has {'besides ' if effects else ''}{', '.join(values)}."
