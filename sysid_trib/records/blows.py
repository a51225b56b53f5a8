"""Blows in a record of ringing, and the free parts between them."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter, uniform_filter1d

from sysid_trib.arrays import Array

# The blow starts where the signals first reach this fraction of their largest value. The ringing is free
# after this number of samples, or this fraction of the record.
ONSET, BLOW_SAMPLES, BLOW_PART = 0.1, 3, 5e-4
# Number of parts of a record in which a second blow is searched, and the least jump of the signals at it.
BLOW_BLOCKS, SECOND_BLOW = 200, 3.0
# A part after a later blow is used only if it is this much longer than the one before.
MUCH_LONGER = 1.5
# Order of the linear prediction, number of samples processed at once, and ridge over the mean square.
PREDICTION_ORDER, SAMPLES_A_BLOCK, PREDICTION_RIDGE = 40, 65_536, 1e-12
# A blow makes errors of the prediction whose RMS over as many samples exceeds its running median this much.
# Noise alone stays below 2 medians in 100,000 samples of one sensor.
RUNNING_MEDIAN, LARGE_ERROR = 601, 3.0


@dataclass(frozen=True)
class FreePart:
    """A part of a record in which structures ring freely.

    Attributes
    ----------
    onset, start, stop : int
        Sample at which its blow starts, first sample of the free ringing, and sample after the last.
    later : bool
        Whether there is an earlier blow, whose ringing is left out.
    """

    onset: int
    start: int
    stop: int
    later: bool = False

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.stop - self.start


def free_part(signals: Array) -> FreePart:
    """Return the free part of signals (sensor, sample); a second blow shows as a large jump."""
    middle = np.median(signals, axis=1)[:, None]
    size = np.abs(signals - middle)
    size = np.max(size / np.maximum(np.max(size, axis=1), 1e-300)[:, None], axis=0)
    onset, wait = int(np.argmax(size > ONSET)), samples_of_blow(size.size)
    first = onset + wait
    part, parts = FreePart(onset, first, size.size), []
    block = max(8, size.size // BLOW_BLOCKS)
    count = (size.size - first) // block
    if count < 4:
        return part
    largest = size[first : first + count * block].reshape(count, block).max(axis=1)
    remaining = np.maximum.accumulate(largest[::-1])[::-1]
    floor = 10.0 * float(np.median(largest[-max(2, count // 20) :]))
    for at in range(2, count):
        recent = largest[max(0, at - 4) : at].max()
        if largest[at] > SECOND_BLOW * recent and largest[at] > floor and remaining[at] > ONSET:
            of_block = first + at * block
            parts.append(FreePart(part.onset, part.start, of_block - block, part.later))
            onset = of_block + int(np.argmax(size[of_block : of_block + block] > recent))
            part = FreePart(onset, min(onset + wait, size.size), size.size, later=True)
    return longest(*parts, part)


def samples_of_blow(count: int) -> int:
    """Return the number of samples of a blow in a record of `count` samples."""
    return max(BLOW_SAMPLES, round(BLOW_PART * count))


def longest(first: FreePart, *others: FreePart) -> FreePart:
    """Return the first part, or a later one that is much longer."""
    for other in others:
        if other.samples > MUCH_LONGER * first.samples:
            first = other
    return first


def without_jumps(part: FreePart, signals: Array) -> FreePart:
    """Return the longest part of a free part in which linear prediction finds no other blow.

    Free ringing with white noise is predicted by its last samples. A blow is not, even if the signals do not
    become larger.

    Parameters
    ----------
    part : FreePart
    signals : (sensor, sample) array of float
        Signals of the part.
    """
    if part.samples < 2 * RUNNING_MEDIAN:
        return part
    errors = _prediction_errors(signals)
    errors /= np.maximum(np.median(np.abs(errors), axis=1), 1e-300)[:, None]
    size = np.sqrt(uniform_filter1d(np.mean(errors**2, axis=0), PREDICTION_ORDER, mode="nearest"))
    typical = np.maximum(median_filter(size, RUNNING_MEDIAN, mode="nearest"), 1e-300)
    large = np.flatnonzero(size > LARGE_ERROR * typical)
    if large.size == 0:
        return part
    # The error of sample k is at k less the order. The mean at k is that of the errors from half an order
    # before k on.
    half = PREDICTION_ORDER // 2
    parts, rest, wait = [], part, samples_of_blow(part.samples)
    for jump in np.split(large, np.flatnonzero(np.diff(large) > PREDICTION_ORDER) + 1):
        onset = part.start + PREDICTION_ORDER + min(int(jump[0]) + half - 1, int(jump[-1]))
        start = part.start + PREDICTION_ORDER + max(int(jump[-1]) - half, int(jump[0])) + wait
        parts.append(replace(rest, stop=onset))
        rest = FreePart(onset, min(start, part.stop), part.stop, later=True)
    return longest(*parts, rest)


def _prediction_errors(signals: Array) -> Array:
    """Return the errors of the best linear prediction common to all sensors, (sensor, sample - order)."""
    order = PREDICTION_ORDER
    normal, right = np.zeros((order, order)), np.zeros(order)
    for signal in signals:
        for low in range(0, signal.size - order, SAMPLES_A_BLOCK):
            piece = signal[low : low + SAMPLES_A_BLOCK + order]
            past = np.lib.stride_tricks.sliding_window_view(piece, order)[:-1]
            normal += past.T @ past
            right += past.T @ piece[order:]
    ridge = PREDICTION_RIDGE * float(np.trace(normal)) / order
    weights = np.linalg.solve(normal + ridge * np.eye(order), right)
    predicted = [np.convolve(signal, weights[::-1], "valid")[:-1] for signal in signals]
    return signals[:, order:] - np.array(predicted)
