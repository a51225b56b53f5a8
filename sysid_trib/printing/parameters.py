"""Parameters of an identification for other programs: TOML or JSON, with their covariance."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib._version import __version__
from sysid_trib.forces.notation import toml_value
from sysid_trib.printing import layout
from sysid_trib.printing.equation import equation_text
from sysid_trib.results.models import library_of
from sysid_trib.results.references import stated_covariance
from sysid_trib.results.variables import signal_units


def parameters_of(result: xr.Dataset) -> dict[str, Any]:
    """Return the parameters of an identification as plain data.

    Parameters
    ----------
    result : Dataset
        An identification.

    Returns
    -------
    dict
        `equation`, `signal_unit`, `reference_frequency` (rad/s); `forces`, `shapes` and `frequencies`, each a
        list with values and standard errors; `covariance` with the `names` of its rows and columns, which are
        the coefficients and the asymptotic frequency.
    """
    symbols = result.force.values.tolist()
    formulas = {force.symbol: force.formula.text for force in library_of(result)}
    uses = {force.symbol: list(force.uses) for force in library_of(result)}
    forces = list[dict[str, Any]]()
    shapes = list[dict[str, Any]]()
    frequencies = list[dict[str, Any]]()
    for row in layout.quantities(result):
        name = row["quantity"]
        plain = {"symbol": name, "name": row.get("name"), "value": row["value"], "unit": row.get("unit")}
        error = row.get("standard_error")
        plain["standard_error"] = error if error is not None and np.isfinite(error) else None
        if name in formulas:
            plain |= {"formula": formulas[name], "uses": uses[name] or None}
            forces.append(_known(plain))
        else:
            (frequencies if name in layout.FREQUENCY_ROWS else shapes).append(_known(plain))
    covariance = stated_covariance(result, symbols)
    return {
        "program": f"sysid_trib {__version__}",
        "equation": equation_text(result),
        "signal_unit": signal_units(result),
        "reference_frequency": result.reference_frequency.item(),
        "forces": forces,
        **({"shapes": shapes} if shapes else {}),
        "frequencies": frequencies,
        "covariance": {"names": [*symbols, "asymptotic_frequency"], "values": covariance.tolist()},
    }


def _known(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return a row without unknown values, which TOML cannot represent."""
    return {key: value for key, value in row.items() if value is not None}


def parameters_text(result: xr.Dataset, language: str) -> str:
    """Return the parameters of an identification in TOML or JSON (see `parameters_of`)."""
    data = parameters_of(result)
    if language == "json":
        return json.dumps(data, indent=2, ensure_ascii=False) + "\n"
    lines = [
        f"{key} = {toml_value(value)}" for key, value in data.items() if not isinstance(value, list | dict)
    ]
    for key, rows in data.items():
        if isinstance(rows, list):
            for row in rows:
                lines += ["", f"[[{key}]]", *(f"{name} = {toml_value(value)}" for name, value in row.items())]
    covariance = data["covariance"]
    lines += ["", "[covariance]", f"names = {toml_value(covariance['names'])}", "values = ["]
    lines += [f"  {_row(row)}," for row in covariance["values"]]
    return "\n".join([*lines, "]", ""])


def _row(values: Sequence[float]) -> str:
    """Return a row of numbers in TOML, which writes `nan` instead of `NaN`."""
    return f"[{', '.join(repr(float(value)) for value in values)}]"
