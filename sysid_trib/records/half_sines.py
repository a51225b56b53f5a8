"""Envelope of a decay: half-sines through its half periods give amplitude, rate, frequency, their errors."""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np
import scipy.sparse as sp
import xarray as xr

from sysid_trib import records
from sysid_trib.arrays import Array, Index, Variables, variable, with_error
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.records import equilibrium, signal
from sysid_trib.records.analytic_signal import analytic_extrema
from sysid_trib.records.half_periods import HalfPeriods, noise_of_record
from sysid_trib.records.runs import RecordLike

EnvelopeCurve: TypeAlias = Literal["half-sines", "analytic-signal"]

IMPULSES = 8
"""Number of impulses in each half period that represent white acceleration."""
SPAN = 4
"""Number of half periods before and after an impulse whose extrema have a transient response."""
# Size of a test impulse, relative to the amplitude of the swing.
IMPULSE_SIZE = 1e-5


def _half_sine_extrema(time: Array, angle: Array, halves: HalfPeriods) -> tuple[Array, Array, Array, Array]:
    """Fit the extrema of all half periods by half-sines b cos(w (t - t_b)) through three or more at once.

    The results are those of `analytic_extrema`. w is the frequency between the neighbouring extrema, w_i in
    the paper, and is found in a few rounds. Fitting w separately in each half period would reduce the
    precision of b and gain nothing. A sample next to a zero crossing counts by the fraction of its cell
    inside, so that the fit does not depend on the positions of the samples.
    """
    sample, half, weight, first = _cells(time, halves)
    middle = 0.5 * (halves.crossing[1:] + halves.crossing[:-1])
    s = time[sample] - middle[half]
    y = angle[sample]
    w: Array = np.pi / halves.duration
    # The third round changes the frequency by less than 1e-6 of its value.
    for _ in range(3):
        phase = w[half] * s
        cc, cs, ss, cy, sy = equilibrium.harmonic_sums(phase, y, weight, first)
        normal = np.stack([cc, cs, cs, ss], axis=1).reshape(-1, 2, 2)
        right = np.stack([cy, sy], axis=1)
        p, q = np.linalg.solve(normal, right[..., None])[..., 0].T
        instant = middle + np.arctan(q / p) / w
        used = w
        inner = 2.0 * np.pi / (instant[2:] - instant[:-2])
        w = np.clip(np.concatenate((inner[:1], inner, inner[-1:])), 0.7 * used, 1.4 * used)
    extremum = np.copysign(np.hypot(p, q), p)
    # Standard errors of (p, q) at unit noise, propagated to b and its time.
    covariance = np.linalg.inv(normal)
    to_b = np.stack([p, q], axis=-1) / extremum[:, None]
    to_t = np.stack([-q, p], axis=-1) / (extremum**2 * used)[:, None]
    errors = [np.sqrt(np.einsum("hi,hij,hj->h", row, covariance, row)) for row in (to_b, to_t)]
    return extremum, instant, errors[0], errors[1]


def _cells(time: Array, halves: HalfPeriods) -> tuple[Index, Index, Array, Index]:
    """Return samples whose cells touch each half period: index, half period, part inside, first of each."""
    edge = np.concatenate(([time[0]], 0.5 * (time[1:] + time[:-1]), [time[-1]]))
    edge[0] -= 0.5 * (time[1] - time[0])
    edge[-1] += 0.5 * (time[-1] - time[-2])
    low = np.searchsorted(edge, halves.crossing[:-1], side="right") - 1
    high = np.searchsorted(edge, halves.crossing[1:], side="left")
    sample, half, first = equilibrium.samples_between(low, high)
    start = np.maximum(edge[sample], halves.crossing[half])
    inside = np.minimum(edge[sample + 1], halves.crossing[half + 1]) - start
    return sample, half, inside / (edge[sample + 1] - edge[sample]), first


