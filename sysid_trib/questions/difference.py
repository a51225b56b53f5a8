"""Comparison of two samples: differences of coefficients, their size and significance."""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any, overload

import numpy as np
import scipy
import xarray as xr

from sysid_trib import forces, records
from sysid_trib.arrays import Array, Mask
from sysid_trib.cycles.backbone import backbone
from sysid_trib.errors import DecayError, Tell, UsageError, silent
from sysid_trib.forces.constraints import NO_CONSTRAINTS, ConstraintTable
from sysid_trib.forces.force import ForceLibrary, LibraryLike
from sysid_trib.forces.library import load_library
from sysid_trib.methods import method_of, scope
from sysid_trib.records.inputs import inputs_of
from sysid_trib.records.runs import RecordsLike, as_runs, one_or_all
from sysid_trib.results import signal_scale
from sysid_trib.results.effects import at_bound
from sysid_trib.results.judged import error_parts, main_result
from sysid_trib.results.kinds import SIDES
from sysid_trib.results.models import forces_in_model, library_of
from sysid_trib.results.variables import PARTS_OF_RECORD, Variables, described, group_names, signal_units
from sysid_trib.validation import random_effects, refits
from sysid_trib.validation.cross_check import HOMOGENEITY_LEVEL
from sysid_trib.validation.driven import is_driven, tested_driven
from sysid_trib.validation.identify import identify, usual_methods
from sysid_trib.validation.model_error import covariance_by_parts, part_fit
from sysid_trib.validation.residuals import FollowedRuns, residuals, with_motions
from sysid_trib.validation.verdict import judged_models

Identified = xr.Dataset | xr.DataTree


@overload
def difference(  # type: ignore[overload-overlap]
    first: Identified | Sequence[Identified],
    second: Identified | Sequence[Identified],
    *,
    level: float = ...,
) -> xr.Dataset: ...


@overload
def difference(
    first: RecordsLike,
    second: RecordsLike,
    library: LibraryLike | None = ...,
    *,
    level: float = ...,
) -> xr.DataTree: ...


def difference(
    first: Any, second: Any, library: LibraryLike | None = None, *, level: float = HOMOGENEITY_LEVEL
) -> xr.Dataset | xr.DataTree:
    """Return the difference of two samples: a contact and none, or two materials.

    Parameters
    ----------
    first, second : Dataset, DataTree, or a sequence of them; or records
        Identifications of different records, or results of `identify`; several are runs of one sample, each
        identified separately. A force that a sample lacks is zero there. Records, `(t, angle)` or results of
        `free_decay`, are identified first.
    library : ForceLibrary, str, or what `library` takes, optional
        The forces offered to records; by default those of `contact_forces`.
    level : float
        Significance level for all forces together (Holm 1979).

    Returns
    -------
    Dataset, or of records a DataTree with it at its root
        Over `force`: `first`, `second` with their `first_standard_error`, ..., both at the reference
        frequency of the first (coefficients held in all are unchanged and not tested); `first_between_runs`,
        ... (scatter beyond the errors; nan for a single run); `difference` first - second, its
        `standard_error`, `z`, `p_value`, whether it `differs`, and `covariance(force, other_force)`; nan for
        a force without a degree in v if the frequencies differ by more than 1 %. Scalars:
        `stiffness_difference`, the ratio of stiffnesses at vanishing amplitude minus 1, with its standard
        error (if the second sample has no contact, it is the paper's alpha, which is defined by frequencies,
        up to the square of zeta); `chi_square` of all differences, `degrees_of_freedom`, `p_value_of_all`;
        `reference_frequency` (rad/s). Attributes: `verdict`, one of `coefficients differ`,
        `together they differ`, `no difference`; `at_a_bound`, coefficients at a bound in one of the runs,
        which are not tested. For records also the groups of `held_against`.

    Raises
    ------
    UsageError
        An argument is neither an identification nor a record, or the records are in different units.

    Notes
    -----
    The samples share no noise, so covariances add, including those of the frequencies. Runs of a sample have
    an additional scatter (random effects, Paule and Mandel 1982); the error of the model is common to them.

    Examples
    --------
    Two samples that differ in viscous friction alone.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> time, noise = np.arange(0.0, 10.0, 0.02), np.random.default_rng(0)
    >>> models = [st.Model("contact_forces", {"zeta": zeta, "delta": 0.05}, 9.91) for zeta in (0.01, 0.012)]
    >>> angles = [st.simulate(model, time, 0.3).angle + noise.normal(0.0, 1e-4, 500) for model in models]
    >>> contrast = st.difference(*angles, "zeta,delta")
    >>> contrast.difference.sel(force="zeta").round(4).item(), contrast.differs.values.tolist()
    (-0.002, [True, False])
    """
    given = [_is_identified(side) for side in (first, second)]
    if all(given) and library is not None:
        raise UsageError(
            "difference takes a library only with records; identifications contain their library."
        )
    if any(given) and not all(given):
        raise UsageError(
            "difference takes two identifications or two records, not one of each; identify the record first."
        )
    if all(given):
        return _of_identifications([_identifications(side) for side in (first, second)], level)
    sides = [as_runs(records.as_decays(side, "difference")) for side in (first, second)]
    offered = load_library() if library is None else forces.as_library(library, "difference")
    method = usual_methods([*sides[0], *sides[1]], offered)[-1]
    return held_against(sides[0], sides[1], offered, method, level=level)


