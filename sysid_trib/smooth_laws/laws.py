"""`laws`: friction against speed and restoring force against displacement, without choosing a form."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sysid_trib import forces, records
from sysid_trib.arrays import Array
from sysid_trib.errors import SysidTribError, Tell, UsageError, silent
from sysid_trib.forces.constraints import NO_CONSTRAINTS, Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary, LibraryLike
from sysid_trib.forces.offered import with_inputs_acting
from sysid_trib.forces.systems import System, load_system
from sysid_trib.likelihood.random_force import RandomForceOption
from sysid_trib.methods import Averaging, Direct
from sysid_trib.records.half_sines import envelope
from sysid_trib.records.inputs import inputs_of
from sysid_trib.records.runs import Decays, RecordsLike, as_runs
from sysid_trib.records.smoothing import clock_of, swing_frequency
from sysid_trib.results import signal_scale
from sysid_trib.results.law_curves import (
    EXPLAINING_OWN,
    NAME_IN_FORMULAS,
    OWN_LAWS,
    PASSIVE,
    PASSIVE_DEFICIT,
    VARIABLE_OF_LAW,
    odd_part,
)
from sysid_trib.results.variables import PARTS_OF_RECORD, Variables, described, group_names
from sysid_trib.smooth_laws import bands, curves
from sysid_trib.smooth_laws.fits import (
    SENSOR_TERMS,
    LawFit,
    explaining_own_laws,
    extended,
    fitted,
    fitted_to_driven,
    refitted,
)
from sysid_trib.smooth_laws.formulas import law_formulas
from sysid_trib.smooth_laws.interaction import interaction, readings
from sysid_trib.smooth_laws.model import LawModel, law_model, smallest_part, why_no_curve
from sysid_trib.smooth_laws.predictions import with_predictions
from sysid_trib.validation import cross_check, judge, model_error
from sysid_trib.validation.driven import is_driven
from sysid_trib.validation.refits import between
from sysid_trib.validation.residuals import FollowedRuns, residuals, with_motions

# A residual that exceeds this multiple of the other method's is far larger.
FAR_WORSE = 2.0
# Range that two parts of the record reach, for the variable of a law.
TWICE = {"speed": "speed of two parts", "displacement": "displacement of two parts"}


def laws(
    decay: RecordsLike,
    system: str | System | None = None,
    constraints: ConstraintTable | None = None,
    *,
    library: LibraryLike | None = None,
    random_force: RandomForceOption = "off",
    own: Sequence[str] = (),
    passive: bool = False,
    tell: Tell = silent,
) -> xr.DataTree:
    """Identify friction as a function of speed and restoring force as a function of displacement.

    Parameters
    ----------
    decay : record, or several of them
        `angle(time)` from `free_decay`, or `(t, angle)`; several runs have common laws.
    system : str or System, optional
        A system of `libraries/systems.toml`: its fixed forces, such as a pendulum's gravity, stay fixed, and
        its usual forces have no penalty.
    constraints : mapping of str to float, (float, float) or str, optional
        Known forces: `{"gravity": 1.0}`.
    library : ForceLibrary, str, or what `library` takes, optional
        Library of the constrained forces (searched before those of the package) and of the forces in formulas
        within the bands.
    random_force : "off", "estimated" or float
        As for `methods.Direct`.
    own : sequence of str
        Laws that are separate for each run, `friction` or `restoring`, and symbols of such named forces;
        other laws are common. Fitted by `direct`, for driven records also by `trajectory`.
    passive : bool
        True if friction must dissipate energy at every speed; where it would not, it is set to zero.
    tell : callable
        Function that is given a few words on the current activity.

    Returns
    -------
    DataTree
        As for `identify`: groups `record`, `averaging`, `direct`, `judged`, `agreement`, `backbone`. Each
        identification also contains `friction(speed)` (rad/s^2 over rad/s: the force over the inertia) and
        `restoring(displacement)` (rad/s^2 over rad), each with `_standard_error`, `_low`, `_high` (a
        simultaneous 95 % band over the visited range), `_error_of_model` and `_covariance`; `speed_visited`,
        `displacement_visited`. `agreement` contains the difference between both methods' laws over its error
        at each speed and displacement. The attrs of `judged` state the preferred method (`preferred`), the
        decisions on even parts (`even`) and errors of the sensor (`sensor`), and the `reason` if the record
        determines no curve. If sums of up to three library forces stay within the band, there are groups
        `friction_formulas` and `restoring_formulas` (see `physics.law_formulas`), with the residuals of each
        formula and of the laws on the held-out last third. If the force is not the sum of both laws there is
        a group `interaction`, otherwise `readings`, which states whether the record separates a law from
        products of speed and displacement. With `own`, the laws of the identifications are the means over the
        runs, and the group `own_laws` contains those of each run: `friction(run, speed)`, ... by the
        preferred method.

    Raises
    ------
    DecayError
        The record cannot support the request.
    UsageError
        There is no such system or force, an angle's force is given for a displacement, or one run has `own`
        laws.

    Notes
    -----
    theta'' = -w^2 (theta + K(theta) + D(theta'/w) + known forces). K and D are penalised splines in mixed
    model form; the named forces are not penalised (Ruppert, Wand & Carroll 2003). `Direct` identifies the
    laws from the motion within the cycle, averaging from the change between amplitudes.

    Examples
    --------
    The friction of this model is 2 zeta w times the speed, 0.2 of it.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.01}, 10.0)
    >>> angle = st.simulate(model, np.arange(0.0, 8.0, 0.02), angle=0.3).angle
    >>> result = st.laws(angle + np.random.default_rng(0).normal(0.0, 1e-4, 400))
    >>> st.best(result).friction.interp(speed=[1.0, 2.0]).round(2).values.tolist()
    [0.2, 0.4]
    """
    moving = system if isinstance(system, System) else load_system(system)
    offered = None if library is None else forces.as_library(library, "laws")
    model = law_model(moving, Constraints(constraints or NO_CONSTRAINTS), offered)
    given = records.as_decays(decay, "laws")
    runs = as_runs(given, driven=True)
    # An input acts by the first force that holds it, where none is named.
    acting = with_inputs_acting(model.named, list(inputs_of(runs[0])), offered or ())
    model = replace(model, named=acting)
    model = replace(model, own=_checked_own(own, model, len(runs)))
    if not signal_scale.counts_angles(runs[0]):
        for force in model.named:
            if not signal_scale.scalable(force):
                raise UsageError(
                    f"Force '{force.symbol}' is a function of an angle, but a displacement was measured; "
                    "leave it out, or give the pendulum's length, --length M."
                )
    tree = _identified(given, model, random_force, passive, offered, tell=tell)
    asked: dict[str, Any] = {
        "system": moving.name,
        "constraints": dict(constraints or {}),
        "random_force": random_force,
    }
    asked |= ({"own": list(own)} if own else {}) | ({"passive": True} if passive else {})
    tree["judged"].attrs["options"] = json.dumps(asked)
    return tree


def _checked_own(own: Sequence[str], model: LawModel, runs: int) -> tuple[str, ...]:
    """Return the laws and forces that are separate for each run; raise an error if they are impossible."""
    offered = [*VARIABLE_OF_LAW, *model.named.symbols]
    if misspelt := [name for name in own if name not in offered]:
        raise UsageError(f"'{misspelt[0]}' cannot be each run's own; there are {', '.join(offered)}.")
    if own and runs < 2:
        raise UsageError(f"Separate {own[0]} for each run needs several runs, but there is one; omit it.")
    return tuple(dict.fromkeys(own))


def _offering(candidates: ForceLibrary | None, law: str) -> ForceLibrary | None:
    """Return the library if formulas of a law can be made from its forces."""
    of = NAME_IN_FORMULAS[VARIABLE_OF_LAW[law]]
    if candidates is None or not any(force.depends_only_on(of) for force in candidates):
        return None
    return candidates


@signal_scale.in_units_of_the_motion
def _identified(
    decay: Decays,
    model: LawModel,
    random_force: RandomForceOption,
    passive: bool,
    candidates: ForceLibrary | None,
    *,
    tell: Tell,
) -> xr.DataTree:
    runs = as_runs(decay, driven=True)
    if is_driven(runs):
        return _identified_driven(runs, model, random_force, passive, tell=tell)
    amplitudes = np.concatenate([np.abs(envelope(run).extremum.values) for run in runs])
    if reason := why_no_curve(amplitudes):
        model = replace(model.without_curves, reason=reason)
    tell("direct")
    within_cycles = Direct(random_force=random_force, constraints=model.constraints)
    direct = fitted(runs, within_cycles, model)
    if not reason and not direct.is_white:
        tell("errors of the sensor, and even parts")
        direct = extended(direct)
    separate = None
    if len(runs) > 1 and not model.own and not direct.is_white:
        tell("whether the runs differ")
        separate = explaining_own_laws(runs, within_cycles, model)
    tell("averaging")
    # Averages contain no information on even forces, nor on a law far below the smallest amplitude.
    lowest = smallest_part(amplitudes)
    method = Averaging(random_force=random_force, constraints=model.constraints)
    fits: dict[str, LawFit] = {}
    failed = ""
    try:
        if model.own:
            raise UsageError("averaging cannot fit separate laws for each run")
        fits["averaging"] = fitted(runs, method, model.of_odd_forces, lowest)
    except (SysidTribError, np.linalg.LinAlgError) as error:
        failed = str(error)
    fits["direct"] = direct
    tell("errors")
    largest = _largest(runs)
    if passive:
        fits = {name: fit.made_passive(largest) for name, fit in fits.items()}
    tree = _tree(runs, {name: _with_laws(fit, largest) for name, fit in fits.items()}, fits, failed)
    if not tree["judged"].attrs["reason"]:
        tell("formulas within the bands")
        answer = tree["judged"].attrs["preferred"]
        preferred = tree[answer].to_dataset()
        listed = {law: law_formulas(preferred, law, _offering(candidates, law)) for law in VARIABLE_OF_LAW}
        tell("predictions of the formulas")
        for law, formulas in with_predictions(listed, fits[answer]).items():
            # netCDF does not store an empty dimension.
            if formulas.sizes["alternative"]:
                tree[f"{law}_formulas"] = xr.DataTree(formulas)
    if separate is not None:
        tree["judged"].attrs[EXPLAINING_OWN] = ", ".join(separate)
    if direct.model.odd and not direct.is_white and separate is None:
        tell("whether both laws add up")
        products = interaction(direct, largest)
        if products is not None:
            tree["interaction"] = xr.DataTree(products)
    if direct.model.odd and "interaction" not in tree.children and separate is None:
        tell("which readings the record separates")
        both = readings(direct, float(np.sqrt(amplitudes.min() * amplitudes.max())))
        if both is not None:
            tree["readings"] = xr.DataTree(both)
    return tree


def _identified_driven(
    runs: Sequence[xr.Dataset],
    model: LawModel,
    random_force: RandomForceOption,
    passive: bool,
    *,
    tell: Tell,
) -> xr.DataTree:
    """Identify the laws of driven records by Direct alone: they have no amplitudes for averaging."""
    method = Direct(random_force=random_force, constraints=model.constraints)
    if model.is_free_to_move:
        # The body does not swing: it has no restoring force, and the frequency only scales time.
        method = replace(method, reference_frequency=max(clock_of(run) for run in runs))
        model = replace(model, odd=tuple(name for name in model.odd if name.startswith("friction")))
    tell("direct")
    fits = {"direct": fitted_to_driven(runs, method, model)}
    largest = _largest(runs)
    if passive:
        fits["direct"] = fits["direct"].made_passive(largest)
    tell("trajectory")
    failed = ""
    try:
        trajectory = refitted(runs, fits["direct"])
        fits["trajectory"] = trajectory.made_passive(largest) if passive else trajectory
    except (SysidTribError, np.linalg.LinAlgError) as error:
        failed = str(error)
    tell("errors")
    of_fits = {name: _with_laws(fit, largest) for name, fit in fits.items()}
    return _tree(runs, of_fits, fits, failed)


def _largest(runs: Sequence[xr.Dataset]) -> dict[str, float]:
    """Return the largest displacement (rad) and speed (rad/s) of the runs."""
    w = max(clock_of(run) if is_driven([run]) else swing_frequency(run) for run in runs)
    ranges = curves.ranges(runs, w)
    return {"x": ranges["x"], "v": ranges["v"] * w}


class FitWithLaws(NamedTuple):
    """An identification with its laws, and the laws of each run if they are separate.

    Attributes
    ----------
    followed : FollowedRuns
    own : Dataset or None
        `friction(run, speed)`, ...
    """

    followed: FollowedRuns
    own: xr.Dataset | None


def _with_laws(fit: LawFit, largest: Mapping[str, float]) -> FitWithLaws:
    """Return the identification with its laws; their errors include that of the model if it was missing."""
    followed, result = fit.followed, fit.followed.result
    runs = list(followed.runs.values())
    parts: list[xr.Dataset] = []
    if not fit.is_white:
        of_parts = model_error.fitted_parts(runs, fit.method_of_parts, fit.library, result, later_only=True)
        parts = of_parts.results
        result = result.assign(described("identification", {"held_out_rms": of_parts.held_out_rms}))
    if parts:
        largest = {**largest, **_reached_twice(runs, largest)}
    values, places = _law_variables(result, parts, largest)
    own = None
    if fit.model.own:
        of_runs = [_law_variables(result, parts, largest, run) for run in enumerate(runs, 1)]
        own = xr.concat([xr.Dataset(values, places) for values, places in of_runs], "run", coords="minimal")
        own = own.assign_coords(run=np.arange(1, len(runs) + 1))
    return FitWithLaws(followed.with_result(result.assign_coords(places).assign(values)), own)


def _law_variables(
    result: xr.Dataset,
    parts: Sequence[xr.Dataset],
    largest: Mapping[str, float],
    run: tuple[int, xr.Dataset] | None = None,
) -> tuple[Variables, Variables]:
    """Return the laws of a run by its number, or of all runs, with the model error estimated from parts."""
    number = None if run is None else run[0]
    whole_laws = bands.laws_of(result, largest, number)
    if run is not None:
        reached = _largest([run[1]])
        whole_laws = [law.reached(reached[NAME_IN_FORMULAS[law.variable]]) for law in whole_laws]
    of_model = [np.zeros_like(law.covariance) for law in whole_laws]
    of_parts = [bands.laws_of(part, largest, number) for part in parts]
    if of_parts:
        of_model = [
            _movement(law, [laws[at] for laws in of_parts], largest[TWICE[law.variable]])
            for at, law in enumerate(whole_laws)
        ]
    return bands.law_variables(whole_laws, of_model)


def _reached_twice(runs: Sequence[xr.Dataset], largest: Mapping[str, float]) -> dict[str, float]:
    """Return the displacement (rad) and speed (rad/s) that at least two parts of the record reach."""
    parts = []
    for limits in PARTS_OF_RECORD.values():
        try:
            parts.append(_largest([run.isel(time=between(run, limits)) for run in runs]))
        except SysidTribError:
            # Too short to be smoothed, so that this part counts as reaching nothing.
            parts.append(dict.fromkeys(largest, 0.0))
    return {TWICE[name]: sorted(part[of] for part in parts)[-2] for name, of in NAME_IN_FORMULAS.items()}


def _movement(law: bands.Law, parts: Sequence[bands.Law], reached: float) -> Array:
    """Return the covariance of a law from its change between parts of the record, (place, place).

    Beyond the range of two parts, no change can be observed: there, the ratio of this error to the standard
    error of the noise is set to the largest ratio elsewhere.
    """
    changes = [part.values - law.values for part in parts]
    errors = [bands.standard_errors(part.covariance) for part in parts]
    own = bands.standard_errors(law.covariance)
    covariance = model_error.covariance_by_parts(changes, errors, own)
    by_movement = bands.standard_errors(covariance)
    seen = np.abs(law.places) <= reached
    ratios = np.divide(by_movement, own, out=np.zeros_like(by_movement), where=seen & (own > 0.0))
    lacking = np.where(seen, 0.0, np.maximum((ratios.max(initial=0.0) * own) ** 2 - by_movement**2, 0.0))
    # All largest speeds occur in the same first swings, so these errors are fully correlated.
    return covariance + np.sqrt(np.outer(lacking, lacking))


def _tree(
    runs: Sequence[xr.Dataset],
    of_fits: Mapping[str, FitWithLaws],
    fits: Mapping[str, LawFit],
    failed: str,
) -> xr.DataTree:
    """Return the result with the comparison of both methods' laws."""
    followed = {name: of.followed for name, of in of_fits.items()}
    names, results = list(followed), {name: of.result for name, of in followed.items()}
    second = results[names[-1]]
    records = with_motions(followed)
    table = judge.judged(records, results, residuals(followed, second))
    preferred = _preferred(results, table, driven=is_driven(runs))
    evidence = {name: judge.evidence_of(table.sel(model=name)) for name in names}
    table = judge.with_verdicts(table, evidence, preferred, "laws")
    table.attrs |= {
        "even": ", ".join(fits[names[-1]].model.even),
        "sensor": ", ".join(s for s in SENSOR_TERMS if s in fits[names[-1]].model.named.symbols),
        "reason": fits[preferred].model.reason,
        "averaging_failed": failed,
    }
    if PASSIVE in results[preferred].attrs:
        table.attrs |= {name: results[preferred].attrs[name] for name in (PASSIVE, PASSIVE_DEFICIT)}
    groups: dict[str, Any] = dict(zip(group_names("record", len(runs)), records, strict=True))
    groups |= results | {"judged": table}
    if len(names) == 2:
        groups["agreement"] = _difference(results[names[0]], second)
    own = of_fits[preferred].own
    if own is not None:
        groups[OWN_LAWS] = own.assign_attrs(names=", ".join(fits[preferred].model.own))
    if not is_driven(runs):
        of_envelopes = [envelope(run) for run in runs]
        groups |= dict(zip(group_names("envelope", len(runs)), of_envelopes, strict=True))
        groups |= cross_check.backbones_of(runs, results)
    return xr.DataTree.from_dict(groups)