def sample_responses(decay: xr.Dataset, extremum_time: Array) -> sp.csr_matrix:
    """Compute the effect of each sample on extrema and times of the half-sines, (2 half periods, sample).

    Parameters
    ----------
    decay : Dataset
        `angle(time)` about its equilibrium, as `envelope` takes it.
    extremum_time : (half_period,) array of float, s
        Times of the extrema of consecutive half periods.

    Returns
    -------
    sparse array of float
        Derivatives of the extrema (positive), then of their times (s per unit of the signal), to first order.
        The frequency of each half-sine is held, because an extremum hardly depends on it.
    """
    time, angle, halves = equilibrium.with_half_periods(decay)
    signed, instant, *_ = _half_sine_extrema(time, angle, halves)
    sample, half, weight, first = _cells(time, halves)
    inner = 2.0 * np.pi / (instant[2:] - instant[:-2])
    w = np.concatenate((inner[:1], inner, inner[-1:]))
    # About the extremum b cos(phase): a cosine adds to b, and a sine moves the extremum.
    phase = w[half] * (time[sample] - instant[half])
    cc, cs, ss, _, _ = equilibrium.harmonic_sums(phase, angle[sample], weight, first)
    inverse = np.linalg.inv(np.stack([cc, cs, cs, ss], axis=1).reshape(-1, 2, 2))[half]
    columns = weight[:, None] * np.stack([np.cos(phase), np.sin(phase)], axis=1)
    cosine, sine = np.einsum("cij,cj->ic", inverse, columns)
    values = np.concatenate([np.sign(signed)[half] * cosine, sine / (signed * w)[half]])
    count = len(signed)
    places = np.concatenate([half, count + half]), np.tile(sample, 2)
    responses = sp.csr_matrix((values, places), (2 * count, len(time)))
    wanted = np.argmin(np.abs(instant - extremum_time[0])) + np.arange(len(extremum_time))
    return responses[np.concatenate([wanted, count + wanted])]


EXTREMA: Mapping[str, Callable[[Array, Array, HalfPeriods], tuple[Array, Array, Array, Array]]] = {
    "half-sines": _half_sine_extrema,
    "analytic-signal": analytic_extrema,
}


def envelope(decay: RecordLike, curve: EnvelopeCurve = "half-sines") -> xr.Dataset:
    """Return the envelope and frequency of a decay from half-sines (Le Bot et al. 2019, Sec. 2.3).

    Parameters
    ----------
    decay : record
        ``angle(time)`` about its equilibrium, as `free_decay` returns it, or ``(t, angle)``. A record without
        the attributes of `free_decay` is used as it is.
    curve : {"half-sines", "analytic-signal"}
        Curve that gives the extrema: ``half-sines``, or the ``analytic-signal`` (see `analytic_extrema`).

    Returns
    -------
    Dataset
        Over ``half_period``: ``extremum`` (b, positive), ``sign``, ``extremum_time`` (t, s). Over
        ``instant``, the half periods except the first and last: ``instant_time`` = t[i] (s),
        ``amplitude`` = (b[i+1] + b[i-1])/2, ``amplitude_rate`` = (b[i+1] - b[i-1])/(t[i+1] - t[i-1]),
        ``frequency`` = 2 pi/(t[i+1] - t[i-1]) (rad/s); each with its ``..._standard_error``. Scalar:
        ``white_noise``, the standard deviation of one sample. Amplitudes have the unit of the decay.

    Raises
    ------
    DecayError
        There are fewer than three half periods, or too few samples in each.
    UsageError
        There is no curve of this name.

    Notes
    -----
    A half period cut off by an end of the record is left out: its remaining part decays less, so that its
    half-sine differs from the neighbouring ones by more than the noise (with a fifth missing, its time by
    1e-3 half periods).

    The noise is that of sixth differences, or that of quantisation if it is larger. If successive extrema (or
    their times) scatter about a smooth curve by clearly more than this noise explains (waves, a moving
    camera), all their standard errors are multiplied by this ratio, as the attributes state. The standard
    errors do not cover a further error: a decaying, not quite harmonic half period is not a half-sine. This
    error of b and t varies slowly from one half period to the next, and is a few 1e-3 b in the paper's run.

    Examples
    --------
    >>> import sysid_trib as st
    >>> half_sines = st.envelope(st.records.paper_twin())
    >>> half_sines.amplitude.values[:3].round(3).tolist()
    [0.274, 0.262, 0.251]
    >>> half_sines.frequency.values[:3].round(2).tolist()
    [9.53, 9.54, 9.55]
    """
    if curve not in EXTREMA:
        raise UsageError(f"curve='{curve}' is neither 'half-sines' nor 'analytic-signal'.")
    decay = decay if isinstance(decay, xr.Dataset) else records.one_record(decay, "envelope")
    time, angle, halves = equilibrium.with_half_periods(decay)
    # A half-sine of known frequency has two unknowns.
    if np.diff(halves.samples(time)[0]).min() < 2:
        source = decay.attrs.get("source", "decay")
        raise DecayError(f"{source}: fewer than two samples in a half period; sample faster.")
    signed, extremum_time, extremum_error, time_error = EXTREMA[curve](time, angle, halves)
    noise = noise_of_record(time, angle)
    extremum = np.abs(signed)
    decay_ratio = float(np.clip(np.median(extremum[2:] / extremum[:-2]), 0.0, 1.0))
    at_noise = (extremum, noise * extremum_error), (extremum_time, noise * time_error)
    ratios = [_scatter_ratio(value, error, decay_ratio) for value, error in at_noise]
    errors = [ratio * error for ratio, (_, error) in zip(ratios, at_noise, strict=True)]
    unit = signal.unit_of_signal(decay)
    data = _with_errors(extremum, extremum_time, errors, unit)
    data["sign"] = variable("half_period", halves.sign, "sign of the half period", "1")
    data["white_noise"] = variable((), noise, "white noise of one sample", unit)
    scatter = {"scatter_of_extrema": ratios[0], "scatter_of_times": ratios[1]}
    return xr.Dataset(data, attrs=decay.attrs | scatter)


