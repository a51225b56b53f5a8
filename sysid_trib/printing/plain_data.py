"""Datasets as plain data, by tables of keys: for JSON, and as rows of CSV."""

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.printing.layout import by_label, error_of
from sysid_trib.results.variables import record_groups

# Signs by which a spreadsheet knows a formula.
FORMULA_SIGNS = ("=", "+", "-", "@")
# See `mapped`.
Source = str | tuple[str, Any] | Mapping[str, Any] | Callable[[Any], Any]
# Attributes of a record that JSON holds as they are.
PLAIN = (str, int, float)


def mapped(data: Any, table: Mapping[str, Source]) -> dict[str, Any]:
    """What a table says of a dataset, as JSON can hold it.

    Parameters
    ----------
    data : Dataset or DataTree
        Its variables and attributes are named by the table.
    table : mapping of str to str, tuple, mapping or callable
        By key: the name of a variable, `name?` of one that may be missing, `name±` of one with its standard
        error, `@name` of an attribute; a dimension with what stands at each of its labels, or a group with
        what stands in it; a table; or what takes `data`.
    """
    return {key: _value(data, source) for key, source in table.items() if not _is_missing(data, source)}


def _is_missing(data: Any, source: Source) -> bool:
    return isinstance(source, str) and source.endswith("?") and source[:-1] not in data


def _value(data: Any, source: Source) -> Any:
    if callable(source):
        return source(data)
    if isinstance(source, Mapping):
        return mapped(data, source)
    if isinstance(source, tuple):
        of, inner = source
        if isinstance(data, xr.DataTree):
            return _value(data[of].to_dataset(), inner)
        return per_label(data, of, inner)
    if source.startswith("@"):
        return data.attrs.get(source[1:])
    if source.endswith("±"):
        return mapped(data, {"value": source[:-1], "standard_error": error_of(source[:-1])})
    return number(data[source.removesuffix("?")].values.tolist())


def per_label(data: Any, dim: str, source: Source) -> dict[str, Any]:
    """What a source says at each label of a dimension; nothing where there is none."""
    if dim not in data.dims:
        return {}
    return {label: _value(part, source) for label, part in by_label(data, dim).items()}


def same(*names: str) -> dict[str, Source]:
    """Keys that are the names of their variables."""
    return {name: name for name in names}


def number(value: Any) -> Any:
    """A number, or a list of them: in place of one that is not finite stands None."""
    if isinstance(value, list):
        return [number(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def records_json(tree: xr.DataTree) -> dict[str, Any]:
    """What is known of the record, and of all if there are several."""
    records = [
        {k: v for k, v in tree[group].attrs.items() if isinstance(v, PLAIN)} for group in record_groups(tree)
    ]
    return {"record": records[0]} | ({"records": records} if len(records) > 1 else {})


# Tables that several kinds of result share.
FREQUENCIES_JSON = same(
    *("reference_frequency", "asymptotic_frequency"),
    *("reference_frequency_standard_error", "asymptotic_frequency_standard_error"),
)
COEFFICIENT: dict[str, Source] = {
    "value": "coefficient",
    "standard_error": "standard_error",
    "constraint": "constraint?",
}


def csv_of(heads: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Rows by the heads of their columns, as CSV."""
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, list(heads), extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    writer.writerows({column: _as_text(cell) for column, cell in row.items()} for row in rows)
    return buffer.getvalue()


def _as_text(cell: object) -> object:
    """A cell of a spreadsheet, which would execute a text that begins as a formula does."""
    return f"'{cell}" if isinstance(cell, str) and cell.startswith(FORMULA_SIGNS) else cell
