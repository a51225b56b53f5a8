"""What a record could show, in sentences: detectable coefficients, and what would separate effects."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.discrepancy.detectability import DETECTED, NAMED
from sysid_trib.forces.force import Force

# Candidates whose detectable coefficient is printed.
CLOSEST = 6


def remedy(tied: Sequence[Force]) -> str:
    """The measurement that would separate forces, by how they differ."""
    if len({force.kind == "sensor" for force in tied}) > 1:
        return (
            "Another inertia, or a second sensor, would separate them: an error of the sensor stays the "
            "same, a force changes."
        )
    if len({force.holds_time for force in tied}) > 1:
        return (
            "A second release at 0.6 of the amplitude would separate them: a drift depends on time, the "
            "others depend on amplitude."
        )
    if len({force.memoryless for force in tied}) > 1:
        return (
            "A low release at 0.2 of the amplitude, or another inertia, would separate them: a "
            "history-dependent force changes in another way."
        )
    if any(force.shape or force.character != "conservative" for force in tied):
        return "A low release at 0.2 of the amplitude would separate them: there they differ most."
    return "A release at a larger amplitude would separate them: there they differ most."


def detectability_sentences(tree: xr.DataTree) -> list[str]:
    """Detectable coefficients; candidates that look alike, cannot be tested, or were not offered."""
    candidates = tree["detectability_after"].to_dataset()
    sentences = [_errors(tree), *_closest(tree), *_alike(candidates), *_untestable(candidates)]
    if left_out := tree.attrs["left_out"]:
        sentences.append(f"Not offered, because the model has them: {', '.join(left_out)}.")
    if failed := tree.attrs["failed_fits"]:
        sentences.append(f"Tried, but not fitted: their motions could not be computed: {', '.join(failed)}.")
    return sentences


def _errors(tree: xr.DataTree) -> str:
    after = tree["after"].to_dataset()
    columns = (after.force.values.tolist(), after.standard_error.values.tolist(), after.unit.values.tolist())
    named = ", ".join(
        f"{symbol} {DETECTED * error:.2g}{_unit(unit)}"
        for symbol, error, unit in zip(*columns, strict=True)
        if np.isfinite(error)
    )
    return f"Five standard errors of the forces in the model: {named}."


def _closest(tree: xr.DataTree) -> list[str]:
    """Candidates that can be tested beside the final model, by |z|, with their detectable coefficients."""
    z = tree["ranking"].z.isel(selection_step=-1).to_series()
    candidates = tree["detectability_after"].to_dataset()
    detectable = candidates.detectable.to_series()
    units = dict(zip(candidates.candidate.values.tolist(), candidates.unit.values.tolist(), strict=True))
    order = z[np.isfinite(z)].sort_values(key=np.abs, ascending=False).index
    tested = [symbol for symbol in order if symbol in detectable.index][:CLOSEST]
    named = ", ".join(
        f"{symbol} {detectable[symbol]:.2g}{_unit(units[symbol])} (z = {z[symbol]:.2g})" for symbol in tested
    )
    if not named:
        return []
    return [
        "Detectable coefficients of the candidates (five standard errors, at the shapes and frequencies of "
        f"the highest score), highest score first: {named}."
    ]


def _unit(unit: str) -> str:
    """A unit behind a number; nothing of what has none."""
    return "" if unit == "1" else f" {unit}"


def _alike(candidates: xr.Dataset) -> list[str]:
    symbols = candidates.candidate.values.tolist()
    pairs = candidates.alike.sel(other=symbols).transpose("candidate", "other").values
    groups: list[list[int]] = []
    for at in range(len(symbols)):
        # Each with each: a chain of neighbours may have ends that are far apart.
        home = next((group for group in groups if pairs[at, group].all()), None)
        if home is None:
            groups.append([at])
        else:
            home.append(at)
    alike = "; ".join(", ".join(symbols[at] for at in group) for group in groups if len(group) > 1)
    return [f"On this record, these look alike even at {NAMED:g} standard errors: {alike}."] if alike else []


def _untestable(candidates: xr.Dataset) -> list[str]:
    by_reason: dict[str, list[str]] = {}
    for symbol, reason in candidates.reason.to_series().items():
        if reason:
            # The reason may name the record already.
            text = reason.removeprefix("not testable on this record: ").rstrip(".")
            by_reason.setdefault(text, []).append(symbol)
    return [
        f"Not testable on this record: {', '.join(symbols)} ({reason})."
        for reason, symbols in by_reason.items()
    ]
