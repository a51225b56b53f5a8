"""What a record could show, in sentences: detectable strengths, ties and what would break them."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.discrepancy.detectability import DETECTED, NAMED
from sysid_trib.forces.force import Force

# Candidates whose detectable strength is told.
CLOSEST = 6


def remedy(tied: Sequence[Force]) -> str:
    """The measurement that would tell tied forces apart, by how they differ."""
    if _mixed([force.kind == "sensor" for force in tied]):
        return (
            "Another inertia, or a second sensor, would tell: an error of the sensor stays, a force changes."
        )
    if _mixed([force.holds_time for force in tied]):
        return (
            "A second release at 0.6 of the amplitude would tell: what drifts goes by the clock, the others "
            "by amplitude."
        )
    if _mixed([force.memoryless for force in tied]):
        return (
            "A low release at 0.2 of the amplitude, or another inertia, would tell: what has a memory "
            "changes otherwise."
        )
    if any(force.shape or force.character != "conservative" for force in tied):
        return "A low release at 0.2 of the amplitude would tell: there they differ most."
    return "A release at a larger amplitude would tell: there they differ most."


def _mixed(each: Sequence[bool]) -> bool:
    return any(each) and not all(each)


def detectability_sentences(tree: xr.DataTree) -> list[str]:
    """Detectable strengths, candidates that look alike, cannot be tested, were left out, or had no fit."""
    told = [_own_told(tree), _closest_told(tree)]
    told += _ties_told(tree)
    told += _untestable_told(tree)
    if left_out := tree.attrs["left_out"]:
        told.append(f"Not offered, because the model has them: {', '.join(left_out)}.")
    if failed := tree.attrs["failed_fits"]:
        told.append(
            f"Tried, but without a fit, because their motions could not be followed: {', '.join(failed)}."
        )
    return [sentence for sentence in told if sentence]


def _own_told(tree: xr.DataTree) -> str:
    after = tree["after"].to_dataset()
    each = [
        f"{symbol} {DETECTED * error:.2g}"
        for symbol, error in zip(after.force.values, after.standard_error.values, strict=True)
        if np.isfinite(error)
    ]
    return f"Five standard errors of the forces in the model: {', '.join(each)}."


def closest(tree: xr.DataTree) -> xr.Dataset:
    """Candidates after the last scan that can be tested, by |z|, with the strength detectable."""
    last, forecast = (
        tree["ranking"].to_dataset().isel(selection_step=-1),
        tree["detectability_after"].to_dataset(),
    )
    scored = last.candidate.values[np.isfinite(last.z.values)]
    shown = forecast.sel(candidate=[s for s in scored if s in forecast.candidate])
    z = last.z.sel(candidate=shown.candidate)
    found = shown[["detectable"]].assign(z=z, p_value=last.p_value.sel(candidate=shown.candidate))
    return found.isel(candidate=np.argsort(-np.abs(found.z.values)))


def _closest_told(tree: xr.DataTree) -> str:
    found = closest(tree)
    if not found.sizes["candidate"]:
        return ""
    named = ", ".join(
        f"{s} {strength:.2g} (z = {z:.2g})"
        for s, strength, z in zip(
            found.candidate.values[:CLOSEST],
            found.detectable.values[:CLOSEST],
            found.z.values[:CLOSEST],
            strict=True,
        )
    )
    return (
        f"Candidates would be detected (five standard errors, with shapes and frequencies as they came "
        f"closest) from these coefficients on, those that came closest first: {named}."
    )


def _ties_told(tree: xr.DataTree) -> list[str]:
    forecast = tree["detectability_after"].to_dataset()
    groups: list[list[str]] = []
    for symbol in forecast.candidate.values.tolist():
        # Each with each: a chain of neighbours may have ends that are far apart.
        others = forecast.alike.sel(candidate=symbol)
        home = next((group for group in groups if others.sel(other=group).all()), None)
        if home is None:
            groups.append([symbol])
        else:
            home.append(symbol)
    alike = "; ".join(", ".join(group) for group in groups if len(group) > 1)
    return [f"On this record these look alike even at {NAMED:g} standard errors: {alike}."] if alike else []


def _untestable_told(tree: xr.DataTree) -> list[str]:
    found = tree["detectability_after"].to_dataset()
    by_reason: dict[str, list[str]] = {}
    for symbol, reason in zip(found.candidate.values.tolist(), found.reason.values.tolist(), strict=True):
        if reason:
            by_reason.setdefault(reason.rstrip("."), []).append(symbol)
    told = []
    for reason, symbols in by_reason.items():
        # The reason may name the record already.
        text = reason.removeprefix("not testable on this record: ")
        told.append(f"Not testable on this record: {', '.join(symbols)} ({text}).")
    return told
