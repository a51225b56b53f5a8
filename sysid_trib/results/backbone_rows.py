"""A few rows of a backbone at round amplitudes, for a printed table."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import xarray as xr
from scipy.interpolate import PchipInterpolator

from sysid_trib.arrays import Array

# Round amplitudes are these factors times a power of ten. The densest series that gives few rows is taken.
ROUND_FACTORS = ((1.0, 1.5, 2.0, 3.0, 5.0, 7.0), (1.0, 2.0, 5.0), (1.0, 3.0), (1.0,))
MOST_ROUND_ROWS = 10


@dataclass(frozen=True)
class BackboneRow:
    """Frequency and damping ratio at one amplitude, with half the widths of their bands.

    Attributes
    ----------
    amplitude : float
        In the unit of the displacement.
    measured_amplitude : float or None
        In the unit of the sensor; none if the displacement itself was measured.
    frequency, frequency_band : float
        In rad/s.
    damping_ratio, damping_ratio_band : float
    """

    amplitude: float
    measured_amplitude: float | None
    frequency: float
    frequency_band: float
    damping_ratio: float
    damping_ratio_band: float


def round_rows(curves: xr.Dataset) -> list[BackboneRow]:
    """Return the rows of a backbone at round amplitudes, largest first.

    Parameters
    ----------
    curves : Dataset
        Result of `backbone`. Where a rate or an acceleration was measured, its amplitudes are round.

    Returns
    -------
    list of BackboneRow
        The curves at both ends and, between them, at round amplitudes, by monotone cubic interpolation over
        the logarithm of the amplitude.
    """
    measured = curves.get("measured_amplitude", curves.amplitude).values
    places = np.log(measured)

    def at(values: Array, place: float) -> float:
        return float(PchipInterpolator(places, values)(place))

    rows = []
    for place in np.log(_round_amplitudes(measured[0], measured[-1])):
        row = BackboneRow(
            amplitude=np.exp(at(np.log(curves.amplitude.values), place)),
            measured_amplitude=np.exp(place) if "measured_amplitude" in curves else None,
            frequency=at(curves.frequency.values, place),
            frequency_band=at((curves.frequency_high - curves.frequency).values, place),
            damping_ratio=at(curves.damping_ratio.values, place),
            damping_ratio_band=at((curves.damping_ratio_high - curves.damping_ratio).values, place),
        )
        rows.append(row)
    return rows


def _round_amplitudes(low: float, high: float) -> list[float]:
    """Return both ends and the round amplitudes between them, largest first."""
    for series in ROUND_FACTORS:
        inside = [value for value in _multiples(series, low, high) if 1.05 * low < value < high / 1.05]
        if len(inside) <= MOST_ROUND_ROWS:
            break
    return [high, *inside[::-1], low]


def _multiples(series: tuple[float, ...], low: float, high: float) -> Iterator[float]:
    """Yield the numbers of a series times powers of ten, increasing, from below low to above high."""
    for power in range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1):
        # A division by a power of ten rounds to the number that its digits name.
        yield from (factor * 10.0**power if power >= 0 else factor / 10.0**-power for factor in series)
