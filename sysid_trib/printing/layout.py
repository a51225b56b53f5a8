"""Numbers with errors and tables as text; datasets as plain data, by tables of keys, and as CSV."""

import tomllib
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from math import floor, log10
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.typing import ArrayLike
from rich.table import Table

from sysid_trib.arrays import Index
from sysid_trib.results.variables import record_groups, small_units

MARKS = {"": "", "fixed": " (fixed)", "at its bound": " (bound)"}
FREQUENCY_ROWS = {"reference_frequency": "w (rad/s)", "asymptotic_frequency": "w_inf (rad/s)"}
# Columns of a row of `quantities`, and the variables of a force for them.
COLUMNS = {
    **{"quantity": "force", "name": "name", "formula": "formula", "value": "coefficient"},
    **{name: name for name in ("standard_error", "unit", "refers_to", "error_of_noise", "error_of_model")},
    **{name: name for name in ("error_of_calibration", "constraint", "z", "p_value", "active")},
}


def value_with_error(value: float, error: float) -> str:
    """Format `0.0097 ± 0.0002`: two digits of the error, and a common power of ten."""
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


def values_with_errors(values: ArrayLike, errors: ArrayLike) -> list[str]:
    """Return several values with their errors as texts."""
    pairs = zip(np.ravel(values).tolist(), np.ravel(errors).tolist(), strict=True)
    return [value_with_error(value, error) for value, error in pairs]


def error_of(name: str) -> str:
    """Return the name of the variable with the standard error of another."""
    return "standard_error" if name == "coefficient" else f"{name}_standard_error"


def quantity(result: xr.Dataset, name: str, units: str = "", factor: float = 1.0) -> str:
    """Return a variable of a result with its standard error, multiplied by a factor, and its units."""
    value, error = (factor * result[key].item() for key in (name, error_of(name)))
    return f"{value_with_error(value, error)}{units}"


def with_unit(text: str, unit: str) -> str:
    """Format a number with its unit, if it has one."""
    return text if unit == "1" else f"{text} {unit}"


def coefficient_text(force: xr.Dataset) -> str:
    """Return the coefficient of a force with its standard error, and its unit if it has one."""
    return with_unit(quantity(force, "coefficient"), force.unit.item())


def in_small_units(size: float, units: str) -> str:
    """Format a quantity that is small relative to the signal: angles in mrad."""
    factor, unit = small_units(units)
    return f"{factor * size:.3g} {unit}"


def p_value_text(p_value: float, equals: str = "= ") -> str:
    """Format a p-value for a sentence or, without `equals`, for a table."""
    if not np.isfinite(p_value):
        return "-"
    return f"{equals}{p_value:.2g}" if p_value > 1e-300 else "< 1e-300"


def by_label(data: xr.Dataset, dim: str) -> dict[str, xr.Dataset]:
    """Return the part of a dataset at each label of a dimension."""
    return {label: data.sel({dim: label}) for label in data[dim].values.tolist()}


def first_and_more(sentences: list[str], most: int, rest: str = "") -> list[str]:
    """Return the first few of many sentences, and one with the number of the others."""
    more = len(sentences) - most
    return [*sentences[:most], *([f"And {more:,} more{rest}."] if more > 0 else [])]


def text_table(
    rows: Sequence[Mapping[str, str]], words: Collection[str] = (), whole: Collection[str] = ()
) -> Table:
    """Return a table of rows; each row has its cells by the heads of their columns.

    Parameters
    ----------
    rows : sequence of mapping of str to str
        Rows; a missing cell is empty.
    words, whole : collection of str
        Heads of the text columns: those that may be folded on a narrow terminal, and those that may not. All
        other columns are numbers.
    """
    table = Table(box=None, pad_edge=False, header_style="bold")
    heads = list(dict.fromkeys(head for row in rows for head in row))
    for head in heads:
        # At least as wide as a word of the head, which a narrow terminal would otherwise break.
        cells = (*(row.get(head, "") for row in rows), *head.split())
        longest = max(len(line) for cell in cells for line in cell.split("\n"))
        folds = head in words and head not in whole
        table.add_column(
            head,
            justify="left" if head in words else "right",
            min_width=min(longest, 12) if folds else longest,
            overflow="fold",
        )
    for row in rows:
        table.add_row(*(row.get(head, "") for head in heads))
    return table


