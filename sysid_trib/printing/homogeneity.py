"""Whether the runs of a discovery differ, in sentences and as plain data."""

from typing import Any

import xarray as xr

from sysid_trib.printing.layout import number, p_value_text
from sysid_trib.printing.runs import DIFFERENT

GROUP = "homogeneity"


def step_heterogeneity_sentences(tree: xr.DataTree, at: int) -> list[str]:
    """That runs which differ would explain as much as the effect of a step."""
    if GROUP not in tree.children:
        return []
    before = tree[GROUP].to_dataset().isel(model=at)
    if before.chi_square < before.gain:
        return []
    return [
        f"Runs that differ (most in {before.most.item()}) would explain as much or more: chi-square "
        f"{before.chi_square.item():.3g} of {before.degrees_of_freedom.item()} differences, the effect "
        f"{before.gain.item():.3g}."
    ]


def heterogeneity_sentences(tree: xr.DataTree) -> list[str]:
    """That the final model does not hold for all runs."""
    if GROUP not in tree.children:
        return []
    last = tree[GROUP].to_dataset().isel(model=-1)
    found = (
        f"chi-square {last.chi_square.item():.3g} for {last.degrees_of_freedom.item()} differences, "
        f"p {p_value_text(last.p_value.item())}"
    )
    if not last.differ:
        return [f"The runs agree: {found}."]
    return [f"The runs disagree: {found}. Most in {last.most.item()}: {DIFFERENT}"]


def homogeneity_json(tree: xr.DataTree) -> dict[str, Any]:
    """The test of each stage as plain data; nothing of a single run."""
    if GROUP not in tree.children:
        return {}
    found = tree[GROUP].to_dataset()
    return {
        "run_differences": {
            name: [number(x) if isinstance(x, float) else x for x in found[name].values.tolist()]
            for name in ("chi_square", "degrees_of_freedom", "p_value", "most", "gain")
        }
    }
