"""A known input: an acceleration that was measured beside the motion, linear from sample to sample."""

from dataclasses import dataclass

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array
from sysid_trib.decays.signal import checked_signal, unit_of_signal
from sysid_trib.errors import UsageError

# Variable of a record.
INPUT = "input"


@dataclass(frozen=True, eq=False)
class KnownInput:
    """u(t) in theta'' + w^2 (theta + f) = u(t).

    Parameters
    ----------
    elapsed : (sample,) array of float, s
        Time since the first sample of the record, increasing.
    acceleration : (sample,) array of float, rad/s^2
        Linear in between, and held beyond the last sample.

    Raises
    ------
    UsageError
        Not as many finite numbers as there are samples.
    """

    elapsed: Array
    acceleration: Array

    def __post_init__(self) -> None:
        shapes = np.shape(self.elapsed), np.shape(self.acceleration)
        if shapes[0] != shapes[1] or len(shapes[0]) != 1:
            raise UsageError(
                f"A known input has one acceleration for each sample; {shapes[1]} came for {shapes[0]}."
            )
        if not np.all(np.isfinite(self.acceleration)):
            raise UsageError("A known input must be finite numbers, rad/s^2; cut the record where it is not.")

    def over_stiffness(self, tau: ArrayLike, frequency: float) -> Array:
        """u/w^2 (rad) at tau = w t of a reference frequency (rad/s)."""
        at = np.asarray(tau) / frequency
        return np.asarray(np.interp(at, self.elapsed, self.acceleration) / frequency**2)


def known_input_of(record: xr.Dataset) -> KnownInput | None:
    """The known input of a record, `input(time)`; None where it has none.

    Parameters
    ----------
    record : Dataset
        `angle(time)`, and `input(time)` in its unit over s^2.

    Raises
    ------
    UsageError
        The input says no unit, or another one: a torque or a voltage is no acceleration.
    DecayError
        It is not a finite number at each time.
    """
    if INPUT not in record.variables:
        return None
    checked_signal(record, INPUT)
    units, wanted = record[INPUT].attrs.get("units"), f"{unit_of_signal(record)}/s^2"
    if units != wanted:
        said = "says no unit" if units is None else f"is in {units}"
        raise UsageError(
            f"input(time) {said}; give the acceleration in {wanted}, input.attrs['units'] = '{wanted}'."
        )
    time = record.time.values.astype(float)
    return KnownInput(time - time[0], record[INPUT].values.astype(float))


def refuse_inputs(record: xr.Dataset) -> None:
    """Refuse a known input in what takes free motions alone.

    Raises
    ------
    UsageError
        The record has one, other than zero.
    """
    if INPUT in record.variables and np.any(record[INPUT].values):
        raise UsageError(
            "This record has a known input, which Direct and Trajectory identify it with, and simulate, "
            "innovations and prediction_bands take; leave it out where it is zero, drop_vars('input')."
        )
