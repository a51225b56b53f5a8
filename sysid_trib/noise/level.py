"""The noise of the sensor: the one definition of `noise` in every result."""

import math
from functools import lru_cache

import numpy as np
import xarray as xr

from sysid_trib.decays.equilibrium import with_half_periods
from sysid_trib.decays.half_periods import noise_of_record
from sysid_trib.errors import DecayError
from sysid_trib.noise.smoothing import MOST_KEPT, noise_about_spline

# Every method and verdict asks for the noise of the same record, or of its few runs: the last are kept.
KEPT_NOISES = 4
# Dry friction makes an acceleration jump, which no spline follows: it leaves so many times the noise.
JUMPS = 1.2


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
        No whole half period.
    """
    _, _, halves = with_half_periods(decay, fewest=1)
    return float(np.pi / np.median(halves.duration))


def nominal_frequency(frequency: float) -> float:
    """A frequency to two digits: the same for records that differ by noise, and so is their spline.

    The digits are those in a unit of time, a power of two of the second, that makes the frequency 5 to 10:
    results do not depend on the unit.
    """
    halvings = math.floor(math.log2(frequency / 5.0))
    return math.ldexp(float(f"{math.ldexp(frequency, -halvings):.2g}"), halvings)


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
        of the swing. Where the samples are too few, or have gaps, it is that of sixth differences, or of the
        quantisation if that is larger. Of an integrated signal it is that of what was measured,
        over the frequency of the swing for each integration.
    """
    integrations = int(decay.attrs.get("integrations", 0))
    if integrations and "measured" in decay:
        measured = decay["measured"].sel(measured_time=slice(*decay.time.values[[0, -1]].tolist()))
        by_spline = sensor_noise(xr.Dataset({"angle": measured.rename(measured_time="time")}))
        by_differences = noise_of_record(
            measured.measured_time.values.astype(float), measured.values.astype(float)
        )
        noise = by_spline if by_spline < JUMPS * by_differences else by_differences
        return float(noise / swing_frequency(decay) ** integrations)
    time, angle = decay.time.values.astype(float), decay.angle.values.astype(float)
    try:
        tau = nominal_frequency(swing_frequency(decay)) * (time - time[0])
        about_spline = _about_spline if len(tau) <= MOST_KEPT else _about_long_spline
        return about_spline(tau.tobytes(), angle.tobytes())
    except DecayError:
        return float(noise_of_record(time, angle))


def _noise(tau: bytes, angle: bytes) -> float:
    return noise_about_spline(np.frombuffer(tau), np.frombuffer(angle))


# A long record outlasts the records that are simulated of it.
_about_spline, _about_long_spline = lru_cache(KEPT_NOISES)(_noise), lru_cache(1)(_noise)
