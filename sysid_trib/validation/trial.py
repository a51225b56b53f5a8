"""One method on the runs: its identification, its model's prediction of a part held out, what it neglects."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.errors import SysidTribError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods.scope import ForceScope, Method, MethodScope, constrained, force_scope, scope_of
from sysid_trib.records.decay import one_or_all
from sysid_trib.results.references import with_contactless_frequency
from sysid_trib.validation.answer import with_model_in_errors
from sysid_trib.validation.driven import is_driven
from sysid_trib.validation.holdout import RunInParts, predicted, up_to_held_out
from sysid_trib.validation.residuals import ModelResidual, ModelResiduals, residual_of
from sysid_trib.validation.verdict import DIVERGES, no_nearer_than_rest


@dataclass(frozen=True)
class Trial:
    """What came of one method.

    Attributes
    ----------
    label : str
        Its name in the table.
    scope : MethodScope
        What it says of itself.
    forces : ForceScope
        What it makes of the forces offered.
    result : Dataset, or None
        Its identification.
    seconds : float, s
        The time that took.
    whole, train, holdout : ModelResiduals
        Of its model on the whole record; of the model of the first two thirds on these, and on the last
        third. Without runs where there is no motion.
    reason : str
        Why there are none, or why they are not to be trusted.
    failure : str
        Why its model says nothing of the record although it neglects no force; empty if it does.
    """

    label: str
    scope: MethodScope
    forces: ForceScope
    result: xr.Dataset | None
    seconds: float
    whole: ModelResiduals
    train: ModelResiduals
    holdout: ModelResiduals
    reason: str = ""
    failure: str = ""


def try_method(
    label: str,
    method: Method,
    runs: Sequence[RunInParts],
    library: ForceLibrary,
    contactless: tuple[float, float] | None,
    constraints: Constraints,
) -> Trial:
    """A method on the training parts, on the parts held out, and on the whole."""
    # The part first: what is imported or compiled at first use is then not in the time of the whole.
    part, part_reason, _ = _identified(method, [run.train for run in runs], library, constraints)
    result, reason, seconds = _identified(method, [run.decay for run in runs], library, constraints)
    amplitude = max(float(np.max(np.abs(run.decay.angle.values))) for run in runs)
    forces = _force_scope(method, library, result, amplitude)
    none = ModelResiduals((), tuple(run.noise for run in runs))
    trial = Trial(label, scope_of(method), forces, result, seconds, none, none, none, reason)
    if result is None:
        return trial
    if not forces.neglects:
        # Errors of what takes the place of neglected forces would hide its bias.
        result = with_model_in_errors(result, method, [run.decay for run in runs], library)
        trial = replace(trial, result=result)
    whole = _of_all(residual_of, [(run.decay, result, run.envelope, at) for at, run in enumerate(runs)], none)
    reason = _complaint("its model", whole) if forces.damped else "its model has no damping"
    if part is not None:
        train = [(run.train, part, run.envelope, at) for at, run in enumerate(runs)]
        later = [(run.rest, part, run.envelope, up_to_held_out(run.decay)) for run in runs]
        holdout = _of_all(predicted, later, none)
        trial = replace(trial, train=_of_all(residual_of, train, none), holdout=holdout)
        part_reason = _complaint("on the part held out it", holdout)
    else:
        part_reason = f"first two thirds: {part_reason}"
    if contactless is not None:
        result = with_contactless_frequency(result, *contactless)
    # The reason against the whole comes first; the prediction only adds to it.
    failure = "" if forces.neglects else _failure(runs, whole)
    return replace(trial, result=result, whole=whole, reason=reason or part_reason, failure=failure)


def _failure(runs: Sequence[RunInParts], whole: ModelResiduals) -> str:
    """Why a model that neglects nothing says nothing of the records (see `breakdown`)."""
    if not whole.runs:
        return DIVERGES
    for at, (run, motion) in enumerate(zip(runs, whole.runs, strict=True)):
        if reason := no_nearer_than_rest(run.decay.angle.values, motion.residual):
            return reason.format(f" of run {at + 1}" if len(runs) > 1 else "")
    return ""


def _identified(
    method: Method, decays: Sequence[xr.Dataset], library: ForceLibrary, constraints: Constraints
) -> tuple[xr.Dataset | None, str, float]:
    """Identification, or why there is none; the time it took, s."""
    # The row of a rule for one record is empty for no fault of its own, nor of the records.
    if len(decays) > 1 and not scope_of(method).several_runs:
        return None, "takes one record at a time", float("nan")
    # Direct identifies driven records in its weak form.
    if is_driven(decays) and not (scope_of(method).driven and getattr(method, "form", "weak") == "weak"):
        return None, "takes free decays alone, and this record has an input", float("nan")
    began = perf_counter()
    try:
        result = constrained(method, constraints).identify(one_or_all(decays), library)
    except SysidTribError as error:
        return None, f"does not apply: {str(error).rstrip('.')}", float("nan")
    except np.linalg.LinAlgError as error:
        return None, f"failed: {type(error).__name__}, {str(error).rstrip('.')}", float("nan")
    seconds = perf_counter() - began
    if not np.all(np.isfinite(result.coefficient.values)):
        return None, "failed: its coefficients are not finite", float("nan")
    return result, "", seconds


def _of_all(
    residual: Callable[..., ModelResidual | None], arguments: Sequence[tuple[Any, ...]], none: ModelResiduals
) -> ModelResiduals:
    """Residuals of a model in all runs; `none` where it diverges in one."""
    of_runs = [residual(*of_run) for of_run in arguments]
    finite = tuple(run for run in of_runs if run is not None and np.isfinite(run.rms))
    return replace(none, runs=finite) if len(finite) == len(arguments) else none


def _complaint(subject: str, residuals: ModelResiduals) -> str:
    complaint = residuals.complaint if residuals.runs else "diverges"
    return f"{subject} {complaint}" if complaint else ""


def _force_scope(
    method: Method, library: ForceLibrary, result: xr.Dataset | None, amplitude: float
) -> ForceScope:
    fitted = None if result is None else tuple(result.force.values.tolist())
    stiffness = library.role("x")
    held = stiffness is None or (fitted is not None and stiffness.symbol in fitted)
    asked = library.select(s for s in library.symbols if held or library[s] is not stiffness)
    try:
        return force_scope(method, asked, fitted, amplitude)
    except SysidTribError:
        return ForceScope()
