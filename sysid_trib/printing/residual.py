"""The gap of a model in words: how large, from when on, in phase or amplitude, and what may close it."""

import numpy as np
import xarray as xr

from sysid_trib.printing.force_types import force_type_sentence
from sysid_trib.results.per_run import record_groups
from sysid_trib.results.signal_units import signal_units, small_units
from sysid_trib.validation.breakdown import record_noise
from sysid_trib.validation.verdict import LOUD

UNKNOWN = "The gap does not follow the motion: it is vibration from outside, or noise of another kind."
# Places that a sentence names; a gap that is everywhere needs none.
WHERE = {
    "large amplitude": ", mostly at large amplitude",
    "small amplitude": ", mostly at small amplitude",
    "late times": ", growing with time",
}
NAMED_HARMONICS = ("second", "third")


def residual_of(tree: xr.DataTree, model: str) -> float:
    """RMS of record minus model over all runs, rad; of an integrated signal that of `comparison`."""
    if "comparison" in tree and int(tree[record_groups(tree)[0]].attrs.get("integrations", 0)):
        return float(tree["comparison"].residual_rms.sel(model=model).item())
    residuals = [
        (tree[group].angle - tree[group].simulated_angle.sel(model=model)).values
        for group in record_groups(tree)
    ]
    return float(np.sqrt(np.mean(np.concatenate(residuals) ** 2)))


def noise_of(tree: xr.DataTree) -> float:
    """Noise of one sample beside which residuals are shown, rad: that of the records."""
    return record_noise(tree)


def slow_noise_sentences(tree: xr.DataTree) -> list[str]:
    """That a part of the gap is slow noise of the sensor, where its noise is coloured."""
    noise, whole = noise_of(tree), float(tree["holdout"].residual_noise)
    if whole <= LOUD * noise:
        return []
    size = in_small_units(whole, signal_units(tree))
    return [
        f"The sensor's noise is coloured: with its slow part it is {size} a sample, "
        f"{times_noise(whole, noise)}."
    ]


def in_small_units(size: float, units: str) -> str:
    """What is small beside the signal as text: angles in mrad."""
    factor, unit = small_units(units)
    return f"{factor * size:.3g} {unit}"


def times_noise(residual: float, noise: float) -> str:
    """A residual over the noise as text."""
    return f"{residual / noise:.3g} times the noise"


def residual_sentences(tree: xr.DataTree, group: str) -> list[str]:
    """Where model and record differ, what the gap is made of, and what that means."""
    spans = tree[group].to_dataset()
    departure, parts = _departure(tree, spans), list(spans.attrs["parts"])
    if not parts:
        # Larger than the noise, but in no part that goes with the motion.
        return [departure, UNKNOWN] if np.isfinite(spans.departure_time) else [departure]
    most = "phase and amplitude" if set(parts[:2]) == {"phase", "amplitude"} else parts[0]
    return [
        departure,
        _sizes(spans, len(record_groups(tree)), signal_units(tree)),
        *_rates(spans, parts[0], signal_units(tree)),
        f"Most of the gap is in the {most}{WHERE.get(spans.attrs['where'], '')}.",
        *force_type_sentences(tree, group),
    ]


def force_type_sentences(tree: xr.DataTree, group: str) -> list[str]:
    """Which type of force the gap asks for, if it has a part that goes with the motion."""
    if not len(tree[group].attrs["parts"]):
        return []
    sentence = force_type_sentence(tree, -1 if group.endswith("after") else 0)
    return [sentence] if sentence else []


def _departure(tree: xr.DataTree, spans: xr.Dataset) -> str:
    start = spans.departure_time.item()
    if not np.isfinite(start):
        return "At no time does the gap by itself exceed the noise."
    groups, run = record_groups(tree), spans.departure_run.item()
    where = f" of run {run + 1}" if len(groups) > 1 else ""
    first = start <= float(tree[groups[run]].time.values[0])
    return f"The gap exceeds the noise from {'the first sample' if first else f'{start:.3g} s'}{where} on."


def _sizes(spans: xr.Dataset, runs: int, units: str) -> str:
    """Phase, amplitude and the rest of record minus model, where they are largest."""
    # The record's own: the model's may be far off.
    amplitude = float((spans.amplitude + spans.amplitude_error).max())
    slip = spans.phase_error.values
    at = int(np.argmax(np.abs(slip)))
    place = f"{spans.time.values[at]:.3g} s{f' of run {spans.run.values[at] + 1}' * (runs > 1)}"
    waves = {
        name: np.hypot(*(spans[f"{name}_{wave}"].values for wave in ("cosine", "sine")))
        for name in NAMED_HARMONICS
    }
    harmonics = [f"{name} harmonic {in_small_units(_most(size), units)}" for name, size in waves.items()]
    return (
        f"The record is up to {abs(slip[at]):.3g} rad {'ahead of' if slip[at] > 0.0 else 'behind'} the model "
        f"in phase (at {place}). Other largest differences: amplitude "
        f"{in_small_units(_most(spans.amplitude_error.values), units)} (of {amplitude:.3g} {units}), offset "
        f"{in_small_units(_most(spans.offset.values), units)}, {', '.join(harmonics)}."
    )


def _most(values: np.ndarray) -> float:
    return float(np.max(np.abs(values)))


def _rates(spans: xr.Dataset, part: str, units: str) -> list[str]:
    """Errors of frequency or decay at the largest and the smallest amplitude, if they differ."""
    if part not in ("phase", "amplitude") or spans.attrs["where"] not in WHERE:
        return []
    rate = spans.frequency_error if part == "phase" else spans.decay_error
    # Where the trend is with time, amplitudes say nothing.
    late = spans.attrs["where"] == "late times"
    order = spans.time.values if late else -spans.amplitude.values
    texts = []
    for end in (int(np.argmin(order)), int(np.argmax(order))):
        value = float(rate.values[end])
        # The record's own, where the model's has faded.
        amplitude = spans.amplitude.values[end] + spans.amplitude_error.values[end]
        where = f"{spans.time.values[end]:.3g} s" if late else f"{amplitude:.3g} {units}"
        size = f"{100.0 * abs(value):.2g} %" if part == "phase" else f"by {abs(value):.2g} w"
        texts.append((f"{size} {'faster' if value > 0.0 else 'slower'}", where))
    (first, here), (last, there) = texts
    verb = "swings" if part == "phase" else "decays"
    return [f"The record {verb} {first} than the model at {here}, and {last} at {there}."]
