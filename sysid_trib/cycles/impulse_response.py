"""What an impulse does to a steady swing: to the extrema fitted to its half periods, and to their times."""

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import scipy.sparse as sp
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.records.half_periods import HalfPeriods
from sysid_trib.records.half_sines import EXTREMA, EnvelopeCurve

IMPULSES = 8
"""Impulses in each half period that stand for white acceleration."""
SPAN = 4
"""Half periods before and after an impulse whose extrema it moves otherwise than for good."""
# Of the swing's amplitude.
IMPULSE_SIZE = 1e-5


@lru_cache(maxsize=2)
def impulse_response(curve: EnvelopeCurve) -> tuple[Array, Array]:
    """The response of extrema of half-sines or of the analytic signal.

    Parameters
    ----------
    curve : {"half-sines", "analytic-signal"}

    Returns
    -------
    lasting : (impulse, 2) array of float
        Of impulses of unit size in v = theta'/w, in the half period after extremum 0, what stays for good:
        amplitude and phase of the swing.
    passing : (impulse, 2 SPAN, 2) array of float
        What extrema 1 - SPAN to SPAN differ by from the swing's at their times: before the impulse from the
        old swing, after it from the new one. The last axis
        holds the extremum (rad), and its time times amplitude and w (rad).

    Notes
    -----
    With x = a cos(phi), v = -a sin(phi), an impulse of v at the phase phi adds -sin(phi) to a, and
    -cos(phi)/a to the phase. A curve through the half period of the impulse takes part of it, found here by
    trying.
    """
    # Of the swing that has the impulse.
    around, samples = 10, 64
    number = np.arange(-around, around + 2)
    crossing = np.pi * (np.append(number, around + 2) - 0.5)
    halves = HalfPeriods(crossing, np.where(number % 2, -1, 1), np.ones(len(number)))
    tau = crossing[0] + (np.arange(len(number) * samples) + 0.5) * np.pi / samples
    phase = (np.arange(IMPULSES) + 0.5) * np.pi / IMPULSES
    lasting = np.stack([-np.sin(phase), np.cos(phase)], axis=1)
    passing = np.empty((IMPULSES, 2 * SPAN, 2))
    for impulse, at in enumerate(phase):
        response = IMPULSE_SIZE * np.where(tau > at, np.sin(tau - at), 0.0)
        up, down = (EXTREMA[curve](tau, np.cos(tau) + sign * response, halves)[:2] for sign in (1.0, -1.0))
        change = np.stack([np.abs(up[0]) - np.abs(down[0]), up[1] - down[1]], axis=1) / (2.0 * IMPULSE_SIZE)
        change[number > 0] -= lasting[impulse]
        passing[impulse] = change[(number > -SPAN) & (number <= SPAN)]
    return lasting, passing


def half_period_responses(measured: xr.Dataset) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """Response of extrema and times to impulses of density 1: (2 half periods, impulse) each.

    What stays for good, from one extremum to the next; and what passes.
    """
    b, t = measured.extremum.values, measured.extremum_time.values
    (lasting, passes), count = impulse_response(measured.attrs.get("curve", "half-sines")), len(b)
    duration = np.diff(t)
    duration = np.concatenate([duration[:1], duration, duration[-1:]])
    # White acceleration adds density/2 * time to the variance of theta' = w v, w = pi/duration.
    size = np.sqrt(0.5 * duration**3 / (np.pi**2 * IMPULSES))
    half, impulse = np.arange(count), np.arange(IMPULSES)

    def matrix(pieces: Sequence[tuple[int, Array]]) -> sp.csr_matrix:
        data, rows, columns = [], [], []
        for offset, by_impulse in pieces:
            # The half period between extrema i - 1 and i has the number i.
            number = half - offset + 1
            inside = (number >= 0) & (number <= count)
            for kind, unit in enumerate((np.ones(count), 1.0 / b)):
                scale = unit[inside] * size[number[inside]]
                scale = scale * (duration[number[inside]] / np.pi) ** kind
                data.append((scale[:, None] * by_impulse[:, kind]).ravel())
                rows.append(np.repeat(kind * count + half[inside], IMPULSES))
                columns.append((number[inside, None] * IMPULSES + impulse).ravel())
        places = np.concatenate(rows), np.concatenate(columns)
        return sp.csr_matrix((np.concatenate(data), places), (2 * count, (count + 1) * IMPULSES))

    offsets = range(1 - SPAN, SPAN + 1)
    passing = matrix([(offset, passes[:, offset + SPAN - 1]) for offset in offsets])
    return matrix([(1, lasting)]), passing
