"""Numbers with errors, tables, coefficients side by side, plain data for JSON, and what results say alike."""

from collections.abc import Callable, Iterable, Mapping
from math import floor, log10
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from rich.table import Table

from sysid_trib.results.variables import record_groups, small_units

# Attributes of a comparison that warn, and their sentences.
ENVELOPE = "Methods of the envelope and the frequency, such as averaging, cannot"
UNIDENTIFIABLE = {
    "no_method_identifies": "No method here identifies: {}.",
    "no_method_can_tell_apart": "No method can separate: {}.",
    "averaging_cannot_tell_apart": f"{ENVELOPE} separate: {{}}.",
    "averaging_cannot_see": f"{ENVELOPE} identify: {{}}.",
}
MARKS = {"": "", "fixed": " (fixed)", "at its bound": " (bound)"}
FREQUENCY_TITLES = {"reference frequency": "w (rad/s)", "asymptotic frequency": "w_inf (rad/s)"}


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


def values_with_errors(values: ArrayLike, errors: ArrayLike) -> list[str]:
    """Several values with their errors as texts."""
    pairs = zip(np.ravel(values).tolist(), np.ravel(errors).tolist(), strict=True)
    return [value_with_error(value, error) for value, error in pairs]


def error_of(name: str) -> str:
    """The variable that has the standard error of another."""
    return "standard_error" if name == "coefficient" else f"{name}_standard_error"


def quantity(result: xr.Dataset, name: str, units: str = "", factor: float = 1.0) -> str:
    """A variable of a result with its standard error, both times a factor, with units behind it."""
    value, error = (factor * result[key].item() for key in (name, error_of(name)))
    return f"{value_with_error(value, error)}{units}"


def with_unit(text: str, unit: str) -> str:
    """A number with its unit; nothing is behind one that has none."""
    return text if unit == "1" else f"{text} {unit}"


def coefficient_text(force: xr.Dataset) -> str:
    """The coefficient of a force with its standard error, and its unit where it has one."""
    return with_unit(quantity(force, "coefficient"), force.unit.item())


def in_small_units(size: float, units: str) -> str:
    """What is small beside the signal as text: angles in mrad."""
    factor, unit = small_units(units)
    return f"{factor * size:.3g} {unit}"


def p_value_text(p_value: float, equals: str = "= ") -> str:
    """A p-value as a sentence takes it, or without `equals` a table."""
    if not np.isfinite(p_value):
        return "-"
    return f"{equals}{p_value:.2g}" if p_value > 1e-300 else "< 1e-300"


def by_label(data: xr.Dataset, dim: str) -> dict[str, xr.Dataset]:
    """The part of a dataset at each label of a dimension."""
    return {label: data.sel({dim: label}) for label in data[dim].values.tolist()}


def first_and_more(sentences: list[str], most: int, rest: str = "") -> list[str]:
    """The first of many sentences, and in one how many more there are."""
    more = len(sentences) - most
    return [*sentences[:most], *([f"And {more:,} more{rest}."] if more > 0 else [])]


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


def identifiability_warnings(attrs: Mapping[str, Any]) -> list[str]:
    """What methods cannot identify or separate by principle, from the attributes of a comparison."""
    return [text.format(attrs[key]) for key, text in UNIDENTIFIABLE.items() if attrs.get(key)]


def text_table(
    heads: list[str], rows: list[list[str]], *, whole: tuple[int, ...] = (), numbers: tuple[int, ...] = ()
) -> Table:
    """A table whose words a narrow terminal may fold, but not the columns `whole` nor the `numbers`."""
    table = Table(box=None, pad_edge=False, header_style="bold")
    for at, head in enumerate(heads):
        # As wide as a word of the head: a narrow terminal would break it.
        cells = (*(row[at] for row in rows), *head.split())
        longest = max(len(line) for cell in cells for line in cell.split("\n"))
        table.add_column(
            head,
            justify="right" if at in numbers else "left",
            min_width=longest if at in (*whole, *numbers) else min(longest, 12),
            overflow="fold",
        )
    for row in rows:
        table.add_row(*row)
    return table


def coefficient_rows(results: Mapping[str, xr.Dataset]) -> dict[str, list[str]]:
    """Rows of a table: what it is, its formula, and a cell for each identification.

    Parameters
    ----------
    results : mapping of str to Dataset
        Identifications by name.

    Returns
    -------
    dict of str to list of str
        By symbols of forces, names of shape parameters, and names of the two frequencies.
    """
    forces = {s: r.sel(force=s) for r in results.values() for s in r.force.values.tolist()}
    width, rows = max([8, *map(len, forces)]), {}
    for symbol, force in forces.items():
        unit = "" if force.unit.item() == "1" else f" ({force.unit.item()})"
        cells = [coefficient_cell(result, symbol) for result in results.values()]
        head = f"{symbol:{width}} {force['name'].item()}{unit}"
        rows[symbol] = [head, force["formula"].item(), *cells]
    shaped = [r.shape_parameter.values.tolist() for r in results.values() if "shape" in r]
    for name in dict.fromkeys(name for names in shaped for name in names):
        rows[name] = [name, "shape parameter", *(_shape_cell(r, name) for r in results.values())]
    for name, title in FREQUENCY_TITLES.items():
        variable = name.replace(" ", "_")
        rows[name] = [title, name, *(quantity(result, variable) for result in results.values())]
    return rows


def coefficient_cell(result: xr.Dataset, symbol: str) -> str:
    """A coefficient with its error, or why there is none."""
    if symbol not in result.force:
        return "-"
    force = result.sel(force=symbol)
    if not force.active.item():
        return f"dropped (± {force.standard_error.item():.2g})"
    return f"{quantity(force, 'coefficient')}{constraint_mark(force)}"


def constraint_mark(force: xr.Dataset) -> str:
    """Behind a coefficient: that it is fixed, at its bound or tied."""
    return MARKS.get(force.constraint.item() if "constraint" in force.coords else "", " (tied)")


def _shape_cell(result: xr.Dataset, name: str) -> str:
    """A shape parameter: fitted with an error, or held."""
    if "shape" not in result or name not in result.shape_parameter:
        return "-"
    return "".join(shape_and_mark(result, name))


def shape_and_mark(result: xr.Dataset, name: str) -> tuple[str, str]:
    """A shape parameter, with its error where it was fitted, and behind it that it is held."""
    shape = result.sel(shape_parameter=name)
    value, error = shape["shape"].item(), shape.shape_standard_error.item()
    return (f"{value:g}", " (held)") if np.isnan(error) else (value_with_error(value, error), "")


def reference_sentence(result: xr.Dataset) -> str:
    """The frequency to which coefficients refer, and their units."""
    w = result.reference_frequency.item()
    refers = ["Coefficients refer to w of their method"]
    units = ["They are dimensionless"]
    forces = [result[name].values.tolist() for name in ("force", "refers_to", "unit")]
    for symbol, frequency, unit in zip(*forces, strict=True):
        if not np.isclose(frequency, w, rtol=1e-12):
            refers.append(f"{symbol} to {frequency:.6g} rad/s")
        if unit != "1":
            units.append(f"{symbol} in {unit}")
    return f"{'; '.join(refers)}. {'; '.join(units)}."


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