def _is_identified(side: Any) -> bool:
    """Return true if a sample is given by results and not by records."""
    first = side[0] if isinstance(side, list | tuple) and side else side
    return isinstance(first, xr.DataTree) or (isinstance(first, xr.Dataset) and "coefficient" in first)


@signal_scale.in_units_of_the_motion
def _of_identifications(sides: Sequence[Sequence[xr.Dataset]], level: float) -> xr.Dataset:
    """Return the contrast of identified samples."""
    return _difference(sides, level)


def _difference(
    sides: Sequence[Sequence[xr.Dataset]], level: float, of_model: Array | None = None
) -> xr.Dataset:
    """Compute `difference`; `of_model` is the covariance of the differences due to both incomplete models."""
    if len({signal_units(result) for side in sides for result in side}) > 1:
        raise UsageError("The samples are in different units; read all records in one (--units).")
    reference = sides[0][0].reference_frequency.item()
    members = [member for side in sides for member in side]
    symbols = list(dict.fromkeys(s for member in members for s in forces_in_model(member)))
    free = {s for m in members for s in m.force.values[m.standard_error.values != 0.0].tolist()}
    held = [s for s in symbols if s not in free and all(s in member.force for member in members)]
    samples = []
    for side in sides:
        runs = [_run(result, symbols, reference, held) for result in side]
        of_runs, by_noise, by_model = (np.array(part) for part in zip(*runs, strict=True))
        samples.append((*random_effects.mean_of_runs(of_runs, by_noise), by_model.mean(axis=0)))
    values, by_noise, between, freedoms, by_model = map(np.array, zip(*samples, strict=True))
    # An estimate at a bound can move to one side only, so no test uses it.
    bounded = {symbol for member in members for symbol in at_bound(member)}
    testable = np.array([symbol not in bounded for symbol in symbols])
    variables = _contrast(values, by_noise, by_model, freedoms, testable, level=level, of_model=of_model)
    verdict = "together they differ" if variables["p_value_of_all"][1] < level else "no difference"
    attrs: dict[str, object] = {
        "verdict": "coefficients differ" if variables["differs"][1].any() else verdict,
        "level": level,
        "signal_units": signal_units(sides[0][0]),
        "at_a_bound": ", ".join(symbol for symbol in symbols if symbol in bounded),
    }
    # A sample may lack the viscous force of the other.
    factors = {s: f for member in members for s, f in library_of(member).damping_factors.items()}
    damping = np.array([factors.get(symbol, 0.0) for symbol in symbols]) * reference
    stiffness = _stiffness_difference(values, by_noise + by_model, damping)
    errors = np.sqrt(np.diagonal(by_noise + by_model, axis1=1, axis2=2))
    stated: dict[str, object] = {"stiffness_difference": stiffness}
    for at, (name, side) in enumerate(zip(SIDES, sides, strict=True)):
        stated[name] = values[at, :-1], errors[at, :-1]
        stated[f"{name}_between_runs"] = between[at, :-1]
        attrs[f"{name}_record"] = [source for result in side for source in result.attrs["record_source"]]
        attrs[f"{name}_method"] = ", ".join(dict.fromkeys(str(member.attrs["method"]) for member in side))
    variables |= described("difference", stated | {"reference_frequency": reference})
    coords: dict[str, Any] = {"force": symbols, "other_force": symbols}
    for label in ("name", "unit"):
        texts = {symbol: text for member in members for symbol, text in _labels(member, label).items()}
        coords[label] = "force", [texts[symbol] for symbol in symbols]
    return xr.Dataset(variables, coords, attrs)


