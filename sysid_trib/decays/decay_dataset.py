"""A decay that was cut out of a record, as a Dataset."""

from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.decays.equilibrium import Swing
from sysid_trib.decays.free_part import Part
from sysid_trib.decays.half_sines import with_standard_error
from sysid_trib.decays.integration import integrated
from sysid_trib.decays.signal import unit_of_signal
from sysid_trib.decays.uniform import Piece

# Samples of a period that are kept of an integrated signal: integration leaves next to no noise above them.
INTEGRATED_POINTS_PER_PERIOD = 32


@dataclass(frozen=True)
class CutDecay:
    """A decay within a piece of a record: its swing, and the part that is free."""

    piece: Piece
    swing: Swing
    part: Part


def decay_dataset(record: xr.Dataset, decay: CutDecay, said: str) -> xr.Dataset:
    """The decay as a part of its record, on the record's own samples where nothing was changed.

    Parameters
    ----------
    record : Dataset
        With `angle(time)`, and the rate or acceleration that is to be integrated (attribute `measured`).
    decay : CutDecay
        Found in the angle, or in what was measured.
    said : str
        What was done to the samples before.

    Returns
    -------
    Dataset
        As `free_decay` returns it.
    """
    piece, swing, part = decay.piece, decay.swing, decay.part
    chosen = slice(part.start, part.stop)
    time, signal = piece.time[chosen], piece.signal[chosen] - swing.equilibrium
    attrs = record["angle"].attrs
    units = centred_in = unit_of_signal(record)
    equilibrium = swing.equilibrium, swing.standard_error
    measured = record.attrs.get("measured")
    beside = {}
    if measured:
        own_attrs = dict(record[measured].attrs) | {"long_name": f"{measured} as measured, about its mean"}
        at = ("measured_time", time, {"units": "s", "long_name": "time"})
        beside = {"measured": xr.DataArray(signal, {"measured_time": at}, "measured_time", attrs=own_attrs)}
        period = swing.oscillation.period
        for _ in range(int(record.attrs["integrations"])):
            signal = integrated(time, signal, period)
        if "felt_per_sine" in record.attrs:
            signal = np.arcsin(np.clip(signal / float(record.attrs["felt_per_sine"]), -1.0, 1.0))
        every = max(1, int(period / INTEGRATED_POINTS_PER_PERIOD * (time.size - 1) / (time[-1] - time[0])))
        every = every if record.attrs["integrations"] else 1
        time, signal = time[::every], signal[::every]
        equilibrium, centred_in = (0.0, np.nan), str(record[measured].attrs["units"])
    cut = _on_own_samples(record, time, bare=bool(measured))
    cut["angle"] = ("time", signal, attrs)
    cut = cut.assign(beside)
    cut = cut.assign(with_standard_error((), "equilibrium", *equilibrium, units, "equilibrium"))
    if np.isfinite(part.stop_time):
        stop_attrs = {"units": "s", "long_name": "time at which it stopped for good"}
        cut["stop_time"] = ((), part.stop_time, stop_attrs)
    mended = "; ".join(text for text in (said, piece.sentence) if text)
    cut.attrs["free_decay"] = _sentence(piece.time, part, swing, centred_in, mended)
    return cut


def _on_own_samples(record: xr.Dataset, time: Array, *, bare: bool) -> xr.Dataset:
    """The record's part at these times, with all its variables; of other times their coordinate alone."""
    first = int(np.searchsorted(record["time"].to_numpy(), time[0]))
    part = record.isel(time=slice(first, first + time.size))
    if np.array_equal(part["time"].to_numpy(), time) and not bare:
        return part.copy()
    return xr.Dataset(coords={"time": ("time", time, record["time"].attrs)}, attrs=record.attrs)


def _sentence(time: Array, part: Part, swing: Swing, units: str, mended: str) -> str:
    cut = " and ".join(text for text in (part.before, part.after) if text)
    kept = f"kept {time[part.start]:.6g} s to {time[part.stop - 1]:.6g} s ({part.stop - part.start} samples)"
    error = f" ± {swing.standard_error:.2g}" if np.isfinite(swing.standard_error) else " as given"
    middle = f"centred on {swing.equilibrium:.6g}{error} {units}"
    done = f"; {mended}" if mended else ""
    return f"Free decay: {kept}; cut {cut or 'nothing'}{done}; {middle}."
