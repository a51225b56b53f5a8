"""The forced response of a model as a table, as CSV and as plain data."""

import csv
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.printing.blocks import Block
from sysid_trib.printing.layout import mapped, same, text_table

# Motions of the printed table in each sweep, evenly apart, beside the largest.
PRINTED = 4
RESPONSE_COLUMNS = ("amplitude", "amplitude_low", "amplitude_high", "phase")
CHECKS = ("check_frequency", "check_amplitude", "simulated_amplitude")


def response_blocks(response: xr.Dataset) -> list[Block]:
    """What the command `response` prints of a result of `forced_response`."""
    unit, heads = response.amplitude.attrs["units"], ["sweep", "frequency (rad/s)", "over w_inf"]
    rows = []
    for sweep in response.sweep.values.tolist():
        motions = response.sel(sweep=sweep)
        there = np.flatnonzero(motions.amplitude.notnull().values)
        if len(there):
            apart = there[np.linspace(0, len(there) - 1, PRINTED + 1).round().astype(int)]
            largest = there[int(np.argmax(motions.amplitude.values[there]))]
            rows += [
                _row(motions.isel(frequency=at), sweep) for at in sorted({*apart.tolist(), int(largest)})
            ]
    heads += [f"amplitude ({unit})", "95 % band", "phase (rad)"]
    table = text_table(heads, rows, numbers=(1, 2, 3, 4, 5))
    return [Block(table=table), Block(_sentences(response))]


def _row(motion: xr.Dataset, sweep: str) -> list[str]:
    ends = (motion.amplitude_low.item(), motion.amplitude_high.item())
    return [
        sweep,
        f"{motion.frequency.item():.5g}",
        f"{motion.frequency_ratio.item():.4f}",
        f"{motion.amplitude.item():.4g}",
        "{:.4g} to {:.4g}".format(*ends),
        f"{motion.phase.item():.3f}",
    ]


def _sentences(response: xr.Dataset) -> list[str]:
    """Sentences on how much simulations differ, and on what the bands hold."""
    off = np.abs(response.simulated_amplitude / response.check_amplitude - 1.0).values
    count, kept = len(off), int(np.sum(off <= response.left_open.item()))
    if not count:
        return ["With this drive the model has no steady motion here: friction holds it, or it grows."]
    said = (
        f"{kept} of {count} simulated motions keep their amplitude, within "
        f"{100.0 * response.left_open.item():.2g} %, which the bands hold in addition to "
        "errors of the coefficients."
    )
    caution = "Beyond the amplitudes of the record the forces may have another form."
    return [said, caution]


def response_csv(response: xr.Dataset) -> str:
    """A row for each sweep and frequency."""
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(["sweep", "frequency_rad_s", "frequency_ratio", "unit", *RESPONSE_COLUMNS])
    for sweep in response.sweep.values.tolist():
        motions = response.sel(sweep=sweep).dropna("frequency", subset=["amplitude"])
        table = np.column_stack(
            [motions[name].values for name in ("frequency", "frequency_ratio", *RESPONSE_COLUMNS)]
        )
        unit = response.amplitude.attrs["units"]
        writer.writerows([sweep, *row[:2], unit, *row[2:]] for row in table.tolist())
    return buffer.getvalue()


def response_json(response: xr.Dataset) -> dict[str, Any]:
    """The curves as plain data, null where a sweep has no such motion."""
    curves: Sequence[str] = ("frequency", "frequency_ratio", *RESPONSE_COLUMNS)
    sweeps = {str(sweep): mapped(response.sel(sweep=sweep), same(*curves)) for sweep in response.sweep.values}
    unit = {"unit": response.amplitude.attrs["units"]}
    return unit | {"sweeps": sweeps} | mapped(response, same("left_open", *CHECKS))
