"""The backbone of a decay: a table and sentences, plain data for JSON, and a table for spreadsheets."""

import csv
import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from sysid_trib.printing.layers import ALWAYS, Block
from sysid_trib.printing.layout import number, text_table, value_with_error

if TYPE_CHECKING:
    from rich.table import Table

# Amplitudes of the printed table, evenly spaced in their logarithm.
PRINTED_AMPLITUDES = 8
CURVE_NAMES = ("frequency", "damping_ratio", "dissipative_force", "elastic_force")
COLUMNS = tuple(f"{name}{end}" for name in CURVE_NAMES for end in ("", "_standard_error", "_low", "_high"))
EXPLANATION = (
    "±: half the band that holds the whole curve in 95 % of records, for noise of the sensor and a random "
    "walk of amplitude and phase."
)


def backbone_blocks(backbones: Mapping[str, xr.Dataset], sources: Sequence[str]) -> list[Block]:
    """What the command `backbone` prints.

    Parameters
    ----------
    backbones : mapping of str to Dataset
        That of each run, of `backbone`.
    sources : sequence of str
        What each record is.
    """
    blocks = [Block(list(dict.fromkeys(sources)), ALWAYS)]
    for count, (_, data) in enumerate(backbones.items(), 1):
        title = f"Run {count}:" if len(backbones) > 1 else ""
        blocks.append(Block(_table(data), ALWAYS, title))
    return [*blocks, Block([EXPLANATION], ALWAYS)]


def backbone_json(backbones: Mapping[str, xr.Dataset]) -> dict[str, Any]:
    """The curves of each run as plain data, in the unit of the record."""
    return {
        "runs": [
            {
                "source": data.attrs.get("source"),
                "unit": data.amplitude.attrs["units"],
                "amplitude": data.amplitude.values.tolist(),
            }
            | {name: [number(value) for value in data[name].values] for name in COLUMNS}
            for data in backbones.values()
        ]
    }


def backbone_csv(backbones: Mapping[str, xr.Dataset]) -> str:
    """A row for each run and amplitude."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["run", "unit", "amplitude", *COLUMNS])
    for run, data in enumerate(backbones.values(), 1):
        table = np.column_stack([data[name].values for name in ("amplitude", *COLUMNS)])
        writer.writerows([run, data.amplitude.attrs["units"], *row] for row in table.tolist())
    return buffer.getvalue()


def _table(data: xr.Dataset) -> "Table":
    unit, amplitude = data.amplitude.attrs["units"], data.amplitude.values
    wanted = np.geomspace(amplitude[-1], amplitude[0], PRINTED_AMPLITUDES)
    places = dict.fromkeys(int(np.argmin(np.abs(np.log(amplitude / a)))) for a in wanted)
    rows = [[f"{amplitude[at]:.3g}", *_cells(data.isel(amplitude=at))] for at in places]
    return text_table([f"amplitude ({unit})", "frequency (rad/s)", "damping ratio"], rows, numbers=(0, 1, 2))


def _cells(point: xr.Dataset) -> list[str]:
    """Frequency and damping ratio at one amplitude with half their bands."""
    return [
        value_with_error(point[name].item(), point[f"{name}_high"].item() - point[name].item())
        for name in CURVE_NAMES[:2]
    ]
