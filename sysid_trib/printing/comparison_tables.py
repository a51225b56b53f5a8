"""Methods side by side as tables and plain data: coefficients, how they differ, how well each predicts."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table

from sysid_trib.printing.layout import (
    COEFFICIENT,
    FREQUENCIES_JSON,
    Source,
    by_label,
    mapped,
    number,
    per_label,
    quantity,
    records_json,
    same,
    text_table,
    values_with_errors,
)
from sysid_trib.results.variables import record_groups, signal_units, small_units
from sysid_trib.validation.comparison_table import applied_methods, column_power

FREQUENCY_SYMBOL = "w_inf"
COMPARED: dict[str, Source] = {
    "coefficients": ("force", COEFFICIENT | same("z", "unit")),
    **FREQUENCIES_JSON,
    **same("asymptotic_frequency_z", "residual_rms", "residual_over_noise", "train_rms"),
    **same("train_over_noise", "holdout_rms", "holdout_over_noise", "holdout_p_value", "phase_error"),
    **same(
        "time_taken", "reason", "failure", "bias", "cannot_tell_apart", "assumes", "identifies", "neglects"
    ),
}
RUN_RMS = same("run_residual_rms", "run_train_rms", "run_holdout_rms")


def coefficient_table(tree: xr.DataTree) -> Table:
    """Coefficients with errors: a row a method, a column a force with its power of ten in the head.

    A method that does not apply, or failed, has no row here; `quality_table` says why.
    """
    table = applied_methods(tree["comparison"].to_dataset())
    columns = {}
    for symbol, row in by_label(table, "force").items():
        power = column_power(row)
        scale = 10.0**power
        parts = " ".join([f"1e{power:+03d}"] * bool(power) + [row.unit.item()] * (row.unit.item() != "1"))
        head = f"{symbol} ({parts})" if parts else symbol
        columns[head] = values_with_errors(row.coefficient / scale, row.standard_error / scale)
    frequencies = [quantity(row, "asymptotic_frequency") for row in by_label(table, "method").values()]
    return _method_table(table, columns | {f"{FREQUENCY_SYMBOL} (rad/s)": frequencies})


def difference_table(tree: xr.DataTree) -> Table:
    """Differences from the method that predicts best, over the errors of both."""
    table = applied_methods(tree["comparison"].to_dataset())
    best = table.method.values == table.attrs["best"]
    values = dict(zip(table.force.values.tolist(), table.z.values.T, strict=True))
    values[FREQUENCY_SYMBOL] = table.asymptotic_frequency_z.values
    columns = {head: [_signed(*pair) for pair in zip(z, best, strict=True)] for head, z in values.items()}
    return _method_table(table, columns)


def quality_table(tree: xr.DataTree) -> Table:
    """Residuals of simulated models, on the record and out of it, and what to mind of each method."""
    table = tree["comparison"].to_dataset()
    factor, unit = small_units(signal_units(tree))
    numbered: dict[str, tuple[xr.DataArray, Callable[[float], str]]] = {
        "all/noise": (table.residual_over_noise, _ratio),
        f"train ({unit})": (factor * table.train_rms, _ratio),
        f"held out ({unit})": (factor * table.holdout_rms, _ratio),
        "held out/noise": (table.holdout_over_noise, _ratio),
        "phase (periods)": (table.phase_error / (2.0 * np.pi), "{:.2f}".format),
        "time (s)": (table.time_taken, "{:#.2g}".format),
    }
    given = table.method.isin(applied_methods(table).method.values).values | (table.failure == "").values
    columns = {
        head: [as_text(x) if np.isfinite(x) else "-" for x in np.where(given, values.values, np.nan).tolist()]
        for head, (values, as_text) in numbered.items()
    }
    neglected = [f"neglects {text}" if text else "" for text in table.neglects.values.tolist()]
    failed = [f"failed: {text}" if text else "" for text in table.failure.values.tolist()]
    remarks = zip(failed, table.reason.values.tolist(), table.bias.values.tolist(), neglected, strict=True)
    columns["remarks"] = ["; ".join(filter(None, remark)) for remark in remarks]
    return _method_table(table, columns, words=["remarks"])


def comparison_json(tree: xr.DataTree) -> dict[str, Any]:
    """A result of `compare` as plain data."""
    table, groups = tree["comparison"].to_dataset(), record_groups(tree)
    several = len(groups) > 1
    starts = [number(tree[group].holdout_start.item()) for group in groups]
    data = {
        **records_json(tree),
        "holdout_start": starts[0],
        **mapped(table, same("common_frequency", "noise")),
        **table.attrs,
        "methods": per_label(table, "method", COMPARED | (RUN_RMS if several else {})),
    }
    if several:
        data |= {"holdout_starts": starts, **mapped(table, {"run_noises": "run_noise"})}
    return data


def _method_table(table: xr.Dataset, columns: dict[str, list[str]], words: Sequence[str] = ()) -> Table:
    """A row a method; columns of numbers, and of words."""
    rows = [list(row) for row in zip(table.method.values.tolist(), *columns.values(), strict=True)]
    right = tuple(at for at, head in enumerate(columns, 1) if head not in words)
    return text_table(["method", *columns], rows, whole=(0,), numbers=right)


def _signed(z: float, best: bool) -> str:
    if not np.isfinite(z):
        return "-"
    return "best" if best else "0.0" if abs(z) < 0.05 else f"{z:+.1f}" if abs(z) < 100.0 else f"{z:+.0f}"


def _ratio(value: float) -> str:
    return f"{value:#.3g}".rstrip(".") if value < 1000.0 else f"{value:.0f}"