def _labels(result: xr.Dataset, label: str) -> dict[str, str]:
    """Return a text for each force: its `name`, or the `unit` of its coefficient."""
    return dict(zip(result.force.values.tolist(), result[label].values.tolist(), strict=True))


def _stiffness_difference(values: Array, covariances: Array, damping: Array) -> tuple[float, float]:
    """Return the ratio of the stiffnesses at vanishing amplitude, minus 1, and its error.

    The stiffness over the inertia is w_inf^2 + (zeta w)^2: viscous friction lowers the frequency, not the
    stiffness. `damping` : zeta w per unit of each coefficient, (force,); the others are (sample, quantity,
    ...).
    """
    weights = np.append(damping, 1.0) ** 2
    # A force without a degree is unknown at another frequency and is ignored.
    values = np.where(weights > 0.0, values, 0.0)
    squared, gradients = values**2 @ weights, 2.0 * weights * values
    variances = np.einsum("sa,sab,sb->s", gradients, covariances, gradients) / squared**2
    ratio = float(squared[0] / squared[1])
    return ratio - 1.0, ratio * float(np.sqrt(variances.sum()))


def _identifications(side: Identified | Sequence[Identified]) -> list[xr.Dataset]:
    """Return the identifications of a sample, one per run."""
    given = list(side) if isinstance(side, list | tuple) else [side]
    results = [main_result(member) if isinstance(member, xr.DataTree) else member for member in given]
    kept = [result for result in results if isinstance(result, xr.Dataset) and "coefficient" in result]
    if not kept or len(kept) < len(results):
        raise UsageError("difference needs two identifications, or lists of them, as identify returns them.")
    return kept


def _run(
    result: xr.Dataset, symbols: Sequence[str], reference: float, held: Sequence[str] = ()
) -> tuple[Array, Array, Array]:
    """Return values of a run, and their covariances due to noise and model; zero for missing forces."""
    (values,), (covariance,) = refits.at_reference([result], symbols, reference, 0.0)
    for place in map(symbols.index, held):
        values[place] = result.coefficient.sel(force=symbols[place]).item()
        covariance[place], covariance[:, place] = 0.0, 0.0
    # A result has both parts of its errors, but their correlations only together.
    kept, part = forces_in_model(result), np.ones(len(symbols) + 1)
    at = list(map(symbols.index, kept))
    of_noise, of_model = (error[np.isin(result.force.values, kept)] for error in error_parts(result))
    total = np.hypot(of_noise, of_model)
    part[at] = np.divide(of_noise, total, out=part[at], where=total > 0.0)
    by_noise = covariance * np.outer(part, part)
    # A force without a degree in v keeps its size, but its shape changes with the frequency. Compare it only
    # if the frequencies differ by less than this fraction.
    if abs(result.reference_frequency.item() / reference - 1.0) > 0.01:
        degrees = result.speed_degree.sel(force=kept).values
        values[[at[k] for k in np.flatnonzero(np.isnan(degrees))]] = np.nan
    return values, by_noise, covariance - by_noise


