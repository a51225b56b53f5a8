"""Whether the runs of one experiment agree, as a table and in a sentence."""

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.printing.layout import number, p_value_text, text_table, value_with_error

if TYPE_CHECKING:
    from rich.table import Table

DIFFERENT = (
    "it changes from run to run, or with amplitude because a force is of another form; the common errors are "
    "then too small."
)


def runs_table(runs: xr.Dataset) -> "Table":
    """What each run alone gives, and the chance of so large a difference (see `run_agreement`)."""
    count = runs.sizes["run"]
    rows = []
    for quantity in runs.quantity.values.tolist():
        one = runs.sel(quantity=quantity)
        pairs = zip(one.value.values.tolist(), one.standard_error.values.tolist(), strict=True)
        cells = [value_with_error(value, error) for value, error in pairs]
        rows.append([quantity, *cells, p_value_text(one.p_value.item(), "")])
    heads = ["quantity", *(f"run {at + 1}" for at in range(count)), "p"]
    return text_table(heads, rows, numbers=tuple(range(1, count + 2)))


def runs_sentences(runs: xr.Dataset) -> list[str]:
    """The test in sentences: as a whole, which force differs, and which run alone decides nothing."""
    told = [
        f"Run {at + 1} alone decides nothing: {reason}"
        for at, reason in enumerate(runs.reason.values.tolist())
        if reason
    ]
    if runs.attrs["verdict"] == "unknown":
        return [*told, "Whether the runs agree cannot be told."]
    found = (
        f"chi-square {runs.total_chi_square.item():.3g} for {runs.total_degrees_of_freedom.item():.0f} "
        f"differences, p {p_value_text(runs.total_p_value.item())}."
    )
    if runs.attrs["verdict"] == "agree":
        return [*told, f"The runs agree: {found}"]
    worst = runs.p_value.fillna(1.0)
    name, least = runs.quantity.values[int(np.argmin(worst.values))], p_value_text(worst.min().item())
    return [
        *told,
        f"The runs disagree: {found} Most in {name} (p {least}): {DIFFERENT}",
    ]


def runs_json(runs: xr.Dataset) -> dict[str, Any]:
    """The test as plain data; non-finite numbers are None."""
    per_quantity = {
        quantity: {
            "values": [number(x) for x in one.value.values.tolist()],
            "standard_errors": [number(x) for x in one.standard_error.values.tolist()],
            "chi_square": number(one.chi_square.item()),
            "p_value": number(one.p_value.item()),
        }
        for quantity, one in ((q, runs.sel(quantity=q)) for q in runs.quantity.values.tolist())
    }
    total = {
        name: number(runs[f"total_{name}"].item()) for name in ("chi_square", "degrees_of_freedom", "p_value")
    }
    return {"verdict": runs.attrs["verdict"], **total, "quantities": per_quantity}
