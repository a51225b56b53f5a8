"""Several runs of one experiment as a list of decays."""

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.decays.signal import checked_signal
from sysid_trib.errors import UsageError
from sysid_trib.records.inputs import refuse_inputs

Decays: TypeAlias = xr.Dataset | Sequence[xr.Dataset]

# Of each run, by which it shows how far names and coefficients hold.
RECORD_PARTS = {"first 70 %": (0.0, 0.7), "middle 70 %": (0.15, 0.85), "last 70 %": (0.3, 1.0)}


def as_runs(decay: Decays, *, driven: bool = False) -> list[xr.Dataset]:
    """The runs as a list, also if there is but one.

    Parameters
    ----------
    decay : Dataset or sequence of Dataset
        `angle(time)` of one run, or of several.
    driven : bool
        Whether a known input is taken.

    Raises
    ------
    UsageError
        None is given, or one is no decay, or has a known input that is not taken.
    DecayError
        One holds what is no number, or times that do not rise.
    """
    runs = [decay] if isinstance(decay, xr.Dataset) else list(decay)
    if not runs:
        raise UsageError("No run is given; give at least one decay.")
    for run in runs:
        checked_signal(run)
        if not driven:
            refuse_inputs(run)
    return runs


def one_or_all(runs: Sequence[xr.Dataset]) -> Decays:
    """The decay itself where there is but one."""
    return runs[0] if len(runs) == 1 else list(runs)


def root_mean_square(values: ArrayLike) -> float:
    """RMS of numbers; of one it is that number itself."""
    numbers = np.asarray(values, dtype=float)
    return float(numbers[0]) if len(numbers) == 1 else float(np.sqrt(np.mean(numbers**2)))
