"""A motion that is too short, too damped or growing to prove itself a free decay, taken as it is."""

from dataclasses import replace

import numpy as np
from scipy.optimize import curve_fit

from sysid_trib.arrays import Array
from sysid_trib.decays.decay_dataset import CutDecay
from sysid_trib.decays.equilibrium import Swing, find_swing
from sysid_trib.decays.free_part import Part, free_part
from sysid_trib.decays.uniform import Piece
from sysid_trib.errors import DecayError

# Half periods from which a stop for good can be seen.
FEWEST_SEEN = 3
# Part of the motion that a damped sine may leave: what leaves more is no swing.
LARGEST_LEFT = 0.5
# Exponents, over the frequency, from which the damped sine is fitted.
FIRST_EXPONENTS = (-0.02, 0.02, 0.2, 0.6)


def short_decay(piece: Piece, value: float | None, refusal: DecayError) -> CutDecay:
    """The swing of a piece about the constant beside the damped sine that fits it best.

    Parameters
    ----------
    piece : Piece
    value : float, optional
        Its equilibrium, if that is given.
    refusal : DecayError
        Why it is no proven decay.

    Raises
    ------
    DecayError
        The refusal, if nothing swings.
    """
    swing = find_swing(piece.time, piece.signal, value)
    if swing is None:
        raise refusal
    part = _part(piece, swing)
    chosen = slice(part.start, part.stop)
    fitted = _damped_sine(piece.time[chosen], piece.signal[chosen], swing.oscillation.period)
    if fitted is None:
        raise refusal
    if value is None:
        swing = replace(swing, equilibrium=fitted[0], standard_error=fitted[1])
    return CutDecay(piece, swing, part)


def _part(piece: Piece, swing: Swing) -> Part:
    """All of it, or what comes before a stop for good."""
    whole, peak = Part(0, piece.time.size, "", ""), swing.halves.peak[swing.run]
    if peak.size < FEWEST_SEEN or peak[-1] > peak[0]:
        return whole
    seen = free_part(piece.time, piece.signal - swing.equilibrium, swing)
    return replace(seen, start=0, before="") if np.isfinite(seen.stop_time) else whole


def _damped_sine(time: Array, signal: Array, period: float) -> tuple[float, float] | None:
    """Constant beside a damped sine, and its standard error; None if that is not what moves."""
    w, size = 2.0 * np.pi / period, float(np.std(signal))
    at, y = w * (time - time[0]), signal / size

    def motion(
        at: Array, constant: float, cosine: float, sine: float, exponent: float, ratio: float
    ) -> Array:
        fall = np.exp(np.clip(-exponent * at, -50.0, 50.0))
        return np.asarray(constant + fall * (cosine * np.cos(ratio * at) + sine * np.sin(ratio * at)))

    fits = []
    for exponent in FIRST_EXPONENTS:
        fall = np.exp(np.clip(-exponent * at, -50.0, 50.0))
        columns = np.stack([np.ones_like(at), fall * np.cos(at), fall * np.sin(at)], axis=1)
        start = np.linalg.lstsq(columns, y, rcond=None)[0]
        try:
            fits.append(curve_fit(motion, at, y, [*start, exponent, 1.0]))
        except (RuntimeError, ValueError):
            continue
    residuals = [float(np.std(y - motion(at, *values))) for values, _ in fits]
    if not fits or min(residuals) > LARGEST_LEFT:
        return None
    values, covariance = fits[int(np.argmin(residuals))]
    return float(values[0] * size), float(np.sqrt(covariance[0, 0]) * size)
