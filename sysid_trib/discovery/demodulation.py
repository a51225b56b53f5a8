"""Difference of model and record: its times and amplitudes, its phase and amplitude errors, its growth."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import scipy
from scipy.integrate import cumulative_trapezoid

from sysid_trib.arrays import Array
from sysid_trib.discovery.free_motion import FreeMotion
from sysid_trib.validation.missing_force import RunWithMotion, missing_force
from sysid_trib.validation.residuals import departure_time, half_period

# Candidate trends of an error rate: proportional to a power of the amplitude, or to time.
SHAPES = {"small amplitude": -1.0, "large amplitude": 1.0, "larger amplitude": 2.0, "late times": None}
# A trend counts if it explains at least this fraction of chi-square, and is significant at this level.
EXPLAINED_PART, LEVEL = 0.5, 1e-3


def trend(value: Array, error: Array, run: Array, tau: Array, amplitude: Array) -> tuple[Array, str]:
    """Return the growth rate of a quantity, as a constant and the best further term.

    Parameters
    ----------
    value, error : (span,) array of float
        The quantity and its standard error.
    run, tau, amplitude : (span,) array
        Run, time and amplitude of each span; tau = w t.

    Returns
    -------
    rate : (span,) array of float
        The rate, over tau.
    where : str
        Amplitudes or times where the rate differs most.

    Notes
    -----
    A conservative force a^(p+1) changes the phase at a rate a^p. The constant contains what the model can
    adjust itself: its frequency or its viscous friction. So the force acts where the rate changes.
    """
    # Unknown values get no weight.
    known = np.isfinite(value) & np.isfinite(error) & (error > 0.0)
    value, error = np.where(known, value, 0.0), np.where(known, error, np.inf)
    offsets = (run[:, None] == np.unique(run)).astype(float)
    plain = np.column_stack([offsets, tau])
    steady, chi_square = _fitted_trend(plain, value, error)
    constant = np.full(len(value), steady[-1]), "all amplitudes"
    if len(value) <= plain.shape[1] + 1:
        return constant
    trends = []
    for name, power in SHAPES.items():
        rate = tau - tau.min() if power is None else amplitude**power
        # A step between runs is possible, because these have separate offsets.
        integral = cumulative_trapezoid(rate, tau, initial=0.0)
        values, remaining = _fitted_trend(np.column_stack([plain, integral]), value, error)
        trends.append((remaining, values[-2] + values[-1] * rate, name.replace("larger", "large")))
    least, *best = min(trends, key=lambda trend: trend[0])
    counts = chi_square - least > max(EXPLAINED_PART * chi_square, float(scipy.stats.chi2.isf(LEVEL, 1)))
    return (best[0], best[1]) if counts else constant


def _fitted_trend(columns: Array, value: Array, error: Array) -> tuple[Array, float]:
    """Solve weighted least squares: coefficients and chi-square."""
    size = np.maximum(np.linalg.norm(columns / error[:, None], axis=0), np.finfo(float).tiny)
    values = np.linalg.lstsq(columns / error[:, None] / size, value / error, rcond=1e-12)[0] / size
    return values, float(np.sum(((value - columns @ values) / error) ** 2))


# Terms of the residual: the harmonic of the motion whose noise applies to each, and the part it belongs to.
DEMODULATED = {
    "offset": (0, "offset"),
    "amplitude_error": (1, "amplitude"),
    "phase_error": (1, "phase"),
    "second_cosine": (2, "second harmonic"),
    "second_sine": (2, "second harmonic"),
    "third_cosine": (3, "third harmonic"),
    "third_sine": (3, "third harmonic"),
}
SLIP = list(DEMODULATED).index("phase_error")


def demodulate(runs: Sequence[FreeMotion]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the residual of a model, demodulated against the phase of its own motion while it moves.

    Parameters
    ----------
    runs : sequence of FreeMotion
        The model's motion in each run.

    Returns
    -------
    values : dict of str to array, or pair of arrays with standard errors
        Over `span` (all runs one after another; `run`, `time` in s, `amplitude` in rad): `rms` (rad),
        `residual_over_noise`, and with standard errors `offset`, `amplitude_error`, `phase_error`,
        `second_cosine`, ... (rad). Their trends give `frequency_error` and `decay_error`, record minus model,
        over w. Over `x` and `v` (rad): the mean missing force (see `missing_force`). Scalars:
        `departure_time` (s) in the run `departure_run`.
    attrs : dict
        `parts` of the residual beyond the noise, largest first, and `where` it acts.
    """
    departures = [
        departure_time(run.time, run.residual, run.noise.standard_deviation, half_period(run.motion.x))
        for run in runs
    ]
    first, at = min((time, run) for run, time in enumerate(np.nan_to_num(departures, nan=np.inf).tolist()))
    spans, of_runs = zip(*(_demodulated(at, run) for at, run in enumerate(runs)), strict=True)
    values: dict[str, Any] = {name: np.concatenate([of_run[name] for of_run in spans]) for name in spans[0]}
    pairs = zip(DEMODULATED, np.concatenate(of_runs).transpose(2, 1, 0), strict=True)
    terms: dict[str, tuple[Array, Array]] = {name: (of, error) for name, (of, error) in pairs}
    a, run, tau = values["amplitude"], values["run"], runs[0].model.reference_frequency * values["time"]
    # Errors of frequency and decay are the trends of the errors of phase and amplitude.
    loss = [of / a for of in terms["amplitude_error"]]
    slipping, where_phase = trend(*terms["phase_error"], run, tau, a)
    decaying, where_amplitude = trend(-loss[0], loss[1], run, tau, a)
    parts = _parts(terms, a)
    where = {"phase": where_phase, "amplitude": where_amplitude}
    values |= terms | _missing_force(runs)
    values |= {"frequency_error": slipping, "decay_error": decaying}
    values |= {"departure_time": first if np.isfinite(first) else np.nan, "departure_run": at}
    place = where.get(parts[0], _place_of_rms(a, values["rms"])) if parts else ""
    return values, {"parts": parts, "where": place}


