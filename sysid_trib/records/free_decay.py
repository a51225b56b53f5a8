"""The free decays within a record: from the release to the stop, about their equilibrium."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.records import cleaning, free_motion_checks as checks, half_periods, modes, no_decay
from sysid_trib.records.decay import decay_dataset, free_part, short_decay
from sysid_trib.records.equilibrium import Swing, find_swing
from sysid_trib.records.in_memory import one_record
from sysid_trib.records.integration import Piece, uniform_pieces
from sysid_trib.records.no_decay import NoDecay, NoDecayError
from sysid_trib.records.runs import RecordLike
from sysid_trib.records.signal import checked_signal
from sysid_trib.records.unwrapping import new_frames, pulses

# In any unit; the squares of smaller numbers underflow.
SMALLEST_SWING = 1e-150
# A record of a decay has at least this number of samples.
FEWEST_OF_A_DECAY = 20
# The rest of a record is searched for another decay if it has this fraction of the first amplitude, the same
# period, and several periods.
SMALLEST_FURTHER = 0.2


def free_decay(
    record: RecordLike,
    *,
    window: tuple[float | None, float | None] = (None, None),
    equilibrium: float | str = "auto",
    keep_outliers: bool = False,
) -> xr.Dataset:
    """Cut a record to its free decay and centre it on its equilibrium.

    If a record has several decays, this is the one with the longest travel; `free_decays` gives all.

    Parameters
    ----------
    record : Dataset, DataArray, pandas Series or DataFrame, dict, (t, angle), or (sample, 2) array
        Record with ``angle(time)``; times in s, or dates.
    window : s
        Times between which decays are searched; None for an end of the record.
    equilibrium : in the unit of the angle, or "auto"
        ``auto``: the robust mean of (b[i-1] + 2 b[i] + b[i+1])/4 over signed extrema. It is not the rest
        position, which dry friction may put anywhere in the stick band.
    keep_outliers : bool
        Whether single samples that jump out of the swing and back are kept.

    Returns
    -------
    Dataset
        The record from the release to the stop, with centred ``angle`` and times unchanged if they are
        uniform within 2 %. Scalars: ``equilibrium`` and ``equilibrium_standard_error`` (nan if given), and
        ``stop_time`` for a final stop. Attribute ``free_decay``: a sentence on the samples cut or mended. No
        sample is cut from a record that is free from its first sample on.

    Raises
    ------
    UsageError
        The window is not an interval.
    DecayError
        The record has fewer than three periods, or it is flat, only noise, not decaying, growing, clipped, or
        pulsed.

    Examples
    --------
    A hand holds the pendulum for two seconds, and the sensor's zero is off by 0.1 rad.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> swing = st.records.paper_twin()
    >>> angle = np.concatenate([np.full(200, 0.3), swing.angle]) + 0.1
    >>> decay = st.free_decay((np.arange(angle.size) / 100.0, angle))
    >>> round(decay.time.values[0].item(), 2), round(decay.equilibrium.item(), 3)
    (2.34, 0.1)
    """
    decays = free_decays(record, window=window, equilibrium=equilibrium, keep_outliers=keep_outliers)
    longest = max(decays, key=lambda decay: float(np.abs(np.diff(decay.angle.values)).sum()))
    if len(decays) > 1:
        others = f" It is the decay of the longest travel among {len(decays)}; free_decays gives all."
        longest.attrs["free_decay"] += others
    return longest


def free_decays(
    record: RecordLike,
    *,
    window: tuple[float | None, float | None] = (None, None),
    equilibrium: float | str = "auto",
    keep_outliers: bool = False,
    as_it_is: bool = False,
) -> list[xr.Dataset]:
    """Return every free decay of a record, in order: divided by gaps, by hands, or by a new release.

    Parameters
    ----------
    record : Dataset, DataArray, pandas Series or DataFrame, or (sample, 2) array
        Record with ``angle(time)`` (see `as_record`).
    window : (float, float), s
        Times between which decays are searched; None for an end of the record.
    equilibrium : float, or "auto"
        Equilibrium, as in `free_decay`.
    keep_outliers : bool
        Whether single samples that jump out of the swing and back are kept.
    as_it_is : bool
        Whether a motion that is too short, too damped or growing for a proven free decay is used as a whole,
        about the constant of the best damped sine. This is for known forces.

    Returns
    -------
    list of Dataset
        Each decay in the form of `free_decay`.

    Raises
    ------
    UsageError, DecayError
        As in `free_decay`.

    Examples
    --------
    The pendulum is released, caught, held for a second, and released again.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> swing, hold = st.records.paper_twin().angle.values[:1500], np.full(100, 0.3)
    >>> angle = np.concatenate([swing, hold, swing])
    >>> decays = st.records.free_decays((np.arange(angle.size) / 100.0, angle))
    >>> [round(decay.time.values[0].item()) for decay in decays]
    [0, 16]
    """
    record = one_record(record, "free_decay")
    checked_signal(record, *filter(None, [getattr(record, "attrs", {}).get("measured")]))
    source = str(record.attrs.get("source", "record"))
    inside = _in_window(record, window, source)
    # A measured rate or acceleration shows the swing best, because its noise is white.
    measured = inside[inside.attrs.get("measured", "angle")]
    time = inside["time"].to_numpy().astype(float)
    angle = measured.to_numpy().astype(float)
    if np.ptp(angle) <= max(1e-12 * np.max(np.abs(angle)), SMALLEST_SWING):
        raise DecayError(f"{source}: the angle is flat at {angle[0]:.6g}; choose another column or window.")
    value = None if equilibrium == "auto" else _given(equilibrium)
    if value is not None and measured.name != "angle":
        raise UsageError(f"{source}: the equilibrium of an integrated angle cannot be given; leave it out.")
    if value is not None and not angle.min() < value < angle.max():
        reach = f"{angle.min():.4g} to {angle.max():.4g} {inside['angle'].attrs.get('units', 'rad')}"
        wrong = f"{source}: an equilibrium of {value:g} is outside of the record, which runs from {reach}"
        raise DecayError(f"{wrong}; correct it, or let it be found (auto).")
    breaks = np.atleast_1d(np.asarray(record.attrs.get("breaks", ()), dtype=float))
    pieces, said = _pieces(time, angle, keep_outliers, breaks)
    refused = ""
    try:
        decays = _decays_of(pieces, value, source)
    except NoDecayError as refusal:
        if not as_it_is:
            raise
        longest = max(pieces, key=lambda piece: piece[0].size)
        decays = [short_decay(longest, value, refusal)]
        refused = refusal.reason.what
        said.append(f"used uncut, because you named the forces; it is no complete free decay ({refused})")
    if len(pieces) > 1:
        said.append(f"gaps part the record into {len(pieces)} pieces, {len(decays)} of them decays")
    datasets = [decay_dataset(inside, decay, "; ".join(said)) for decay in decays]
    return [decay.assign_attrs(taken_as_it_is=refused) for decay in datasets] if refused else datasets


def _pieces(
    time: Array, angle: Array, keep_outliers: bool = False, breaks: Array | tuple[()] = ()
) -> tuple[list[Piece], list[str]]:
    """Return pieces of the kept samples on a uniform clock, and sentences on the other samples."""
    kept, said = _kept_samples(time, angle, keep_outliers)
    time = time[kept]
    angle = angle[kept]
    periods = half_periods.dominant_periods(time, angle)
    period = periods[0] if periods else float(time[-1] - time[0])
    return uniform_pieces(time, angle, period, tuple(breaks)), said


def _kept_samples(time: Array, angle: Array, keep_outliers: bool) -> tuple[Index, list[str]]:
    """Return the indices of the kept samples, and sentences on the others."""
    kept = np.arange(time.size)
    said = []
    frames = new_frames(angle)
    if frames is not None:
        kept = frames
        said.append(f"values are held over rows: the {frames.size} new ones of {time.size} are used")
    if keep_outliers:
        return kept, said
    calm = np.delete(kept, cleaning.spikes(time[kept], angle[kept]))
    if periods := half_periods.dominant_periods(time[calm], angle[calm]):
        calm = np.delete(calm, cleaning.outliers(time[calm], angle[calm], periods[0]))
    left_out = np.setdiff1d(kept, calm)
    if left_out.size:
        listed = ", ".join(f"{angle[at]:.4g} at {time[at]:.6g} s" for at in left_out[:3])
        more = ", ..." if left_out.size > 3 else ""
        count = "1 outlier" if left_out.size == 1 else f"{left_out.size} outliers"
        said.append(f"{count} left out ({listed}{more}; --keep-outliers keeps them)")
    return calm, said


def _decays_of(pieces: list[Piece], value: float | None, source: str) -> list[Swing]:
    """Return the decays of all pieces; without a decay, raise the reason for the longest piece."""
    longest = max(pieces, key=lambda piece: piece[0].size)
    waiting = [longest, *(piece for piece in pieces if piece is not longest)]
    decays: list[Swing] = []
    refusals: list[NoDecayError] = []
    while waiting and len(decays) < 60:
        piece = waiting.pop(0)
        if piece is not longest and not _may_hold_another(*piece[:2], decays):
            continue
        try:
            swing = _swing(*piece, value, source)
        except NoDecayError as refusal:
            refusals.append(refusal)
            continue
        decay, reason = _free(swing, source)
        if parts := _without_wrong_swings(swing, decay):
            longest = max(parts, key=lambda part: part[0].size) if piece is longest else longest
            waiting = [*parts, *waiting]
            continue
        if decay is None:
            refusals.extend([reason] if reason else [])
            continue
        if decays and (not _alike(decay, decays[0]) or checks.is_held(decay, decays[0])):
            continue
        decays.append(decay)
        # Search after the decay and before it.
        ends = slice(decay.free.stop, None), slice(decay.free.start)
        waiting = [*(Piece(decay.time[end], decay.signal[end], decay.mended) for end in ends), *waiting]
    if not decays:
        raise _naming_modes(refusals[0], longest, source)
    return sorted(decays, key=lambda decay: decay.time[decay.free.start])


def _naming_modes(refusal: NoDecayError, piece: Piece, source: str) -> NoDecayError:
    """Add the frequencies of simultaneous modes to an error, if there are several."""
    several = modes.modes(*piece[:2]) if refusal.reason.cause in no_decay.MAYBE_OF_MODES else []
    if len(several) < 2:
        return refusal
    return NoDecayError(source, no_decay.several_modes(modes.listed(several), refusal.reason))


def _may_hold_another(time: Array, signal: Array, decays: list[Swing]) -> bool:
    """Return true if a piece is long enough, and moves far enough, for a decay like the first one."""
    if time.size < FEWEST_OF_A_DECAY or not decays:
        return time.size >= FEWEST_OF_A_DECAY
    period = decays[0].oscillation.period
    far = np.ptp(signal) >= SMALLEST_FURTHER * np.ptp(decays[0].signal)
    return bool(far and time[-1] - time[0] >= 4.0 * period)


def _alike(swing: Swing, first: Swing) -> bool:
    alike = abs(swing.oscillation.period / first.oscillation.period - 1.0) < 0.25
    return bool(alike and swing.peaks.max() > SMALLEST_FURTHER * first.peaks.max())


def _swing(time: Array, signal: Array, mended: str, value: float | None, source: str) -> Swing:
    """Return the swing of a piece after its clipped part; raise the reason if it has none."""
    if pulses(signal):
        raise NoDecayError(source, no_decay.pulses())
    swing = find_swing(time, signal, value)
    if swing is None:
        raise NoDecayError(source, no_decay.no_oscillation())
    first, clipped = checks.end_of_clipping(swing, source)
    if first:
        mended = "; ".join(text for text in (mended, clipped) if text)
        return _swing(time[first:], signal[first:], mended, value, source)
    return replace(swing, mended=mended)


def _free(swing: Swing, source: str) -> tuple[Swing | None, NoDecayError | None]:
    """Return the free part of a swing, or the reason why it has none."""
    try:
        return free_part(checks.after_the_largest(checks.after_the_drive(swing), source)), None
    except NoDecayError as refusal:
        return None, refusal


def _without_wrong_swings(swing: Swing, decay: Swing | None) -> list[Piece]:
    """Return the parts of a piece between half periods that its sensor shows wrongly.

    The result is empty if there are none, or if a decay can be found from its start on despite them.
    """
    if decay is not None and decay.run.start == swing.run.start:
        return []
    wrong = checks.wrong_swings(swing)
    if not wrong.size or (decay is not None and decay.run.start not in wrong):
        return []
    first, stop = swing.halves.samples(swing.time)
    left_out = np.zeros(swing.time.size, dtype=bool)
    for half in wrong:
        left_out[first[half] : stop[half]] = True
    listed = ", ".join(f"{swing.halves.crossing[half]:.4g}" for half in wrong[:3])
    more = ", ..." if wrong.size > 3 else ""
    said = (
        f"{wrong.size} half period{'s' * (wrong.size > 1)} left out, from {listed}{more} s, whose amplitude "
        "differs from those before and after, like an error of a tracker"
    )
    bounds = np.flatnonzero(np.diff(left_out)) + 1
    parts = [part for part in np.split(np.arange(swing.time.size), bounds) if not left_out[part[0]]]
    # Use the reason of the part that most resembles a decay.
    longest = max(range(len(parts)), key=lambda at: parts[at].size)
    mended = [swing.mended] * len(parts)
    mended[longest] = "; ".join(text for text in (swing.mended, said) if text)
    pairs = zip(parts, mended, strict=True)
    return [Piece(swing.time[part], swing.signal[part], text) for part, text in pairs]


def swing_within(time: Array, signal: Array) -> Swing | NoDecay:
    """Return the swing of a signal if it is a free decay, else the reason; in any unit and time.

    Parameters
    ----------
    time : (sample,) array of float
        Increasing times.
    signal : (sample,) array of float
    """
    if signal.size < FEWEST_OF_A_DECAY:
        return no_decay.few_samples(signal.size, FEWEST_OF_A_DECAY)
    if np.ptp(signal) <= max(1e-12 * np.max(np.abs(signal)), SMALLEST_SWING):
        return no_decay.still()
    try:
        swings = _decays_of(_pieces(time, signal)[0], None, "")
    except NoDecayError as error:
        return error.reason
    return max(swings, key=lambda swing: float(swing.peaks.sum()))


def _given(equilibrium: float | str) -> float:
    with suppress(ValueError):
        if np.isfinite(value := float(equilibrium)):
            return value
    raise UsageError(f"equilibrium {equilibrium!r}: give a number, or auto.")


def _in_window(record: xr.Dataset, window: tuple[float | None, float | None], source: str) -> xr.Dataset:
    start = -np.inf if window[0] is None else float(window[0])
    stop = np.inf if window[1] is None else float(window[1])
    if not start < stop:
        raise UsageError(f"window {window[0]}:{window[1]}: its start must come before its end.")
    time = record["time"].to_numpy()
    inside = record.sel(time=slice(start, stop))
    if (count := inside.sizes["time"]) < FEWEST_OF_A_DECAY:
        asked = ":".join("" if end is None else f"{end:g}" for end in window)
        where = f"the window {asked} (the record runs from {time[0]:g} s to {time[-1]:g} s); widen it."
        if window == (None, None):
            where = f"{np.ptp(time):.3g} s, too short for a decay; record longer."
        raise DecayError(f"{source}: only {count} sample{'s' * (count != 1)} in {where}")
    return inside
