"""Methods side by side: tables, plain sentences, and plain data for JSON."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.printing.comparison_sentences import (
    FREQUENCY_SYMBOL,
    comparison_sentences,
    effective_sentence,
    explanation_sentences,
)
from sysid_trib.printing.layers import ALWAYS, USUALLY, Block, Layer
from sysid_trib.printing.layout import (
    by_label,
    constraint_sentences,
    identifiability_warnings,
    number,
    numbers,
    quantity,
    quantity_json,
    records_json,
    text_table,
    value_with_error,
)
from sysid_trib.results.per_run import record_groups
from sysid_trib.results.signal_units import signal_units, small_units
from sysid_trib.validation.comparison_table import applied_methods, column_power

if TYPE_CHECKING:
    from rich.table import Table

JSON_SCALARS = (
    *("reference_frequency", "asymptotic_frequency", "reference_frequency_standard_error"),
    *("asymptotic_frequency_standard_error", "asymptotic_frequency_z", "residual_rms"),
    *("residual_over_noise", "train_rms", "train_over_noise", "holdout_rms", "holdout_over_noise"),
    *("holdout_p_value", "phase_error", "time_taken"),
)
RUN_RMS = ("run_residual_rms", "run_train_rms", "run_holdout_rms")
COEFFICIENTS = "Coefficients"
DIFFERENCES = "Difference from the method that predicts best, in standard errors of both"
QUALITY = (
    "RMS residual (record minus simulated model) of the whole record (all); of a model identified from the "
    "first two thirds, on these (train) and on the last third (held out)"
)
JSON_TEXTS = ("reason", "failure", "bias", "identifies", "neglects", "cannot_tell_apart", "assumes")
# Keys of the JSON where they differ from the names of the variables.
SCOPE_KEYS = {"identifies": "sees", "neglects": "blind_to"}


def comparison_blocks(tree: xr.DataTree, sources: Sequence[str]) -> list[Block]:
    """What the command `compare` prints, in layers.

    Parameters
    ----------
    tree : DataTree
        Result of `compare`.
    sources : sequence of str
        What each record is.

    Returns
    -------
    list of Block
    """
    table = tree["comparison"].to_dataset()
    layers = {COEFFICIENTS: ALWAYS, DIFFERENCES: Layer.EXPLAIN, QUALITY: Layer.DEFAULT | Layer.EXPLAIN}
    verdict, *sentences = comparison_sentences(tree)
    return [
        Block([verdict], ALWAYS),
        Block(sources),
        Block(effective_sentence(tree), ALWAYS),
        *(Block(content, layers[title], title) for title, content in comparison_tables(tree).items()),
        Block(
            constraint_sentences(tree[label].ds for label in _applied(tree).method.values.tolist()), USUALLY
        ),
        Block(
            [*explanation_sentences(table, ("bias", "form")), *identifiability_warnings(table.attrs)],
            Layer.DEFAULT,
        ),
        Block(sentences, Layer.EXPLAIN),
    ]


def comparison_tables(tree: xr.DataTree) -> dict[str, "Table"]:
    """Coefficients, how far apart they are, and how well each method predicts, by title."""
    return {
        COEFFICIENTS: coefficient_table(tree),
        DIFFERENCES: difference_table(tree),
        QUALITY: quality_table(tree),
    }


def coefficient_table(tree: xr.DataTree) -> "Table":
    """Coefficients with errors: a row a method, a column a force with its power of ten in the head.

    A method that does not apply, or failed, has no row here; `quality_table` says why.
    """
    table = _applied(tree)
    columns = {}
    for symbol, row in by_label(table, "force").items():
        power = column_power(row)
        scale = 10.0**power
        pairs = zip(row.coefficient.values / scale, row.standard_error.values / scale, strict=True)
        unit = [row.unit.item()] if row.unit.item() != "1" else []
        parts = " ".join([*([f"1e{power:+03d}"] if power else []), *unit])
        head = f"{symbol} ({parts})" if parts else symbol
        columns[head] = [value_with_error(float(value), float(error)) for value, error in pairs]
    frequencies = [quantity(row, "asymptotic_frequency") for row in by_label(table, "method").values()]
    return _method_table(table, columns | {f"{FREQUENCY_SYMBOL} (rad/s)": frequencies})


def difference_table(tree: xr.DataTree) -> "Table":
    """Differences from the method that predicts best, over the errors of both."""
    table = _applied(tree)
    best = table.method.values == table.attrs["best"]
    values = dict(zip(table.force.values.tolist(), table.z.values.T, strict=True))
    values[FREQUENCY_SYMBOL] = table.asymptotic_frequency_z.values
    columns = {head: [_signed(*pair) for pair in zip(z, best, strict=True)] for head, z in values.items()}
    return _method_table(table, columns)


def quality_table(tree: xr.DataTree) -> "Table":
    """Residuals of simulated models, on the record and out of it, and what to mind of each method."""
    table = tree["comparison"].ds
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
    texts = (failed, table.reason.values.tolist(), table.bias.values.tolist(), neglected)
    remarks = zip(*texts, strict=True)
    columns["remarks"] = ["; ".join(filter(None, remark)) for remark in remarks]
    return _method_table(table, columns, words=["remarks"])


def comparison_json(tree: xr.DataTree) -> dict[str, Any]:
    """The comparison as plain data; non-finite numbers are None."""
    table, groups = tree["comparison"].ds, record_groups(tree)
    methods: dict[str, Any] = {}
    for label, row in by_label(table, "method").items():
        coefficients = {
            symbol: quantity_json(force, "coefficient") | numbers(force, ["z"]) | {"unit": force.unit.item()}
            for symbol, force in by_label(row, "force").items()
        }
        texts = {SCOPE_KEYS.get(name, name): row[name].item() for name in JSON_TEXTS}
        methods[label] = {"coefficients": coefficients, **numbers(row, JSON_SCALARS), **texts}
        if len(groups) > 1:
            methods[label] |= numbers(row, RUN_RMS)
    starts = [number(tree[group].holdout_start.item()) for group in groups]
    data = {
        **records_json(tree),
        "holdout_start": starts[0],
        **numbers(table, ("common_frequency", "noise")),
        **table.attrs,
        "methods": methods,
    }
    if len(groups) > 1:
        data |= {"holdout_starts": starts, "run_noises": numbers(table, ["run_noise"])["run_noise"]}
    return data


def _applied(tree: xr.DataTree) -> xr.Dataset:
    """The comparison, of methods that gave a coefficient or a frequency and did not fail."""
    return applied_methods(tree["comparison"].to_dataset())


def _method_table(table: xr.Dataset, columns: dict[str, list[str]], words: Sequence[str] = ()) -> "Table":
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
