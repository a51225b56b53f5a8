"""Simultaneous modes in a signal: the decaying lines of its spectrum, without harmonics."""

import numpy as np
from scipy.fft import next_fast_len, rfft
from scipy.ndimage import maximum_filter1d, median_filter

from sysid_trib.arrays import Array

# Bins of the spectrum on a logarithmic axis: their width, the number of bins on either side of which a line
# is the largest, and the bins whose median it exceeds by this factor.
BIN = 0.01
NEIGHBOURING_BINS = 5
BINS_OF_FLOOR = 30
ABOVE_FLOOR = 5.0
# Least number of samples and of lines for a result.
FEWEST_FOR_MODES = 200
FIRST_LINE = 8
# Least size of a mode over the strongest one; and the same if it may be a harmonic.
LEAST_MODE = 0.03
LEAST_MULTIPLE = 0.5
# Relative distance within which a frequency is a whole multiple of another; and the least fall of a line from
# the first third of the record to the last: otherwise it is hum or a drive.
NEAR_MULTIPLE = 0.015
FALL = 0.8
MOST_MODES = 8
# Number of lines on either side of a mode's line from which its centre is computed.
CENTRED = 2


def modes(time: Array, signal: Array) -> list[float]:
    """Return the frequencies (1/time) of the modes in a decay, increasing; at most one for a single mode.

    Parameters
    ----------
    time : (sample,) array of float
        Increasing times with nearly equal steps.
    signal : (sample,) array of float
        Signal that decays from its largest value on.
    """
    finite = np.isfinite(signal)
    time = time[finite]
    signal = signal[finite]
    if signal.size < FEWEST_FOR_MODES:
        return []
    signal = signal - np.median(signal)
    start = min(int(np.argmax(np.abs(signal))), signal.size // 2)
    time = time[start:]
    signal = signal[start:]
    interval = (time[-1] - time[0]) / (time.size - 1)
    size = next_fast_len(signal.size, real=True)
    # The window falls at the end, because a jump there would leak.
    fade = np.ones(signal.size)
    fade[-(signal.size // 10) :] = 0.5 + 0.5 * np.cos(np.linspace(0.0, np.pi, signal.size // 10))
    spectrum = np.abs(rfft(signal * fade, size))[FIRST_LINE:]
    index = np.arange(FIRST_LINE, FIRST_LINE + spectrum.size)
    bins = np.floor(np.log(index / FIRST_LINE) / BIN).astype(int)
    first = np.flatnonzero(np.diff(bins, prepend=-1))
    largest = np.maximum.reduceat(spectrum, first)
    energy = np.sqrt(np.add.reduceat(spectrum**2, first))
    lines = largest >= maximum_filter1d(largest, 2 * NEIGHBOURING_BINS + 1)
    lines &= largest > ABOVE_FLOOR * median_filter(largest, 2 * BINS_OF_FLOOR + 1, mode="nearest")
    lines &= largest > 8.0 * np.median(spectrum)
    decaying_lines = []
    for at in np.flatnonzero(lines):
        stop = first[at + 1] if at + 1 < first.size else spectrum.size
        line = first[at] + int(np.argmax(spectrum[first[at] : stop]))
        amplitude = float(
            np.sqrt(np.sum(energy[max(0, at - NEIGHBOURING_BINS) : at + NEIGHBOURING_BINS + 1] ** 2))
        )
        # Centre of the line, between two bins.
        near = slice(max(0, line - CENTRED), line + CENTRED + 1)
        centre = np.average(index[near], weights=spectrum[near] ** 2)
        decaying_lines.append((amplitude, float(centre / (size * interval))))
    decaying_lines = [
        (amplitude, frequency) for amplitude, frequency in decaying_lines if _falls(time, signal, frequency)
    ]
    if not decaying_lines:
        return []
    most, strongest = max(decaying_lines)
    kept = [
        frequency
        for amplitude, frequency in decaying_lines
        if amplitude >= (LEAST_MULTIPLE if _is_multiple(frequency / strongest) else LEAST_MODE) * most
    ]
    return kept if len(kept) <= MOST_MODES else []


def _is_multiple(ratio: float) -> bool:
    """Return true for 2, 3, ... and their inverses: the harmonics of a nonlinear swing."""
    ratio = max(ratio, 1.0 / ratio)
    return ratio > 1.5 and abs(ratio / round(ratio) - 1.0) < NEAR_MULTIPLE


def _falls(time: Array, signal: Array, frequency: float) -> bool:
    """Return true if a line is smaller in the last third of a signal than in the first."""
    third = signal.size // 3
    window = np.hanning(third)
    sizes = []
    for part in (slice(0, third), slice(signal.size - third, signal.size)):
        wave = np.exp(-2j * np.pi * frequency * time[part])
        sizes.append(abs(np.sum(window * wave * (signal[part] - np.mean(signal[part])))))
    return bool(sizes[1] < FALL * sizes[0])


def listed(frequencies: list[float]) -> str:
    """Return the frequencies of modes as a text, in Hz."""
    texts = [f"{frequency:.0f}" if frequency >= 1000.0 else f"{frequency:.3g}" for frequency in frequencies]
    return f"{', '.join(texts[:-1])} and {texts[-1]} Hz"
