"""Samples that draw a long signal."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from sysid_trib.arrays import Array

# Points of a curve: about the pixels of a wide screen, with the minimum and the maximum of each section.
MOST_POINTS = 3000


def drawn_samples(values: Array) -> NDArray[np.intp]:
    """Return the minimum and the maximum of each section, which draw a curve with all its peaks.

    Parameters
    ----------
    values : (sample,) array
        Values of the curve.

    Returns
    -------
    (point,) array of int
        Indices of at most 3000 samples, in increasing order.

    Examples
    --------
    >>> import numpy as np
    >>> import sysid_trib as st
    >>> shown = st.records.drawn_samples(np.sin(np.arange(1e6)))
    >>> shown.size
    3000
    """
    if values.size <= MOST_POINTS:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, MOST_POINTS // 2 + 1).astype(int)
    ends = [start + f(values[start:stop]) for start, stop in pairwise(edges) for f in (np.argmin, np.argmax)]
    return np.unique(ends)
