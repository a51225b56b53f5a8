"""Whether the runs of one experiment differ: as a table, in sentences and as plain data."""

from typing import Any

import xarray as xr
from rich.table import Table

from sysid_trib.printing.layout import by_label, p_value_text, text_table, values_with_errors
from sysid_trib.printing.mapping import Source, mapped, same

# The test of each model of a discovery, and its variables in the JSON.
GROUP = "homogeneity"
TESTED = ("chi_square", "degrees_of_freedom", "p_value", "most", "gain")
OF_QUANTITY = {"values": "value", "standard_errors": "standard_error", **same("chi_square", "p_value")}
RUNS_JSON: dict[str, Source] = {
    "verdict": "@verdict",
    **{name: f"total_{name}" for name in TESTED[:3]},
    "quantities": ("quantity", OF_QUANTITY),
}
DENSITIES: dict[str, Source] = {
    "verdict": "@density_verdict",
    "densities": "random_force_density",
    "standard_errors": "random_force_density_standard_error",
    **{name: f"density_{name}" for name in TESTED[:3]},
}


def runs_table(runs: xr.Dataset) -> Table:
    """What each run alone gives, and the p-value of the differences (see `run_agreement`)."""
    rows = []
    for name, row in by_label(runs, "quantity").items():
        cells = values_with_errors(row.value, row.standard_error)
        rows.append([name, *cells, p_value_text(row.p_value.item(), "")])
    heads = ["quantity", *(f"run {at + 1}" for at in range(runs.sizes["run"])), "p"]
    return text_table(heads, rows, numbers=tuple(range(1, len(heads))))


def runs_sentences(runs: xr.Dataset) -> list[str]:
    """The test in sentences: as a whole, which force differs, and which run alone decides nothing."""
    sentences = [
        f"Run {at + 1} alone decides nothing: {reason}"
        for at, reason in enumerate(runs.reason.values.tolist())
        if reason
    ]
    if runs.attrs["verdict"] == "unknown":
        return [*sentences, "Whether the runs differ cannot be tested.", *_density_sentences(runs)]
    p_values = runs.p_value.fillna(1.0).to_series()
    worst = f"{p_values.idxmin()} (p {p_value_text(p_values.min())})"
    total = {name: runs[f"total_{name}"].item() for name in TESTED[:3]}
    most = worst if runs.attrs["verdict"] == "disagree" else ""
    return [*sentences, _sentence(total, most), *_density_sentences(runs)]


def _density_sentences(runs: xr.Dataset) -> list[str]:
    """Whether a random force has the same size in all runs; nothing where there is none."""
    if "density_verdict" not in runs.attrs:
        return []
    if runs.attrs["density_verdict"] == "unknown":
        return ["Whether the random force has the same size in all runs cannot be tested."]
    test = f"p {p_value_text(runs.density_p_value.item())}"
    if runs.attrs["density_verdict"] == "disagree":
        return [f"The size of the random force differs between the runs ({test})."]
    return [
        f"No difference between the runs was found in the size of the random force ({test}): it may be a "
        "property of the experiment."
    ]


def heterogeneity_sentences(tree: xr.DataTree) -> list[str]:
    """Whether the final model of a discovery holds for all runs; nothing of a single run."""
    if GROUP not in tree.children:
        return []
    last = tree[GROUP].to_dataset().isel(model=-1)
    return [
        _sentence({name: last[name].item() for name in TESTED[:3]}, last.most.item() if last.differ else "")
    ]


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


def _sentence(test: dict[str, Any], most: str) -> str:
    """The result of a test for runs that differ, `most` in a quantity, or in none."""
    result = (
        f"chi-square {test['chi_square']:.3g} for {test['degrees_of_freedom']:.0f} differences, "
        f"p {p_value_text(test['p_value'])}"
    )
    if not most:
        return f"No difference between the runs was found: {result}."
    return (
        f"The runs differ: {result}. The largest difference is in {most}: it changes from run to run, or "
        "with amplitude because a force has another form. The common errors are then too small."
    )


def runs_json(runs: xr.Dataset) -> dict[str, Any]:
    """Whether the runs of one experiment differ, as plain data."""
    pushed = {"random_force": DENSITIES} if "density_verdict" in runs.attrs else {}
    return mapped(runs, RUNS_JSON | pushed)
