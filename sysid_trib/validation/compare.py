"""Every method on the same runs: what each identifies, how well it predicts, what it neglects."""

from collections.abc import Mapping, Sequence
from dataclasses import Field, fields, is_dataclass, replace
from typing import Any

import xarray as xr

from sysid_trib.errors import DecayError, Tell, UsageError, silent
from sysid_trib.forces.constraints import NO_CONSTRAINTS, Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.likelihood.sensor_noise import WHITE_LEVEL, white_p_value
from sysid_trib.methods import METHODS
from sysid_trib.methods.scope import Method, scope_of
from sysid_trib.records.decay import Decays, as_runs
from sysid_trib.records.half_sines import envelope
from sysid_trib.records.inputs import inputs_for
from sysid_trib.results.schema import library_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import group_names
from sysid_trib.validation.answer import check_method, with_common_noise, with_noise
from sysid_trib.validation.comparison_table import method_table
from sysid_trib.validation.cross_check import ties
from sysid_trib.validation.driven import is_driven
from sysid_trib.validation.holdout import RunInParts, split
from sysid_trib.validation.trial import try_method

RESERVED = ("", ".", "..", "record", "envelope", "comparison")
Methods = Sequence[Method] | Mapping[str, Method]


def every_method(
    reference_frequency: float | None = None, shapes: Mapping[str, float] | None = None
) -> dict[str, Method]:
    """Every method of the field by name, for `compare`.

    Parameters
    ----------
    reference_frequency : float, rad/s
        Held by the methods that can; else each fits its own.
    shapes : Mapping of str to float
        Shape parameters to hold; defaults of the library where left out.

    Returns
    -------
    dict of str to method
        Those of `methods.METHODS` with their variants, in that order.
    """
    given = {"reference_frequency": reference_frequency, "shapes": dict(shapes or {})}
    methods: dict[str, Method] = {}
    for kind in METHODS:
        taken = {option.name for option in fields(kind)}
        method = kind(**{name: value for name, value in given.items() if name in taken})
        methods[method.scope.label] = method
        for variant, options in method.scope.variants.items():
            methods[f"{method.scope.label} ({variant})"] = replace(method, **options)
    return methods


def compare(
    decay: Decays,
    library: ForceLibrary | None = None,
    methods: Methods | None = None,
    *,
    contactless: tuple[float, float] | None = None,
    constraints: ConstraintTable = NO_CONSTRAINTS,
    tell: Tell = silent,
) -> xr.DataTree:
    """Identify a decay by several methods, side by side, each tested on a part it has not seen.

    Parameters
    ----------
    decay : Dataset, or sequence of Dataset
        `angle(time)` in rad, as `free_decay` returns it; or a list of runs, as `identify` takes them. With
        inputs Direct and Trajectory alone identify it.
    library : ForceLibrary, optional
        The forces offered to every method; by default those of `contact_forces`.
    methods : sequence of methods, or Mapping of str to method, optional
        Labelled by their scope and options; or by label. By default every method of the field with its
        variants.
    contactless : (float, float), rad/s
        Frequency without contact and its standard error, which adds alpha.
    constraints : mapping of str to float, (float, float) or str
        What is held, bounded or tied, `{"lambda": 0, "zeta": (0, None), "nu": "-2.356*delta"}`, by every
        method; one that takes none keeps its row without numbers.
    tell : callable
        Called with a method's label before it starts.

    Returns
    -------
    DataTree
        Groups `record` (with `holdout_start`, s), `envelope` (`record_1`, `envelope_1`, `record_2`, ... of
        several runs), one identification of the whole decay (all runs) per method that gave one, named by its
        label, and `comparison`. That has, over `method` and `force`: `coefficient`, `standard_error` (nan
        where not identified) at the one `common_frequency` (rad/s), and `z`, the difference from the method
        that predicts best over the errors of both, taken as independent. Over `method`:
        `reference_frequency`, `asymptotic_frequency` (rad/s) with errors, `asymptotic_frequency_z`;
        `residual_rms`, `train_rms`, `holdout_rms` (rad) and each over the noise; `phase_error` (rad);
        `holdout_p_value` of the difference from the best (Diebold-Mariano test); `time_taken` (s); the texts
        `reason`, `bias`, `identifies`, `neglects`, `cannot_tell_apart`, `assumes`, `family`; and whether
        errors hold in `white_noise` only. Of several runs also `run_noise(run)` and, over `method` and `run`,
        `run_residual_rms`, `run_train_rms`, `run_holdout_rms` (rad). A method is chosen by
        `sel({"method": label})`: `method=` is an argument of xarray's own.

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
    centre was found on the whole. One noise for all: the sensor's (see `sensor_noise`).
    A method that does not apply keeps its row: nan, and why in `reason`.

    Of several runs the last third of each is held out. RMS are over the runs, whatever their lengths; over
    the noise, each run's RMS is over its own. Methods that take one record at a time have no numbers.
    """
    library = load_library() if library is None else library
    if not isinstance(library, ForceLibrary):
        raise UsageError(f"compare wants a ForceLibrary, not {library!r}: load_library('contact_forces').")
    named = _by_label(every_method() if methods is None else methods)
    return _compared(decay, library, named, contactless, constraints, tell)


