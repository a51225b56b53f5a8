"""Variables of a result: dimensions, units and descriptions, and separate values of each run."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.special import ndtri

from sysid_trib.arrays import (
    Variable as Variable,
    Variables as Variables,
    variable as variable,
    with_error as with_error,
)
from sysid_trib.errors import UsageError

# Increase this with every change of variables, groups or attributes. Files without it have version 1.
FORMAT_VERSION = 8
# Parts of each run in which a result is fitted again: start and end as fractions of its duration.
PARTS_OF_RECORD = {"first 70 %": (0.0, 0.7), "middle 70 %": (0.15, 0.85), "last 70 %": (0.3, 1.0)}
# Confidence of all intervals, and of bands that contain a whole curve.
CONFIDENCE = 0.95
# Half width of such an interval, in standard errors of a normal distribution.
HALF_INTERVAL = float(-ndtri(0.5 * (1.0 - CONFIDENCE)))
# A coefficient's unit differs from force to force.
PER_FORCE_UNIT = "see the coordinate unit"
# Variables of validation and physics, by name.
RESULT_TABLES = tomllib.loads(Path(__file__).with_name("variables.toml").read_text(encoding="utf-8"))


# Scaling of each variable with the unit of the signal, if its own unit does not show it.
SCALINGS: Mapping[str, str] = {
    name: row[3] for table in RESULT_TABLES.values() for name, row in table.items() if len(row) > 3
}
# Prefixes and suffixes of names whose variables scale like another one.
OF_A_PERIOD = "period_"
ERRORS_AND_LIMITS = ("_standard_error", "_low", "_high")


def scaling_of(name: str) -> str:
    """Return the scaling of a variable with the unit of the signal: the fourth column of `variables.toml`.

    Parameters
    ----------
    name : str
        Name of a variable; its standard errors and limits scale in the same way.

    Returns
    -------
    str
        "fixed", "coefficient", "shape", or "unit" if its own unit shows it.
    """
    if name not in SCALINGS:
        name = name.removeprefix(OF_A_PERIOD)
        for ending in ERRORS_AND_LIMITS:
            name = name.removesuffix(ending)
    return SCALINGS.get(name, "unit")


def described(table: Mapping[str, Sequence[str]] | str, values: Mapping[str, Any]) -> Variables:
    """Return variables with the descriptions of a table.

    Parameters
    ----------
    table : mapping of str to (str, str, str), or str
        Dimensions separated by spaces, unit, and description; "text" is the unit of texts; a fourth entry is
        the scaling. Or the name of a table in `variables.toml`.
    values : mapping of str to array_like, or to a pair of them
        Values by the names in the table; a pair contains values and their standard errors.
    """
    known, variables = RESULT_TABLES[table] if isinstance(table, str) else table, Variables()
    for name, value in values.items():
        dims, units, meaning, *_ = known[name]
        if isinstance(value, tuple):
            variables |= with_error(name, tuple(dims.split()), value, meaning, units)
        elif units == "text":
            # An array of texts has the width of its longest text.
            variables[name] = variable(tuple(dims.split()), np.asarray(value, dtype=str), meaning)
        else:
            variables[name] = variable(tuple(dims.split()), value, meaning, units)
    return variables


def refuse_whole_result(result: Any) -> None:
    """Raise an error for a whole result where one identification is needed.

    Raises
    ------
    UsageError
        The message states how to take one of the identifications.
    """
    if isinstance(result, xr.DataTree) and result.children:
        raise UsageError(
            "This takes one identification; give the preferred one of this result, st.best(result), or that "
            "of a method, result['direct'].to_dataset()."
        )


def start_variables(
    starts: Sequence[tuple[float, float]], offsets: ArrayLike
) -> Mapping[str, tuple[ArrayLike, str, str]]:
    """Return start and sensor's zero of each run, in the form of `Estimate.extra`.

    Parameters
    ----------
    starts : sequence of (float, float)
        Angle (rad) and rate (rad/s) at the first sample of each run.
    offsets : (run,) array_like of float, rad
        Zero of the sensor in each run.
    """
    angles, rates = zip(*starts, strict=True)
    return {
        "start_angle": (angles, "rad", "angle of the model at the first sample"),
        "start_rate": (rates, "rad/s", "rate of the model at the first sample"),
        "offset": (offsets, "rad", "zero of the sensor about the decay's equilibrium"),
    }


def noise_of_run(result: xr.Dataset, run: int) -> float:
    """Return the sensor's noise in one run of an identification, rad."""
    return float(result.run_noise.values[run]) if "run_noise" in result else float(result.noise)


def group_names(name: str, count: int) -> list[str]:
    """Return the names of the runs' groups in a tree: `record`, or `record_1`, `record_2`, ... of several."""
    return [name] if count == 1 else [f"{name}_{at + 1}" for at in range(count)]


def record_groups(tree: xr.DataTree) -> list[str]:
    """Return the names of the records in a tree, in the order of the runs."""
    count = 0
    while f"record_{count + 1}" in tree.children:
        count += 1
    return group_names("record", max(1, count))


# Variables in the unit of the signal; each part of a result has at least one of them.
STATED_IN = ("angle", "noise", "innovation", "measured", "amplitude", "force")


def signal_units(data: Any) -> str:
    """Return the unit of the signal in a dataset, or in the records of a tree; rad if none is stated.

    Parameters
    ----------
    data : Dataset or DataTree
        A record, an identification, a part of a result, or a whole one.
    """
    group = record_groups(data)[0] if isinstance(data, xr.DataTree) else ""
    part = data[group] if group and group in data.children else data
    stated = (part[name].attrs.get("units") for name in STATED_IN if name in part)
    return str(next((units for units in stated if units), "rad"))


def frequency_unit_of(attrs: Mapping[Any, Any]) -> tuple[str, float]:
    """Return the unit in which a backbone shows its frequency, and this unit in rad/s: Hz for a mode."""
    return ("Hz", 2.0 * np.pi) if "mode_frequency" in attrs else ("rad/s", 1.0)


def small_units(units: str) -> tuple[float, str]:
    """Return factor and unit for small values of the signal: mrad for angles, otherwise unchanged."""
    return (1e3, "mrad") if units == "rad" else (1.0, units)


def signal_label(units: str) -> str:
    """Return the label of the signal with its unit, for an axis."""
    return f"{'angle' if units == 'rad' else 'displacement'} ({units})"


def signal_symbol(units: str) -> str:
    """Return the symbol of a signal in LaTeX."""
    return r"\theta" if units == "rad" else "x"
