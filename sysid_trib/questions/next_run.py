"""Next run: release and duration that separate competing models, or give a wanted error."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, TypeAlias

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import DecayError, SysidTribError, Tell, UsageError, silent
from sysid_trib.questions import rivals as models
from sysid_trib.questions.rivals import ODDS, Rival, RunPrediction, predicted, rivals_of
from sysid_trib.results import judged, kinds, signal_scale
from sysid_trib.results.random_force import random_force_of
from sysid_trib.results.variables import PER_FORCE_UNIT, described, record_groups, signal_units, variable
from sysid_trib.simulation.model import Model
from sysid_trib.validation import holdout

Span: TypeAlias = tuple[float | None, float | None]
# Numbers of releases and durations tried between the limits, in equal ratios.
RELEASES, DURATIONS = 7, 4
# Default limits: these multiples of the release and the duration of the record.
AMPLITUDE_LIMITS, DURATION_LIMITS = (0.3, 1.5), (0.5, 2.0)
# Largest number of samples of a run in the design: the information increases equally for all runs.
MOST_SAMPLES_PLANNED = 4000


def plan(
    result: xr.Dataset | xr.DataTree,
    *,
    amplitude: Span = (None, None),
    duration: Span = (None, None),
    sampling_rate: float | None = None,
    repeats: int = 1,
    wanted: Mapping[str, float] | None = None,
    tell: Tell = silent,
) -> xr.Dataset:
    """Rank possible next runs by their expected information.

    Parameters
    ----------
    result : Dataset or DataTree
        Result of `identify`, or of `discover`, whose last effect may be any member of its credible set.
    amplitude, duration : (float, float)
        Limits of the release (in the unit of the record) and of the recorded duration (s); None means 0.3 and
        1.5 times the record's release, and half and twice its duration.
    sampling_rate : float, Hz
        Sampling rate of the next run; by default that of the record.
    repeats : int
        Number of repeats of each run.
    wanted : mapping of str to float
        Wanted standard errors, `{"delta": 0.0005}`.
    tell : callable
        Called with each release.

    Returns
    -------
    Dataset
        Over `run`, the best first: `amplitude`, `duration` (s; at most that of the motion), `samples`;
        expected `entropy` of the models (nats; 0 for one model) and the `probability` that the true model has
        odds of 10 against each other; `standard_error(run, force)` of the coefficients that are not held,
        from all records together, including the error of the model, and whether the run `meets` the wanted
        errors (nan if none is wanted). Over `force` also the `stated_error` of the result and its part
        `error_of_model`. `parting(time)` of the best run: expected log likelihood ratio of its two most
        likely `models` up to each time. Attributes: `models` with their `probabilities`, `sampling_rate`,
        `repeats`.

    Raises
    ------
    UsageError
        The records are driven, nothing was identified, the result gives no limits, or a wanted error is for a
        coefficient that is held or not in the model.
    DecayError
        No run within the limits has a motion.

    Notes
    -----
    Each model predicts a run to first order: its motion with the uncertainty of its coefficients, shapes and
    frequency, an unknown start, an unknown zero of the sensor, and the noise. The next run has the random
    force of the record. Runs are drawn from the predictions of each model, taken as true with its present
    probability (Box and Hill 1967). The evidence of a model then changes as in `discover`: by r' V^-1 r, with
    r the difference from its motion and V the covariance of its prediction, and by the information on its
    shapes. Its odds are those after all records. Only the part of a run that a search fits is used: without
    the last third if this is held out. Errors follow from the inverse of the sum of the Fisher informations
    of all runs.

    Examples
    --------
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin())
    >>> runs = st.plan(result, amplitude=(0.2, 0.6), duration=(10.0, 20.0), wanted={"epsilon": 0.002})
    >>> best = runs.isel(run=0)
    >>> best.amplitude.round(2).item(), best.duration.round(1).item(), bool(best.meets)
    (0.6, 10.0, True)
    """
    if isinstance(result, xr.DataTree) and kinds.is_of_driven(result):
        raise UsageError("plan is for free decays; the records of this result are driven.")
    wanted, unit = dict(wanted or {}), signal_units(result)
    given = {
        "release": variable("end", np.array(amplitude, dtype=float), "limits of the release", unit),
        "wanted": variable("force", [*map(float, wanted.values())], "wanted errors", PER_FORCE_UNIT),
    }
    asked = xr.Dataset(given, {"force": [*wanted]})
    planned = _planned(result, asked, duration, sampling_rate, repeats, tell)
    return _with_known_errors(planned, judged.best(result), wanted)


def _with_known_errors(planned: xr.Dataset, main: xr.Dataset, wanted: Mapping[str, float]) -> xr.Dataset:
    """Add to a plan the wanted errors, and those from the records of the result."""
    symbols = planned.force.values.tolist()
    known = main.sel(force=symbols)
    values = {
        "wanted": [wanted.get(symbol, np.nan) for symbol in symbols],
        "stated_error": known.standard_error.values,
        "error_of_model": judged.error_parts(known)[1],
    }
    with_units = planned.assign_coords(unit=("force", known.unit.values))
    return with_units.assign(described("plan", values))


@signal_scale.in_units_of_the_motion
def _planned(
    result: xr.Dataset | xr.DataTree,
    asked: xr.Dataset,
    duration: Span,
    sampling_rate: float | None,
    repeats: int,
    tell: Tell,
) -> xr.Dataset:
    """Compute `plan` with the limits of releases and wanted errors of the scaled motion."""
    main, rivals, known = rivals_of(result)
    wanted = dict(zip(asked.force.values.tolist(), asked.wanted.values.tolist(), strict=True))
    _check_wanted(wanted, known, [rival.name for rival in rivals])
    release, length, kept, measured = _first_record(result)
    low, high = (None if np.isnan(end) else end for end in asked.release.values.tolist())
    releases = _between((low, high), AMPLITUDE_LIMITS, release, RELEASES, "amplitude")
    durations = _between(duration, DURATION_LIMITS, length, DURATIONS, "duration")
    rate = measured if sampling_rate is None else sampling_rate
    if rate <= 0.0:
        raise UsageError(f"The sampling rate {rate:g} Hz must be positive.")
    if np.isnan(rate):
        raise UsageError("The result keeps no record; give the sampling rate of the next run.")
    if np.isnan(kept):
        kept = measured = rate
    # The information increases with the sampling rate, because the noise is white, and with the repeats.
    every = int(durations[-1] * kept) // MOST_SAMPLES_PLANNED + 1
    noise = float(np.ravel(main.noise)[0]) * np.sqrt(measured / rate / repeats / every)
    push = random_force_of(main).per_tau(known.model.reference_frequency) / repeats / noise**2
    in_part = "holdout_given" in result and not result["holdout_given"]
    rows, motions_of = list[dict[str, Any]](), list[tuple[dict[str, RunPrediction], Array]]()
    for at, release in enumerate(releases):
        tell(f"release {at + 1} of {len(releases)}", at / len(releases))
        given = (release, 0.0), noise, (known.model, push)
        # The motion may stop in the held-out part.
        stated, stop = _longest(known, [_times(end, kept, every) for end in durations], given)
        lengths = np.unique(np.minimum(durations, stop))
        times = [_times(end, kept, every, in_part=in_part) for end in lengths]
        motions = {rival.name: _longest(rival, times, given)[0] for rival in rivals if rival is not known}
        motions[known.name] = stated
        for length, time in zip(lengths, times, strict=True):
            moving = {name: run for name, run in motions.items() if run is not None and len(run) >= len(time)}
            of_run = {name: run[: len(time)] for name, run in moving.items()}
            rows.append({"amplitude": release, "duration": length, **_worth(rivals, known, main, of_run)})
            motions_of.append((of_run, time))
    values = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    if not np.isfinite(values["entropy"]).any():
        raise DecayError("No run within these limits has a motion; take others.")
    limits = np.array([wanted.get(symbol, np.inf) for symbol in known.fitted])
    values |= {"meets": np.all(values["standard_error"] <= limits, axis=1)}
    values |= {"samples": (values["duration"] * rate).astype(int) + 1}
    best = _best_first(values, limits, len(rivals))
    ranked = {name: column[best] for name, column in values.items()}
    data = xr.Dataset(described("plan", ranked), {"force": known.fitted})
    data.amplitude.attrs["units"] = signal_units(main)
    data.attrs = {
        "models": [rival.name for rival in rivals],
        "probabilities": [rival.probability for rival in rivals],
        "odds": ODDS,
        "sampling_rate": rate,
        "repeats": repeats,
    }
    return data if len(rivals) == 1 else _with_parting(data, rivals, *motions_of[best[0]])


def _check_wanted(wanted: Mapping[str, float], known: Rival, names: Sequence[str]) -> None:
    """Raise an error for a wanted error that is not positive, or of a parameter that is fixed or unknown."""
    if not known.fitted:
        raise UsageError("All coefficients of this model are fixed: no run changes an error.")
    for symbol, error in wanted.items():
        if symbol in names and symbol not in known.model.coefficients:
            raise UsageError(
                f"'{symbol}' competes with '{known.name}', which is in this model: give the wanted error of "
                f"{known.name}, or first plan the run that separates them (no --want)."
            )
        if symbol not in known.model.coefficients:
            there = ", ".join(known.fitted)
            raise UsageError(f"There is no coefficient '{symbol}' in this model, which has {there}.")
        if symbol not in known.fitted:
            raise UsageError(f"The coefficient '{symbol}' is fixed in this model: no run changes its error.")
        if not error > 0.0:
            raise UsageError(f"The wanted error of '{symbol}', {error:g}, must be positive.")


def _first_record(result: xr.Dataset | xr.DataTree) -> tuple[float, float, float, float]:
    """Release, duration (s), and kept and measured samples per second; nan if none is kept."""
    if not isinstance(result, xr.DataTree) or (group := record_groups(result)[0]) not in result.children:
        return (np.nan,) * 4
    record = result[group]
    time = record.time.values
    window = np.asarray(record.attrs.get("kept_window", time[[0, -1]]))
    rate = 1.0 / float(np.median(np.diff(time)))
    release = float(np.abs(record.angle).max())
    return release, float(window[-1] - window[0]), rate, rate * float(record.attrs.get("decimation", 1.0))


def _between(limits: Span, parts: tuple[float, float], known: float, count: int, name: str) -> Array:
    """Return values in equal ratios between limits; missing limits follow from the record."""
    low, high = (part * known if end is None else end for end, part in zip(limits, parts, strict=True))
    if not 0.0 < low <= high:
        raise UsageError(f"Give limits of {name}, LOW:HIGH, both above zero and the lower one first.")
    return np.geomspace(low, high, count if high > low else 1)


def _times(length: float, rate: float, every: int, *, in_part: bool = False) -> Array:
    """Return the times of a run; if a search holds out its last third, of the first two thirds."""
    time = np.arange(0, int(length * rate) + 1, every) / rate
    return time[: holdout.first_held_out(time) if in_part else None]


def _longest(
    rival: Rival, times: Sequence[Array], given: tuple[tuple[float, float], float, tuple[Model, float]]
) -> tuple[RunPrediction | None, float]:
    """Predict a rival's longest run and return its stop time (s).

    After the stop nothing is fitted; the stop time is infinite if the motion does not stop. Without a motion
    the prediction is None. `given` : further arguments of `predicted`.
    """
    for time in reversed(times):
        with suppress(SysidTribError):
            return predicted(rival, time, *given)
    return None, np.inf


def _worth(
    rivals: Sequence[Rival], known: Rival, main: xr.Dataset, runs: Mapping[str, RunPrediction]
) -> dict[str, Any]:
    """Return expected entropy, probability of the odds for the right model, and standard errors.

    `runs` : prediction of each model, by its name.
    """
    if known.name not in runs:
        nothing = np.full(len(known.fitted), np.nan)
        return {"entropy": np.nan, "probability": np.nan, "standard_error": nothing}
    pairs = [(rival, runs[rival.name]) for rival in rivals if rival.name in runs]
    # A model without such a motion is distinguished by any run.
    moving = np.array([rival.probability for rival, _ in pairs])
    entropy, right = 0.0, moving.sum()
    if len(pairs) > 1:
        entropy, right = models.informed(moving, models.log_odds(pairs))
    after = models.covariance_after(runs[known.name])
    of_noise = np.sqrt(np.sum((known.directions @ after) * known.directions, axis=1))
    stated = dict(zip(known.model.coefficients, of_noise.tolist(), strict=False))
    of_model = dict(zip(main.force.values.tolist(), judged.error_parts(main)[1].tolist(), strict=True))
    errors = np.hypot([stated[s] for s in known.fitted], [of_model[s] for s in known.fitted])
    return {"entropy": entropy, "probability": right + 1.0 - moving.sum(), "standard_error": errors}


def _best_first(values: Mapping[str, Array], limits: Array, rivals: int) -> Index:
    """Return the indices of the runs with a motion, best first; `limits` : wanted errors, or infinite."""
    length, entropy, errors = (values[name] for name in ("duration", "entropy", "standard_error"))
    # Runs with equal information to a hundredth, or a thousandth of a nat, are equally good: prefer the
    # shorter one.
    learnt = np.round(np.log(np.prod(errors / np.nanmin(errors, axis=0), axis=1)), 2)
    order = [length, np.round(entropy, 3) if rivals > 1 else learnt]
    if np.isfinite(limits).any():
        # First compare the distance from the wanted errors.
        lacking = np.max(np.where(np.isfinite(limits), errors / limits, 0.0), axis=1)
        order += [np.where(values["meets"], length, 0.0), np.where(values["meets"], 0.0, lacking)]
    ranked = np.lexsort(order)
    return ranked[np.isfinite(entropy[ranked])]


def _with_parting(
    data: xr.Dataset, rivals: Sequence[Rival], predictions: Mapping[str, RunPrediction], time: Array
) -> xr.Dataset:
    """Add `parting(time)` of the best run."""
    ranked = sorted(rivals, key=lambda rival: -rival.probability)
    likeliest = [rival.name for rival in ranked if rival.name in predictions][:2]
    log_ratio = np.full(len(time), np.nan)
    if len(likeliest) == 2:
        log_ratio = 0.5 * models.parting_of(*(predictions[name] for name in likeliest))
    data = data.assign_coords(time=time).assign(described("plan", {"parting": log_ratio}))
    data.parting.attrs["models"] = likeliest
    return data
