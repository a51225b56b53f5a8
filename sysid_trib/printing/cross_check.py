"""The cross-check of two methods in plain sentences: do they agree, what is left, what follows."""

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from sysid_trib.noise.random_force import random_force_of
from sysid_trib.printing.layout import constraint_sentences, identifiability_warnings
from sysid_trib.printing.model_verdict import (
    answer_of,
    effective_sentences,
    failure_sentences,
    failures,
    holds,
    kept_results,
    verdict_sentence,
)
from sysid_trib.printing.physics import physics_sentences
from sysid_trib.printing.random_force import random_force_sentences
from sysid_trib.printing.residual import residual_of
from sysid_trib.results.per_run import group_names, record_groups
from sysid_trib.results.schema import library_of
from sysid_trib.results.signal_units import signal_units
from sysid_trib.validation.breakdown import record_noise

# Between the level at which methods disagree and this one they agree, but barely.
BARELY = 0.05
NO_CONSEQUENCES = "Weights, crossovers and arrest are not given: the model {} the record."


def identification_sentences(tree: xr.DataTree) -> list[str]:
    """The cross-check in plain sentences: is the record explained, do the methods agree, what to mind."""
    said = [verdict_sentence(tree), *failure_sentences(tree), *effective_sentences(tree)]
    return [*said, *agreement_sentences(tree, details=True)]


def agreement_sentences(tree: xr.DataTree, *, details: bool = False) -> list[str]:
    """Whether the methods agree, and all that warns.

    Parameters
    ----------
    tree : DataTree
        Result of `cross_check`.
    details : bool
        Say also how large the residuals are, and what a single record cannot tell.
    """
    checked, results = tree["comparison"].ds, kept_results(tree)
    second = tree[checked.attrs["second"]].to_dataset()
    sentences = [] if failures(tree) else [_agreement_sentence(checked)]
    if details and not failures(tree):
        sentences += _agreement_test(checked)
    if details:
        sentences += [_residual_sentence(tree, name) for name in results]
    if checked.attrs["second"] in results:
        sentences += random_force_sentences(tree, float(amplitudes(tree).max()))
    for name, result in results.items():
        sentences += _remarks(name, result)
    sentences += [*constraint_sentences(results.values()), *_held_shapes(second)]
    sentences += identifiability_warnings(checked.attrs)
    stiffness = library_of(second, whole=True).role("x")
    if details and stiffness is not None and stiffness.symbol not in second.force:
        symbol = stiffness.symbol
        sentences.append(
            f"In a single record, {symbol} cannot be separated from the frequency: give --omega0 (frequency "
            f"without contact) to identify {symbol}."
        )
    return sentences


def _agreement_sentence(checked: xr.Dataset) -> str:
    pair = f"{checked.attrs['first'].capitalize()} and {checked.attrs['second']}{_part(checked)}"
    if checked.attrs["verdict"] == "unknown":
        return (
            f"{pair} cannot be compared: the error of their difference could not be computed{_few(checked)}."
        )
    if checked.attrs["verdict"] == "disagree":
        return f"{pair} disagree."
    if checked.p_value.item() < BARELY:
        return f"{pair} agree, but barely."
    if checked.attrs.get("verdict_on_record", "").startswith("explained"):
        return f"{pair} agree within their errors."
    return f"{pair} differ by no more than their errors."


def _agreement_test(checked: xr.Dataset) -> list[str]:
    """The test behind the sentence on agreement."""
    if checked.attrs["verdict"] == "unknown":
        return []
    # The records that count are fewer than were drawn where the motion is pushed and one was not identified.
    records = checked.attrs.get("simulated_records", checked.attrs["draws"])
    stated = checked.attrs.get("errors") == "stated"
    errors = "stated errors" if stated else f"Hotelling, {records} simulated records"
    return [
        f"Their differences: chi-square {checked.chi_square.item():.3g} for "
        f"{checked.degrees_of_freedom.item()} of them, p = {checked.p_value.item():.2g} ({errors})."
    ]


def _part(checked: xr.Dataset) -> str:
    """On which part of a long record the methods are compared."""
    duration = checked.attrs.get("compared_stretch")
    return "" if duration is None else f", compared on stretches of {duration:.3g} s,"


def _few(checked: xr.Dataset) -> str:
    """That too few simulated records were identified, where these are counted."""
    if "simulated_records" not in checked.attrs:
        return ""
    records, draws = checked.attrs["simulated_records"], checked.attrs["draws"]
    return f" (both methods identified {records} of {draws} simulated records)"


def _residual_sentence(tree: xr.DataTree, name: str) -> str:
    """RMS of record minus model over the noise; beside a random force what is predicted a step ahead."""
    rms, unit = residual_of(tree, name), signal_units(tree)
    checked = tree["comparison"].sel(model=name)
    start = checked.departure_time.item()
    ratio = f"{rms / record_noise(tree):.3g} times the noise"
    text = f"The residual of the model from {name} is {rms:.3g} {unit} (RMS), {ratio}"
    if random_force_of(tree[name].to_dataset()):
        ahead = checked.residual_over_noise.item()
        return f"{text}; one sample ahead it predicts the record to {ahead:.3g} of the error that it states."
    return f"{text}." if np.isnan(start) else f"{text}; it exceeds the noise from {start:.3g} s on."


def _held_shapes(result: xr.Dataset) -> list[str]:
    if "shape" not in result:
        return []
    held = ", ".join(f"{name} = {value:g}" for name, value in result["shape"].to_series().items())
    return [f"Held, not fitted: {held} (--set to change)."]


def consequences(tree: xr.DataTree, inertia: float | None) -> list[str]:
    """What follows from the second identification, in sentences; with an inertia (kg m^2) in SI units too.

    Nothing follows from a model that does not hold.
    """
    if not holds(tree):
        undetermined = tree["comparison"].attrs["verdict_on_record"] == "undetermined"
        return [NO_CONSEQUENCES.format("is not decided by" if undetermined else "does not explain")]
    result = tree[answer_of(tree)].to_dataset()
    return physics_sentences(result, amplitudes(tree), inertia, time=times_of_amplitudes(tree))


def amplitudes(tree: xr.DataTree) -> NDArray[np.float64]:
    """Amplitudes of the half periods of all runs, rad."""
    groups = group_names("envelope", len(record_groups(tree)))
    return np.concatenate([tree[group].amplitude.values for group in groups])


def times_of_amplitudes(tree: xr.DataTree) -> NDArray[np.float64]:
    """Since the first sample of their run, s: `t` of the formulas at each of the `amplitudes`."""
    groups = record_groups(tree)
    pairs = zip(groups, group_names("envelope", len(groups)), strict=True)
    return np.concatenate([tree[half].instant_time.values - tree[run].time.values[0] for run, half in pairs])


def _remarks(method: str, result: xr.Dataset) -> list[str]:
    """What to mind of a method's result."""
    sentences = []
    corrected = result.attrs.get("first_order_bias_removed", "yes")
    if corrected != "yes":
        reason = corrected[2:].strip(": .") or "as asked"
        sentences.append(f"The first-order bias of {method} was not removed: {reason}.")
    if result.attrs.get("refined", "True") != "True":
        sentences.append(
            f"The columns of {method} come from the smoothed record: the motion of its model does not follow "
            "the record."
        )
    if int(result.attrs.get("correlation_lags", 0)):
        sentences.append(
            f"The residuals of {method} are correlated; its errors take that into account (Newey and West)."
        )
    return sentences
