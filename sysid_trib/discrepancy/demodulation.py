"""Where model and record disagree: when, at which amplitude, in phase or amplitude, where in a cycle."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.signal import freqz
from scipy.stats import binned_statistic_2d, chi2

from sysid_trib.discrepancy.baseline import Baseline
from sysid_trib.discrepancy.candidate_sensitivities import ReferenceMotion
from sysid_trib.discrepancy.trends import trend
from sysid_trib.noise.residual_noise import NoiseModel
from sysid_trib.noise.smoothing import smooth
from sysid_trib.results.variables import variable

Array = NDArray[np.float64]

# Spans of the record in each of which the gap is demodulated, so many at most, of a period at least.
SPANS = 24
# Cells of the map, each way.
CELLS = 11
# Drawings of noise, for the errors of the map.
DRAWS = 32
# A gap whose mean square over half a period is beyond this many times the noise's has left it.
LEFT = 4.0
# A part of the gap counts that noise alone would make so large with this chance.
CHANCE = 1e-3
TERMS = {
    "offset": "mean of the gap",
    "amplitude_error": "record's amplitude minus the model's",
    "phase_error": "record's phase minus the model's",
    "second_cosine": "part of the gap with cos 2 phi",
    "second_sine": "part of the gap with sin 2 phi",
    "third_cosine": "part of the gap with cos 3 phi",
    "third_sine": "part of the gap with sin 3 phi",
}
# Harmonic of the motion whose noise each term takes.
HARMONICS = np.array([0, 1, 1, 2, 2, 3, 3])
PARTS = {
    "phase": ("phase_error",),
    "amplitude": ("amplitude_error",),
    "offset": ("offset",),
    "second harmonic": ("second_cosine", "second_sine"),
    "third harmonic": ("third_cosine", "third_sine"),
}


def disagreement(baseline: Baseline, references: Sequence[ReferenceMotion]) -> xr.Dataset:
    """The gap of a model, demodulated against the phase of its own motion while it moves.

    Returns
    -------
    Dataset. Over `span` (of all runs in turn; `run`, `time` in s, `amplitude` in rad): `rms` (rad),
    `residual_over_noise`, and with standard errors `offset`, `amplitude_error`, `phase_error`,
    `second_cosine`, ... (rad). As trends through these `frequency_error` and `decay_error`, of the record
    minus the model's, over w. Over `x` and `v` (rad): `force`, the mean force that the residual asks for, as
    a part of I w^2, its `standard_error` by the noise alone, and the number of `samples`. Scalars
    `departure_time` (s, of the run `departure_run`). attrs: `parts` of which the residual is made beyond the
    noise, largest first, and `where` it acts.
    """
    residuals = [-left for left in baseline.problem.residuals(baseline.values)]
    spans, cells, departures = [], [], []
    for run, (course, gap, noise) in enumerate(zip(references, residuals, baseline.noises, strict=True)):
        x, v = course.about.at_samples(course.about.x), course.about.at_samples(course.about.v)
        departures.append(_departure(course.time, gap, x, noise.standard_deviation))
        spans.append(_demodulated(run, course, gap, (x, v), noise))
        cells.append((x, v, _asked_force(course, gap, (x, v)), _asked_by_noise(course, noise)))
    found = xr.concat(spans, "span").merge(_map(cells))
    left = [(time, run) for run, time in enumerate(departures) if np.isfinite(time)]
    first = min(left) if left else (np.nan, 0)
    found, where = _with_rates(found, references[0].model.reference_frequency)
    parts = _parts(found)
    place = where.get(parts[0], _place_of_rms(found)) if parts else ""
    found["departure_time"] = variable(
        (), first[0], "time from which on the residual is beyond the noise", "s"
    )
    found["departure_run"] = variable((), first[1], "the run of that time, from 0")
    found.attrs = {"parts": parts, "where": place}
    return found


def _departure(time: Array, gap: Array, x: Array, noise: float) -> float:
    """First time at which the gap over half a period is beyond the noise; nan if never."""
    turns = np.flatnonzero(np.diff(np.sign(x)) != 0)
    width = int(np.median(np.diff(turns))) if len(turns) > 2 else max(2, len(x) // 10)
    total = np.concatenate([[0.0], np.cumsum(gap**2)])
    local = (total[width:] - total[:-width]) / width
    # A level that half a period of noise passes once in a hundred records.
    level = max(LEFT, float(chi2.isf(0.01 * width / len(x), width)) / width) * noise**2
    beyond = np.flatnonzero(local > level)
    return float(time[beyond[0]]) if len(beyond) else float("nan")


def _demodulated(
    run: int, course: ReferenceMotion, gap: Array, motion: tuple[Array, Array], noise: NoiseModel
) -> xr.Dataset:
    # After its stop a motion has no phase.
    moving = len(course.about.x[:: course.about.every])
    gap, x, v = gap[:moving], motion[0][:moving], motion[1][:moving]
    phase, amplitude = np.unwrap(np.arctan2(-v, x)), np.hypot(x, v)
    turns = np.abs(phase[-1] - phase[0]) / (2.0 * np.pi)
    count = int(max(1, min(SPANS, turns)))
    step = float(np.median(np.diff(course.time)))
    _, response = freqz([1.0], noise.filter_, HARMONICS * min(1.0, course.model.reference_frequency * step))
    coloured = noise.innovation * np.abs(response)
    rows = []
    for part in np.array_split(np.arange(len(gap)), count):
        p, a = phase[part], amplitude[part]
        waves = [w(m * p) for m in (2, 3) for w in (np.cos, np.sin)]
        columns = np.stack([np.ones_like(p), a * np.cos(p), -a * np.sin(p), *waves], axis=1)
        values, *_ = np.linalg.lstsq(columns, gap[part], rcond=None)
        errors = coloured * np.sqrt(np.diag(np.linalg.pinv(columns.T @ columns)))
        # The record is a turned and stretched motion: exact also where it has slipped far.
        cosine, sine, mean = 1.0 + values[1], values[2], float(np.mean(a))
        values[1:3] = mean * (np.hypot(cosine, sine) - 1.0), np.arctan2(sine, cosine)
        errors[1] *= mean
        rms = float(np.sqrt(np.mean(gap[part] ** 2)))
        rows.append(
            (float(np.mean(course.time[part])), mean, rms, rms / noise.standard_deviation, *values, *errors)
        )
    table = np.array(rows).T
    slipped = list(TERMS).index("phase_error")
    table[4 + slipped] = np.unwrap(table[4 + slipped])
    data: dict[str, Any] = {
        "run": ("span", np.full(count, run)),
        "time": ("span", table[0], {"units": "s", "long_name": "time"}),
        "amplitude": ("span", table[1], {"units": "rad", "long_name": "amplitude of the model"}),
        "rms": ("span", table[2], {"units": "rad", "long_name": "RMS residual"}),
        "residual_over_noise": (
            "span",
            table[3],
            {"units": "1", "long_name": "RMS residual over the noise"},
        ),
    }
    for at, (name, told) in enumerate(TERMS.items()):
        data[name] = ("span", table[4 + at], {"units": "rad", "long_name": told})
        error = {"units": "rad", "long_name": f"standard error: {told}"}
        data[f"{name}_standard_error"] = ("span", table[4 + len(TERMS) + at], error)
    return xr.Dataset(data)


def _with_rates(found: xr.Dataset, frequency: float) -> tuple[xr.Dataset, dict[str, str]]:
    """Errors of frequency and decay as trends through those of phase and amplitude, and where they act."""
    a, tau, run = found.amplitude.values, frequency * found.time.values, found.run.values
    slip = trend(found.phase_error.values, found.phase_error_standard_error.values, run, tau, a)
    shrunk, error = found.amplitude_error.values / a, found.amplitude_error_standard_error.values / a
    decay = trend(-shrunk, error, run, tau, a)
    told = {
        "frequency_error": "frequency of record minus model",
        "decay_error": "decay of record minus model",
    }
    rates = {
        name: ("span", one.rate, {"units": "1", "long_name": f"{told[name]}, over w"})
        for name, one in (("frequency_error", slip), ("decay_error", decay))
    }
    return found.assign(rates), {"phase": slip.where, "amplitude": decay.where}


def _parts(found: xr.Dataset) -> list[str]:
    """Parts of the gap that noise would not make, and that are not small beside the largest."""
    size = {}
    for part, names in PARTS.items():
        z = np.stack([found[name].values / found[f"{name}_standard_error"].values for name in names])
        values = np.stack([found[name].values for name in names])
        if float(np.sum(z**2)) > chi2.isf(CHANCE, z.size):
            scaled = values * found.amplitude.values if part == "phase" else values
            size[part] = float(np.sqrt(np.mean(np.sum(scaled**2, axis=0))))
    ordered = sorted(size, key=lambda part: -size[part])
    return [part for part in ordered if size[part] > 0.5 * size[ordered[0]]]


def _place_of_rms(found: xr.Dataset) -> str:
    """Where the gap itself is largest."""
    a, gap = found.amplitude.values, found.rms.values
    early, late = gap[a > np.median(a)], gap[a <= np.median(a)]
    ratio = float(np.mean(early) / max(float(np.mean(late)), 1e-300)) if len(early) and len(late) else 1.0
    return "large amplitude" if ratio > 2.0 else "small amplitude" if ratio < 0.5 else "all amplitudes"


def _asked_force(course: ReferenceMotion, gap: Array, motion: tuple[Array, Array]) -> Array:
    """The force that would make the gap over I w^2, by its equation of motion.

    Both motions are smoothed alike, so that what smoothing takes from them falls out.
    """
    x, v = motion
    w = course.model.reference_frequency
    since = course.time - course.time[0]
    left, rate, curvature, _ = smooth(w * since, gap)
    asked = -(curvature + left)
    for force in course.model.library:
        if force.memoryless and force.kind == "force":
            here, there = (
                force.value(x + part * left, v + part * rate, since, shapes=course.model.shapes)
                for part in (0.0, 1.0)
            )
            asked = asked - course.model.coefficients.get(force.symbol, 0.0) * (there - here)
    # A spline bends freely in the quarter period before its ends.
    inside = np.minimum(w * since, w * (since[-1] - since)) > 0.5 * np.pi
    return np.where(inside, asked, np.nan)


def _asked_by_noise(course: ReferenceMotion, noise: NoiseModel) -> Array:
    """The same of drawings of the noise, (draw, sample); what it does to the model's forces is small."""
    drawn = noise.draws(len(course.time), DRAWS)
    left, _, curvature, _ = smooth(course.model.reference_frequency * course.time, drawn.T)
    return np.asarray(-(curvature + left).T)


