"""Search for missing effects: compare model and record, name the missing effect, add it, and repeat."""

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sysid_trib import forces, records
from sysid_trib.arrays import root_mean_square
from sysid_trib.discovery import parts, to_xarray
from sysid_trib.discovery.engine import start_model
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.trials import DEFAULTS, Settings
from sysid_trib.discovery.fits import Fits, evidence
from sysid_trib.discovery.free_motion import free_motions
from sysid_trib.discovery.law_rival import LawPrediction, held_out_by_laws
from sysid_trib.discovery.motion_fits import (
    MOST_COMPUTED,
    Budget,
    MotionFits,
    decimated_run,
    swing_frequency_of,
)
from sysid_trib.discovery.motion_groups import groups_of_motions, held_out_of
from sysid_trib.discovery.motion_search import search_by_motions
from sysid_trib.discovery.plain_start import PlainStart, plain_start, residual_of_motions
from sysid_trib.discovery.search import Search, search, with_steps
from sysid_trib.discovery.unseen import RecordPart, predicted, search_parts, start_forces
from sysid_trib.errors import Tell, UsageError, silent
from sysid_trib.forces.constraints import NO_CONSTRAINTS, Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary, LibraryLike
from sysid_trib.forces.library import load_library
from sysid_trib.forces.offered import further_forces, offered_forces, viscous_model
from sysid_trib.forces.selection import is_free_to_move, known_coefficients
from sysid_trib.methods.direct import Direct
from sysid_trib.records import smoothing
from sysid_trib.records.inputs import inputs_for, inputs_of
from sysid_trib.records.runs import Decays, RecordsLike, as_runs, one_or_all
from sysid_trib.records.signal import NOISE_IS_WHITE_IN
from sysid_trib.results import effects, judged, schema, signal_scale, variables
from sysid_trib.results.judged import SEARCH_OUTCOME
from sysid_trib.validation.cross_check import CLEARLY_BETTER
from sysid_trib.validation.holdout import diebold_mariano


