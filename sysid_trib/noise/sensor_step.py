"""The step of a sensor: the spacing of the lattice on which its values lie."""

import numpy as np

from sysid_trib.arrays import Array

# Values and candidate steps that are looked at.
MOST_VALUES = 20_000
MOST_STEP_CANDIDATES = 200
# Spacings of up to so many steps count: over more the step itself is not known well enough.
MOST_STEPS = 20.0
FEWEST_SPACINGS = 12
# Of values that repeat so often three show their spacing.
OFTEN, FEWEST_OF_OFTEN = 20, 2
# Distance from a whole number of steps that is rounding, and the part of the spacings it must explain. By
# chance it explains a fifth.
ROUNDED = 0.1
LEAST_EXPLAINED = 0.9
# Below this part of the range two values are one, but for rounding.
SAME_VALUE = 1e-12


def sensor_step(signal: Array) -> float:
    """Largest spacing that explains the values of a sensor.

    Parameters
    ----------
    signal : (sample,) array of float
        As it was measured, in any unit.

    Returns
    -------
    float
        In the unit of the signal; nan of values that lie on no lattice.

    Notes
    -----
    Values that repeat are looked at first: where the record was interpolated to an even clock, they alone are
    the sensor's. A step divides nearly all spacings between neighbouring values.
    """
    held, every = np.unique(signal[1:][np.diff(signal) == 0.0]), np.unique(signal)
    fewest = FEWEST_SPACINGS if OFTEN * every.size > signal.size else FEWEST_OF_OFTEN
    for values in (held, every):
        step = _lattice(values, fewest)
        if np.isfinite(step):
            return step
    return float("nan")


def _lattice(values: Array, fewest: int) -> float:
    """Largest spacing that explains sorted values; nan if none does."""
    first = max(0, (values.size - MOST_VALUES) // 2)
    values = values[first : first + MOST_VALUES]
    spacing = np.diff(values)
    spacing = np.sort(spacing[spacing > SAME_VALUE * np.ptp(values)]) if values.size > 1 else spacing
    if spacing.size < fewest:
        return float("nan")
    shortest = spacing[np.linspace(0, spacing.size - 1, min(MOST_STEP_CANDIDATES, spacing.size)).astype(int)]
    # Neighbours may never be one step apart, but two and three.
    for step in np.sort(np.concatenate([shortest, shortest / 2.0, shortest / 3.0]))[::-1]:
        if _explains(step, spacing, fewest):
            count = np.round(spacing / step)
            near = (count > 0.0) & (count <= MOST_STEPS)
            return float(np.median(spacing[near] / count[near]))
    return float("nan")


def _explains(step: float, spacing: Array, fewest: int) -> bool:
    count = spacing[: np.searchsorted(spacing, MOST_STEPS * step)] / step
    whole = np.abs(count - np.round(count)) < ROUNDED
    return count.size >= fewest and bool(np.mean(whole & (count > ROUNDED)) >= LEAST_EXPLAINED)
