"""Where model and record disagree: when, at which amplitude, in phase or amplitude, where in a cycle."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import chi2

from sysid_trib.discrepancy.baseline import Baseline
from sysid_trib.discrepancy.probes import Course
from sysid_trib.regression.weak_form import build_weak_form, smooth

Array = NDArray[np.float64]

# Spans of the record in each of which the gap is demodulated, so many at most, of a period at least.
SPANS = 24
# Cells of the map, each way.
CELLS = 15
# A gap whose mean square over half a period is beyond this many times the noise's has left it.
LEFT = 4.0
TERMS = {
    "offset": "mean of the gap",
    "amplitude_error": "record's amplitude minus the model's",
    "phase_error": "record's phase minus the model's",
    "second_cosine": "part of the gap with cos 2 phi",
    "second_sine": "part of the gap with sin 2 phi",
    "third_cosine": "part of the gap with cos 3 phi",
    "third_sine": "part of the gap with sin 3 phi",
}


def disagreement(baseline: Baseline, courses: Sequence[Course]) -> xr.Dataset:
    """The gap of a model, demodulated against the phase of its own motion.

    Returns
    -------
    Dataset. Over `span` (of all runs in turn; `run`, `time` in s, `amplitude` in rad): `rms` (rad),
    `gap_over_noise`, and with standard errors `offset`, `amplitude_error`, `phase_error`, `second_cosine`,
    ... (rad). Over `x` and `v` (rad): `force`, the mean force that the gap asks for, as a part of I w^2, and
    the number of `samples`. attrs: `departure_time` (s, of the run `departure_run`), `parts` of which
    the gap is made, most first, and `where` it acts.
    """
    residuals = [-left for left in baseline.problem.residuals(baseline.unknown)]
    spans, cells = [], []
    departures = []
    for run, (course, gap, noise) in enumerate(zip(courses, residuals, baseline.noises, strict=True)):
        x, v = course.about.at_samples(course.about.x), course.about.at_samples(course.about.v)
        departures.append(_departure(course.time, gap, x, noise.level))
        spans.append(_demodulated(run, course.time, gap, x, v, noise.level))
        cells.append((x, v, _asked_force(course, gap)))
    found = xr.concat(spans, "span").merge(_map(cells))
    left = [(time, run) for run, time in enumerate(departures) if np.isfinite(time)]
    first = min(left) if left else (np.nan, 0)
    found.attrs = {"departure_time": first[0], "departure_run": first[1], **_described(found)}
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


def _demodulated(run: int, time: Array, gap: Array, x: Array, v: Array, noise: float) -> xr.Dataset:
    phase, amplitude = np.arctan2(-v, x), np.hypot(x, v)
    turns = np.abs(np.unwrap(phase)[-1] - phase[0]) / (2.0 * np.pi)
    count = int(max(1, min(SPANS, turns)))
    rows = []
    for part in np.array_split(np.arange(len(time)), count):
        p, a = phase[part], amplitude[part]
        columns = np.stack(
            [
                np.ones_like(p),
                np.cos(p),
                -a * np.sin(p),
                *(w(m * p) for m in (2, 3) for w in (np.cos, np.sin)),
            ],
            axis=1,
        )
        values, *_ = np.linalg.lstsq(columns, gap[part], rcond=None)
        errors = noise * np.sqrt(np.diag(np.linalg.pinv(columns.T @ columns)))
        rms = float(np.sqrt(np.mean(gap[part] ** 2)))
        rows.append((float(np.mean(time[part])), float(np.mean(a)), rms, rms / noise, *values, *errors))
    table = np.array(rows).T
    data: dict[str, Any] = {
        "run": ("span", np.full(count, run)),
        "time": ("span", table[0], {"units": "s", "long_name": "time"}),
        "amplitude": ("span", table[1], {"units": "rad", "long_name": "amplitude of the model"}),
        "rms": ("span", table[2], {"units": "rad", "long_name": "RMS of the gap"}),
        "gap_over_noise": ("span", table[3], {"units": "1", "long_name": "RMS of the gap over the noise"}),
    }
    for at, (name, told) in enumerate(TERMS.items()):
        data[name] = ("span", table[4 + at], {"units": "rad", "long_name": told})
        error = {"units": "rad", "long_name": f"standard error: {told}"}
        data[f"{name}_standard_error"] = ("span", table[4 + len(TERMS) + at], error)
    return xr.Dataset(data)


def _asked_force(course: Course, gap: Array) -> Array:
    """Force that would make the smoothed gap: what its curvature and the spring ask for, (sample,)."""
    w = course.model.reference_frequency
    form = build_weak_form(w * (course.time - course.time[0]))
    smoothed, _, curvature, _ = smooth(form, gap)
    return -(curvature + smoothed)


def _map(cells: Sequence[tuple[Array, Array, Array]]) -> xr.Dataset:
    x, v, force = (np.concatenate(part) for part in zip(*cells, strict=True))
    size = 1.001 * float(np.max(np.hypot(x, v)))
    edges = np.linspace(-size, size, CELLS + 1)
    samples, *_ = np.histogram2d(x, v, [edges, edges])
    total, *_ = np.histogram2d(x, v, [edges, edges], weights=force)
    mean = np.divide(total, samples, out=np.full_like(total, np.nan), where=samples > 0)
    middle = 0.5 * (edges[1:] + edges[:-1])
    told = {"units": "rad", "long_name": "force that the gap asks for, over I w^2"}
    return xr.Dataset(
        {"force": (("x", "v"), mean, told), "samples": (("x", "v"), samples, {"units": "1"})},
        {
            "x": ("x", middle, {"units": "rad", "long_name": "angle"}),
            "v": ("v", middle, {"units": "rad", "long_name": "angular rate over w"}),
        },
    )


def _described(found: xr.Dataset) -> dict[str, str]:
    """What kind of force is missing, and where it acts, by what the gap is made of."""
    a = found.amplitude.values
    phase = found.phase_error.values * a
    parts = {
        "phase": float(np.sqrt(np.mean(phase**2))),
        "amplitude": float(np.sqrt(np.mean(found.amplitude_error.values**2))),
        "offset": float(np.sqrt(np.mean(found.offset.values**2))),
        "second harmonic": _size(found, "second"),
        "third harmonic": _size(found, "third"),
    }
    ordered = sorted(parts, key=lambda name: -parts[name])
    strong = [name for name in ordered if parts[name] > 0.5 * parts[ordered[0]]]
    rates = np.abs(np.gradient(found.phase_error.values)) if ordered[0] == "phase" else found.rms.values
    early, late = rates[a > np.median(a)], rates[a <= np.median(a)]
    ratio = float(np.mean(early) / max(float(np.mean(late)), 1e-300)) if len(early) and len(late) else 1.0
    where = "large amplitude" if ratio > 2.0 else "small amplitude" if ratio < 0.5 else "all amplitudes"
    return {"parts": ", ".join(strong), "where": where}


def _size(found: xr.Dataset, name: str) -> float:
    return float(np.sqrt(np.mean(found[f"{name}_cosine"].values ** 2 + found[f"{name}_sine"].values ** 2)))