@in_units_of_the_motion
def _compared(
    decay: Decays,
    library: ForceLibrary,
    named: Mapping[str, Method],
    contactless: tuple[float, float] | None,
    constraints: ConstraintTable,
    tell: Tell,
) -> xr.DataTree:
    runs = [RunInParts(run, *split(run), envelope(run)) for run in as_runs(decay, driven=True)]
    groups = dict(zip(group_names("record", len(runs)), [run.record for run in runs], strict=True))
    groups |= dict(zip(group_names("envelope", len(runs)), [run.envelope for run in runs], strict=True))
    if taken := sorted(set(groups) & set(named)):
        raise UsageError(f"'{taken[0]}' is the name of a run; label the method otherwise.")
    driven = is_driven([run.decay for run in runs])
    if driven:
        for run in runs:
            inputs_for(run.decay, library)
    # In driven records a random force is asked for, not looked for.
    named = (
        {label: with_noise(method, "off") for label, method in named.items()}
        if driven
        else with_common_noise(decay, library, named)
    )
    trials = []
    for at, (label, method) in enumerate(named.items()):
        tell(label, at / len(named))
        trials.append(try_method(label, method, runs, library, contactless, Constraints(constraints)))
    results = {trial.label: trial.result for trial in trials if trial.result is not None}
    if not results:
        subject = "this record" if len(runs) == 1 else "these runs together"
        raise DecayError(f"No method can identify {subject}. {trials[0].label}: {trials[0].reason}.")
    table = method_table(trials, [run.noise for run in runs], [run.block for run in runs])
    table.attrs["noise_from"] = "a least-squares spline"
    if driven:
        # A driven motion may have what no spline follows: what is left at that noise need not be noise.
        of_runs = {trial.label: trial.whole.runs for trial in trials}[table.attrs["best"]]
        p_value = len(of_runs) * min((white_p_value(run.residual) for run in of_runs), default=0.0)
        table.attrs["white_residual"] = "yes" if p_value >= WHITE_LEVEL else "no"
    table.attrs |= _not_separable(runs, list(results.values()), library)
    return xr.DataTree.from_dict({**groups, **results, "comparison": table})


def _by_label(methods: Methods) -> dict[str, Method]:
    """Methods by a unique label that may be the name of a group in a netCDF file."""
    pairs = list(methods.items()) if isinstance(methods, Mapping) else [("", method) for method in methods]
    if not pairs:
        raise UsageError("compare wants at least one method, such as methods.Direct().")
    by_label: dict[str, Method] = {}
    for name, method in pairs:
        check_method(method, "compare")
        same = [other for _, other in pairs if type(other) is type(method)]
        label = " ".join(str(name).replace("/", "-").split()) or _label(method, same)
        label = f"{label} (method)".strip() if label in RESERVED else label
        number, unique = 1, label
        while unique in by_label:
            number += 1
            unique = f"{label} {number}"
        by_label[unique] = method
    return by_label


def _label(method: Method, same: Sequence[Method]) -> str:
    """Label of a method, with the options in which it differs from others of it and from the default."""
    options = []
    all_options: tuple[Field[Any], ...] = fields(method) if is_dataclass(method) else ()
    for option in all_options:
        value = getattr(method, option.name)
        default = option.default_factory() if callable(option.default_factory) else option.default
        alike = all(repr(getattr(other, option.name)) == repr(value) for other in same)
        if not alike and repr(value) != repr(default):
            options.append(_option(option.name.replace("_", " "), value))
    label = scope_of(method).label
    return f"{label} ({', '.join(options)})".replace("/", "-") if options else label


def _option(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return name if value else f"not {name}"
    return f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"


def _not_separable(
    runs: Sequence[RunInParts], results: Sequence[xr.Dataset], library: ForceLibrary
) -> dict[str, str]:
    """Forces that no method separates, or identifies, on these runs; as attrs."""
    widest = max(results, key=lambda result: result.sizes["force"])
    identified = {symbol for result in results for symbol in result.force.values.tolist()}
    force = library.role("x") or library_of(widest, whole=True).role("x")
    stiffness = "" if force is None else force.symbol
    unseen = [s for s in library.symbols if s not in identified and s != stiffness]
    return ties([run.decay for run in runs], widest) | {
        "no_method_identifies": ", ".join(unseen),
        "exchangeable_with_the_frequency": "" if stiffness in identified else stiffness,
    }