def quantities(result: xr.Dataset) -> Iterator[dict[str, Any]]:
    """Yield rows of coefficients, shape parameters and frequencies of an identification (see `COLUMNS`)."""
    for force in by_label(result, "force").values():
        yield {column: force[name].item() for column, name in COLUMNS.items() if name in force}
    shapes = by_label(result, "shape_parameter") if "shape" in result else {}
    for name, shape in shapes.items():
        row = {"quantity": name, "name": "shape", "value": shape["shape"].item()}
        error = shape.shape_standard_error.item()
        yield row | ({"constraint": "fixed"} if np.isnan(error) else {"standard_error": error})
    for name in FREQUENCY_ROWS:
        row = {"quantity": name, "name": name.replace("_", " "), "unit": "rad/s"}
        yield row | {"value": result[name].item(), "standard_error": result[error_of(name)].item()}


def number_and_mark(row: Mapping[str, Any]) -> tuple[str, str]:
    """Return a quantity with its error, and a mark if it is fixed, at its bound or tied."""
    if "standard_error" not in row:
        return f"{row['value']:g}", " (held)"
    number = value_with_error(row["value"], row["standard_error"])
    return number, MARKS.get(row.get("constraint", ""), " (tied)")


def coefficient_table(
    results: Mapping[str, xr.Dataset],
    z: Mapping[Any, float] = MappingProxyType({}),
    below: Iterable[Mapping[str, str]] = (),
) -> Table:
    """Return coefficients by each identification with errors, and their differences in errors.

    Parameters
    ----------
    results : mapping of str to Dataset
        Identifications by name.
    z : mapping of str to float
        Differences over their errors, by the names of quantities; if empty, this column is omitted.
    below : iterable of mapping of str to str
        Further rows.
    """
    pairs = [(method, row) for method, result in results.items() for row in quantities(result)]
    width = max([8, *(len(row["quantity"]) for _, row in pairs if "formula" in row)])
    rows: dict[str, dict[str, str]] = {}
    # Forces, then shape parameters, then frequencies of all methods.
    pairs.sort(key=_place_in_table)
    for method, row in pairs:
        label = row["quantity"]
        name = row["name"]
        if "formula" in row:
            what = f"{label:{width}} {name_and_unit(name, row['unit'])}"
            formula = shortened(row["formula"])
        elif label in FREQUENCY_ROWS:
            label, what, formula = name, FREQUENCY_ROWS[label], name
        else:
            what = label
            formula = "shape parameter"
        cells = rows.setdefault(label, {"force": what, "formula": formula, **dict.fromkeys(results, "-")})
        dropped = not row.get("active", True)
        cells[method] = (
            f"dropped (± {row['standard_error']:.2g})" if dropped else "".join(number_and_mark(row))
        )
    for label, cells in rows.items() if z else ():
        apart = z.get(label, np.nan)
        cells["difference / error"] = f"{apart:+.1f}" if np.isfinite(apart) else ""
    return text_table([*rows.values(), *below], ("force", "formula"))


def shortened(formula: str, longest: int = 48) -> str:
    """Return a formula for a table; the command `forces` shows long formulas in full."""
    return formula if len(formula) <= longest else f"{formula[: longest - 3]}..."


def name_and_unit(name: str, unit: str) -> str:
    """Return a name followed by its unit, if it has one."""
    return name if unit == "1" else f"{name} ({unit})"


# First characters of a spreadsheet formula.
FORMULA_SIGNS = ("=", "+", "-", "@")
# Types of attributes that JSON contains unchanged.
PLAIN = (str, int, float)
# Tables of keys for each kind of result or part of a result.
KEYS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("keys.toml").read_text(encoding="utf-8"))


