"""Numbers with errors, and tables for a terminal."""

from collections.abc import Iterable, Mapping
from math import floor, log10
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.results.per_run import record_groups

if TYPE_CHECKING:
    from rich.table import Table

# Attributes of a comparison that warn, and their sentences.
ENVELOPE = "Methods of the envelope and the frequency, such as averaging, cannot"
UNIDENTIFIABLE = {
    "no_method_identifies": "No method here identifies: {}.",
    "no_method_can_tell_apart": "No method can separate: {}.",
    "averaging_cannot_tell_apart": f"{ENVELOPE} separate: {{}}.",
    "averaging_cannot_see": f"{ENVELOPE} identify: {{}}.",
}


def value_with_error(value: float, error: float) -> str:
    """`0.0097 ± 0.0002`: two digits of the error, the value to the same place, one power of ten for both."""
    if not np.isfinite(value):
        return "-"
    if not np.isfinite(error):
        return f"{value:.5g} ± ?"
    if error <= 0.0:
        return f"{value:.6g}"
    size = max(abs(value), error)
    power = floor(log10(size))
    power = power if power < -3 or power > 4 else 0
    digits = max(0, 1 - floor(log10(error)) + power)
    text = f"{value / 10.0**power:.{digits}f} ± {error / 10.0**power:.{digits}f}"
    return text if power == 0 else f"({text})e{power:+03d}"


def by_label(data: xr.Dataset, dim: str) -> dict[str, xr.Dataset]:
    """The part of a dataset at each label of a dimension."""
    return {label: data.sel({dim: label}) for label in data[dim].values.tolist()}


def quantity(result: xr.Dataset, name: str, units: str = "", factor: float = 1.0) -> str:
    """A variable of a result with its standard error, both times a factor, with units behind it."""
    value, error = (factor * result[key].item() for key in (name, _error_of(name)))
    return f"{value_with_error(value, error)}{units}"


def coefficient_text(force: xr.Dataset) -> str:
    """The coefficient of a force with its standard error, and its unit where it has one."""
    return quantity(force, "coefficient", "" if force.unit.item() == "1" else f" {force.unit.item()}")


def constraint_sentences(results: Iterable[xr.Dataset]) -> list[str]:
    """Which coefficients of results are fixed, tied or at a bound, in a sentence; none if none is."""
    parts = []
    for result in results:
        kinds = result.constraint.values.tolist() if "constraint" in result.coords else []
        for symbol, kind in zip(result.force.values.tolist(), kinds, strict=False):
            if kind:
                value = f"{result.coefficient.sel(force=symbol).item():.6g}"
                parts.append(kind if "=" in kind else f"{symbol} is {kind} ({value})")
    if not parts:
        return []
    return [f"Constraints: {'; '.join(dict.fromkeys(parts))}. Standard errors are given these."]


def _error_of(name: str) -> str:
    return "standard_error" if name == "coefficient" else f"{name}_standard_error"


def p_value_text(p_value: float, equals: str = "= ") -> str:
    """A p-value as a sentence takes it, or without `equals` a table."""
    if not np.isfinite(p_value):
        return "-"
    return f"{equals}{p_value:.2g}" if p_value > 1e-300 else "< 1e-300"


def number(value: Any) -> Any:
    """A number, or a list of them, that JSON can hold: in place of one that is not finite stands None."""
    if isinstance(value, list):
        return [number(item) for item in value]
    return value if np.isfinite(value) else None


def numbers(result: xr.Dataset, names: Iterable[str]) -> dict[str, Any]:
    """Variables of a result as JSON holds them."""
    return {name: number(result[name].values.tolist()) for name in names}


def quantity_json(result: xr.Dataset, name: str) -> dict[str, Any]:
    """A variable of a result with its standard error as JSON holds them."""
    value, error = (number(result[key].item()) for key in (name, _error_of(name)))
    return {"value": value, "standard_error": error}


def coefficient_json(force: xr.Dataset) -> dict[str, Any]:
    """The coefficient of a force as JSON holds it, and how it is constrained where any is."""
    kind = {"constraint": force.constraint.item()} if "constraint" in force.coords else {}
    return quantity_json(force, "coefficient") | kind


# Keys of the JSON where they differ from the attributes.
JSON_KEYS = {"decimated": "thinned"}
# Attributes that JSON holds as they are.
PLAIN = (str, int, float)


def records_json(tree: xr.DataTree) -> dict[str, Any]:
    """What is known of the record, and of all if there are several."""
    records = [
        {JSON_KEYS.get(str(k), k): v for k, v in tree[group].attrs.items() if isinstance(v, PLAIN)}
        for group in record_groups(tree)
    ]
    return {"record": records[0]} | ({"records": records} if len(records) > 1 else {})


def identifiability_warnings(attrs: Mapping[str, Any]) -> list[str]:
    """What methods cannot identify or separate by principle, from the attributes of a comparison."""
    return [text.format(attrs[key]) for key, text in UNIDENTIFIABLE.items() if attrs.get(key)]


def text_table(
    heads: list[str], rows: list[list[str]], *, whole: tuple[int, ...] = (), numbers: tuple[int, ...] = ()
) -> "Table":
    """A table whose words a narrow terminal may fold, but not the columns `whole` nor the `numbers`."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="bold")
    for at, head in enumerate(heads):
        # As wide as a word of the head: a narrow terminal would break it.
        longest = max(len(text) for text in (*(row[at] for row in rows), *head.split()))
        table.add_column(
            head,
            justify="right" if at in numbers else "left",
            min_width=longest if at in (*whole, *numbers) else min(longest, 12),
            overflow="fold",
        )
    for row in rows:
        table.add_row(*row)
    return table