def _scatter_ratio(value: Array, error: Array, decay_ratio: float) -> float:
    """Return the scatter of values over their errors; 1 if the excess may be chance.

    `decay_ratio` : ratio of extrema a period apart. Differences are taken between half periods of one sign: a
    difference between the two sides cancels in every instant and is not scatter. They vanish for a line
    (solid friction), for a geometric decay (viscous friction), and for the sum of both.
    """
    # A few differences, which span eight half periods, do not determine the scatter.
    if value.size < 15:
        return 1.0
    weights = np.convolve([1.0, 0.0, -2.0, 0.0, 1.0], [1.0, 0.0, -2.0 * decay_ratio, 0.0, decay_ratio**2])
    difference = np.convolve(value, weights, "valid")
    expected = np.sqrt(np.convolve(error**2, weights**2, "valid"))
    ratio = float(1.4826 * np.median(np.abs(difference) / np.maximum(expected, 1e-300)))
    # In one record of a thousand, white noise scatters by more than 1 + this over sqrt(differences), for any
    # length.
    return ratio if ratio > 1.0 + 6.5 / np.sqrt(value.size - 8) else 1.0


def _with_errors(b: Array, t: Array, errors: Sequence[Array], unit: str) -> Variables:
    """Return extrema, times; amplitude, rate and frequency at all half periods but the first and the last."""
    variance_b = errors[0] ** 2
    variance_t = errors[1] ** 2
    span = t[2:] - t[:-2]
    rate = (b[2:] - b[:-2]) / span
    frequency = 2.0 * np.pi / span
    both_b = variance_b[2:] + variance_b[:-2]
    both_t = variance_t[2:] + variance_t[:-2]
    of_rate = (both_b + rate**2 * both_t) / span**2
    variables: Variables = {}
    for name, value, error, units, long_name in (
        ("extremum", b, errors[0], unit, "extremum of the half-sine"),
        ("extremum_time", t, errors[1], "s", "time of the extremum"),
        ("instant_time", t[1:-1], np.sqrt(variance_t[1:-1]), "s", "time"),
        ("amplitude", 0.5 * (b[2:] + b[:-2]), np.sqrt(0.25 * both_b), unit, "amplitude"),
        ("amplitude_rate", rate, np.sqrt(of_rate), f"{unit}/s", "rate of the amplitude"),
        ("frequency", frequency, np.sqrt(frequency**2 * both_t / span**2), "rad/s", "angular frequency"),
    ):
        dim = "half_period" if name.startswith("extremum") else "instant"
        variables |= with_error(name, dim, (value, error), long_name, units)
    return variables