def mapped(
    data: Any, table: str | Mapping[str, Any], computed: Mapping[str, Any] = MappingProxyType({})
) -> dict[str, Any]:
    """Return the entries of a table for a dataset, by its keys.

    Parameters
    ----------
    data : Dataset or DataTree
        Contains the variables and attributes named in the table.
    table : str or mapping
        Name of a table in `keys.toml`; or the entry for each key.
    computed : mapping of str to data
        Values for other keys of the table.
    """
    rows = KEYS[table] if isinstance(table, str) else table
    if "of" in rows:
        own = {key: source for key, source in rows.items() if key != "of"}
        inner = KEYS[own["as"]] if "as" in own else own.get("is", own)
        if isinstance(data, xr.DataTree):
            return _value(data[rows["of"]].to_dataset(), inner)
        return per_label(data, rows["of"], inner)
    made = {}
    for key, source in rows.items():
        if key in computed:
            made[key] = computed[key]
        elif not (isinstance(source, str) and source.endswith("?") and source[:-1] not in data):
            made[key] = _value(data, source)
    return made


def _value(data: Any, source: str | Mapping[str, Any]) -> Any:
    if isinstance(source, Mapping):
        return mapped(data, source)
    name, _, attribute = source.partition("@")
    if attribute:
        return (data[name] if name else data).attrs.get(attribute)
    if name.endswith("±"):
        return mapped(data, {"value": name[:-1], "standard_error": error_of(name[:-1])})
    return data[name.removesuffix("?")]


def _place_in_table(pair: tuple[str, Mapping[str, Any]]) -> int:
    """Return the place of a row of a method: forces first, then shape parameters, then frequencies."""
    _, row = pair
    if row["quantity"] in FREQUENCY_ROWS:
        return 2
    return int("formula" not in row)


def evenly_chosen(count: int, most: int) -> Index:
    """Return a limited number of indices below a count, evenly spaced from the first to the last."""
    return np.unique(np.linspace(0, count - 1, most).round().astype(int))


def by_variables(data: xr.Dataset) -> dict[str, Any]:
    """Return scalars by the names of their variables, other variables by each label of their dimension.

    Parameters
    ----------
    data : Dataset
        Data with one labelled dimension, and other dimensions without labels.
    """
    dims = [dim for dim in data.dims if dim in data.coords]
    along = {}
    said: dict[str, Any] = {}
    for name, variable in data.data_vars.items():
        along[name] = next((dim for dim in dims if dim in variable.dims), "")
        if not along[name]:
            said[str(name)] = variable
    for dim in dims:
        names = [name for name, of in along.items() if of == dim]
        said[str(dim)] = {
            label: {str(name): part[name] for name in names}
            for label, part in by_label(data, str(dim)).items()
        }
    return said


def judged_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return the judged variables of each model, by their names."""
    return {"judged": by_variables(tree["judged"].to_dataset())["model"]}


def per_label(data: Any, dim: str, source: str | Mapping[str, Any]) -> dict[str, Any]:
    """Return the entries of a source at each label of a dimension; nothing without this dimension."""
    if dim not in data.dims:
        return {}
    return {label: _value(part, source) for label, part in by_label(data, dim).items()}


def plain(value: Any) -> Any:
    """Convert data for JSON: a number that is not finite becomes None."""
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, xr.DataArray | np.ndarray | np.generic):
        return plain(np.asarray(value).tolist())
    return None if isinstance(value, float) and not np.isfinite(value) else value


def records_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return the attributes of the record, and of all records if there are several."""
    records = []
    for group in record_groups(tree):
        attrs = tree[group].attrs
        records.append({key: value for key, value in attrs.items() if isinstance(value, PLAIN)})
    return {"record": records[0]} | ({"records": records} if len(records) > 1 else {})


def csv_of(heads: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    """Return the rows as CSV, by the heads of their columns."""
    # A missing cell is empty; a number that is not finite is nan.
    whole = [dict.fromkeys(heads, "") | dict(row) for row in rows]
    table = pd.DataFrame(whole, columns=list(heads), dtype=object)
    # A spreadsheet would execute a text that begins like a formula.
    safe = table.map(lambda v: f"'{v}" if isinstance(v, str) and v.startswith(FORMULA_SIGNS) else v)
    return str(safe.to_csv(index=False, na_rep="nan", lineterminator="\n"))
