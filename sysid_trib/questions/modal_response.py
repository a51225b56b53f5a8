"""Steady response of one mode to a harmonic force, from the backbone of its decay."""

from itertools import product

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, Variables, variable
from sysid_trib.cycles.backbone import half_width
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.questions.steady_response import SWEEPS, sweeps

# Number of amplitudes at which the balance is computed, and their start below the smallest of the record.
BALANCE_POINTS, BELOW_RECORD = 3000, 1e-3
# Masing's rule for a slipping joint: decrease of the stiffness over the damping ratio that slip adds.
SLIP_PER_DAMPING = 1.5 * np.pi


def response_of_mode(
    backbone: xr.Dataset, drive: float, frequencies: ArrayLike, *, modal_mass: float | None = None
) -> xr.Dataset:
    """Compute the steady response of a mode to a harmonic force, from the backbone of its decay.

    Parameters
    ----------
    backbone : Dataset
        Result of `backbone`, of the record of one mode.
    drive : float
        Amplitude of the force on the mode: in N with a modal mass, else over the modal mass, in the unit of
        the displacement over s^2.
    frequencies : (frequency,) array of float, rad/s
        Increasing frequencies.
    modal_mass : float, kg, optional
        Modal mass for the sensor whose amplitude the backbone has.

    Returns
    -------
    Dataset
        Over `sweep` (`up`, `down`, `unstable`) and `frequency` (rad/s): `amplitude` in the unit of the
        measured signal, nan if there is no such motion or the record does not reach it, with `amplitude_low`
        and `amplitude_high`; `phase` (rad), the phase lead over the force. `frequency_ratio(frequency)`,
        relative to the frequency at small amplitudes; `drive`.

    Raises
    ------
    UsageError
        The drive or the mass is not positive, or the frequencies do not increase.
    DecayError
        The decay gains energy at some amplitude.

    Notes
    -----
    The response follows from harmonic balance: a ((w^2 - W^2)^2 + (2 zeta w W)^2)^(1/2) = force over modal
    mass, with w(a) and zeta(a) of the backbone. The damping ratio of a decay is the energy loss over the work
    of the restoring force at the reversal; that of a steady motion is the energy loss over w^2 a^2. They
    differ by the change of the stiffness. For a slipping joint (Masing) this change follows from the damping
    that the joint adds. The bands include this difference and the corners of the bands of the backbone.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> curves = st.backbone(st.records.paper_twin())
    >>> response = st.response_of_mode(curves, drive=0.3, frequencies=np.linspace(9.0, 10.5, 61))
    >>> up = response.amplitude.sel(sweep="up")
    >>> up.max().round(2).item(), up.idxmax("frequency").item()
    (0.13, 9.7)
    """
    w = np.asarray(frequencies, dtype=float)
    if w.ndim != 1 or not w.size or not np.all(np.isfinite(w)) or w[0] <= 0.0 or np.any(np.diff(w) <= 0.0):
        raise UsageError("Frequencies must be a row of positive numbers that increase, in rad/s.")
    for name, value in (("drive", drive), ("modal mass", 1.0 if modal_mass is None else modal_mass)):
        if not (np.isfinite(value) and value > 0.0):
            raise UsageError(f"A {name} must be a positive number, not {value}.")
    force = drive / (modal_mass or 1.0)
    if not np.all(backbone.damping_ratio.values > 0.0):
        raise DecayError("The decay gains energy at some amplitude: its steady response has no bound.")
    middle, *corners = (
        _response(*curve, force, w) for curve in [_curves(backbone, 0.0, 0.0), *_corners(backbone)]
    )
    amplitude, phase = middle
    others = np.array([amplitude, *(of_corner for of_corner, _ in corners)])
    scale = w ** int(backbone.attrs.get("integrations", 0))
    # If no corner has a motion, there is no band.
    others = np.where(np.isnan(others), amplitude, others)
    low, high = (
        np.where(np.isnan(amplitude), np.nan, part) for part in (others.min(axis=0), others.max(axis=0))
    )
    measured = backbone.measured_amplitude if "measured_amplitude" in backbone else backbone.amplitude
    unit = str(measured.attrs["units"])
    unit_of_drive = "N" if modal_mass else f"{backbone.amplitude.attrs['units']}/s^2"
    dims = ("sweep", "frequency")
    data: Variables = {
        "amplitude": variable(dims, amplitude * scale, "amplitude", unit),
        "amplitude_low": variable(dims, low * scale, "low end of the band", unit),
        "amplitude_high": variable(dims, high * scale, "high end of the band", unit),
        "phase": variable(dims, phase, "phase ahead of the force", "rad"),
        "drive": variable((), drive, "amplitude of the force", unit_of_drive),
        "frequency_ratio": variable(
            "frequency",
            w / backbone.smallest_amplitude_frequency.item(),
            "over that at small amplitudes",
            "1",
        ),
    }
    largest = float(measured.values[-1])
    coords = {"sweep": list(SWEEPS), "frequency": variable("frequency", w, "angular frequency", "rad/s")}
    return xr.Dataset(data, coords, {**backbone.attrs, "largest_amplitude": largest})


