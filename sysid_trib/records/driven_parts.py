"""Parts of a driven record: without outliers, divided at gaps."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import xarray as xr
from scipy.interpolate import make_interp_spline

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.records import cleaning, half_periods
from sysid_trib.records.inputs import KnownInput, inputs_of, integral_of_rate, is_constant
from sysid_trib.records.roles import ROLE, input_label
from sysid_trib.records.saturation import refuse_saturated
from sysid_trib.records.signal import FEWEST_SAMPLES, LONGEST_FILLED, PARTED_STEP, usual_step

# Least number of samples and of periods of a part that is used.
FEWEST_IN_PART, SHORTEST_RUN = 20, 2.0
# If more steps than this fraction are long, the clock is uneven and no sample is missing.
MOST_GAPS = 0.1
# Degree of the spline through the available samples.
DEGREE = 7
# An input is smooth if its range exceeds this multiple of its noise; otherwise none of its samples is an
# outlier.
RANGE_OVER_NOISE = 15.0
# An outlier deviates from the cubic through its neighbours by at least this multiple of the deviation of any
# other sample.
LEAP = 3.0
# Number of samples at either end that have too few neighbours to be filled: a bad one is cut off.
AT_END = 4
# Largest number of outliers and gaps that a sentence lists.
MOST_SPELLED_OUT = 3


def driven_parts(
    record: xr.Dataset,
    window: tuple[float | None, float | None] = (None, None),
    *,
    keep_outliers: bool = False,
    across_gaps: bool = False,
    known_until: float = np.inf,
) -> list[xr.Dataset]:
    """Divide a driven record within a window at its gaps; each part states its changes (`free_decay`).

    Parameters
    ----------
    record : Dataset
        `angle(time)` with inputs; a record without inputs, or one that was divided before, is returned
        unchanged.
    window : (float or None, float or None), s
        First and last time; None leaves an end open.
    keep_outliers : bool
        Whether single samples that jump out of the signal, or of a smooth input, are kept.
    across_gaps : bool
        Whether the record is needed as one part: its inputs must then be known in the gaps as well.
    known_until : float, s
        Time from which the signal is predicted. The later samples change neither the earlier measured ones
        nor the times and inputs of the record.

    Returns
    -------
    list of Dataset
        Outliers, and gaps of a quarter of a period or less, are filled from the samples near them. A longer
        gap divides the record.

    Raises
    ------
    DecayError
        The window contains too few samples, the signal is flat or clipped by its sensor, or no part between
        gaps is long enough.
    UsageError
        An input is unknown in a gap.
    """
    if "free_decay" in record.attrs or not inputs_of(record):
        return [record]
    part = _own_quantity_at_samples(record).sel(time=slice(*window))
    if part.sizes["time"] < FEWEST_SAMPLES:
        raise DecayError(f"The window contains {part.sizes['time']} samples; give a longer one.")
    said: list[str] = []
    measured = _signal_names(part)[0]
    values = part[measured].values.astype(float)
    name, unit = _shown(part, measured), str(part[measured].attrs.get("units", ""))
    predicts = known_until < np.inf
    # A body at rest can be predicted.
    if np.nanmax(values) == np.nanmin(values) and not predicts:
        level = f"{values[0]:.6g} {unit}".strip()
        raise DecayError(f"The {name} is flat at {level}; choose another column, or leave this run out.")
    refuse_saturated(part.time.values.astype(float), values, name, unit)
    if not keep_outliers:
        part, said = _without_outliers(part, known_until)
    time = part.time.values.astype(float)
    known = time < known_until
    periods = half_periods.dominant_periods(time[known], part.angle.values.astype(float)[known])
    period = periods[0] if periods else float(np.ptp(time[known]))
    gaps = _gaps(time, period, np.atleast_1d(np.asarray(record.attrs.get("breaks", ()), dtype=float)))
    if across_gaps and gaps.size:
        missing = [str(name) for name, values in part.data_vars.items() if _is_at_samples(values)]
        if missing:
            raise UsageError(
                f"The input {input_label(record, missing[0])} is missing in a gap of the record "
                f"({_listed_gaps(time, gaps)}); "
                "predict a part without it (--window; record.sel(time=slice(...)) in Python)."
            )
        gaps = gaps[:0]
    bounds = [0, *gaps.tolist(), len(time)]
    pieces = [part.isel(time=slice(*ends)) for ends in pairwise(bounds)]
    lasting = SHORTEST_RUN * period if len(pieces) > 1 else 0.0
    fewest = FEWEST_IN_PART if len(pieces) > 1 else FEWEST_SAMPLES
    kept = [p for p in pieces if p.sizes["time"] >= fewest and np.ptp(p.time.values) >= lasting]
    if not kept:
        raise DecayError(
            f"Gaps divide this record ({_listed_gaps(time, gaps)}), and none of its "
            f"{len(pieces)} parts lasts "
            "for two periods; record it without them."
        )
    if len(pieces) > 1:
        used = "all" if len(kept) == len(pieces) else f"{len(kept)} of them"
        said.append(
            f"parted by {'a gap' if gaps.size == 1 else 'gaps'} ({_listed_gaps(time, gaps)}) into "
            f"{len(pieces)} parts, {used} used as runs"
        )
    whole = [_filled(piece, period) for piece in kept]
    return [_described(_own_quantity_apart(filled), [*said, *also]) for filled, also in whole]


# Names of the measured quantity of a driven record whose angle is its integral, and of its own times.
MEASURED_ITSELF, OWN_TIMES = "measured", "measured_time"


def _own_quantity_at_samples(record: xr.Dataset) -> xr.Dataset:
    """Put a measured rate or acceleration on the time axis of the record, like the angle."""
    own = record.get(MEASURED_ITSELF)
    if own is None or not np.array_equal(own.coords.get(OWN_TIMES, ()), record.time.values):
        return record
    return record.drop_dims(OWN_TIMES).assign({MEASURED_ITSELF: ("time", own.values, own.attrs)})


def _own_quantity_apart(part: xr.Dataset) -> xr.Dataset:
    """Put a measured rate or acceleration on a separate time axis."""
    own = part.get(MEASURED_ITSELF)
    if own is None or own.dims != ("time",):
        return part
    at = {OWN_TIMES: (OWN_TIMES, part.time.values.astype(float), {"units": "s", "long_name": "time"})}
    return part.drop_vars(MEASURED_ITSELF).assign(
        {MEASURED_ITSELF: xr.DataArray(own.values, at, OWN_TIMES, attrs=own.attrs)}
    )


def _signal_names(record: xr.Dataset) -> list[str]:
    """Return the names of the measured quantities: the rate or acceleration itself, if it is compared."""
    if MEASURED_ITSELF in record:
        return [MEASURED_ITSELF]
    return [str(name) for name in ("angle", record.attrs.get("measured")) if name in record]


def _shown(record: xr.Dataset, name: str) -> str:
    """Return the name of a variable in a sentence: its own name for a measured rate or acceleration."""
    return str(record.attrs.get("measured", name)) if name == MEASURED_ITSELF else name


def _without_outliers(record: xr.Dataset, known_until: float) -> tuple[xr.Dataset, list[str]]:
    """Fill the outliers of a record from the samples near them, and report it."""
    record, said = _without_bad_ends(record, known_until)
    inputs = inputs_of(record)
    for name in (*_signal_names(record), *inputs):
        known = inputs.get(name)
        values = record[name]
        own = values[values.dims[0]].values.astype(float)
        numbers = values.values.astype(float)
        if known is not None and not _is_smooth(own, numbers, known):
            continue
        pieces = [slice(None)] if known is not None else _known_apart(own, known_until)
        bad_in = [_significant(own[at], numbers[at], _outliers(own[at], numbers[at])) for at in pieces]
        bad = np.concatenate([np.arange(own.size)[at][of] for at, of in zip(pieces, bad_in, strict=True)])
        if not bad.size:
            continue
        mended_in = [
            _mended(own[at], numbers[at], of) if of.size else numbers[at]
            for at, of in zip(pieces, bad_in, strict=True)
        ]
        mended = np.concatenate(mended_in)
        record = record.assign({name: (values.dims, mended, values.attrs)})
        if name == MEASURED_ITSELF and record.attrs.get("measured") == "rate":
            record = record.assign(angle=record.angle.copy(data=integral_of_rate(own, mended)))
        listed = ", ".join(f"{numbers[at]:.4g} at {own[at]:.6g} s" for at in bad[:MOST_SPELLED_OUT])
        more = ", ..." if bad.size > MOST_SPELLED_OUT else ""
        count = "1 outlier" if bad.size == 1 else f"{bad.size} outliers"
        said.append(
            f"{count} of {_shown(record, name)} left out and filled from the samples near ({listed}{more}; "
            "--keep-outliers keeps them)"
        )
    return record, said


def _known_apart(time: Array, known_until: float) -> list[slice]:
    """Return the samples of a signal before and after the time from which it is predicted."""
    count = int(np.searchsorted(time, known_until))
    return [slice(count), slice(count, None)] if 0 < count < time.size else [slice(None)]


def _without_bad_ends(record: xr.Dataset, known_until: float) -> tuple[xr.Dataset, list[str]]:
    """Cut off the first or last samples if one of them jumps, and report it."""
    time, count = record.time.values.astype(float), record.sizes["time"]
    low, high, said = 0, count, list[str]()
    inputs = inputs_of(record)
    for name in (*_signal_names(record)[:1], *(name for name in inputs if _is_at_samples(record[name]))):
        values = record[name].values.astype(float)
        if name in inputs and not _is_smooth(time, values, inputs[name]):
            continue
        searched = slice(None) if name in inputs else _known_apart(time, known_until)[0]
        spikes = cleaning.spikes(time[searched], values[searched])
        if np.any(spikes < AT_END):
            low, said = (
                AT_END,
                [*said, f"the first {AT_END} samples cut off, because one of {_shown(record, name)} jumps"],
            )
        if np.any(spikes >= count - AT_END):
            high = count - AT_END
            said.append(f"the last {AT_END} samples cut off, because one of {_shown(record, name)} jumps")
    return record.isel(time=slice(low, high)), said


def _outliers(time: Array, values: Array) -> Index:
    """Find single samples that jump out of a signal whose frequency may change."""
    if time.size < FEWEST_IN_PART:
        return np.zeros(0, dtype=np.int64)
    spikes = cleaning.spikes(time, values)
    calm = np.delete(np.arange(time.size), spikes)
    # Use as many knots as the samples allow: a driven motion can be faster than its period suggests.
    shortest = cleaning.KNOTS * cleaning.SAMPLES_PER_INTERVAL * usual_step(np.diff(time))
    both = np.union1d(spikes, calm[cleaning.outliers(time[calm], values[calm], shortest)]).astype(np.int64)
    return both[(both >= AT_END) & (both < time.size - AT_END)]


def _is_smooth(time: Array, values: Array, known: KnownInput) -> bool:
    """Return true if an input changes smoothly most of the time: no noise, no pulses, no steps."""
    reach = float(np.ptp(np.percentile(values, [10.0, 90.0])))
    followed = known.between in ("smooth", "cubic")
    return followed and reach > RANGE_OVER_NOISE * half_periods.noise_level(time, values)


def _significant(time: Array, values: Array, bad: Index) -> Index:
    """Return the outliers whose deviation from their neighbours is far larger than any other sample's.

    With stick-slip motion, with a kinked input or with poor resolution, all samples deviate.
    """
    for _ in range(2):
        if not bad.size:
            break
        mended = _mended(time, values, bad)
        usual = float(np.max(np.abs(np.diff(mended, 4)))) / 6.0
        bad = bad[np.abs(values - mended)[bad] > LEAP * usual]
    return bad


def _mended(time: Array, values: Array, bad: Index) -> Array:
    """Fill bad values from the samples near them."""
    good = np.delete(np.arange(time.size), bad)
    mended = values.copy()
    mended[bad] = _between(time[good], values[good], time[bad])
    return mended


def _between(time: Array, values: Array, wanted: Array) -> Array:
    degree = DEGREE if time.size > DEGREE else 1
    return np.asarray(make_interp_spline(time, values, degree)(wanted))


def _gaps(time: Array, period: float, breaks: Array) -> Index:
    """Find the samples after a gap longer than a quarter of a period, or after a clock set back."""
    steps = np.diff(time)
    usual = usual_step(steps)
    long = np.flatnonzero(steps > max(LONGEST_FILLED * period, PARTED_STEP * usual)) + 1
    if long.size > MOST_GAPS * time.size:
        long = long[:0]
    inside = breaks[(breaks > time[0]) & (breaks <= time[-1])]
    return np.union1d(long, np.searchsorted(time, inside)).astype(np.int64)


def _listed_gaps(time: Array, gaps: Index) -> str:
    listed = ", ".join(f"{time[at - 1]:.6g} to {time[at]:.6g} s" for at in gaps[:MOST_SPELLED_OUT])
    return listed + ", ..." * (gaps.size > MOST_SPELLED_OUT)


def _is_at_samples(values: xr.DataArray) -> bool:
    """Return true if a variable is an input on the time axis of the record itself."""
    return values.attrs.get("role") == ROLE and values.dims == ("time",)


def _filled(record: xr.Dataset, period: float) -> tuple[xr.Dataset, list[str]]:
    """Fill the few missing samples within a part, and report it."""
    time = record.time.values.astype(float)
    steps = np.diff(time)
    usual = usual_step(steps)
    long = np.flatnonzero((steps > PARTED_STEP * usual) & (steps <= LONGEST_FILLED * period))
    if not 0 < long.size <= MOST_GAPS * time.size:
        return record, []
    counts = np.round(steps[long] / usual).astype(int)
    made = [np.linspace(time[at], time[at + 1], n + 1)[1:-1] for at, n in zip(long, counts, strict=True)]
    new = np.concatenate(made)
    if not new.size:
        return record, []
    whole = np.union1d(time, new)
    known = inputs_of(record)
    changed = {}
    for key, values in record.data_vars.items():
        name = str(key)
        if values.dims != ("time",) or values.dtype.kind not in "fiu":
            continue
        # A measured sample stays unchanged.
        given = values.values.astype(float)
        between = known[name].of(new - time[0]) if name in known else _between(time, given, new)
        filled = np.empty(whole.size)
        filled[np.searchsorted(whole, time)], filled[np.searchsorted(whole, new)] = given, between
        changed[name] = (("time",), filled, values.attrs)
    rest = record.drop_dims("time").assign_attrs(record.attrs)
    made_whole = rest.assign(changed).assign_coords(time=("time", whole, record.time.attrs))
    count = "1 missing sample" if new.size == 1 else f"{new.size} missing samples"
    return made_whole, [f"{count} filled from the samples near"]


def _described(record: xr.Dataset, said: Sequence[str]) -> xr.Dataset:
    """Add to a part the sentence on its changes."""
    time, known = record.time.values, inputs_of(record)
    units, kinds = list[str](), dict[str, list[str]]()
    for name, given in known.items():
        kinds.setdefault(given.between, []).append(name)
        constant = [f"constant at {given.values[0]:g}"] if is_constant(given.values) else []
        units.append(input_label(record, name, record[name].attrs.get("units", "unit not stated"), *constant))
    step = float(np.median(np.diff(time)))
    between = " and ".join(kinds)
    if len(kinds) > 1:
        between = "; ".join(f"{', '.join(names)} {word}" for word, names in kinds.items())
    text = (
        f"Driven record: {time[0]:.6g} s to {time[-1]:.6g} s ({len(time)} samples, {step:.4g} s apart); "
        f"inputs {', '.join(units)}{'; ' if len(kinds) > 1 else ', '}{between} between samples"
    )
    return record.assign_attrs(free_decay="; ".join([text, *said]) + ".")
