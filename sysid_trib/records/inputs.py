"""A known input: an acceleration that was measured beside the motion, a polynomial from sample to sample."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.polynomial.polynomial import polyval
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from sysid_trib.arrays import Array
from sysid_trib.decays.signal import checked_signal, unit_of_signal
from sysid_trib.errors import UsageError

# Variable of a record.
INPUT = "input"
BETWEEN_SAMPLES = ("linear", "held", "cubic")


@dataclass(frozen=True, eq=False)
class KnownInput:
    """u(t) in theta'' + w^2 (theta + f) = u(t).

    Parameters
    ----------
    elapsed : (sample,) array of float, s
        Time since the first sample of the record, increasing.
    acceleration : (sample,) array of float, rad/s^2
        At the samples; held beyond the last.
    between : str
        `linear`, `held` (as what a converter puts out), or `cubic` (a spline, as of a smooth signal).

    Raises
    ------
    UsageError
        Not as many finite numbers as there are samples, or another word for what is between them.
    """

    elapsed: Array
    acceleration: Array
    between: str = "linear"

    def __post_init__(self) -> None:
        shapes = np.shape(self.elapsed), np.shape(self.acceleration)
        if shapes[0] != shapes[1] or len(shapes[0]) != 1:
            raise UsageError(
                f"A known input has one acceleration for each sample; {shapes[1]} came for {shapes[0]}."
            )
        if not np.all(np.isfinite(self.acceleration)):
            raise UsageError("A known input must be finite numbers, rad/s^2; cut the record where it is not.")
        if self.between not in BETWEEN_SAMPLES:
            words = ", ".join(BETWEEN_SAMPLES)
            raise UsageError(f"Between samples an input is one of {words}, not '{self.between}'.")

    @cached_property
    def pieces(self) -> Array:
        """Polynomial from each sample on, by powers of the time since it, (power, step)."""
        if self.between == "cubic":
            return np.asarray(CubicSpline(self.elapsed, self.acceleration).c[::-1])
        held, slope = self.acceleration[:-1], np.diff(self.acceleration) / np.diff(self.elapsed)
        return np.array([held] if self.between == "held" else [held, slope])

    def over_stiffness(self, tau: ArrayLike, frequency: float) -> Array:
        """u/w^2 (rad) at tau = w t of a reference frequency (rad/s); at a jump the mean of both sides."""
        at = np.clip(np.asarray(tau) / frequency, self.elapsed[0], self.elapsed[-1])
        sides = [np.searchsorted(self.elapsed, at, side) - 1 for side in ("left", "right")]
        steps = [np.clip(side, 0, len(self.elapsed) - 2) for side in sides]
        values = [polyval(at - self.elapsed[i], self.pieces[:, i], tensor=False) for i in steps]
        return np.asarray(0.5 * (values[0] + values[1]) / frequency**2)

    def polynomials(self, knots: Array, frequency: float) -> Array:
        """u/w^2 (rad) from each knot (tau) on, by powers of tau since it, (knot, power)."""
        last = np.searchsorted(frequency * self.elapsed, knots, side="right") - 1
        within = (last >= 0) & (last < len(self.elapsed) - 1)
        step = np.clip(last, 0, len(self.elapsed) - 2)
        since, powers = knots / frequency - self.elapsed[step], self.pieces[:, step].copy()
        for low in range(len(powers) - 1):
            for power in range(len(powers) - 2, low - 1, -1):
                powers[power] += since * powers[power + 1]
        # Before the first sample and from the last on it is held.
        powers[:, ~within] = 0.0
        powers[0, ~within] = self.acceleration[np.where(last[~within] < 0, 0, -1)]
        return np.asarray(powers.T / frequency ** (2.0 + np.arange(len(powers))))


def known_input_of(record: xr.Dataset) -> KnownInput | None:
    """The known input of a record, `input(time)`; None where it has none.

    Parameters
    ----------
    record : Dataset
        `angle(time)`, and `input(time)` in its unit over s^2; its attribute `between` says what is between
        samples (see `KnownInput`).

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
    between = str(record[INPUT].attrs.get("between", "linear"))
    return KnownInput(time - time[0], record[INPUT].values.astype(float), between)


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
