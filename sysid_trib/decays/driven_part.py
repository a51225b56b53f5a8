"""The part of a driven record that is asked for, as it is: no decay is looked for in it."""

import numpy as np
import xarray as xr

from sysid_trib.decays.signal import FEWEST_SAMPLES
from sysid_trib.errors import DecayError, UsageError


def driven_part(
    record: xr.Dataset, window: tuple[float | None, float | None], names: list[str]
) -> xr.Dataset:
    """A driven record within a window, with a sentence on it (attrs `free_decay`).

    Parameters
    ----------
    record : Dataset
        `angle(time)` with inputs.
    window : (float or None, float or None), s
        First and last time; open where None.
    names : list of str
        Its inputs.

    Raises
    ------
    DecayError
        The window holds too few samples.
    UsageError
        What was measured is a rate or an acceleration, which is fitted of free decays alone.
    """
    if record.attrs.get("integrations"):
        raise UsageError(
            "A driven record is an angle or a displacement; this one is integrated. Name a column of these "
            "(--angle), or leave the input out."
        )
    low, high = window
    part = record.sel(time=slice(low, high))
    if part.sizes["time"] < FEWEST_SAMPLES:
        raise DecayError(
            f"The window holds {part.sizes['time']} samples of {record.sizes['time']}; give a longer one."
        )
    time, between = part.time.values, {str(part[name].attrs["between"]) for name in names}
    units = [f"{name} ({part[name].attrs.get('units', 'unit not stated')})" for name in names]
    step = float(np.median(np.diff(time)))
    said = (
        f"Driven record: {time[0]:.6g} s to {time[-1]:.6g} s ({len(time)} samples, {step:.4g} s apart); "
        f"inputs {', '.join(units)}, {' and '.join(sorted(between))} between samples."
    )
    return part.assign_attrs(free_decay=said)
