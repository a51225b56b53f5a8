"""The least-squares spline through a record: motion, derivatives, and the noise of the sensor."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import scipy.sparse as sp
import xarray as xr
from scipy.interpolate import BSpline
from scipy.linalg import cho_solve_banded, cholesky_banded

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError
from sysid_trib.records import half_periods, inputs, signal
from sysid_trib.records.equilibrium import with_half_periods

SPLINE_DEGREE = 5
KNOTS_PER_PERIOD = 12
# With fewer samples between knots, the splines would follow the noise.
SAMPLES_PER_KNOT = 2
# Number of samples up to which splines or test functions are cached for the next records on the same grids:
# about 40 MB. For longer records only the last splines are cached.
MOST_KEPT = 100_000


# The influence of a sample on the spline decreases to a third with each knot (the root -0.666 of the
# Euler-Frobenius polynomial of degree 11): after this number of knots it is below rounding.
FELT_KNOTS = 100


def knot_intervals(tau: Array, fewest: float = SAMPLES_PER_KNOT) -> int:
    """Return the number of intervals of a twelfth of a period (2 pi in tau), whole samples if possible."""
    step = (tau[-1] - tau[0]) / (len(tau) - 1)
    per_knot = max(fewest, 2.0 * np.pi / KNOTS_PER_PERIOD / step)
    per_knot = round(per_knot) if per_knot >= SAMPLES_PER_KNOT else per_knot
    return max(1, round((len(tau) - 1) / per_knot))


def knot_sequence(tau: Array, intervals: int | None = None) -> Array:
    """Return the clamped uniform knots, with the given number of intervals or `knot_intervals`."""
    return signal.clamped_knots(tau, intervals or knot_intervals(tau), SPLINE_DEGREE)


def least_squares_spline(tau: Array, values: Array, intervals: int | None = None) -> tuple[BSpline, Array]:
    """Return the spline on a `knot_sequence` that is nearest to values, and its values at their times.

    Parameters
    ----------
    tau : (sample,) array of float
    values : (sample,) or (sample, record) array of float
    intervals : int, optional
        Number of intervals between its knots.

    Raises
    ------
    DecayError
        The samples do not determine the spline: too few, or with gaps.

    Notes
    -----
    The normal equations of B-splines are well conditioned and banded. scipy's `make_lsq_spline` gives the
    same result to the bit, but searches for the interval of every sample from the first knot on: 12 s for
    10^6 samples.
    """
    return _spline_on(knot_sequence(tau, intervals), tau, values)


def first_of_spline(tau: Array, values: Array) -> tuple[float, float]:
    """Return first value and slope of `least_squares_spline`, from the samples on which they depend."""
    knots = knot_sequence(tau)
    if len(knots) > FELT_KNOTS + 2 * (SPLINE_DEGREE + 1):
        last = knots[SPLINE_DEGREE + FELT_KNOTS]
        knots = np.append(knots[: SPLINE_DEGREE + FELT_KNOTS], np.full(SPLINE_DEGREE + 1, last))
        used = slice(np.searchsorted(tau, last, side="right"))
        tau = tau[used]
        values = values[used]
    spline, x = _spline_on(knots, tau, values)
    return float(x[0]), float(spline(tau[0], 1))


def _spline_on(knots: Array, tau: Array, values: Array) -> tuple[BSpline, Array]:
    try:
        kept = _kept if len(tau) <= MOST_KEPT else _last
        basis, factor = kept(tau.tobytes(), knots.tobytes())
        coefficients = cho_solve_banded((factor, True), basis.T @ values, check_finite=False)
    except ValueError:
        wrong = "The samples of this record do not determine a spline"
        raise DecayError(f"{wrong}; check its sampling.") from None
    return BSpline.construct_fast(knots, coefficients, SPLINE_DEGREE), np.asarray(basis @ coefficients)


def _normal_equations(tau_bytes: bytes, knots_bytes: bytes) -> tuple[sp.csr_array, Array]:
    """Return B-splines at the samples, (sample, spline), and the banded Cholesky factor of their products."""
    tau = np.frombuffer(tau_bytes)
    knots = np.frombuffer(knots_bytes)
    if np.any(np.diff(tau) <= 0.0):
        raise ValueError("times that do not increase")
    # No sample is beyond the knots: with extrapolation, Python's min and max would go through all of them.
    basis = BSpline.design_matrix(tau, knots, SPLINE_DEGREE, extrapolate=True)
    normal = basis.T @ basis
    band = np.stack([np.pad(normal.diagonal(off), (0, off)) for off in range(SPLINE_DEGREE + 1)])
    return basis, cholesky_banded(band, lower=True, check_finite=False)


_kept = lru_cache(maxsize=6)(_normal_equations)
_last = lru_cache(maxsize=1)(_normal_equations)


def smooth(tau: Array, angle: Array) -> tuple[Array, Array, Array, float]:
    """Smooth one or several records by the least-squares spline on `knot_sequence`.

    Parameters
    ----------
    tau : (sample,) array of float
        Time times the frequency of the motion, increasing.
    angle : (sample,) or (sample, record) array of float, rad

    Returns
    -------
    x, v, acceleration : (sample,) or (sample, record) array of float, rad
        The angle and its first and second derivatives by tau.
    noise : float, rad
        Standard deviation of a sample about the spline.

    Raises
    ------
    DecayError
        See `least_squares_spline`.
    """
    spline, x = least_squares_spline(tau, angle)
    return x, spline(tau, 1), spline(tau, 2), _noise_about(spline, angle - x)


def _noise_about(spline: BSpline, residual: Array) -> float:
    """Return the standard deviation of a sample about a spline that was fitted to it."""
    degrees_of_freedom = max(1, len(residual) - len(spline.c))
    return float(np.sqrt(np.sum(residual**2) / degrees_of_freedom))


@dataclass(frozen=True)
class SplinesAt:
    """All splines on given knots, at given points.

    Attributes
    ----------
    points : (point,) array of float
    knots : (knot,) array of float
    """

    points: Array
    knots: Array

    @cached_property
    def _designs(self) -> dict[int, sp.csr_matrix]:
        return {}

    def design(self, order: int = 0) -> sp.csr_matrix:
        """Return values of every B-spline or of a derivative, (point, spline); computed once."""
        if order not in self._designs:
            self._designs[order] = spline_design(self.points, self.knots, order)
        return self._designs[order]

    def of(self, spline: BSpline, order: int = 0) -> Array:
        """Return a spline on these knots, or a derivative, at the points, (point,).

        For many points it is computed without the matrices, which would take more memory than the records.
        """
        if len(self.points) > MOST_KEPT:
            return np.asarray(spline(self.points, order))
        return np.asarray(self.design(order) @ spline.c)


def spline_design(tau: Array, knots: Array, order: int) -> sp.csr_matrix:
    """Return the `order`-th derivative of all B-splines of `SPLINE_DEGREE` at points, (point, spline)."""
    # No point is beyond the knots: with extrapolation, Python's min and max would go through all of them.
    lowest = knots[order : len(knots) - order]
    design = BSpline.design_matrix(tau, lowest, SPLINE_DEGREE - order, extrapolate=True)
    # d/dx B_{i,p} = p (B_{i,p-1}/(t_{i+p}-t_i) - B_{i+1,p-1}/(t_{i+p+1}-t_{i+1})), from low to high degree.
    for lift in range(order, 0, -1):
        degree = SPLINE_DEGREE - lift + 1
        inner = knots[lift - 1 : len(knots) - lift + 1]
        count = len(inner) - degree - 1
        scale = degree / (inner[degree + 1 : degree + count] - inner[1:count])
        lower = sp.diags_array([-scale, scale], offsets=[0, 1], shape=(count - 1, count))
        design = design @ lower
    return design.tocsr()


def swing_frequency(decay: xr.Dataset, equilibrium: float | None = 0.0) -> float:
    """Return the frequency of a decay from the median of its half periods, rad/s.

    Parameters
    ----------
    decay : Dataset
        Decay with `angle(time)`.
    equilibrium : float or None, rad
        Equilibrium; with None it is estimated.

    Returns
    -------
    float

    Raises
    ------
    DecayError
        There is no whole half period.
    """
    _, _, halves = with_half_periods(decay, 1, equilibrium)
    return float(np.pi / np.median(halves.duration))


def samples_of_a_period(decay: xr.Dataset) -> int:
    """Return the samples of a period of a record, by its `swing_frequency` and its median time step.

    Residuals are correlated over a period: it is the block of a Diebold-Mariano test.

    Raises
    ------
    DecayError
        No whole half period.
    """
    step = float(np.median(np.diff(decay.time.values)))
    return max(1, round(2.0 * np.pi / (swing_frequency(decay) * step)))


def first_frequency(runs: Sequence[xr.Dataset]) -> float:
    """Return the frequency from which fits of runs start: the median of their frequencies, rad/s.

    A driven body, such as one on a belt, may swing away from zero: its own middle is then used. A driven run
    that does not swing, such as one that is lifted slowly, is ignored if others do. If none swings, the
    result is a frequency below which their rates have nearly all of their power.

    Raises
    ------
    DecayError
        A free run has no whole half period.
    """
    frequencies = list[float]()
    for run in runs:
        try:
            frequencies.append(swing_frequency(run))
        except DecayError:
            if not inputs.inputs_of(run):
                raise
            with suppress(DecayError):
                frequencies.append(swing_frequency(run, equilibrium=None))
    return float(np.median(frequencies)) if frequencies else max(clock_of(run) for run in runs)


def clock_of(record: xr.Dataset) -> float:
    """Return a frequency (rad/s) below which the rate has nearly all of its power, to two digits."""
    time = record.time.values.astype(float)
    step = float(np.median(np.diff(time)))
    rate = np.diff(np.interp(np.arange(time[0], time[-1], step), time, record.angle.values))
    power = np.cumsum(np.abs(np.fft.rfft(rate)) ** 2)
    # Fraction of the power of the rate.
    at = np.searchsorted(power, 0.95 * power[-1])
    return nominal_frequency(2.0 * np.pi * float(np.fft.rfftfreq(len(rate), step)[max(1, at)]))


def nominal_frequency(frequency: float) -> float:
    """Round a frequency to two digits, so that records that differ by noise have the same splines.

    The digits refer to a unit of time (a power of two of the second) in which the frequency is 5 to 10, so
    results do not depend on the unit.
    """
    halvings = math.floor(math.log2(frequency / 5.0))
    return math.ldexp(float(f"{math.ldexp(frequency, -halvings):.2g}"), halvings)


def sensor_noise(decay: xr.Dataset) -> float:
    """Return the standard deviation of a sample's noise, independent of any forces (rad).

    Parameters
    ----------
    decay : Dataset
        Decay with `angle(time)`.

    Returns
    -------
    float
        Noise from the residual of the least-squares spline with twelve knots a period. It needs no model, and
        so is the same for every method. For coloured noise it is the part above six times the frequency of
        the swing. With too few samples, or with gaps, it is that of sixth differences, or of quantisation if
        that is larger. For an integrated signal it is the noise of the measured signal, divided by the
        frequency of the swing for each integration.
    """
    integrations = int(decay.attrs.get("integrations", 0))
    if integrations and "measured" in decay:
        measured = decay["measured"].sel(measured_time=slice(*decay.time.values[[0, -1]].tolist()))
        by_spline = sensor_noise(xr.Dataset({"angle": measured.rename(measured_time="time")}))
        at, values = (of.values.astype(float) for of in (measured.measured_time, measured))
        by_differences = half_periods.noise_of_record(at, values)
        # Dry friction makes an acceleration jump, which a spline does not follow: its residual is then larger
        # than the noise by at least this factor.
        noise = by_spline if by_spline < 1.2 * by_differences else by_differences
        return float(noise / swing_frequency(decay) ** integrations)
    time = decay.time.values.astype(float)
    angle = decay.angle.values.astype(float)
    try:
        tau = nominal_frequency(swing_frequency(decay)) * (time - time[0])
        about_spline = _about_spline if len(tau) <= MOST_KEPT else _about_long_spline
        return about_spline(tau.tobytes(), angle.tobytes())
    except DecayError:
        return float(half_periods.noise_of_record(time, angle))


def _noise(tau: bytes, angle: bytes) -> float:
    """Return only `noise` of `smooth`, without the derivatives of the motion."""
    values = np.frombuffer(angle)
    spline, x = least_squares_spline(np.frombuffer(tau), values)
    return _noise_about(spline, values - x)


# Every method and verdict asks for the noise of the same record, or of its few runs: cache the last ones.
# A long record has a separate cache, so that records simulated from it do not displace it.
_about_spline = lru_cache(4)(_noise)
_about_long_spline = lru_cache(1)(_noise)