@lru_cache(maxsize=2)
def _impulse_response(curve: EnvelopeCurve) -> tuple[Array, Array]:
    """Return the response of extrema of half-sines or of the analytic signal.

    Parameters
    ----------
    curve : {"half-sines", "analytic-signal"}

    Returns
    -------
    lasting : (impulse, 2) array of float
        Lasting effect of unit impulses in v = theta'/w, in the half period after extremum 0, on amplitude and
        phase of the swing.
    passing : (impulse, 2 SPAN, 2) array of float
        Deviation of extrema 1 - SPAN to SPAN from those of the swing at their times: before the impulse from
        the old swing, after it from the new one. The last axis contains the extremum (rad), and its time
        multiplied by amplitude and w (rad).

    Notes
    -----
    With x = a cos(phi), v = -a sin(phi), an impulse of v at the phase phi adds -sin(phi) to a, and
    -cos(phi)/a to the phase. A curve through the half period of the impulse contains part of its effect,
    which is found here by a numerical experiment.
    """
    # Number of half periods around the impulse, and of samples in each.
    around = 10
    samples = 64
    number = np.arange(-around, around + 2)
    crossing = np.pi * (np.append(number, around + 2) - 0.5)
    halves = HalfPeriods(crossing, np.where(number % 2, -1, 1), np.ones(len(number)))
    tau = crossing[0] + (np.arange(len(number) * samples) + 0.5) * np.pi / samples
    phase = (np.arange(IMPULSES) + 0.5) * np.pi / IMPULSES
    lasting = np.stack([-np.sin(phase), np.cos(phase)], axis=1)
    passing = np.empty((IMPULSES, 2 * SPAN, 2))
    for impulse, at in enumerate(phase):
        response = IMPULSE_SIZE * np.where(tau > at, np.sin(tau - at), 0.0)
        up, down = (EXTREMA[curve](tau, np.cos(tau) + sign * response, halves)[:2] for sign in (1.0, -1.0))
        change = np.stack([np.abs(up[0]) - np.abs(down[0]), up[1] - down[1]], axis=1) / (2.0 * IMPULSE_SIZE)
        change[number > 0] -= lasting[impulse]
        passing[impulse] = change[(number > -SPAN) & (number <= SPAN)]
    return lasting, passing


def half_period_responses(measured: xr.Dataset) -> tuple[sp.csr_matrix, sp.csr_matrix]:
    """Return the response of extrema and times to impulses of density 1: (2 half periods, impulse) each.

    There is a lasting part, from one extremum to the next, and a transient part.
    """
    b = measured.extremum.values
    t = measured.extremum_time.values
    (lasting, passes), count = _impulse_response(measured.attrs.get("curve", "half-sines")), len(b)
    duration = np.diff(t)
    duration = np.concatenate([duration[:1], duration, duration[-1:]])
    # White acceleration adds density/2 * time to the variance of theta' = w v, w = pi/duration.
    size = np.sqrt(0.5 * duration**3 / (np.pi**2 * IMPULSES))

    # First the extrema, then their times.
    of_half_period = np.stack([size, size * (duration / np.pi)])
    of_extremum = np.stack([np.ones(count), 1.0 / b])

    def matrix(offsets: Index, parts: Array) -> sp.csr_matrix:
        """Return responses (offset, impulse, 2) of the extremum `offset` half periods after an impulse."""
        # The half period between extrema i - 1 and i has the index i.
        half = np.arange(count) + 1 - offsets[:, None]
        which, extremum = np.nonzero((half >= 0) & (half <= count))
        half = half[which, extremum]
        values = of_half_period.T[half][:, None] * parts[which]
        values = of_extremum.T[extremum][:, None] * values
        rows = extremum[:, None, None] + count * np.arange(2)
        columns = IMPULSES * half[:, None, None] + np.arange(IMPULSES)[:, None]
        places = np.broadcast_to(rows, values.shape).ravel(), np.broadcast_to(columns, values.shape).ravel()
        return sp.csr_matrix((values.ravel(), places), (2 * count, IMPULSES * (count + 1)))

    passing = matrix(np.arange(1 - SPAN, SPAN + 1), passes.transpose(1, 0, 2))
    return matrix(np.ones(1, int), lasting[None]), passing
