"""The weak form of Eq. 1: test functions that vanish with their slope at both ends of the record.

Multiplying theta'' + w^2 (theta + sum c_j h_j) = 0 by a test function psi and integrating twice by parts,
``int psi'' theta + w^2 int psi (theta + sum c_j h_j) = 0``, needs no derivative of the measured angle.
The test functions are B-splines. They are narrow, so noise of distant rows is independent and whitening needs
only a banded Cholesky factor. They are clamped at the ends, so the large first swing is used completely.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy
import scipy.linalg
import scipy.sparse as sp
from scipy.interpolate import make_interp_spline

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.likelihood.sensor_noise import covariance_band, memory_samples
from sysid_trib.records.smoothing import (
    MOST_KEPT,
    SPLINE_DEGREE,
    SplinesAt,
    knot_intervals,
    knot_sequence,
    spline_design,
)

# With fewer samples per row, rows would nearly depend on each other. With many more, the rows of a record
# with 20 samples per period would not resolve the third harmonic of the motion.
SAMPLES_PER_ROW = 1.5
# The first and last rows have multiple knots. There, samples are interpolated by splines of this degree and
# integrated in this number of parts per step; otherwise each row would be wrong by a hundredth.
END_ROWS, END_DEGREE, END_PARTS = SPLINE_DEGREE - 2, 7, 6
# Next to a gap, which is a step longer than this multiple of the median step, samples are not interpolated.
MOST_UNEVEN = 1.5
# Attributes of a sparse matrix with the places of its entries.
ENTRIES = "indptr", "indices"
# Largest number of entries that are filtered at once.
MOST_DENSE = 4_000_000


@dataclass(frozen=True)
class WeakForm:
    """Integrals against the test functions as sparse matrices on the samples.

    Attributes
    ----------
    tau : (sample,) array of float
        Time times a frequency.
    value, slope, curvature : (row, sample) sparse array of float
        ``value @ f`` is int psi f dtau for every test function psi; `slope` and `curvature` are the same with
        psi' and psi''.
    splines : SplinesAt
        Splines on the knots of the test functions, at the samples.
    """

    tau: Array
    value: sp.csr_matrix
    slope: sp.csr_matrix
    curvature: sp.csr_matrix
    splines: SplinesAt

    @cached_property
    def gram(self) -> Array:
        """Covariance of the rows for white acceleration of unit size, int psi_i psi_j dtau: (band, row)."""
        return covariance_band(self.value @ sp.diags_array(1.0 / np.gradient(self.tau)), self.value)

    @cached_property
    def shares_entries(self) -> bool:
        """True if the three matrices have their entries in the same places and order."""
        return all(
            np.array_equal(getattr(self.value, name), getattr(other, name))
            for other in (self.slope, self.curvature)
            for name in ENTRIES
        )

    @property
    def rows(self) -> int:
        """Number of test functions."""
        return int(self.value.shape[0])


def build_weak_form(tau: Array, intervals: int | None = None) -> WeakForm:
    """Build the weak form on the samples `tau` = w t (increasing, also uneven); the last few are cached.

    `intervals` : number of intervals between the knots of the test functions; by default `knot_intervals` of
    tau, with at least `SAMPLES_PER_ROW` samples each.
    """
    number = intervals or knot_intervals(tau, SAMPLES_PER_ROW)
    return _kept(tau.tobytes(), number) if len(tau) <= MOST_KEPT else _built(tau, number)


@lru_cache(maxsize=4)
def _kept(tau: bytes, intervals: int) -> WeakForm:
    return _built(np.frombuffer(tau), intervals)


def _built(tau: Array, intervals: int) -> WeakForm:
    value, slope, curvature = (_sample_integrals(tau, intervals, order) for order in range(3))
    for matrix in (value, slope, curvature):
        # After sorting, the three matrices have their entries in the same places.
        matrix.sort_indices()
    return WeakForm(tau, value, slope, curvature, SplinesAt(tau, knot_sequence(tau, intervals)))


def _sample_integrals(tau: Array, intervals: int, order: int) -> sp.csr_matrix:
    """Return integrals against a derivative of the test functions from values at samples, (row, sample)."""
    # In a short record the first rows are also the last ones.
    if intervals + 1 < 2 * END_ROWS:
        return _integrals(tau, tau, intervals, order)
    turned = tau[0] + tau[-1] - tau[::-1]
    first, last = _first_rows(tau, intervals, order), _first_rows(turned, intervals, order)
    if first is None or last is None:
        return _integrals(tau, tau, intervals, order)
    # Reverse the entries one by one: scipy would sort all samples.
    last = last.tocoo()
    places = END_ROWS - 1 - last.row, len(tau) - 1 - last.col
    last = sp.coo_array(((-1.0) ** order * last.data, places), last.shape).tocsr()
    inside = _integrals(tau, tau, intervals, order, ends=END_ROWS)
    return sp.vstack([first, inside, last]).tocsr()


def _first_rows(tau: Array, intervals: int, order: int) -> sp.csr_matrix | None:
    """Return the first rows, (row, sample), from interpolated samples; None next to a gap."""
    end = knot_sequence(tau, intervals)[END_ROWS + 2 + SPLINE_DEGREE]
    used = max(END_DEGREE + 1, int(np.searchsorted(tau, end)) + 1)
    steps = np.diff(tau[:used])
    if used > len(tau) or steps.max() > MOST_UNEVEN * np.median(steps):
        return None
    points = _between_samples(tau[:used], END_PARTS)
    between = make_interp_spline(tau[:used], np.eye(used), END_DEGREE)(points)
    rows = sp.csr_matrix(_integrals(points, tau, intervals, order)[:END_ROWS] @ between)
    return sp.hstack([rows, sp.csr_matrix((END_ROWS, len(tau) - used))]).tocsr()


def points_between(tau: Array, intervals: int, per_period: float) -> tuple[SplinesAt, sp.csr_matrix]:
    """Return points between samples, for integrands that vary quickly, and their integrals; cached.

    Parameters
    ----------
    tau : (sample,) array of float
        Times of the weak form.
    intervals : int
        Intervals of the weak form.
    per_period : float
        Least number of points per 2 pi of tau.

    Returns
    -------
    splines : SplinesAt
        Splines on the knots of the test functions, at the points, which divide each step of `tau` into equal
        parts.
    integrals : (row, point) sparse array of float
        Integrals over the same rows as `WeakForm.value`.
    """
    step = float(np.median(np.diff(tau)))
    parts = max(1, int(np.ceil(per_period * step / (2.0 * np.pi))))
    return _kept_between(tau.tobytes(), intervals, parts)


@lru_cache(maxsize=8)
def _kept_between(tau: bytes, intervals: int, parts: int) -> tuple[SplinesAt, sp.csr_matrix]:
    samples = np.frombuffer(tau)
    points = _between_samples(samples, parts)
    return SplinesAt(points, knot_sequence(samples, intervals)), _integrals(points, samples, intervals, 0)


def _between_samples(tau: Array, parts: int) -> Array:
    """Return points that divide each step of tau into equal parts, (point,)."""
    return np.interp(np.arange(parts * (len(tau) - 1) + 1) / parts, np.arange(len(tau)), tau)


def _integrals(points: Array, tau: Array, intervals: int, order: int, ends: int = 0) -> sp.csr_matrix:
    """Return integrals against a derivative of the test functions on `tau`, without `ends` at each end."""
    knots = knot_sequence(tau, intervals)
    weights = np.gradient(points) * _end_weights(len(points))
    # Leave out the first two and last two clamped splines, which have a value or a slope at the ends.
    keep = slice(2 + ends, len(knots) - SPLINE_DEGREE - 1 - 2 - ends)
    rows = spline_design(points, knots, order).T.tocsr()[keep]
    # A spline is zero at its last knot; remove the explicit zeros of its derivatives there.
    rows.eliminate_zeros()
    rows.data *= weights[rows.indices]
    return rows


def noise_operator(form: WeakForm, stiffness: Array, damping: Array) -> sp.csr_matrix:
    """Return the rows applied to the noise: those of the equation linearised along the trajectory.

    Parameters
    ----------
    form : WeakForm
    stiffness, damping : (sample,) array of float
        1 + sum c dh/dx and sum c dh/dv along the trajectory.

    Returns
    -------
    (row, sample) sparse array of float
    """
    # int psi d e' = -int (psi d)' e: the derivative is that of the rows, not of the noise.
    rate = np.gradient(damping, form.tau)
    if form.shares_entries:
        at = form.value.indices
        data = form.curvature.data + (stiffness - rate)[at] * form.value.data - damping[at] * form.slope.data
        return sp.csr_matrix((data, at, form.value.indptr), form.value.shape)
    turned = form.curvature + form.value @ sp.diags_array(stiffness - rate)
    return (turned - form.slope @ sp.diags_array(damping)).tocsr()


def coloured(operator: sp.csr_matrix, filter_: Array, *, has_past: bool = False) -> sp.csr_matrix:
    """Return an operator on samples as an operator on the innovations of coloured noise.

    Parameters
    ----------
    operator : (row, sample) sparse array of float
        Each row acts on a few neighbouring samples.
    filter_ : (tap,) array of float
        Whitening filter of the noise; [1] if it is white.
    has_past : bool
        Whether the noise began long before the first sample. Its innovations before then are further columns,
        ahead of the others.

    Returns
    -------
    (row, sample) sparse array of float
        Product with the inverse of the filter, truncated where the noise is no longer correlated.

    Notes
    -----
    The filter runs backwards along each row, for blocks of rows in parallel.
    """
    if len(filter_) == 1:
        return operator
    memory = min(memory_samples(filter_), operator.shape[1])
    if has_past:
        operator = sp.hstack([sp.csr_matrix((operator.shape[0], memory)), operator], format="csr")
    rows = operator.shape[0]
    operator = operator.sorted_indices()
    first, last = operator.indices[operator.indptr[:-1]], operator.indices[operator.indptr[1:] - 1]
    length = last - np.maximum(0, first - memory) + 1
    values, columns = [], []
    for block in np.array_split(np.arange(rows), 1 + int(np.sum(length)) // MOST_DENSE):
        # Reverse each row from its end, so that all start in the same column.
        entries = operator[block].tocoo()
        backwards = np.zeros((len(block), int(length[block].max())))
        backwards[entries.row, last[block][entries.row] - entries.col] = entries.data
        carried = scipy.signal.lfilter([1.0], filter_, backwards, axis=1)
        inside = np.arange(backwards.shape[1]) < length[block][:, None]
        values.append(carried[inside])
        columns.append((last[block][:, None] - np.arange(backwards.shape[1]))[inside])
    pointers = np.append(0, np.cumsum(length))
    return sp.csr_matrix((np.concatenate(values), np.concatenate(columns), pointers), operator.shape)


def cholesky_factor(band: Array, gram: Array | None = None, ratio: float = 0.0) -> Array:
    """Return the banded Cholesky factor of a covariance plus `ratio` times another (band, row)."""
    if gram is not None and ratio:
        whole = np.zeros((max(len(band), len(gram)), band.shape[1]))
        whole[: len(band)] = band
        whole[: len(gram)] += ratio * gram
        band = whole
    try:
        return scipy.linalg.cholesky_banded(band, lower=True, check_finite=False)
    except np.linalg.LinAlgError:
        raise DecayError("The equations of this record are degenerate; check its sampling.") from None


def log_determinant(factor: Array) -> float:
    """Return the log determinant of a covariance from its banded Cholesky factor."""
    return 2.0 * float(np.sum(np.log(factor[0])))


def whiten(factor: Array, columns: Array) -> Array:
    """Solve L z = columns, so that the noise of z has the unit matrix as its covariance."""
    # LAPACK of scipy 1.17 writes beyond the end of an empty array.
    if not columns.size:
        return columns.copy()
    solve = scipy.linalg.get_lapack_funcs("tbtrs", (factor, columns))
    solved, _ = solve(factor, columns.reshape(len(columns), -1), uplo="L")
    return np.asarray(solved).reshape(columns.shape)


def _end_weights(samples: int) -> Array:
    """Return Gregory's end weights: the trapezoid rule to sixth order at the ends of a smooth integrand.

    Inside the record the error of the rule is negligible, because test functions end smoothly there.
    """
    weights = np.ones(samples)
    ends = np.array([95 / 288, 317 / 240, 23 / 30, 793 / 720, 157 / 160])
    if samples >= 2 * len(ends):
        weights[: len(ends)] = ends
        weights[-len(ends) :] = ends[::-1]
    return weights