def _demodulated(number: int, run: FreeMotion) -> tuple[dict[str, Array], Array]:
    """Return spans of a run, and the terms of the residual in each with their errors: (span, 2, term)."""
    # After its stop, a motion has no phase.
    moving, residual, noise = run.moving, run.residual, run.noise
    x, v = run.motion.x[:moving], run.motion.v[:moving]
    phase, amplitude = np.unwrap(np.arctan2(-v, x)), np.hypot(x, v)
    periods = np.abs(phase[-1] - phase[0]) / (2.0 * np.pi)
    # At most 24 spans, each of at least one period, for the demodulated residual.
    spans = np.array_split(np.arange(moving), int(max(1, min(24, periods))))
    step = float(np.median(np.diff(run.time)))
    harmonics = np.array([harmonic for harmonic, _ in DEMODULATED.values()])
    per_sample = min(1.0, run.model.reference_frequency * step)
    _, response = scipy.signal.freqz([1.0], noise.filter_, harmonics * per_sample)
    coloured = noise.innovation * np.abs(response)
    fitted = [_fitted(residual[span], phase[span], amplitude[span], coloured) for span in spans]
    terms = np.array(fitted)
    terms[:, 0, SLIP] = np.unwrap(terms[:, 0, SLIP])
    rms = np.array([np.sqrt(np.mean(residual[span] ** 2)) for span in spans])
    values = {
        "run": np.full(len(spans), number),
        "time": np.array([np.mean(run.time[span]) for span in spans]),
        "amplitude": np.array([np.mean(amplitude[span]) for span in spans]),
        "rms": rms,
        "residual_over_noise": rms / noise.standard_deviation,
    }
    return values, terms


def _fitted(residual: Array, phase: Array, amplitude: Array, noise: Array) -> tuple[Array, Array]:
    """Return the terms of a span and their errors, (term,) each; `noise` is that of each term's harmonic."""
    waves = [wave(m * phase) for m in (2, 3) for wave in (np.cos, np.sin)]
    first = [amplitude * np.cos(phase), -amplitude * np.sin(phase)]
    columns = np.stack([np.ones_like(phase), *first, *waves], axis=1)
    values, *_ = np.linalg.lstsq(columns, residual, rcond=None)
    errors = noise * np.sqrt(np.diag(np.linalg.pinv(columns.T @ columns)))
    # The record is a rotated and scaled motion: this is exact also for a large phase error.
    cosine, sine, mean = 1.0 + values[1], values[2], float(np.mean(amplitude))
    values[1:3] = mean * (np.hypot(cosine, sine) - 1.0), np.arctan2(sine, cosine)
    errors[1] *= mean
    return values, errors


def _parts(terms: Mapping[str, tuple[Array, Array]], amplitude: Array) -> list[str]:
    """Return the significant parts of the residual that are not small relative to the largest."""
    size = {}
    for part in dict.fromkeys(part for _, part in DEMODULATED.values()):
        of_part = [terms[name] for name, (_, other) in DEMODULATED.items() if other == part]
        values, errors = np.stack(of_part, axis=1)
        # A part of the residual counts if it is significant at this level.
        if float(np.sum((values / errors) ** 2)) > scipy.stats.chi2.isf(1e-3, values.size):
            scaled = values * amplitude if part == "phase" else values
            size[part] = float(np.sqrt(np.mean(np.sum(scaled**2, axis=0))))
    ordered = sorted(size, key=lambda part: -size[part])
    return [part for part in ordered if size[part] > 0.5 * size[ordered[0]]]


def _place_of_rms(a: Array, rms: Array) -> str:
    """Return the amplitudes at which the residual is largest, in words."""
    large, small = rms[a > np.median(a)], rms[a <= np.median(a)]
    ratio = np.mean(large) / max(float(np.mean(small)), 1e-300) if len(large) and len(small) else 1.0
    return "large amplitude" if ratio > 2.0 else "small amplitude" if ratio < 0.5 else "all amplitudes"


def _missing_force(runs: Sequence[FreeMotion]) -> dict[str, Any]:
    """Return the mean force that the model lacks, over `x` and `v`, and the number of samples."""
    with_motions = []
    for run in runs:
        angle = run.motion.x + run.residual
        with_motions.append(RunWithMotion(run.time, angle, run.motion.x, run.noise, run.inputs))
    cells = missing_force(runs[0].model, with_motions)
    return {name: cells[name] for name in ("x", "v", "force", "samples")}
