"""Every method on one record, side by side: what each finds, how well it predicts, what it cannot see."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.agreement import ties
from sysid_trib.decays.half_periods import quantisation_step
from sysid_trib.decays.half_sines import envelope
from sysid_trib.errors import DecayError, SysidTribError, UsageError
from sysid_trib.forces import ForceLibrary
from sysid_trib.holding_out import Followed, followed, predicted, split
from sysid_trib.identification import Method
from sysid_trib.method_labels import Methods, labelled
from sysid_trib.method_table import Trial, method_table
from sysid_trib.results import library_of, with_contactless_frequency
from sysid_trib.visibility import Visibility, visibility


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
    decay: xr.Dataset,
    library: ForceLibrary,
    methods: Methods,
    *,
    contactless: tuple[float, float] | None = None,
    tell: Callable[[str], None] | None = None,
) -> xr.DataTree:
    """Identify one decay by several methods, side by side, each tested on a part it has not seen.

    Parameters
    ----------
    decay : `angle(time)` in rad, as `free_decay` returns it.
    library : the forces offered to every method.
    methods : method objects, labelled by their class and options; or `{label: method}`, as `every_method()`.
    contactless : frequency without contact and its error (rad/s), which adds alpha.
    tell : called with a method's label before it starts.

    Returns
    -------
    DataTree with groups `record` (with `holdout_start`, s), `envelope`, one identification of the whole
    decay per method that gave one, named by its label, and `comparison`. That has, over `method` and `force`:
    `coefficient`, `standard_error` (nan where not identified) at the one `common_frequency` (rad/s), and `z`,
    the difference from the method that predicts best over the errors of both, taken as independent. Over
    `method`: `reference_frequency`, `asymptotic_frequency` (rad/s) with errors, `asymptotic_frequency_z`;
    `residual_rms`, `train_rms`, `holdout_rms` (rad) and each over the noise; `phase_error` (rad);
    `holdout_p_value`, the chance of predicting so much worse than the best; `time_taken` (s); and the texts
    `reason`, `bias`, `sees`, `blind_to`, `cannot_tell_apart`, `assumes`.

    Raises
    ------
    UsageError
        Several decays, no method, or something else in the place of a library or method.
    DecayError
        No method can identify this decay.

    Notes
    -----
    Held out is the last third by time: each method identifies the first two thirds again, its model is
    simulated over the last with the start and the sensor's zero fitted there, nothing else. The record's
    centre was found on the whole. One noise for all: that of the record's envelope (see `envelope`).
    A method that does not apply keeps its row: nan, and why in `reason`.
    """
    if not isinstance(decay, xr.Dataset) or "angle" not in decay:
        raise UsageError("compare takes one record: a Dataset with angle(time), as free_decay returns it.")
    if not isinstance(library, ForceLibrary):
        raise UsageError(f"compare wants a ForceLibrary, not {library!r}: load_library('contact_forces').")
    named = labelled(methods)
    measured = envelope(decay)
    trials = []
    for label, method in named.items():
        if tell is not None:
            tell(label)
        trials.append(_tried(label, method, decay, library, measured, contactless))
    decided = [trial for trial in trials if trial.result is not None]
    if not decided:
        raise DecayError(f"No method can identify this record. {trials[0].label}: {trials[0].reason}.")
    block = max(1, round(2 * float(np.median(np.diff(measured.extremum_time))) / _step(decay)))
    table = method_table(trials, measured.noise.item(), block)
    table.attrs["noise_from"] = _noise_source(decay, measured.noise.item())
    table.attrs |= _never_told_apart(decay, decided, library)
    held_out = split(decay)[1].time.values[0]
    about = {"units": "s", "long_name": "start of the part held out"}
    record = decay.assign(holdout_start=((), float(held_out), about))
    groups = {trial.label: trial.result for trial in decided if trial.result is not None}
    return xr.DataTree.from_dict({"record": record, "envelope": measured, **groups, "comparison": table})


def _tried(
    label: str,
    method: Method,
    decay: xr.Dataset,
    library: ForceLibrary,
    measured: xr.Dataset,
    contactless: tuple[float, float] | None,
) -> Trial:
    """A method on the training part, on the part held out, and on the whole."""
    train, rest = split(decay)
    # The part first: what is imported or compiled at first use is then not in the time of the whole.
    part, part_reason, _ = _identified(method, train, library)
    result, reason, seconds = _identified(method, decay, library)
    size = float(np.max(np.abs(decay.angle.values)))
    seen = _visibility(method, library, result, size)
    if result is None:
        return Trial(label, seen, reason=reason)
    whole = _safely(followed, decay, result, measured)
    reason = _complaint("its model", whole) if seen.damped else "its model has no damping"
    trial = Trial(label, seen, result, seconds, whole=whole, reason=reason)
    if part is not None:
        first = float(decay.time.values[0])
        fitted = _safely(followed, train, part, measured)
        held_out = _safely(predicted, rest, part, measured, first)
        trial = replace(trial, train=fitted, holdout=held_out)
        part_reason = _complaint("on the part held out it", held_out)
    else:
        part_reason = f"first two thirds: {part_reason}"
    # What goes wrong with the whole is told; the prediction only adds to it.
    trial = replace(trial, reason=trial.reason or part_reason)
    if contactless is not None:
        trial = replace(trial, result=with_contactless_frequency(result, *contactless))
    return trial


def _identified(
    method: Method, decay: xr.Dataset, library: ForceLibrary
) -> tuple[xr.Dataset | None, str, float]:
    """Identification, or why there is none; the time it took, s."""
    began = perf_counter()
    try:
        result = method.identify(decay, library)
    except SysidTribError as error:
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


def _complaint(subject: str, motion: Followed | None) -> str:
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


def _never_told_apart(decay: xr.Dataset, decided: Sequence[Trial], library: ForceLibrary) -> dict[str, str]:
    """What no method tells apart, or sees, on this record; as attrs."""
    widest = max((t.result for t in decided if t.result is not None), key=lambda r: r.sizes["force"])
    found = {symbol for t in decided if t.result is not None for symbol in t.result.force.values.tolist()}
    stiffness = library.role("x") or library_of(widest, whole=True).role("x")
    unseen = [s for s in library.symbols if s not in found and (stiffness is None or s != stiffness.symbol)]
    alone = stiffness is not None and stiffness.symbol not in found
    return ties([decay], widest) | {
        "no_method_identifies": ", ".join(unseen),
        "exchangeable_with_the_frequency": stiffness.symbol if alone and stiffness is not None else "",
    }


def _noise_source(decay: xr.Dataset, noise: float) -> str:
    """Where the noise of an envelope is from (see `envelope`)."""
    coarse = quantisation_step(decay.angle.values.astype(float)) / np.sqrt(12.0)
    return "its quantisation" if coarse >= noise * (1.0 - 1e-9) else "its sixth differences"


def _step(decay: xr.Dataset) -> float:
    return float(np.median(np.diff(decay.time.values)))