def _preferred(results: Mapping[str, xr.Dataset], table: xr.Dataset, *, driven: bool) -> str:
    """Choose the preferred method: by the held-out prediction if a residual is more than noise."""
    names = list(results)
    missed = {name: float(table.tested_rms.sel(model=name)) for name in names}
    held_out = [float(results[name].get("held_out_rms", np.nan)) for name in names]
    whole = all("held_out_rms" in result for result in results.values())
    if driven or (whole and not np.all(np.isfinite(held_out))):
        least = min(missed.values(), key=lambda rms: np.nan_to_num(rms, nan=np.inf))
        # A method whose parts predict no motion is not chosen, unless the other's residual is far larger.
        known = [
            name
            for name, rms in zip(names, held_out, strict=True)
            if np.isfinite(rms) and missed[name] <= FAR_WORSE * least
        ]
        offered = names if driven or not known else known
        return min(offered, key=lambda name: np.nan_to_num(missed[name], nan=np.inf))
    return names[cross_check.better_of(*results.values())] if len(names) == 2 else names[0]


def _difference(first: xr.Dataset, second: xr.Dataset) -> xr.Dataset:
    """Return the difference of both methods' laws over its error, for the odd parts that both identify.

    Both methods use the same noise: the sum of their variances exceeds the variance of their difference.
    """
    values: dict[str, Any] = {}
    for law in VARIABLE_OF_LAW:
        averaged, other = xr.align(odd_part(first, law), odd_part(second, law))
        error = np.hypot(averaged[f"{law}_standard_error"], other[f"{law}_standard_error"])
        values[f"{law}_difference"] = (averaged[law] - other[law]).assign_attrs(units="rad/s^2")
        values[f"{law}_z"] = ((averaged[law] - other[law]) / error).assign_attrs(units="1")
    return xr.Dataset(values)
