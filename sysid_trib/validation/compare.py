"""Comparison of all methods on the same runs: coefficients, predictions, neglected forces."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from time import perf_counter

import numpy as np
import xarray as xr

from sysid_trib import records
from sysid_trib.errors import DecayError, SysidTribError, Tell, UsageError, silent
from sysid_trib.forces.constraints import NO_CONSTRAINTS, Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary, LibraryLike
from sysid_trib.likelihood.sensor_noise import WHITE_LEVEL, white_p_value
from sysid_trib.methods import as_method, every_kind
from sysid_trib.methods.options import constrained, with_stated
from sysid_trib.methods.scope import Method, scope_of
from sysid_trib.records import inputs, smoothing
from sysid_trib.records.half_sines import envelope
from sysid_trib.records.runs import Decays, RecordsLike, as_runs, one_or_all
from sysid_trib.results import references, signal_scale, variables
from sysid_trib.results.models import library_of
from sysid_trib.validation import cross_check, holdout, residuals, verdict
from sysid_trib.validation.driven import is_driven, tested_driven
from sysid_trib.validation.force_scope import force_scope
from sysid_trib.validation.holdout import MethodResult, in_all_runs
from sysid_trib.validation.method_labels import by_unique_label

RESERVED = ("", ".", "..", "record", "envelope", "comparison", "judged")
Methods = str | Method | Sequence[Method | str] | Mapping[str, Method]


def every_method(
    reference_frequency: float | None = None, shapes: Mapping[str, float] | None = None
) -> dict[str, Method]:
    """Return every method of the field by name, for `compare`.

    Parameters
    ----------
    reference_frequency : float, rad/s
        Reference frequency, held by the methods that support this; the others fit their own.
    shapes : Mapping of str to float
        Shape parameters to hold; default values of the library for missing ones.

    Returns
    -------
    dict of str to method: those of `methods.METHODS` with their variants, in that order; then those that
    other installed packages declare as entry points `sysid_trib.methods`.
    """
    given = {"reference_frequency": reference_frequency, "shapes": dict(shapes or {})}
    methods: dict[str, Method] = {}
    for kind in every_kind():
        taken = {option.name for option in fields(kind)} if is_dataclass(kind) else set()
        method = kind(**{name: value for name, value in given.items() if name in taken})
        scope = scope_of(method)
        methods[scope.label] = method
        for variant, options in scope.variants.items():
            methods[f"{scope.label} ({variant})"] = replace(method, **options)
    return methods


def compare(
    decay: RecordsLike,
    library: LibraryLike | None = None,
    methods: Methods | None = None,
    *,
    contactless: tuple[float, float] | None = None,
    constraints: ConstraintTable = NO_CONSTRAINTS,
    tell: Tell = silent,
) -> xr.DataTree:
    """Identify a decay by several methods, and test each on a held-out part.

    Parameters
    ----------
    decay : record, or several of them
        `angle(time)` in rad, as `free_decay` returns it, or `(t, angle)`; or a list of runs, as `identify`
        takes them. Records with inputs are identified by Direct and Trajectory only.
    library : ForceLibrary, str, or what `library` takes, optional
        The forces offered to every method, or the name of their library; by default `contact_forces`.
    methods : sequence of methods or their names, or Mapping of str to method, optional
        Methods, whose labels come from scope and options; or methods by label. By default every method of the
        field with its variants.
    contactless : (float, float), rad/s
        Frequency without contact and its standard error; with it, alpha is identified too.
    constraints : mapping of str to float, (float, float) or str
        Fixed values, bounds and ties, `{"lambda": 0, "zeta": (0, None), "nu": "-2.356*delta"}`, for every
        method; a method without constraints keeps a row without numbers.
    tell : callable
        Called with a method's label before it starts.

    Returns
    -------
    DataTree
        Groups: `record` (with `holdout_start`, s) and `envelope` (`record_1`, `envelope_1`, `record_2`, ...
        for several runs); one identification of the whole decay (all runs) per successful method, under its
        label; and `comparison`. Over `model` and `force`, `comparison` contains `coefficient`,
        `standard_error` (nan if not identified) at the `common_frequency` (rad/s), and `z`, the difference
        from the method of the best prediction over the errors of both, taken as independent. Over `model`:
        `reference_frequency`, `asymptotic_frequency` (rad/s) with errors, `asymptotic_frequency_z`;
        `residual_rms`, `train_rms`, `holdout_rms` (rad) and each over the noise; `phase_error` (rad);
        `holdout_p_value` of the difference from the best (Diebold-Mariano test); `time_taken` (s); the texts
        `reason`, `bias`, `identifies`, `neglects`, `cannot_tell_apart`, `assumes`, `family`; `white_noise`,
        whether errors are valid in white noise only; and `names_forces`. A method that identifies curves
        instead has no numbers over `force` and is never the best method. For several runs also
        `run_noise(run)` and, over `model` and `run`, `run_residual_rms`, `run_train_rms`, `run_holdout_rms`
        (rad). `sel(model=label)` selects a method.

    Raises
    ------
    UsageError
        There is no run or no method, or another object was given as library or method.
    DecayError
        No method can identify this decay.

    Notes
    -----
    The last third by time is held out: each method identifies the first two thirds again, and its model is
    simulated over the last third, where only its start and the sensor's zero are fitted. The equilibrium is
    that of the whole record. All methods use the same noise, that of the sensor (see `sensor_noise`). A
    method that does not apply keeps its row with nan and the `reason`.

    For several runs, the last third of each run is held out. RMS values are over all runs; an RMS over the
    noise uses the noise of each run. Methods for one record at a time have no numbers.

    Examples
    --------
    A method that neglects a force predicts the held-out part of the record with an error above the noise, 1.

    >>> import sysid_trib as st
    >>> methods = ["direct", "averaging", "logarithmicdecrement"]
    >>> compared = st.compare(st.records.paper_twin(), "lambda,zeta,delta,nu,epsilon", methods)
    >>> compared["comparison"].holdout_over_noise.round(1).to_series().to_dict()
    {'direct': 1.0, 'averaging': 1.0, 'logarithmic decrement': 14.1}
    """
    runs = records.as_decays(decay, "compare")
    given = every_method() if methods is None else methods
    listed = [given] if isinstance(given, str) or hasattr(given, "identify") else given
    named_kinds = listed.items() if isinstance(listed, Mapping) else [("", method) for method in listed]
    pairs = [(name, as_method(kind, "compare")) for name, kind in named_kinds]
    offered = verdict.checked_library("compare", library, runs)
    if not pairs:
        raise UsageError("compare needs at least one method, such as methods.Direct().")
    named = by_unique_label(pairs, RESERVED)
    return _compared(runs, offered, named, contactless, constraints, tell)


@signal_scale.in_units_of_the_motion
def _compared(
    decay: Decays,
    library: ForceLibrary,
    named: Mapping[str, Method],
    contactless: tuple[float, float] | None,
    constraints: ConstraintTable,
    tell: Tell,
) -> xr.DataTree:
    runs = as_runs(decay, driven=True)
    parts = [(run, *holdout.split(run), envelope(run)) for run in runs]
    of_records, of_envelopes = (variables.group_names(name, len(runs)) for name in ("record", "envelope"))
    groups = dict(zip(of_envelopes, [half_sines for *_, half_sines in parts], strict=True))
    if taken := sorted({*groups, *of_records} & set(named)):
        raise UsageError(f"'{taken[0]}' is the name of a run; label the method otherwise.")
    if driven := is_driven(runs):
        for run in runs:
            inputs.inputs_for(run, library)
        # In driven records a random force is used only on request.
        named = {label: verdict.with_noise(method, "off") for label, method in named.items()}
    else:
        named = verdict.with_common_noise(decay, library, named)
    by_label: dict[str, MethodResult] = {}
    for at, (label, method) in enumerate(named.items()):
        tell(label, at / len(named))
        held = with_stated(constraints, library, method)
        by_label[label] = _try_method(method, parts, library, contactless, held)
    results = {label: tried.result for label, tried in by_label.items() if tried.result is not None}
    if not results:
        subject = "this record" if len(runs) == 1 else "these runs together"
        label, tried = next(iter(by_label.items()))
        raise DecayError(f"No method can identify {subject}. {label}: {tried.row['reason']}.")
    blocks = [smoothing.samples_of_a_period(run) for run in runs]
    table = holdout.method_table(by_label, [smoothing.sensor_noise(run) for run in runs], blocks)
    table.attrs["noise_from"] = "a least-squares spline"
    best = table.attrs["best"]
    of_best = by_label[best].motions
    for at, (name, (run, _, rest, _)) in enumerate(zip(of_records, parts, strict=True)):
        start = variables.described("record", {"holdout_start": float(rest.time.values[0])})
        # A model without a motion has nan.
        nothing = np.full(run.sizes["time"], np.nan)
        residuals_of = {
            label: tried.motions["residual"][at].residual.values if tried.motions.get("residual") else nothing
            for label, tried in by_label.items()
        }
        simulated = run.angle.values - np.array(list(residuals_of.values()))
        # For a driven record the noise is at most the residual of the best model.
        of_best_alone = run.angle.values - residuals_of[best][None]
        of_noise = residuals.with_noise_and_models(run, [best], of_best_alone)
        kept = residuals.with_noise_and_models(run, list(by_label), simulated).assign(noise=of_noise.noise)
        groups[name] = kept.assign(start)
    if driven:
        # A driven motion may contain components that no spline follows, so a residual of that size need not
        # be noise.
        of_runs = [motion.residual.values for motion in of_best.get("residual", [])]
        p_value = len(runs) * min(map(white_p_value, of_runs), default=0.0)
        white = variables.described("comparison", {"white_residual": p_value >= WHITE_LEVEL})
        table = table.assign(white)
    of_names = [result for label, result in results.items() if scope_of(named[label]).names_forces]
    table.attrs |= _not_separable(runs, of_names or list(results.values()), library)
    table, judged = _judged(
        table,
        [groups[name] for name in of_records],
        {label: tried.followed for label, tried in by_label.items()},
    )
    return xr.DataTree.from_dict({**groups, **results, "comparison": table, "judged": judged})


def _judged(
    table: xr.Dataset, records: Sequence[xr.Dataset], followed: Mapping[str, residuals.FollowedRuns | None]
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return the judged identifications, and the table of methods without the judged variables."""
    best = table.attrs["best"]
    known = {label: of for label, of in followed.items() if of is not None}
    # The last identification determines the noise of the verdict.
    known[best] = known.pop(best)
    driven = any(map(inputs.inputs_of, records))
    of_known = table.sel(model=list(known))
    judged = verdict.judged_models(
        known,
        [record.sel(model=list(known)) for record in records],
        tested_driven(known) if driven else residuals.residuals(known, known[best].result),
        preferred=best,
        made_by="compare",
        random_force_p=float("nan") if driven else None,
        replaced={"held_out_rms": of_known.holdout_rms.values, "failure": of_known.failure.values},
    )
    there = [label for label in table.model.values if label in known]
    # The group `judged` contains these variables of each method: the table of methods omits them.
    return table.drop_vars(["residual_rms", "residual_over_noise", "failure"]), judged.sel(model=there)