def usual_frequencies(backbone: xr.Dataset, points: int) -> Array:
    """Return frequencies (rad/s) around the resonance of a mode."""
    w = backbone.frequency.values
    width = 12.0 * float(backbone.damping_ratio.max())
    return np.linspace(w.min() * (1.0 - width), w.max() * (1.0 + width), points)


def _corners(backbone: xr.Dataset) -> list[tuple[Array, Array, Array]]:
    """Return the curves for each combination of the ends of both bands."""
    return [_curves(backbone, *signs) for signs in product((-1.0, 1.0), repeat=2)]


def _curves(backbone: xr.Dataset, of_frequency: float, of_damping: float) -> tuple[Array, Array, Array]:
    """Return amplitudes, frequency and damping ratio of steady motion, some half widths from the middle."""
    a = backbone.amplitude.values
    frequency, damping = backbone.frequency.values, backbone.damping_ratio.values
    stiffness = (frequency / frequency[0]) ** 2 - 1.0
    slip = np.maximum(np.abs(stiffness), SLIP_PER_DAMPING * np.abs(damping - damping[0]))
    steady = damping / (1.0 + 0.5 * slip)
    half = half_width(backbone, "damping_ratio") + 0.5 * slip * damping
    w = frequency + of_frequency * half_width(backbone, "frequency")
    zeta = np.maximum(steady + of_damping * half, 0.05 * steady)
    amplitude = np.geomspace(BELOW_RECORD * a[0], a[-1], BALANCE_POINTS)
    at = np.log(amplitude)
    return amplitude, np.interp(at, np.log(a), w), np.interp(at, np.log(a), zeta)


def _response(
    amplitude: Array, w: Array, zeta: Array, force: float, frequencies: Array
) -> tuple[Array, Array]:
    """Return the amplitude and phase of each sweep, (sweep, frequency)."""
    under = w**4 * (1.0 - 2.0 * zeta**2) ** 2 - w**4 + (force / amplitude) ** 2
    root = np.sqrt(np.maximum(under, 0.0))
    # At the point where both branches meet, no crossing lies between two amplitudes.
    top = np.flatnonzero((under[:-1] >= 0.0) & (under[1:] < 0.0))
    middle, reach = w[top] ** 2 * (1.0 - 2.0 * zeta[top] ** 2), root[top]
    rows, amplitudes, stable = [], [], []
    for at, frequency in enumerate(frequencies):
        crossing = amplitude[top[np.abs(frequency**2 - middle) < reach]].tolist()
        for sign in (-1.0, 1.0):
            square = w**2 * (1.0 - 2.0 * zeta**2) + sign * root
            excess = np.where(under >= 0.0, square - frequency**2, np.nan)
            change = np.flatnonzero(excess[:-1] * excess[1:] < 0.0)
            part = excess[change] / (excess[change] - excess[change + 1])
            crossing += (amplitude[change] + part * (amplitude[change + 1] - amplitude[change])).tolist()
        for order, value in enumerate(sorted(crossing)):
            rows.append(at)
            amplitudes.append(value)
            stable.append(order % 2 == 0)
    chosen = sweeps(
        len(frequencies), np.array(rows, dtype=int), np.array(amplitudes), np.array(stable, dtype=bool)
    )
    made = np.append(np.array(amplitudes, dtype=float), np.nan)[chosen]
    own = np.interp(np.log(np.nan_to_num(made, nan=1.0)), np.log(amplitude), w)
    damping = np.interp(np.log(np.nan_to_num(made, nan=1.0)), np.log(amplitude), zeta)
    phase = -np.arctan2(2.0 * damping * own * frequencies, own**2 - frequencies**2)
    return made, np.where(np.isnan(made), np.nan, phase)
