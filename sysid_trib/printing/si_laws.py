"""Printed laws in SI units: friction and the coefficient of friction at some speeds."""

from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.printing import ALWAYS, Block, layout
from sysid_trib.printing.laws import FRICTION_TITLE
from sysid_trib.results.kinds import GIVEN, MU
from sysid_trib.results.law_curves import LAWS_SI

SI_ROWS = 8


def si_blocks(tree: xr.DataTree) -> list[Block]:
    """Return the table of the friction in SI units; nothing if no inertia or mass was given."""
    if LAWS_SI not in tree.children:
        return []
    data = tree[LAWS_SI].to_dataset()
    rows = []
    along, name = ("sliding_speed", MU) if MU in data else ("speed", "friction")
    visited = np.flatnonzero(data.speed_visited.values)
    for at in visited[layout.evenly_chosen(len(visited), SI_ROWS)]:
        row = data.isel(speed=at, other_speed=at)
        unit = data[along].attrs["units"]
        cells = {f"{along.replace('_', ' ')} ({unit})": f"{row[along].item():.3g}"}
        cells[f"friction ({data.friction.attrs['units']})"] = layout.quantity(row, "friction")
        if MU in data:
            cells["coefficient of friction"] = layout.quantity(row, MU)
        low, high = (row[f"{name}_{end}"].item() for end in ("low", "high"))
        rows.append(cells | {"95 % band": f"{low:.4g} to {high:.4g}"})
    given = ", ".join(
        f"{known} {layout.quantity(data, known)} {data[known].attrs['units']}"
        for known in GIVEN
        if known in data
    )
    return [Block((), ALWAYS, FRICTION_TITLE, layout.text_table(rows), f"In SI units ({given})")]


def si_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return the laws in SI units as plain data, at the key `si`; empty if not requested."""
    if LAWS_SI not in tree.children:
        return {}
    data = tree[LAWS_SI].to_dataset()
    kept = [
        str(name) for name in data.variables if "other_" not in str(name) and "covariance" not in str(name)
    ]
    units = {name: data[name].attrs["units"] for name in kept if data[name].attrs.get("units")}
    return {"si": {name: data[name].values for name in kept} | {"units": units}}
