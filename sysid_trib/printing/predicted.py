"""What an answer predicts of other records, in sentences and as plain data."""

from collections.abc import Sequence
from typing import Any

import xarray as xr

from sysid_trib.printing.mapping import mapped, same


def prediction_sentences(predicted: Sequence[xr.Dataset]) -> list[str]:
    """How near a free run comes to each record, its start fitted there (see `predict`)."""
    sentences = []
    for record in predicted:
        warm_up = float(record.attrs["warm_up"])
        start = f"to its first {warm_up:g} s, which do not count" if warm_up else "to all of it"
        unit = record.residual_rms.attrs["units"]
        part = 100.0 * record.residual_over_motion.item()
        sentences.append(
            f"Predicted: {record.attrs.get('source', 'record')}, its start fitted {start}: "
            f"{record.residual_rms.item():.3g} {unit} are left (RMS), {part:.2g} % of its motion."
        )
    return sentences


def prediction_json(predicted: Sequence[xr.Dataset]) -> dict[str, Any]:
    """The same as plain data, under `test`; nothing where nothing was predicted."""
    rows = [
        {"source": record.attrs.get("source", ""), "warm_up": record.attrs["warm_up"]}
        | mapped(record, same("residual_rms", "residual_over_motion"))
        for record in predicted
    ]
    return {"test": rows} if rows else {}
