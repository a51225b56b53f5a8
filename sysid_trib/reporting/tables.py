"""Coefficients of identifications as tables of a page."""

from collections.abc import Mapping

import numpy as np
import xarray as xr

from sysid_trib.printing.identification import coefficient_cell
from sysid_trib.printing.layout import value_with_error
from sysid_trib.reporting.parts import PageTable
from sysid_trib.results.signal_units import signal_units


def coefficient_table(results: Mapping[str, xr.Dataset]) -> PageTable:
    """Coefficients of identifications side by side with errors, units, and the frequency they refer to."""
    forces = {symbol: r.sel(force=symbol) for r in results.values() for symbol in r.force.values.tolist()}
    rows = []
    for symbol, force in forces.items():
        cells = [coefficient_cell(result, symbol) for result in results.values()]
        unit, refers_to = force.unit.item().removeprefix("1"), f"{force.refers_to.item():.6g}"
        rows.append([symbol, force["name"].item(), force.formula.item(), *cells, unit, refers_to])
    rows += _shape_rows(results)
    for name, title in (("reference_frequency", "w"), ("asymptotic_frequency", "w_inf")):
        errors = [result[f"{name}_standard_error"].item() for result in results.values()]
        cells = [value_with_error(r[name].item(), e) for r, e in zip(results.values(), errors, strict=True)]
        rows.append([title, name.replace("_", " "), "", *cells, "rad/s", ""])
    noises = [f"{result.noise.item():.2g}" for result in results.values()]
    rows.append(["noise", "standard deviation", "", *noises, signal_units(next(iter(results.values()))), ""])
    heads = ["force", "name", "formula", *results, "unit", "refers to (rad/s)"]
    last = len(heads) - 1
    return PageTable("Coefficients", heads, rows, frozenset({*range(3, last - 1), last}))


def _shape_rows(results: Mapping[str, xr.Dataset]) -> list[list[str]]:
    """Shape parameters: fitted with an error, or held."""
    cells: dict[str, dict[str, str]] = {}
    for label, result in results.items():
        for name in result.shape_parameter.values.tolist() if "shape" in result else []:
            shape = result.sel(shape_parameter=name)
            value, error = shape["shape"].item(), shape.shape_standard_error.item()
            text = f"{value:g} (held)" if np.isnan(error) else value_with_error(value, error)
            cells.setdefault(name, {})[label] = text
    return [
        [name, "shape parameter", "", *(by_label.get(label, "-") for label in results), "", ""]
        for name, by_label in cells.items()
    ]


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