def _contrast(
    values: Array,
    by_noise: Array,
    by_model: Array,
    freedoms: Array,
    testable: Mask,
    *,
    level: float,
    of_model: Array | None,
) -> Variables:
    """Return the differences of the forces with their tests, and the `mean_of_runs` of both samples.

    `testable` : forces that the tests may use, (force,).
    """
    contrast, errors = values[0] - values[1], np.diagonal(by_noise + by_model, axis1=1, axis2=2)
    covariance = by_noise.sum(axis=0) + (by_model.sum(axis=0) if of_model is None else of_model)
    tested = np.any(errors > 0.0, axis=0)
    covariance *= np.outer(tested, tested)
    error = np.sqrt(np.diag(covariance))
    z = np.divide(contrast, error, out=np.full_like(contrast, np.nan), where=error > 0.0)
    parts = np.sum(np.diagonal(by_noise, axis1=1, axis2=2) ** 2 / freedoms, axis=0)
    known_by = np.divide(error**4, parts, out=np.full_like(error, np.inf), where=parts > 0.0)
    # The frequency is not a force.
    contrast, error, z, covariance = contrast[:-1], error[:-1], z[:-1], covariance[:-1, :-1]
    p_value, known = 2.0 * scipy.stats.t.sf(np.abs(z), known_by[:-1]), np.isfinite(z) & testable
    weights = covariance[known][:, known] / np.outer(error[known], error[known])
    statistic = float(z[known] @ np.linalg.pinv(weights, hermitian=True) @ z[known])
    values_of = {"difference": contrast, "standard_error": error, "z": z, "p_value": p_value}
    values_of |= {"differs": _holm(np.where(testable, p_value, np.nan), level), "covariance": covariance}
    values_of |= {"chi_square": statistic, "degrees_of_freedom": float(known.sum())}
    values_of |= {"p_value_of_all": scipy.stats.chi2.sf(statistic, known.sum())}
    return described("difference", values_of)


def _holm(p_values: Array, level: float) -> Mask:
    """Return the mask of rejected hypotheses at a common level (Holm 1979); nan is not rejected."""
    order = np.argsort(p_values)[: np.count_nonzero(np.isfinite(p_values))]
    refused = np.zeros(len(p_values), dtype=bool)
    refused[order] = np.logical_and.accumulate(p_values[order] <= level / np.arange(len(order), 0, -1))
    return refused


@signal_scale.in_units_of_the_motion
def _held_apart(
    sides: Sequence[Sequence[xr.Dataset]],
    runs: Sequence[Sequence[xr.Dataset]],
    library: ForceLibrary,
    level: float,
) -> xr.Dataset:
    """Compute `difference` with the change of the differences between parts as the error of the model.

    A force missing in both samples changes both in the same way, but not their difference.
    """
    return _difference(sides, level, _model_error_of_difference(sides, runs, library))


def _model_error_of_difference(
    sides: Sequence[Sequence[xr.Dataset]], runs: Sequence[Sequence[xr.Dataset]], library: ForceLibrary
) -> Array | None:
    """Return the model's covariance of the differences; None if all explain, or no part can be fitted."""
    if not any("error_of_model" in result for side in sides for result in side):
        return None
    reference, symbols = sides[0][0].reference_frequency.item(), forces_in_model(sides[0][0])
    if any(forces_in_model(result) != symbols for side in sides for result in side):
        return None

    def contrast(of: Sequence[Sequence[xr.Dataset]]) -> tuple[Array, Array]:
        """Return first minus second sample, as means over the runs, and the errors due to noise."""
        means, variances = [], []
        for side in of:
            values, covariances, _ = zip(*(_run(member, symbols, reference) for member in side), strict=True)
            means.append(np.mean(values, axis=0))
            variances.append(np.diag(np.mean(covariances, axis=0)) / len(side))
        return means[0] - means[1], np.sqrt(variances[0] + variances[1])

    (whole, stated), changes, errors = contrast(sides), [], []
    for limits in PARTS_OF_RECORD.values():
        parts = [
            [part_fit(method_of(m), [run], library, limits, m) for m, run in zip(side, of_side, strict=True)]
            for side, of_side in zip(sides, runs, strict=True)
        ]
        fitted = [[part for part in of_side if part is not None] for of_side in parts]
        if [*map(len, fitted)] == [*map(len, sides)]:
            change, error = contrast(fitted)
            changes.append(change - whole)
            errors.append(error)
    return covariance_by_parts(changes, errors, stated) if changes else None


