"""How far recent predictions were off, against what they claimed: by too much where a force is missing."""

import numpy as np
from scipy.stats import chi2

from sysid_trib.arrays import Array

# Periods that count as recent: as many as the longest predictions that are asked for go ahead.
RECENT_PERIODS = 10
# Significance level of predictions that are worse than they claim.
WIDENING_LEVEL = 0.01


def widening(scores: Array, known_at: Array, origins: Array) -> Array:
    """By how much bands are to be widened at each of some instants, from predictions that came due before.

    Parameters
    ----------
    scores : (prediction,) array of float
        Errors of predictions one period ahead over the stated ones; nan where nothing was measured.
    known_at : (prediction,) array of float, s
        When each came due, ascending.
    origins : (origin,) array of float, s

    Returns
    -------
    (origin,) array of float
        Birge ratio (1932) of the last `RECENT_PERIODS` predictions where it is above 1 by more than chance
        (chi-square), else 1.

    Notes
    -----
    Errors of a random force are those of a white series: of a model that lacks nothing the sum of their
    squares is a chi-square. What a model lacks comes and goes with the amplitude, so that predictions of long
    ago say little of it.
    """
    seen = np.isfinite(scores)
    squares, known_at = scores[seen] ** 2, known_at[seen]
    factors = np.ones(len(origins))
    for at, due in enumerate(np.searchsorted(known_at, origins, side="right")):
        recent = squares[max(0, due - RECENT_PERIODS) : due]
        if len(recent) and chi2.sf(np.sum(recent), len(recent)) < WIDENING_LEVEL:
            factors[at] = np.sqrt(np.mean(recent))
    return factors
