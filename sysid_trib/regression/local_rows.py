"""Covariance of rows that each act on neighbouring samples: many of them in noise of long memory."""

import numpy as np
import scipy.sparse as sp

from sysid_trib.arrays import Array
from sysid_trib.regression.weak_form import covariance_band

# Rows that overlap, up to which the sparse product is faster than dense ones of blocks of rows.
SPARSE_OVERLAP = 16


def covariance_of_local_rows(operator: sp.csr_matrix) -> Array:
    """Diagonals of the covariance `operator @ operator.T`, (band, row), lower as scipy.linalg stores them.

    Parameters
    ----------
    operator : (row, sample) sparse array of float
        Each row on neighbouring samples, later rows on later ones.
    """
    if not operator.has_sorted_indices:
        operator = operator.sorted_indices()
    rows = operator.shape[0]
    first = np.minimum.accumulate(operator.indices[operator.indptr[:-1]][::-1])[::-1]
    end = np.maximum.accumulate(operator.indices[operator.indptr[1:] - 1] + 1)
    # Rows that share a sample with a row: itself and so many after it.
    bands = int(np.max(np.searchsorted(first, end) - np.arange(rows)))
    if bands <= SPARSE_OVERLAP:
        return covariance_band(operator @ operator.T)
    band = np.zeros((bands, rows))
    for begin in range(0, rows, bands):
        last = min(begin + 2 * bands - 1, rows)
        dense = operator[begin:last, first[begin] : end[last - 1]].toarray()
        products = dense @ dense[:bands].T
        for below in range(min(bands, last - begin)):
            diagonal = np.diagonal(products, -below)
            band[below, begin : begin + len(diagonal)] = diagonal
    return band
