"""A gap in words: how large, from when on, in phase or amplitude, and what makes such a one."""

import numpy as np
import xarray as xr

from sysid_trib.printing.force_types import force_type_sentence
from sysid_trib.results.per_run import record_groups

UNKNOWN = "what is left does not follow the motion: vibration from outside, or noise of another kind"
# Places that a sentence tells; a gap that is everywhere needs none.
WHERE = {
    "large amplitude": ", most at large amplitude",
    "small amplitude": ", most at small amplitude",
    "late times": ", growing with time",
}
HARMONICS = ("second", "third")


def residual_of(tree: xr.DataTree, model: str) -> float:
    """RMS of record minus model over all runs, rad."""
    left = [
        (tree[group].angle - tree[group].simulated_angle.sel(model=model)).values
        for group in record_groups(tree)
    ]
    return float(np.sqrt(np.mean(np.concatenate(left) ** 2)))


def noise_of(tree: xr.DataTree) -> float:
    """Noise of one sample, rad."""
    return float(tree["holdout"].noise.item())


def in_mrad(angle: float) -> str:
    """An angle (rad) as text."""
    return f"{1e3 * angle:.3g} mrad"


def times_noise(gap: float, noise: float) -> str:
    """A gap over the noise as text."""
    return f"{gap / noise:.3g} times the noise"


def residual_sentences(tree: xr.DataTree, group: str) -> list[str]:
    """Where a model leaves the record, what the gap is made of, and what that means."""
    found = tree[group].to_dataset()
    told = [_departure_told(tree, found)]
    parts = list(found.attrs["parts"])
    if not parts:
        # Beyond the noise, but in no part that goes with the motion.
        return [*told, f"{UNKNOWN.capitalize()}."] if np.isfinite(found.departure_time) else told
    told.append(f"{_sizes_told(found, len(record_groups(tree)))}.")
    if rates := _rates_told(found, parts[0]):
        told.append(rates)
    most = "phase and amplitude" if set(parts[:2]) == {"phase", "amplitude"} else parts[0]
    told.append(f"Most of it is {most}{WHERE.get(found.attrs['where'], '')}.")
    return [*told, *filter(None, [force_type_sentence(tree, -1 if group.endswith("after") else 0)])]


def _departure_told(tree: xr.DataTree, found: xr.Dataset) -> str:
    left = found.departure_time.item()
    if not np.isfinite(left):
        return "At no time does the gap stand out of the noise by itself."
    groups = record_groups(tree)
    run = found.departure_run.item()
    where = f" of run {run + 1}" if len(groups) > 1 else ""
    if left <= float(tree[groups[run]].time.values[0]):
        return f"The gap is beyond the noise from the first sample{where} on."
    return f"The gap is beyond the noise from {left:.3g} s{where} on."


def _sizes_told(found: xr.Dataset, runs: int) -> str:
    """How far phase, amplitude and the rest are off, where they are most."""
    # The record's own: the model's may be far off.
    amplitude = float((found.amplitude + found.amplitude_error).max())
    slip = found.phase_error.values
    at = int(np.argmax(np.abs(slip)))
    place = f"{found.time.values[at]:.3g} s{f' of run {found.run.values[at] + 1}' * (runs > 1)}"
    ahead = "ahead of" if slip[at] > 0.0 else "behind"
    texts = [
        f"In phase the record is up to {abs(slip[at]):.3g} rad {ahead} the model (at {place})",
        f"in amplitude up to {in_mrad(_most(found.amplitude_error.values))} off (of {amplitude:.3g} rad)",
        f"in offset {in_mrad(_most(found.offset.values))}",
    ]
    higher = [
        in_mrad(_most(np.hypot(found[f"{name}_cosine"].values, found[f"{name}_sine"].values)))
        for name in HARMONICS
    ]
    return ", ".join(texts) + f"; its second and third harmonics are {' and '.join(higher)} off"


def _most(values: np.ndarray) -> float:
    return float(np.max(np.abs(values)))


def _rates_told(found: xr.Dataset, part: str) -> str:
    """Errors of frequency or decay at the largest and the smallest amplitude, if they differ."""
    if part not in ("phase", "amplitude") or found.attrs["where"] not in WHERE:
        return ""
    rate = found.frequency_error if part == "phase" else found.decay_error
    # Where the trend is with time, amplitudes tell nothing.
    late = found.attrs["where"] == "late times"
    order = found.time.values if late else -found.amplitude.values
    texts = []
    for end in (int(np.argmin(order)), int(np.argmax(order))):
        value = float(rate.values[end])
        # The record's own, where the model's has faded.
        amplitude = found.amplitude.values[end] + found.amplitude_error.values[end]
        place = f"{found.time.values[end]:.3g} s" if late else f"{amplitude:.3g} rad"
        size = f"{100.0 * abs(value):.2g} %" if part == "phase" else f"by {abs(value):.2g} w"
        texts.append((f"{size} {'faster' if value > 0.0 else 'slower'}", place))
    (first, here), (last, there) = texts
    does = "swings" if part == "phase" else "decays"
    return f"The record {does} {first} than the model at {here}, and {last} at {there}."