def _map(cells: Sequence[tuple[Array, Array, Array, Array]]) -> xr.Dataset:
    x, v, force, drawn = (np.concatenate(part, axis=-1) for part in zip(*cells, strict=True))
    size = 1.001 * float(np.max(np.hypot(x, v)))
    edges = np.linspace(-size, size, CELLS + 1)
    good = np.isfinite(force)
    values = np.concatenate([np.ones((1, len(x))), force[None], drawn])[:, good]
    binned = binned_statistic_2d(x[good], v[good], values, "sum", bins=[edges, edges]).statistic
    samples = binned[0]
    mean, *scatter = np.where(samples > 0, binned[1:] / np.maximum(samples, 1.0), np.nan)
    middle = 0.5 * (edges[1:] + edges[:-1])
    told = {"units": "rad", "long_name": "force that the gap asks for, over I w^2"}
    error = {"units": "rad", "long_name": "standard error of that force by the noise"}
    return xr.Dataset(
        {
            "force": (("x", "v"), mean, told),
            "standard_error": (("x", "v"), np.sqrt(np.mean(np.square(scatter), axis=0)), error),
            "samples": (("x", "v"), samples, {"units": "1"}),
        },
        {
            "x": ("x", middle, {"units": "rad", "long_name": "angle"}),
            "v": ("v", middle, {"units": "rad", "long_name": "angular rate over w"}),
        },
    )