def _try_method(
    method: Method,
    parts: Sequence[tuple[xr.Dataset, ...]],
    library: ForceLibrary,
    contactless: tuple[float, float] | None,
    constraints: Constraints,
) -> MethodResult:
    """Identify by a method on the training parts and on the whole; predict the held-out parts.

    `parts` : for each run, the training part, the held-out part, and the envelope.
    """
    runs, train, rest, envelopes = zip(*parts, strict=True)
    # Fit the part first: the time of the whole then excludes imports and compilation at first use.
    part, part_reason, _ = _identified(method, train, library, constraints)
    result, reason, seconds = _identified(method, runs, library, constraints)
    amplitude = max(float(np.max(np.abs(run.angle.values))) for run in runs)
    names_forces = scope_of(method).names_forces
    forces = force_scope(method, library, result, amplitude)
    if not names_forces:
        forces |= {"identifies": scope_of(method).identifies, "neglects": "", "cannot_tell_apart": ""}
    row = {**vars(scope_of(method)), **forces, "time_taken": seconds, "failure": ""}
    row["bias"] = _bias(result)
    if result is None:
        return MethodResult(None, row | {"reason": reason}, {})
    followed = residuals.FollowedRuns(dict(enumerate(runs)), result)
    if names_forces and not forces["neglects"]:
        # The errors of forces that absorb neglected ones would hide their bias.
        held = constrained(method, constraints)
        followed = verdict.with_model_in_errors(followed, held, library)
    result, motions = followed.result, {"residual": in_all_runs(runs, followed.motions, envelopes)}
    reason = _complaint("its model", motions["residual"]) if forces["damped"] else "its model has no damping"
    if part is None:
        part_reason = f"first two thirds: {part_reason}"
    else:
        of_train = residuals.FollowedRuns(dict(enumerate(train)), part)
        motions["train"] = in_all_runs(train, of_train.motions, envelopes)
        motions["holdout"] = in_all_runs(rest, holdout.motions_held_out(part, runs), envelopes)
        part_reason = _complaint("on the part held out it", motions["holdout"])
    if contactless is not None:
        result = references.with_contactless_frequency(result, *contactless)
    if not forces["neglects"]:
        row["failure"] = holdout.failure_of(runs, motions["residual"])
    # The reason that concerns the whole has priority over that of the prediction.
    return MethodResult(result, row | {"reason": reason or part_reason}, motions, followed)


