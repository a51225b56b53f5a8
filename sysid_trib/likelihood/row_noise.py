"""Covariance of rows that each act on neighbouring samples: all alike, or many of them in long memory."""

import numpy as np
import scipy.sparse as sp

from sysid_trib.arrays import Array

# Rows that overlap, up to which the sparse product is faster than dense ones of blocks of rows.
SPARSE_OVERLAP = 16


def covariance_of_local_rows(operator: sp.csr_matrix, other: sp.csr_matrix | None = None) -> Array:
    """Diagonals of the covariance `operator @ operator.T`, (band, row), lower as scipy.linalg stores them.

    Parameters
    ----------
    operator : (row, sample) sparse array of float
        Each row on neighbouring samples, later rows on later ones.
    other : (row, sample) sparse array of float, optional
        In the place of the second operator, with entries in the same places; the product is symmetric too.
    """
    if other is None:
        operator = other = operator if operator.has_sorted_indices else operator.sorted_indices()
    rows = operator.shape[0]
    if not np.diff(operator.indptr).all():
        return covariance_band(operator @ other.T)
    first = np.minimum.accumulate(operator.indices[operator.indptr[:-1]][::-1])[::-1]
    end = np.maximum.accumulate(operator.indices[operator.indptr[1:] - 1] + 1)
    # Rows that share a sample with a row: itself and so many after it.
    bands = int(np.max(np.searchsorted(first, end) - np.arange(rows)))
    alike = _rows_alike(operator)
    if alike.stop - alike.start > 2 * bands:
        return _of_rows_alike(operator, other, alike, bands)
    if bands <= SPARSE_OVERLAP or other is not operator:
        return covariance_band(operator @ other.T)
    band = np.zeros((bands, rows))
    for begin in range(0, rows, bands):
        last = min(begin + 2 * bands - 1, rows)
        dense = operator[begin:last, first[begin] : end[last - 1]].toarray()
        products = dense @ dense[:bands].T
        for below in range(min(bands, last - begin)):
            diagonal = np.diagonal(products, -below)
            band[below, begin : begin + len(diagonal)] = diagonal
    return band


def covariance_band(covariance: sp.csr_matrix) -> Array:
    """Diagonals of a banded covariance, (band, row), lower as scipy.linalg stores them."""
    entries = covariance.tocoo()
    below = entries.row - entries.col
    band = np.zeros((int(below.max()) + 1, covariance.shape[0]))
    lower = below >= 0
    band[below[lower], entries.col[lower]] = entries.data[lower]
    return band


def _rows_alike(operator: sp.csr_matrix) -> slice:
    """Rows about the middle one that are like it: as many neighbouring samples, as many further each time."""
    start, last = operator.indices[operator.indptr[:-1]], operator.indices[operator.indptr[1:] - 1]
    lengths, steps = np.diff(operator.indptr), np.diff(start, append=0)
    middle = (len(lengths) - 1) // 2
    without_gaps = last - start + 1 == lengths
    like_middle = without_gaps & (lengths == lengths[middle])
    if not like_middle[middle] or steps[middle] <= 0:
        return slice(middle, middle)
    # A row after which the step is another one is the last of them.
    others = np.flatnonzero(~like_middle | (steps != steps[middle]))
    before, after = others[others < middle], others[others >= middle]
    begin = int(before[-1]) + 1 if len(before) else 0
    return slice(begin, int(after[0]) + int(like_middle[after[0]]))


def _of_rows_alike(operator: sp.csr_matrix, other: sp.csr_matrix, alike: slice, bands: int) -> Array:
    """`covariance_of_local_rows` of which most rows are alike: shifted tables of numbers, without indices."""
    rows, step = operator.shape[0], int(np.diff(operator.indices[operator.indptr[alike.start :][:2]])[0])
    tables = [m.data[m.indptr[alike.start] : m.indptr[alike.stop]] for m in (operator, other)]
    left, right = (table.reshape(alike.stop - alike.start, -1) for table in tables)
    ends = slice(alike.start + bands), slice(alike.stop - bands, rows)
    of_ends = [covariance_band(operator[part] @ other[part].T) for part in ends]
    band = np.zeros((max(-(-left.shape[1] // step), *map(len, of_ends)), rows))
    for part, of_end in zip(ends, of_ends, strict=True):
        band[: len(of_end), part] = of_end
    for below, shift in enumerate(range(0, left.shape[1], step)):
        # The sample that is `shift` further in a row is the first of the row so many below.
        count = len(left) - below
        products = np.einsum("rs,rs->r", left[:count, shift:], right[below:, : left.shape[1] - shift])
        band[below, alike.start : alike.start + count] = products
    return band
