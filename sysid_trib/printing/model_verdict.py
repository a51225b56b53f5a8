"""Whether the model of a cross-check explains the record, and what that means for its numbers."""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from sysid_trib.noise.random_force import random_force_of
from sysid_trib.printing.layout import p_value_text
from sysid_trib.printing.random_force import random_force_verdict
from sysid_trib.printing.residual import residual_of
from sysid_trib.results.per_run import record_groups
from sysid_trib.results.significance import SIGNIFICANT_ERRORS
from sysid_trib.validation.breakdown import breakdown, record_noise, stated_widening, widening

EXPLAINED = {
    "yes": "The record is explained: no departure from white noise was found in the residual ({}).",
    "partly": "The residual is small, but it is not white noise ({}). Either the noise is coloured, or a "
    "force is missing or has another form. In the second case the coefficients are off by more than their "
    "errors.",
    "no": "The model does not explain the record ({}). A force is missing, or one has another form.",
}
EXPLAINED_BY_RATE = (
    "The residual is not white noise ({}). The integral of a measured rate always has such a residual: it "
    "does not show whether a force is missing."
)
UNDETERMINED = (
    "The record does not decide: none of the coefficients differs from zero by more than "
    f"{SIGNIFICANT_ERRORS:g} standard errors, so that nothing in it could contradict these forces."
)
EFFECTIVE = (
    "These coefficients are of a model that does not explain the record: they are effective values, which "
    "may be off by far more than their errors"
)


def holds(tree: xr.DataTree) -> bool:
    """Whether the record is explained by the model, with a random force or without."""
    return str(tree["comparison"].attrs["verdict_on_record"]).startswith("explained")


def verdict_sentence(tree: xr.DataTree) -> str:
    """Whether the record is explained."""
    checked = tree["comparison"].ds
    if checked.attrs["verdict_on_record"] == "undetermined":
        return UNDETERMINED
    if sentence := random_force_verdict(tree):
        return sentence
    explained = checked.attrs["explained"]
    measured_rate = tree[record_groups(tree)[0]].attrs.get("signal") == "rate"
    sentence = EXPLAINED_BY_RATE if measured_rate and explained != "yes" else EXPLAINED[explained]
    return sentence.format(f"p {p_value_text(float(checked.residual_p_value.max()))}")


def residual_over_noise(tree: xr.DataTree, model: str) -> float:
    """RMS of record minus model over the sensor's noise of the record; nan of a model that diverges."""
    return residual_of(tree, model) / record_noise(tree)


def failures(tree: xr.DataTree) -> dict[str, str]:
    """The methods of a cross-check whose models broke down, and why."""
    checked = tree["comparison"].attrs
    reasons = {name: breakdown(tree, name) for name in (checked["first"], checked["second"])}
    return {name: reason for name, reason in reasons.items() if reason}


def failure_sentences(tree: xr.DataTree) -> list[str]:
    """A sentence on each method that failed: its coefficients are not given."""
    return [
        f"{name.capitalize()} failed: {reason}{_off(residual_over_noise(tree, name))}. Its coefficients "
        "are not given."
        for name, reason in failures(tree).items()
    ]


def _off(ratio: float) -> str:
    return f" (residual {ratio:.3g} times the noise)" if np.isfinite(ratio) else ""


def widenings(tree: xr.DataTree, results: Mapping[str, xr.Dataset]) -> dict[str, float]:
    """By how much the errors of each method are widened: 1 where the model explains the record."""
    if tree["comparison"].attrs["verdict_on_record"] != "not explained":
        return dict.fromkeys(results, 1.0)
    return {name: widening(result, residual_over_noise(tree, name)) for name, result in results.items()}


def kept_results(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """The identifications by the name of their method, without one that failed."""
    checked, failed = tree["comparison"].attrs, failures(tree)
    names = (checked["first"], checked["second"])
    return {name: tree[name].to_dataset() for name in names if name not in failed}


def effective_sentences(tree: xr.DataTree) -> list[str]:
    """What coefficients of a model that does not explain the record are, and how errors were widened."""
    results = kept_results(tree)
    if tree["comparison"].attrs["verdict_on_record"] != "not explained" or not results:
        return []
    parts, factors = [], widenings(tree, results)
    pushed = [name for name, result in results.items() if random_force_of(result)]
    if pushed:
        whose = " and ".join(pushed)
        parts.append(f"errors of {whose} allow for a random force in the place of what is missing")
    for name, result in results.items():
        whole = factors[name] * stated_widening(result)
        if name not in pushed and whole > 1.0:
            parts.append(f"errors of {name} are {whole:.3g} times those by the noise, for what is left")
    return ["; ".join([EFFECTIVE, *parts]) + "."]