def _complaint(subject: str, motions: Sequence[xr.Dataset]) -> str:
    """Describe why, and in which run, the motion diverges from the record; empty if all motions follow."""
    if not motions:
        return f"{subject} diverges"
    for at, motion in enumerate(motions):
        of_run = f" in run {at + 1}" if len(motions) > 1 else ""
        if np.isfinite(motion.stop_time):
            return f"{subject} stops at {motion.stop_time.item():.3g} s{of_run}"
        # In antiphase (rad) the residual contains no more information on the forces.
        if motion.phase_error > np.pi:
            return f"{subject} slips by {motion.phase_error.item() / (2.0 * np.pi):.2g} periods{of_run}"
    return ""


def _identified(
    method: Method, decays: Sequence[xr.Dataset], library: ForceLibrary, constraints: Constraints
) -> tuple[xr.Dataset | None, str, float]:
    """Identify; return the result or the reason of failure, and the time used (s)."""
    # An empty row of a method for one record is a fault of neither the method nor the records.
    if len(decays) > 1 and not scope_of(method).several_runs:
        return None, "takes one record at a time", float("nan")
    # Direct identifies driven records in its weak form only.
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


def _not_separable(
    runs: Sequence[xr.Dataset], results: Sequence[xr.Dataset], library: ForceLibrary
) -> dict[str, str]:
    """Return the forces that no method separates, or identifies, on these runs, as attributes."""
    widest = max(results, key=lambda result: result.sizes["force"])
    identified = {symbol for result in results for symbol in result.force.values.tolist()}
    force = library.role("x") or library_of(widest, whole=True).role("x")
    stiffness = "" if force is None else force.symbol
    unseen = [s for s in library.symbols if s not in identified and s != stiffness]
    return cross_check.ties(runs, widest) | {
        "no_method_identifies": ", ".join(unseen),
        "exchangeable_with_the_frequency": "" if stiffness in identified else stiffness,
    }


def _bias(result: xr.Dataset | None) -> str:
    """Return the bias that a method reports."""
    if result is None:
        return ""
    if not result.get("first_order_bias_removed", True):
        why = result.attrs.get("first_order_bias_reason", "").rstrip(".")
        return f"first-order bias not removed{': ' + why if why else ''}"
    if not result.get("refined", True):
        return "columns from the smoothed record, whose noise biases them"
    return ""
