"""The noise of the sensor: the one definition of `noise` in every result."""

import numpy as np
import xarray as xr

from sysid_trib.decays.equilibrium import usable_half_periods
from sysid_trib.noise.smoothing import smooth


def swing_frequency(decay: xr.Dataset) -> float:
    """Frequency of a decay by the median of its half periods, rad/s.

    Parameters
    ----------
    decay : Dataset
        With `angle(time)`.

    Returns
    -------
    float

    Raises
    ------
    DecayError
        Fewer than three half periods.
    """
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    halves = usable_half_periods(time, angle, str(decay.attrs.get("source", "decay")))
    return float(np.pi / np.median(halves.duration))


def nominal_frequency(frequency: float) -> float:
    """A frequency to two digits: the same for records that differ by noise, and so is their spline."""
    return float(f"{frequency:.2g}")


def sensor_noise(decay: xr.Dataset) -> float:
    """Standard deviation of a sample's noise, whatever the forces (rad).

    Parameters
    ----------
    decay : Dataset
        With `angle(time)`.

    Returns
    -------
    float
        Of what the least-squares spline with twelve knots a period does not follow: no model is needed, so
        that it is the same for every method. Of coloured noise it is the part above six times the frequency
        of the swing.

    Raises
    ------
    DecayError
        Fewer than three half periods, or samples that do not determine the spline.
    """
    time = decay.time.values.astype(float)
    tau = nominal_frequency(swing_frequency(decay)) * (time - time[0])
    return smooth(tau, decay.angle.values.astype(float)).noise
