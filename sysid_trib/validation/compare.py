"""Every method on the same runs, side by side: what each finds, how well it predicts, what it cannot see."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.decays.half_periods import quantisation_step
from sysid_trib.decays.half_sines import envelope
from sysid_trib.errors import DecayError, SysidTribError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.records.runs import Decays, as_runs, group_names, one_or_all
from sysid_trib.results.schema import library_of, with_contactless_frequency
from sysid_trib.validation.comparison_table import Trial, method_table
from sysid_trib.validation.cross_check import Method
from sysid_trib.validation.cross_check_statistics import ties
from sysid_trib.validation.holdout import Followed, FollowedRuns, RunInParts, followed, predicted, split
from sysid_trib.validation.method_labels import Methods, labelled
from sysid_trib.validation.method_scope import Visibility, visibility

# What a rule for one record says of several runs.
ONE_RECORD = "takes one record at a time"


def every_method(
    reference_frequency: float | None = None, shapes: Mapping[str, float] | None = None
) -> dict[str, Method]:
    """Every method of the field by name, for `compare`.

    Parameters
    ----------
    reference_frequency : rad/s, held by the methods that can; else each fits its own.
    shapes : shape parameters to hold; defaults of the library where left out.
    """
    from sysid_trib import methods as m

    w, held = reference_frequency, dict(shapes or {})
    return {
        "trajectory": m.Trajectory(reference_frequency=w, shapes=held),
        "direct": m.Direct(reference_frequency=w, shapes=held),
        # pysindy.SINDy on derivatives of the smoothed record, as it is commonly used.
        "direct (strong form)": m.Direct(reference_frequency=w, shapes=held, form="strong"),
        "averaging": m.Averaging(reference_frequency=w, shapes=held),
        "averaging (analytic signal)": m.Averaging(
            reference_frequency=w, shapes=held, curve="analytic-signal"
        ),
        # As Le Bot et al. 2019 print it: last frequency, least squares, first order.
        "averaging (printed rule)": m.Averaging(
            "last", correct=False, reference_frequency=w, weighted=False, shapes=held
        ),
        "frequency shift": m.FrequencyShift(reference_frequency=w, shapes=held),
        "Wu decrement": m.WuDecrement(),
        "Feeny-Liang decrement": m.FeenyLiang(),
        "energy decay": m.EnergyDecay(),
        "logarithmic decrement": m.LogarithmicDecrement(),
        "linear decrement": m.LinearDecrement(),
        "quadratic decay": m.QuadraticDecay(),
        "windowed ERA": m.WindowedERA(),
    }


def compare(
    decay: Decays,
    library: ForceLibrary,
    methods: Methods,
    *,
    contactless: tuple[float, float] | None = None,
    tell: Callable[[str], None] | None = None,
) -> xr.DataTree:
    """Identify a decay by several methods, side by side, each tested on a part it has not seen.

    Parameters
    ----------
    decay : `angle(time)` in rad, as `free_decay` returns it; or a list of runs, as `identify` takes them.
    library : the forces offered to every method.
    methods : method objects, labelled by their class and options; or `{label: method}`, as `every_method()`.
    contactless : frequency without contact and its error (rad/s), which adds alpha.
    tell : called with a method's label before it starts.

    Returns
    -------
    DataTree with groups `record` (with `holdout_start`, s), `envelope` (`record_1`, `envelope_1`, `record_2`,
    ... of several runs), one identification of the whole decay (all runs) per method that gave one, named by
    its label, and `comparison`. That has, over `method` and `force`:
    `coefficient`, `standard_error` (nan where not identified) at the one `common_frequency` (rad/s), and `z`,
    the difference from the method that predicts best over the errors of both, taken as independent. Over
    `method`: `reference_frequency`, `asymptotic_frequency` (rad/s) with errors, `asymptotic_frequency_z`;
    `residual_rms`, `train_rms`, `holdout_rms` (rad) and each over the noise; `phase_error` (rad);
    `holdout_p_value`, the chance of predicting so much worse than the best; `time_taken` (s); and the texts
    `reason`, `bias`, `identifies`, `neglects`, `cannot_tell_apart`, `assumes`. Of several runs also
    `run_noise(run)` and, over `method` and `run`, `run_residual_rms`, `run_train_rms`, `run_holdout_rms`
    (rad).

    Raises
    ------
    UsageError
        No run, no method, or something else in the place of a library or method.
    DecayError
        No method can identify this decay.

    Notes
    -----
    Held out is the last third by time: each method identifies the first two thirds again, its model is
    simulated over the last with the start and the sensor's zero fitted there, nothing else. The record's
    centre was found on the whole. One noise for all: that of the record's envelope (see `envelope`).
    A method that does not apply keeps its row: nan, and why in `reason`.

    Of several runs the last third of each is held out. RMS are over the runs, whatever their lengths; over
    the noise, each run's RMS is over its own. Methods that take one record at a time have no numbers.
    """
    if not isinstance(library, ForceLibrary):
        raise UsageError(f"compare wants a ForceLibrary, not {library!r}: load_library('contact_forces').")
    named = labelled(methods)
    runs = [RunInParts(run, *split(run), envelope(run)) for run in as_runs(decay)]
    groups = dict(zip(group_names("record", len(runs)), [run.labelled for run in runs], strict=True))
    groups |= dict(zip(group_names("envelope", len(runs)), [run.measured for run in runs], strict=True))
    if taken := sorted(set(groups) & set(named)):
        raise UsageError(f"'{taken[0]}' is the name of a run; label the method otherwise.")
    trials = []
    for label, method in named.items():
        if tell is not None:
            tell(label)
        trials.append(_tried(label, method, runs, library, contactless))
    decided = [trial for trial in trials if trial.result is not None]
    if not decided:
        subject = "this record" if len(runs) == 1 else "these runs together"
        raise DecayError(f"No method can identify {subject}. {trials[0].label}: {trials[0].reason}.")
    table = method_table(trials, [run.noise for run in runs], [run.block for run in runs])
    table.attrs["noise_from"] = " or ".join(dict.fromkeys(_noise_source(run) for run in runs))
    table.attrs |= _never_told_apart(runs, decided, library)
    groups |= {trial.label: trial.result for trial in decided if trial.result is not None}
    return xr.DataTree.from_dict({**groups, "comparison": table})


def _tried(
    label: str,
    method: Method,
    runs: Sequence[RunInParts],
    library: ForceLibrary,
    contactless: tuple[float, float] | None,
) -> Trial:
    """A method on the training parts, on the parts held out, and on the whole."""
    # The part first: what is imported or compiled at first use is then not in the time of the whole.
    part, part_reason, _ = _identified(method, [run.train for run in runs], library)
    result, reason, seconds = _identified(method, [run.decay for run in runs], library)
    size = max(float(np.max(np.abs(run.decay.angle.values))) for run in runs)
    seen = _visibility(method, library, result, size)
    if result is None:
        return Trial(label, seen, reason=reason)
    each = [_safely(followed, run.decay, result, run.measured, at) for at, run in enumerate(runs)]
    whole = _together(each, runs)
    reason = _complaint("its model", whole) if seen.damped else "its model has no damping"
    trial = Trial(label, seen, result, seconds, whole=whole, reason=reason)
    if part is not None:
        fitted = [_safely(followed, run.train, part, run.measured, at) for at, run in enumerate(runs)]
        later = [
            _safely(predicted, run.rest, part, run.measured, float(run.decay.time.values[0])) for run in runs
        ]
        held_out = _together(later, runs)
        trial = replace(trial, train=_together(fitted, runs), holdout=held_out)
        part_reason = _complaint("on the part held out it", held_out)
    else:
        part_reason = f"first two thirds: {part_reason}"
    # What goes wrong with the whole is told; the prediction only adds to it.
    trial = replace(trial, reason=trial.reason or part_reason)
    if contactless is not None:
        trial = replace(trial, result=with_contactless_frequency(result, *contactless))
    return trial


def _identified(
    method: Method, decays: Sequence[xr.Dataset], library: ForceLibrary
) -> tuple[xr.Dataset | None, str, float]:
    """Identification, or why there is none; the time it took, s."""
    began = perf_counter()
    try:
        result = method.identify(one_or_all(decays), library)
    except SysidTribError as error:
        # The row of a rule for one record is empty for no fault of its own, nor of the records.
        if len(decays) > 1 and isinstance(error, UsageError) and "one record" in str(error):
            return None, ONE_RECORD, float("nan")
        return None, f"does not apply: {str(error).rstrip('.')}", float("nan")
    except (ArithmeticError, ValueError) as error:
        return None, f"failed: {type(error).__name__}, {str(error).rstrip('.')}", float("nan")
    seconds = perf_counter() - began
    if not np.all(np.isfinite(result.coefficient.values)):
        return None, "failed: its coefficients are not finite", float("nan")
    return result, "", seconds


def _safely(follow: Callable[..., Followed | None], *about: Any) -> Followed | None:
    """How a model follows a record, or None where its numbers overflow."""
    try:
        found = follow(*about)
    except (ArithmeticError, ValueError):
        return None
    return found if found is not None and np.isfinite(found.rms) else None


def _together(each: Sequence[Followed | None], runs: Sequence[RunInParts]) -> FollowedRuns | None:
    """How a model follows all runs; None where it diverges in one."""
    known = tuple(one for one in each if one is not None)
    return FollowedRuns(known, tuple(run.noise for run in runs)) if len(known) == len(runs) else None


def _complaint(subject: str, motion: FollowedRuns | None) -> str:
    told = "diverges" if motion is None else motion.complaint
    return f"{subject} {told}" if told else ""


def _visibility(method: Method, library: ForceLibrary, result: xr.Dataset | None, size: float) -> Visibility:
    fitted = None if result is None else tuple(result.force.values.tolist())
    stiffness = library.role("x")
    held = stiffness is None or (fitted is not None and stiffness.symbol in fitted)
    asked = library.select(s for s in library.symbols if held or library[s] is not stiffness)
    try:
        return visibility(method, asked, fitted, size, dict(getattr(method, "shapes", {})))
    except SysidTribError:
        return Visibility()


def _never_told_apart(
    runs: Sequence[RunInParts], decided: Sequence[Trial], library: ForceLibrary
) -> dict[str, str]:
    """What no method tells apart, or sees, on these runs; as attrs."""
    widest = max((t.result for t in decided if t.result is not None), key=lambda r: r.sizes["force"])
    found = {symbol for t in decided if t.result is not None for symbol in t.result.force.values.tolist()}
    stiffness = library.role("x") or library_of(widest, whole=True).role("x")
    unseen = [s for s in library.symbols if s not in found and (stiffness is None or s != stiffness.symbol)]
    alone = stiffness is not None and stiffness.symbol not in found
    return ties([run.decay for run in runs], widest) | {
        "no_method_identifies": ", ".join(unseen),
        "exchangeable_with_the_frequency": stiffness.symbol if alone and stiffness is not None else "",
    }


def _noise_source(run: RunInParts) -> str:
    """Where the noise of an envelope is from (see `envelope`)."""
    coarse = quantisation_step(run.decay.angle.values.astype(float)) / np.sqrt(12.0)
    return "its quantisation" if coarse >= run.noise * (1.0 - 1e-9) else "its sixth differences"
