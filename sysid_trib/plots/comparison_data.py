"""Methods side by side as numbers to draw, the same on paper and on a page."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.plots.style import BLUE, GREEN, INK, ORANGE, Style
from sysid_trib.validation.comparison_table import column_power

# Marks of the families that methods state (see `MethodScope`).
OTHER_FAMILY = "other"
FAMILY_MARKS: dict[str, dict[str, Any]] = {
    "trajectory": {"color": GREEN, "marker": "D"},
    "direct": {"color": BLUE, "marker": "s"},
    "averaging": {"color": ORANGE, "marker": "o"},
    OTHER_FAMILY: {"color": INK, "marker": "^"},
}
FAMILY_LABELS = {OTHER_FAMILY: "decrements and others"}
ASYMPTOTIC = "asymptotic_frequency"
PREDICTION = {"train_over_noise": "first two thirds", "holdout_over_noise": "held-out third"}
# A method farther from the best than this many times the usual distance is an arrow at the edge.
ARROW_BEYOND = 5.0


@dataclass(frozen=True)
class ComparisonData:
    """Methods that have any result, with their marks.

    Attributes
    ----------
    table : xr.Dataset
        The group `comparison` of these methods.
    marks : mapping of str to style
        Mark of each method: that of its family, open for all but the first of the family.
    legend : mapping of str to style
        Mark of each of their families, by its name in a legend.
    """

    table: xr.Dataset
    marks: Mapping[str, Style]
    legend: Mapping[str, Style]

    @property
    def quantities(self) -> list[str]:
        """What is compared: the forces by symbol, and the asymptotic frequency."""
        return [*self.table.force.values.tolist(), ASYMPTOTIC]

    def quantity(self, name: str) -> xr.Dataset:
        """A coefficient or the `asymptotic_frequency` by method, as an axis shows it.

        Parameters
        ----------
        name : str
            Symbol of a force, or `asymptotic_frequency`.

        Returns
        -------
        xr.Dataset
            `value(method)` and `error(method)` over ten to the attribute `power`, and `side(method)`: -1 or 1
            for a value beyond the axis, else 0. Attributes: `power`, `unit`, the ends `low` and `high` of the
            axis, and the band of the method that predicts best, `band_low` and `band_high` (nan without one).
        """
        table = self.table
        if name == ASYMPTOTIC:
            power, unit = 0, "rad/s"
            columns = table[ASYMPTOTIC], table[f"{ASYMPTOTIC}_standard_error"]
        else:
            column = table.sel(force=name)
            power, unit = column_power(column), column.unit.item()
            columns = column.coefficient, column.standard_error
        value, error = (column.values / 10.0**power for column in columns)
        at = table.method.values.tolist().index(table.attrs["best"])
        low, high = _limits(value, error, at)
        side = np.where(value > high, 1, np.where(value < low, -1, 0))
        shown = {name: ("method", c) for name, c in (("value", value), ("error", error), ("side", side))}
        band = {"band_low": value[at] - error[at], "band_high": value[at] + error[at]}
        attrs = {"power": power, "unit": unit, "low": low, "high": high} | band
        return xr.Dataset(shown, {"method": table.method.values}, attrs)


def comparison_data(tree: xr.DataTree) -> ComparisonData:
    """A result of `compare` as figures draw it."""
    table = tree["comparison"].to_dataset()
    # A method that failed must not set a scale.
    table = table.isel(method=np.flatnonzero((table.failure == "") | (table.method == table.attrs["best"])))
    results = [table[name].notnull() for name in ("coefficient", ASYMPTOTIC, *PREDICTION)]
    there = [column.any("force") if "force" in column.dims else column for column in results]
    table = table.isel(method=np.flatnonzero(np.any(there, axis=0)))
    marks: dict[str, Style] = {}
    before: set[str] = set()
    for method, stated in zip(table.method.values.tolist(), table.family.values.tolist(), strict=True):
        family = stated if stated in FAMILY_MARKS else OTHER_FAMILY
        face = {"markerfacecolor": "white"} if family in before - {OTHER_FAMILY} else {}
        marks[method] = FAMILY_MARKS[family] | face
        before.add(family)
    legend = {FAMILY_LABELS.get(k, k): style for k, style in FAMILY_MARKS.items() if k in before}
    return ComparisonData(table, marks, legend)


def _limits(value: Array, error: Array, best: int) -> tuple[float, float]:
    """Ends of an axis on which most methods have room; an outlier must not squeeze the others."""
    known = np.isfinite(value[best])
    centre = float(value[best] if known else np.nanmedian(value))
    distance = np.abs(value - centre) + error
    usual = max(float(np.nanmedian(distance)), 3.0 * float(error[best]) if known else 0.0)
    inside = distance <= ARROW_BEYOND * usual
    low = min(float((value - error)[inside].min(initial=np.inf)), centre - usual)
    high = max(float((value + error)[inside].max(initial=-np.inf)), centre + usual)
    spare = max(0.08 * (high - low), 1e-9 * abs(centre), 1e-300)
    return low - spare, high + spare