def held_against(
    first: Sequence[xr.Dataset],
    second: Sequence[xr.Dataset],
    library: ForceLibrary,
    method: scope.Method,
    *,
    constraints: ConstraintTable = NO_CONSTRAINTS,
    level: float = HOMOGENEITY_LEVEL,
    tell: Tell = silent,
) -> xr.DataTree:
    """Identify each run of two samples by one method, and compare the samples.

    Parameters
    ----------
    first, second : sequence of Dataset
        Decays, the runs of each sample. Driven runs of a sample are identified together, because one run
        alone does not separate the effects of joint, load and motor.
    library : ForceLibrary
    method : Method
    constraints : mapping
        Constraints, see `identify`.
    level : float
        Significance level, see `difference`.
    tell : callable
        Called with a few words on the progress of the work.

    Returns
    -------
    DataTree
        `difference` at its root. The groups `sample_first`, ... (for several runs `sample_first_1`, ...) are
        the identifications; `backbone_first`, ... are frequency and damping ratio of each record without a
        model, if it has enough half periods; `record_1`, ... are the records of both, with the
        `simulated_angle` of their models; `judged` over `model`, the names of the identifications, as in a
        result of `identify`.
    """
    driven = any(inputs_of(run) for run in (*first, *second))
    results: dict[str, list[xr.Dataset]] = {name: [] for name in SIDES}
    groups: dict[str, xr.Dataset] = {}
    records_of: list[xr.Dataset] = []
    tables: list[xr.Dataset] = []
    for name, runs in zip(SIDES, (first, second), strict=True):
        together = [list(runs)] if driven else [[run] for run in runs]
        for label, some in zip(group_names(name, len(together)), together, strict=True):
            tell(f"the {label.replace('_', ' ')} record")
            result = identify(one_or_all(some), library, method, constraints=constraints)
            results[name].append(result)
            groups[f"sample_{label}"] = result
            with_model, table = _judged(f"sample_{label}", some, result)
            records_of += with_model
            tables.append(table)
            # A record with few half periods, or a driven record, has no backbone.
            with suppress(DecayError, UsageError):
                groups[f"backbone_{label}"] = backbone(some[0])
    one_a_result = (first[:1], second[:1]) if driven else (first, second)
    groups["/"] = _held_apart([*results.values()], one_a_result, library, level)
    groups |= dict(zip(group_names("record", len(records_of)), records_of, strict=True))
    groups["judged"] = xr.concat(tables, "model", combine_attrs="drop").assign_attrs(made_by="difference")
    return xr.DataTree.from_dict(groups)


def _judged(name: str, runs: Sequence[xr.Dataset], result: xr.Dataset) -> tuple[list[xr.Dataset], xr.Dataset]:
    """Return the runs of a sample with the motions of its model, and the judgement on them."""
    followed = {name: FollowedRuns(dict(enumerate(runs)), result)}
    with_model = with_motions(followed)
    tested = tested_driven(followed) if is_driven(runs) else residuals(followed, result)
    table = judged_models(followed, with_model, tested, preferred=name, made_by="difference")
    # Samples may have different numbers of runs.
    return with_model, table.drop_dims("run", errors="ignore")