def discover(
    decay: RecordsLike,
    model_forces: LibraryLike | None = None,
    candidates: LibraryLike | None = None,
    *,
    reference_frequency: float | None = None,
    constraints: ConstraintTable = NO_CONSTRAINTS,
    max_effects: int | None = None,
    holdout: RecordsLike = (),
    refit: bool = False,
    level: float | None = None,
    seed: int | None = None,
    time_limit: float = np.inf,
    settings: Settings = DEFAULTS,
    tell: Tell = silent,
) -> xr.DataTree:
    """Find, name and add the forces that a model lacks to explain a decay, or runs of one experiment.

    Parameters
    ----------
    decay : record, or several of them
        `angle(time)` as `free_decay` returns it, `(t, angle)`, or a list of runs; driven records with their
        inputs.
    model_forces : ForceLibrary, str, or what `library` takes, optional
        The forces of the start model; by default viscous friction and the forces of known inputs.
    candidates : ForceLibrary, str, or what `library` takes, optional
        Effects that may be missing; by default the other forces of `contact_forces`, and `candidate_effects`;
        for a driven record also the other forces of its inputs. Effects that the model has, or whose input
        the records lack, are not offered; the result names them.
    reference_frequency : float, rad/s, optional
        Reference frequency w, which is then held; otherwise it is fitted.
    constraints : mapping of str to float
        Coefficients of forces of the model that are always present, such as a pendulum's `{"gravity": 1.0}`.
        A search supports neither bounds nor ties. Coefficients stated in a user's library are fixed, too.
    max_effects : int, optional
        Largest number of added effects, instead of that of the settings.
    holdout : record, or several of them
        Runs that are used neither for fitting nor for naming; each model predicts them. Without such runs,
        the last third of each run is held out.
    refit : bool
        Fit the resulting models again, to the whole runs.
    level : float, optional
        Significance level that the tests of the candidates and the omnibus test share, instead of that of the
        settings.
    seed : int, optional
        Seed of the random numbers that give the number of independent tests, instead of that of the settings.
    time_limit : float, s
        Time after which the search fits no further model and returns its present result.
    settings : Settings
        Other settings of the search.
    tell : Tell
        Called with a few words on the progress of the work.

    Returns
    -------
    xr.DataTree
        Result for records decimated to about sixty samples a period (attribute `decimated`). A driven record
        of more than about 180 periods is replaced by three stretches (attribute `stretches`). Further
        attributes: `search_outcome` (`explained`, `unknown effect`, `nothing missing`), `converged`,
        `out_of_time` (the limit that ended the search), `closing_effect` (excluded by `max_effects` alone;
        with it nothing is missing), `not_improving` (an effect that is significant but does not improve the
        held-out prediction), `noise_p_value` (of the hypothesis that the residual of the final model is
        noise, or a random force independent of the motion; nan if the time ran out), `settings` (JSON),
        `laws_held_out_rms` (rad, held-out residual of smooth laws, nan if they were not needed),
        `refused_by_laws` (effects that predict worse than the laws), `left_out`, `failed_fits`.
        Groups: `record` (`record_1`, ... for several runs) with `simulated_angle(model)` before and after;
        `discrepancy` and `discrepancy_after`, the differences of model and record (see
        `demodulation.demodulate`); `detectability`, `detectability_after`; `ranking` of candidates before
        each effect and at the end; `steps`, the effects added; `before` and `after`, the identifications;
        `omnibus`, the tests without candidates; `holdout` over the models; for several runs `homogeneity`,
        the test whether the runs differ.

    Raises
    ------
    UsageError
        No force in the start model, or no candidates; an impossible level, number of effects or time limit; a
        held force that is not in the model; a body without a restoring force.
    DecayError
        The decay cannot support the start model.

    Examples
    --------
    The record has five forces. The search starts with four of them, and is offered the fifth and another one.

    >>> import sysid_trib as st
    >>> found = st.discover(st.records.paper_twin(), "lambda,zeta,delta,nu", "epsilon,dahl")
    >>> found["steps"].symbol.values.tolist(), found.attrs["search_outcome"]
    (['epsilon'], 'explained')
    >>> st.best(found).coefficient.sel(force="epsilon").round(1).item()
    0.3
    """
    if not time_limit > 0.0:
        raise UsageError(f"A time limit of {time_limit:g} s leaves no time to search; give a positive one.")
    asked: dict[str, Any] = {"max_effects": max_effects, "level": level, "seed": seed}
    settings = replace(settings, **{k: value for k, value in asked.items() if value is not None})
    runs, unseen = records.as_decays(decay, "discover"), records.as_decays(holdout, "discover, holdout=,")
    inputs = inputs_of(as_runs(runs, driven=True)[0])
    if model_forces is None:
        model = viscous_model(load_library(), inputs)
    else:
        model = forces.as_library(model_forces, "discover")
    if candidates is None:
        offered = further_forces(load_library(), model, inputs)
    else:
        offered = forces.as_library(candidates, "discover, candidates=,")
    constraints = known_coefficients(model) | dict(constraints)
    if is_free_to_move(model, Constraints(constraints).fixed):
        raise UsageError(
            "discover needs a restoring force, and this body has none; identify it with several sets of "
            "forces, and compare the residuals."
        )
    how = SearchPlan(reference_frequency, refit, time_limit, settings, tell)
    together = replace(
        model, forces=(*model, *(force for force in offered if force.symbol not in model.symbols))
    )
    if together.used and all(map(inputs_of, as_runs(runs, driven=True))):
        return _discovery_by_motions(runs, model, offered, constraints, unseen, how)
    if together.used:
        # A candidate has its own coefficient and shapes: those of the start model enter it as numbers.
        coefficients = _of_start_model(runs, model, reference_frequency, constraints)
        model, offered = (
            replace(library, forces=tuple(force.with_numbers(coefficients) for force in library))
            for library in (model, offered)
        )
    return to_xarray.with_inseparable(_discovery(runs, model, offered, constraints, unseen, how))


def _of_start_model(
    decay: Decays,
    library: ForceLibrary,
    reference_frequency: float | None,
    constraints: ConstraintTable,
) -> dict[str, float]:
    """Return the coefficients of the start model, identified by Direct, for formulas that use them."""
    held = {name: value for name, value in constraints.items() if name in library.symbols}
    direct = Direct(reference_frequency, random_force="off", refine=False, constraints=held)
    result = direct.identify(decay, library)
    return dict(zip(result.force.values.tolist(), result.coefficient.values.tolist(), strict=True))


# The plain start model replaces that of the search if its residual is below this fraction of the other's.
NEARER = 0.95
# Significance level at which smooth laws predict better than named effects.
LAWS_LEVEL = 0.05


@dataclass(frozen=True)
class SearchPlan:
    """Plan of a search.

    Attributes
    ----------
    reference_frequency : float or None, rad/s
        Reference frequency, which is fixed; with None it is fitted.
    refit : bool
        Whether the models are fitted again to the whole runs.
    time_limit : float, s
    settings : Settings
    tell : Tell
    """

    reference_frequency: float | None
    refit: bool
    time_limit: float
    settings: Settings
    tell: Tell


@signal_scale.in_units_of_the_motion
def _discovery(
    decay: Decays,
    model_forces: ForceLibrary,
    candidates: ForceLibrary,
    constraints: ConstraintTable,
    holdout: Decays,
    how: SearchPlan,
) -> xr.DataTree:
    reference_frequency, settings, tell = how.reference_frequency, how.settings, how.tell
    deadline = time.monotonic() + how.time_limit
    whole = as_runs(decay, driven=True)
    model, free, held = start_forces(model_forces, reference_frequency, Constraints(constraints))
    offered, left_out = _offered(model_forces, candidates, whole)
    unseen = _held_out_runs(holdout)
    taken = replace(model, forces=(*model, *offered))
    if any(inputs_for(run, taken) for run in (*whole, *unseen)):
        # A driven record may have few samples a period, and forces then need fewer points between samples.
        settings = replace(settings, points_per_period=settings.points_per_period // 2)
    runs, learnt, later = search_parts(whole, unseen, settings.samples_per_period)
    seen = [part.record for part in learnt]
    tell("fit of the start model")
    pasts = [(part.origin, part.before) for part in learnt]
    start = start_model.fit_start_model(seen, free, reference_frequency, settings, held, pasts)
    # Each held-out part has the noise of the last fitted part of its run.
    noises = [max(at for at, part in enumerate(learnt) if part.run == unseen.run) for unseen in later]
    predict = partial(predicted, parts=later, runs=noises, frequency=start.rows[0].path.frequency)
    nearer = partial(_nearer_start, library=model, constraints=constraints, frequency=reference_frequency)
    fits = Fits(start, offered.forces, deadline, runs=seen, predict=predict)
    fits.plain = None if fits.is_complete(start) else nearer(start, seen)
    done = _best_by_holdout(_or_coloured_noise(fits, tell), tell)
    # The rival gets the forces of the start model outside of its penalty, and the fitted and predicted parts.
    rival = partial(held_out_by_laws, model_forces, constraints, learnt, later)
    done, laws_rms, refused = _unless_laws_predict_better(done, later, rival, tell)
    closing = parts.closing_effect(done)
    if how.refit and not unseen:
        tell("fit to the whole runs")
        done = replace(done, models=[_refitted(model, runs, learnt) for model in done.models])
        seen = runs
    tell("difference of model and record")
    plain = nearer(done.models[0], seen) if fits.plain is not None and seen is runs else fits.plain
    of_seen = range(len(whole)) if seen is runs else [part.run for part in learnt]
    groups = to_xarray.groups_of(seen, [whole[at] for at in of_seen], done, offered, plain)
    groups["/"] = _search_group(done.converged, holdout_given=bool(unseen), refitted=how.refit and not unseen)
    tree = xr.DataTree.from_dict(_with_kept_windows(groups, [whole[at] for at in of_seen]))
    third = f"the last third{' of each run' * (len(whole) > 1)}"
    tree.attrs = {
        **schema.provenance(None, one_or_all(runs), model),
        "method": "discover",
        "options": json.dumps(_options_of(how, constraints)),
        "settings": json.dumps(asdict(settings)),
        "candidates": offered.to_toml(),
        **_outcome(done, closing),
        "laws_held_out_rms": laws_rms,
        "refused_by_laws": ", ".join(refused),
        "out_of_time": f"{how.time_limit:g} s" if done.out_of_time else "",
        "max_effects": settings.max_effects,
        "left_out": left_out,
        "held_out": f"{len(unseen)} run{'s' * (len(unseen) > 1)}" if unseen else third,
        "stretches": "" if seen is runs else _stretches_of(learnt, len(runs)),
        "decimated": [run.attrs["decimated"] for run in runs if "decimated" in run.attrs],
    }
    if refused or effects.misnamed_effects(tree):
        tree.attrs[SEARCH_OUTCOME] = "unknown effect"
    return tree


@signal_scale.in_units_of_the_motion
def _discovery_by_motions(
    decay: Decays,
    model_forces: ForceLibrary,
    candidates: ForceLibrary,
    constraints: ConstraintTable,
    holdout: Decays,
    how: SearchPlan,
) -> xr.DataTree:
    """Search driven runs for forces whose formulas hold coefficients of others.

    Such a force is not linear in the coefficients: the columns of the other search would be those of a start
    model that is wrong. Here each model is fitted to the motions (see `search_by_motions`).
    """
    whole = as_runs(decay, driven=True)
    budget = Budget(time.monotonic() + how.time_limit, MOST_COMPUTED)
    model, _, _ = start_forces(model_forces, how.reference_frequency, Constraints(constraints))
    offered, left_out = _offered(model_forces, candidates, whole)
    unseen = _held_out_runs(holdout)
    frequency = how.reference_frequency or swing_frequency_of(whole)
    seen = [decimated_run(run, frequency, how.settings.samples_per_period) for run in whole]
    fixed = Constraints(constraints).fixed
    fits = MotionFits(seen, model, offered, fixed, how.reference_frequency, how.settings, budget)
    done = search_by_motions(fits, how.tell)
    how.tell("difference of model and record")
    groups = groups_of_motions(done, offered, whole, unseen)
    # The models are fitted to all of the runs from the start.
    groups["/"] = _search_group(done.converged, holdout_given=bool(unseen), refitted=not unseen)
    tree = xr.DataTree.from_dict(_with_kept_windows(groups, whole))
    complete = "explained" if done.effects else "nothing missing"
    tree.attrs = {
        **schema.provenance(None, one_or_all(seen), model),
        "method": "discover",
        "options": json.dumps(_options_of(how, constraints)),
        "settings": json.dumps(asdict(how.settings)),
        "candidates": offered.to_toml(),
        SEARCH_OUTCOME: complete if done.is_complete and done.converged else "unknown effect",
        "closing_effect": "",
        "not_improving": "",
        "noise_p_value": done.models[-1].noise_p_value,
        "failed_fits": sorted({*fits.failed} - {*done.effects}),
        "laws_held_out_rms": float("nan"),
        "refused_by_laws": "",
        "out_of_time": f"{how.time_limit:g} s" if budget.late and not done.converged else "",
        "max_effects": how.settings.max_effects,
        "left_out": left_out,
        "held_out": held_out_of(done, len(unseen)),
        "stretches": "",
        "decimated": [run.attrs["decimated"] for run in seen if "decimated" in run.attrs],
    }
    if effects.misnamed_effects(tree):
        tree.attrs[SEARCH_OUTCOME] = "unknown effect"
    return tree


class Offered(NamedTuple):
    """Candidates of a search, and the names of those that are left out."""

    library: ForceLibrary
    left_out: list[str]


def _offered(model_forces: ForceLibrary, candidates: ForceLibrary, runs: Sequence[xr.Dataset]) -> Offered:
    """Return the candidates that the inputs of the runs permit.

    Raises
    ------
    UsageError
        There is no candidate.
    """
    offered = Offered(*offered_forces(model_forces, candidates, inputs_of(runs[0])))
    if not len(offered.library):
        raise UsageError(
            "The library has no candidate except the forces of the model; offer another library."
        )
    return offered


def _held_out_runs(holdout: Decays) -> Sequence[xr.Dataset]:
    """Return the runs that take no part in the search; none if none are given."""
    given = isinstance(holdout, xr.Dataset) or len(holdout)
    return as_runs(holdout, driven=True) if given else []


def _search_group(converged: bool, *, holdout_given: bool, refitted: bool) -> xr.Dataset:
    """Return the true-or-false variables of a search."""
    values = {"converged": converged, "holdout_given": holdout_given, "refitted": refitted}
    return xr.Dataset(variables.described("search", values))


def _options_of(how: SearchPlan, constraints: ConstraintTable) -> dict[str, Any]:
    """Return the options of a search as its result stores them."""
    return {
        "max_effects": how.settings.max_effects,
        "level": how.settings.level,
        "seed": how.settings.seed,
        "refit": how.refit,
        "reference_frequency": how.reference_frequency,
        "constraints": dict(constraints),
    }


def _outcome(done: Search, closing: str) -> dict[str, Any]:
    """Return the outcome of a search as attributes of its result."""
    return {
        SEARCH_OUTCOME: parts.outcome_of(done, closing),
        "closing_effect": closing,
        "not_improving": parts.not_improving(done),
        "noise_p_value": done.noise_p_value,
        "failed_fits": done.failed,
    }


def _unless_laws_predict_better(
    done: Search, later: Sequence[RecordPart], rival: Callable[[], LawPrediction], tell: Tell
) -> tuple[Search, float, tuple[str, ...]]:
    """Return the search, without names if smooth laws predict clearly better; the laws' RMS; refused names.

    Laws predict better if their residual is smaller by more than the standard error of the comparison. They
    are not tried if the named effects explain the record, if the held-out residual is hardly larger than the
    noise, if the record is driven, or if only one effect is missing that `max_effects` excludes.
    """
    named = done.predictions[-1]
    named_rms = float(np.nan_to_num(named.rms, nan=np.inf))
    noise = root_mean_square([smoothing.sensor_noise(part.record) for part in later])
    driven = any(inputs_of(part.record) for part in later)
    # Under a random force or coloured noise, the prediction by a free motion is good or bad by chance.
    residual_is_noise = parts.outcome_of(done) == "explained"
    explains = residual_is_noise or named_rms <= judged.LARGE * noise or parts.closing_effect(done)
    if not done.effects or driven or explains:
        return done, float("nan"), ()
    tell("laws as an alternative model")
    laws = rival()
    if not CLEARLY_BETTER * laws.rms < named_rms:
        return done, laws.rms, ()
    if np.isfinite(named_rms):
        periods = [smoothing.samples_of_a_period(part.record) for part in later]
        p_value = diebold_mariano(named.residuals, laws.residuals, periods)
        if not p_value < LAWS_LEVEL:
            return done, laws.rms, ()
    start = done.models[0]
    return _best_by_holdout(search(done.fits, begin=start, most=0, tell=tell), tell), laws.rms, done.effects


def _with_kept_windows(groups: dict[str, xr.Dataset], runs: Sequence[xr.Dataset]) -> dict[str, xr.Dataset]:
    """Return the groups of a result; each record states the times (s) between which its run was kept."""
    for name, run in zip(variables.group_names("record", len(runs)), runs, strict=True):
        groups[name].attrs["kept_window"] = run.time.values[[0, -1]]
    return groups


def _nearer_start(
    start: FittedModel,
    seen: Sequence[xr.Dataset],
    library: ForceLibrary,
    constraints: ConstraintTable,
    frequency: float | None,
) -> PlainStart | None:
    """Return the start model fitted without a random force, if its motion is clearly nearer to records."""
    plain = plain_start(seen, library, Constraints(constraints).fixed, frequency, start)
    nearer = plain is not None and plain.residual < NEARER * residual_of_motions(free_motions(start))
    return plain if nearer else None


def _stretches_of(learnt: Sequence[RecordPart], runs: int) -> str:
    """Describe the parts of long records to which models are fitted; empty if the parts are the whole."""
    ends = [part.record.time.values[[0, -1]] for part in learnt]
    spans = ", ".join(f"{first:.4g} to {last:.4g} s" for first, last in ends)
    said = f"A long driven record: models are fitted to stretches ({spans}), each with its own noise."
    return said if len(learnt) > runs else ""


def _best_by_holdout(done: Search, tell: Tell) -> Search:
    """Return the search without the effects that do not improve the held-out prediction."""
    fits = done.fits
    while True:
        steps = with_steps(done, tell)
        tell("hold-out")
        predictions = [fits.foretold(model) for model in steps.models]
        fewer = int(np.argmin([np.nan_to_num(prediction.rms, nan=np.inf) for prediction in predictions]))
        # No effect is named in addition to a start model that fits worse than the start model of `identify`.
        while fewer and not fits.is_complete(steps.models[-1]):
            if fits.beats_plain_start(steps.models[fewer]):
                break
            fewer -= 1
        if fewer == len(done.effects) or fits.is_complete(steps.models[-1]):
            noise_p_value = np.nan if done.out_of_time else fits.noise_p_value(steps.models[-1])
            return replace(steps, predictions=predictions, noise_p_value=noise_p_value)
        done = search(fits, begin=steps.models[fewer], most=fewer, tell=tell)


def _or_coloured_noise(fits: Fits, tell: Tell) -> Search:
    """Return the search, or that with coloured noise if it explains the record better.

    The named effects, or the residual, may be coloured noise that the lines above the band of the motion did
    not show. The noise of another colour without any named effect must be outside of the credible set of all
    effects, just as noise alone must be outside of the set of each effect. Otherwise the colour is tried
    together with the effects.
    """
    done = search(fits, growing=True, tell=tell)
    colour_is_known = any(run.attrs.get(NOISE_IS_WHITE_IN) for run in fits.runs)
    if colour_is_known or parts.outcome_of(done) == "nothing missing":
        return done
    tell("colour of the sensor's noise")
    start, last, outside = fits.start, done.models[-1], fits.start.settings.outside_of_set

    def with_colour(model: FittedModel) -> float:
        """Return minus twice the logarithm of the evidence of a model and of the colour of its noise."""
        return evidence(model) + start_model.colour_penalty(model)

    # Without convergence, the residual is not yet noise.
    settled = done.converged or not done.effects
    with_names = start_model.recoloured(last) if done.effects and settled else last
    without_names = start_model.recoloured(start, with_names)
    known, named, nameless = map(with_colour, (last, with_names, without_names))
    if without_names is not start and nameless < min(known, named) + outside:
        coloured, begin = without_names, None
    elif named < known - outside:
        coloured = start_model.with_sensor_noises(start, [rows.path.sensor for rows in with_names.rows])
        begin = with_names
    else:
        return done
    other_fits = Fits(coloured, fits.candidates, fits.deadline, runs=fits.runs, predict=fits.predict)
    other_fits.plain = fits.plain
    again = search(other_fits, begin=begin, growing=True, tell=tell)
    fewer = outside * (len(again.effects) < len(done.effects))
    return again if with_colour(again.models[-1]) < with_colour(last) + fewer else done


def _refitted(model: FittedModel, runs: Sequence[xr.Dataset], learnt: Sequence[RecordPart]) -> FittedModel:
    """Return a model fitted to the whole runs."""
    nears = {part.run: rows.path for part, rows in zip(learnt, model.rows, strict=True)}
    places = ((run, nears[at]) for at, run in enumerate(runs))
    paths = [start_model.path_like(near, run, near.frequency, near.origin) for run, near in places]
    return start_model.refitted(model, paths)
