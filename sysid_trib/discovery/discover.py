"""Find where model and record differ, name the missing effect, add it: the gap shrinks."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.discovery import parts, to_xarray
from sysid_trib.discovery.fits import Fits, evidence
from sysid_trib.discovery.free_motion import free_motions
from sysid_trib.discovery.law_rival import held_out_by_laws
from sysid_trib.discovery.plain_start import PlainStart, plain_start, residual_of_motions
from sysid_trib.discovery.search import Search, search, with_steps
from sysid_trib.discovery.unseen import RecordPart, predicted, search_parts, start_forces
from sysid_trib.errors import Tell, UsageError, silent
from sysid_trib.forces.constraints import NO_CONSTRAINTS, Constraints, ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import (
    further_forces,
    is_free_to_move,
    known_coefficients,
    offered_forces,
    viscous_model,
)
from sysid_trib.likelihood import start_model
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.trials import DEFAULTS, Settings
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.scope import without_old_arguments
from sysid_trib.records import smoothing
from sysid_trib.records.decay import Decays, as_runs, one_or_all, root_mean_square
from sysid_trib.records.inputs import inputs_for, inputs_of
from sysid_trib.results import effects, schema, signal_scale, variables
from sysid_trib.validation import findings
from sysid_trib.validation.cross_check import CLEARLY_BETTER


def discover(
    decay: Decays,
    model_forces: ForceLibrary | None = None,
    candidates: ForceLibrary | None = None,
    *,
    reference_frequency: float | None = None,
    constraints: ConstraintTable = NO_CONSTRAINTS,
    max_effects: int | None = None,
    holdout: Decays = (),
    refit: bool = False,
    level: float | None = None,
    seed: int | None = None,
    time_limit: float = np.inf,
    settings: Settings = DEFAULTS,
    tell: Tell = silent,
    fix: Mapping[str, float] | None = None,
) -> xr.DataTree:
    """Find, name and add what a model lacks to explain a decay, or runs of one experiment.

    Parameters
    ----------
    decay : xr.Dataset or sequence of xr.Dataset
        `angle(time)` as `free_decay` returns it, or a list of runs; with inputs if they are driven.
    model_forces : ForceLibrary, optional
        The forces of the model to start from; by default viscous friction alone, and what drives.
    candidates : ForceLibrary, optional
        What may be missing; by default the other forces of `contact_forces`, and `candidate_effects`; of a
        driven record the other forces of its inputs too. Those that the model has, or whose input the records
        lack, are not offered, and named in the result.
    reference_frequency : float, rad/s, optional
        w, held; else it is fitted.
    constraints : mapping of str to float
        Coefficients of forces of the model that are always there, as a pendulum's `{"gravity": 1.0}`. A
        search bounds and ties none. Those that a library of one's own states are held too.
    max_effects : int, optional
        Effects added at most, in the place of the settings'.
    holdout : xr.Dataset or sequence of xr.Dataset
        Runs that take no part in fitting or naming, and are predicted by each model. Without any the last
        third of each run takes no part.
    refit : bool
        Fit the models that were found again, to the whole runs.
    level : float, optional
        Significance level, shared by the tests of the candidates and the omnibus test, in the place of the
        settings'.
    seed : int, optional
        Of the drawing that counts independent tests, in the place of the settings'.
    time_limit : float, s
        After which the search fits no further model, and what it has is described.
    settings : Settings
        What else decides.
    tell : Tell
        Called with a few words as the work goes on.
    fix : mapping of str to float, deprecated
        Now `constraints`.

    Returns
    -------
    xr.DataTree
        Of records decimated to some sixty samples a period (attrs `decimated`); of a driven one of more than
        some 180 periods three stretches are the records (attrs `stretches`). attrs: `verdict`
        (`explained`, `unknown effect`, `nothing missing`), `converged`, `out_of_time` (the limit that ended
        the search), `closing_effect` (that `max_effects` left out, and with which nothing is missing),
        `not_improving` (an effect that gains more than chance, and that the hold-out refuses),
        `noise_p_value` (of a final model that leaves but noise, or a random force without cause; nan where
        the time ran out), `settings`
        (JSON), `laws_held_out_rms` (rad, nan where it was not needed: what smooth laws leave of what was held
        out) and `refused_by_laws` (effects that predict it worse than the laws), `left_out`, `failed_fits`.
        Groups: `record`
        (`record_1`, ... of several runs) with `simulated_angle(model)` before and after;
        `discrepancy` and `discrepancy_after`, where model and record differ (see `demodulation.demodulate`);
        `detectability`, `detectability_after`; `ranking` of candidates before each effect and at the end;
        `steps`, the effects added; `before` and `after`, the identifications; `omnibus`, the tests that know
        no candidate; `holdout` over the models; of several runs `homogeneity`, whether they differ.

    Raises
    ------
    UsageError
        No forces to start from, or no candidates; a level, a number of effects or a time limit that is none;
        what is to be held is no force of the model; a body without a restoring force.
    DecayError
        The decay cannot support the start model.
    """
    if not time_limit > 0.0:
        raise UsageError(f"A time limit of {time_limit:g} s leaves no time to search; give a positive one.")
    constraints = {**constraints, **without_old_arguments("discover", fix, stacklevel=3)}
    asked: dict[str, Any] = {"max_effects": max_effects, "level": level, "seed": seed}
    settings = replace(settings, **{k: value for k, value in asked.items() if value is not None})
    inputs = inputs_of(as_runs(decay, driven=True)[0])
    model_forces = viscous_model(load_library(), inputs) if model_forces is None else model_forces
    candidates = further_forces(load_library(), model_forces, inputs) if candidates is None else candidates
    constraints = known_coefficients(model_forces) | constraints
    if is_free_to_move(model_forces, Constraints(constraints).fixed):
        raise UsageError(
            "A candidate is weighed by the restoring force, which this body has none of; identify it with "
            "forces that may act, and compare the residuals."
        )
    if candidates.used or model_forces.used:
        # A candidate has a coefficient and shapes of its own: those of the start model are numbers to it.
        coefficients = _of_start_model(decay, model_forces, reference_frequency, constraints)
        model_forces, candidates = (
            replace(library, forces=tuple(force.with_numbers(coefficients) for force in library))
            for library in (model_forces, candidates)
        )
    how = (reference_frequency, refit, time_limit, settings, tell)
    return _discovery(decay, model_forces, candidates, constraints, holdout, how)


def _of_start_model(
    decay: Decays,
    library: ForceLibrary,
    reference_frequency: float | None,
    constraints: ConstraintTable,
) -> dict[str, float]:
    """Return the coefficients of the start model by Direct, for formulas that hold them."""
    held = {name: value for name, value in constraints.items() if name in library.symbols}
    direct = Direct(reference_frequency, random_force="off", refine=False, constraints=held)
    result = direct.identify(decay, library)
    return dict(zip(result.force.values.tolist(), result.coefficient.values.tolist(), strict=True))


# Part of the residual of the search's own start model below which that of the plain one stands for it.
NEARER = 0.95
# Frequency that is held, whether models are refitted, time limit, settings, and whom to tell.
_How = tuple[float | None, bool, float, Settings, Tell]


@signal_scale.in_units_of_the_motion
def _discovery(
    decay: Decays,
    model_forces: ForceLibrary,
    candidates: ForceLibrary,
    constraints: ConstraintTable,
    holdout: Decays,
    how: _How,
) -> xr.DataTree:
    reference_frequency, refit, time_limit, settings, tell = how
    deadline = time.monotonic() + time_limit
    whole = as_runs(decay, driven=True)
    model, free, held = start_forces(model_forces, reference_frequency, Constraints(constraints))
    offered, left_out = offered_forces(model_forces, candidates, inputs_of(whole[0]))
    if not len(offered):
        raise UsageError("No candidate is left beside the forces of the model; offer another library.")
    unseen = as_runs(holdout, driven=True) if isinstance(holdout, xr.Dataset) or len(holdout) else []
    taken = replace(model, forces=(*model, *offered))
    if any(inputs_for(run, taken) for run in (*whole, *unseen)):
        # A driven record may have few samples a period: so many points between them no force asks for.
        settings = replace(settings, points_per_period=settings.points_per_period // 2)
    runs, learnt, later = search_parts(whole, unseen, settings.samples_per_period)
    seen = [part.record for part in learnt]
    tell("fit of the start model")
    pasts = [(part.origin, part.before) for part in learnt]
    start = start_model.fit_start_model(seen, free, reference_frequency, settings, held, pasts)
    # Each with the noise of what was seen of its run.
    noises = [max(at for at, part in enumerate(learnt) if part.run == unseen.run) for unseen in later]
    predict = partial(predicted, parts=later, runs=noises, frequency=start.rows[0].path.frequency)
    nearer = partial(_nearer_start, library=model, constraints=constraints, frequency=reference_frequency)
    fits = Fits(start, offered.forces, deadline, runs=seen, predict=predict)
    fits.plain = None if fits.is_complete(start) else nearer(start, seen)
    done = _best_by_holdout(_or_coloured_noise(fits, tell), tell)
    # Start forces outside of the penalty, what laws are identified from and what they predict.
    rival = partial(held_out_by_laws, model_forces, constraints, learnt, later)
    done, laws_rms, refused = _unless_laws_predict_better(done, later, rival, tell)
    closing = parts.closing_effect(done)
    if refit and not unseen:
        tell("fit to the whole runs")
        done = replace(done, models=[_refitted(model, runs, learnt) for model in done.models])
        seen = runs
    tell("where model and record differ")
    plain = nearer(done.models[0], seen) if fits.plain is not None and seen is runs else fits.plain
    groups = to_xarray.groups_of(seen, done, offered, plain)
    of_seen = range(len(whole)) if seen is runs else [part.run for part in learnt]
    tree = xr.DataTree.from_dict(_with_kept_windows(groups, [whole[at] for at in of_seen]))
    options = {name: getattr(settings, name) for name in ("max_effects", "level", "seed")}
    options |= {"refit": refit, "reference_frequency": reference_frequency, "constraints": dict(constraints)}
    third = f"the last third{' of each run' * (len(whole) > 1)}"
    tree.attrs = {
        **schema.provenance(None, one_or_all(runs), model),
        "method": "discover",
        "options": json.dumps(options),
        "settings": json.dumps(asdict(settings)),
        "candidates": offered.to_toml(),
        **_outcome(done, closing),
        "laws_held_out_rms": laws_rms,
        "refused_by_laws": ", ".join(refused),
        "out_of_time": f"{time_limit:g} s" if done.out_of_time else "",
        "max_effects": settings.max_effects,
        "left_out": left_out,
        "held_out": f"{len(unseen)} run{'s' * (len(unseen) > 1)}" if unseen else third,
        "stretches": "" if seen is runs else _stretches_of(learnt, len(runs)),
        "decimated": [run.attrs["decimated"] for run in runs if "decimated" in run.attrs],
    }
    if refused or effects.misnamed_effects(tree):
        tree.attrs["verdict"] = "unknown effect"
    return tree


def _outcome(done: Search, closing: str) -> dict[str, Any]:
    """Return what a search says of itself, as attributes of its result."""
    return {
        "verdict": parts.verdict_of(done, closing),
        "closing_effect": closing,
        "not_improving": parts.not_improving(done),
        "noise_p_value": done.noise_p_value,
        "converged": str(done.converged),
        "failed_fits": done.failed,
    }


def _unless_laws_predict_better(
    done: Search, later: Sequence[RecordPart], rival: Callable[[], float], tell: Tell
) -> tuple[Search, float, tuple[str, ...]]:
    """Return the search without names where smooth laws predict clearly better; their residual; the names.

    Names that leave hardly more than noise of what was held out are not held against laws, nor are those of
    driven records, nor those to which one more that was not asked for is all that lacks.
    """
    named_rms = float(np.nan_to_num(done.predictions[-1][1], nan=np.inf))
    noise = root_mean_square([smoothing.sensor_noise(part.record) for part in later])
    driven = any(inputs_of(part.record) for part in later)
    explains = named_rms <= findings.LARGE * noise or parts.closing_effect(done)
    if not done.effects or driven or explains:
        return done, float("nan"), ()
    tell("laws as the rival of the names")
    laws_rms = rival()
    if not CLEARLY_BETTER * laws_rms < named_rms:
        return done, laws_rms, ()
    start = done.models[0]
    return _best_by_holdout(search(done.fits, begin=start, most=0, tell=tell), tell), laws_rms, done.effects


def _with_kept_windows(groups: dict[str, xr.Dataset], runs: Sequence[xr.Dataset]) -> dict[str, xr.Dataset]:
    """The groups of a result; each record says between which times (s) its run was kept."""
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
    """The start model fitted without a random force, where its motion is clearly nearer to the records."""
    plain = plain_start(seen, library, Constraints(constraints).fixed, frequency, start)
    nearer = plain is not None and plain.residual < NEARER * residual_of_motions(free_motions(start))
    return plain if nearer else None


def _stretches_of(learnt: Sequence[RecordPart], runs: int) -> str:
    """What of long records the models are fitted to; empty where that is all of them."""
    ends = [part.record.time.values[[0, -1]] for part in learnt]
    spans = ", ".join(f"{first:.4g} to {last:.4g} s" for first, last in ends)
    said = f"A long driven record: models are fitted to stretches ({spans}), each with its own noise."
    return said if len(learnt) > runs else ""


def _best_by_holdout(done: Search, tell: Tell) -> Search:
    """The search with its steps and their predictions; without what does not improve what was held out."""
    fits = done.fits
    while True:
        steps = with_steps(done, tell)
        tell("hold-out")
        predictions = [fits.foretold(model) for model in steps.models]
        fewer = int(np.argmin([np.nan_to_num(rms, nan=np.inf) for _, rms in predictions]))
        # Nothing is named on top of a start model that fits worse than that of `identify`.
        while fewer and not fits.is_complete(steps.models[-1]):
            if fits.beats_plain_start(steps.models[fewer]):
                break
            fewer -= 1
        if fewer == len(done.effects) or fits.is_complete(steps.models[-1]):
            noise_p_value = np.nan if done.out_of_time else fits.noise_p_value(steps.models[-1])
            return replace(steps, predictions=predictions, noise_p_value=noise_p_value)
        done = search(fits, begin=steps.models[fewer], most=fewer, tell=tell)


def _or_coloured_noise(fits: Fits, tell: Tell) -> Search:
    """The search, or that with noise of the likeliest colour, if that explains the record better.

    What is named, or left, may be noise of a colour that the lines above the motion did not show. As chance
    must be outside of an effect's credible set, so must noise of another colour, without any name, of that of
    all of them; else the colour with what was named is tried, of which that of the search is outside.
    """
    done = search(fits, growing=True, tell=tell)
    if parts.verdict_of(done) == "nothing missing":
        return done
    tell("colour of the sensor's noise")
    start, last, outside = fits.start, done.models[-1], fits.start.settings.outside_of_set

    def with_colour(model: FittedModel) -> float:
        """Minus twice the logarithm of the evidence of a model and of the colour of its noise."""
        return evidence(model) + start_model.colour_penalty(model)

    # Else what is left of the record is no noise yet.
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
    """A model fitted to the whole runs."""
    nears = {part.run: rows.path for part, rows in zip(learnt, model.rows, strict=True)}
    places = ((run, nears[at]) for at, run in enumerate(runs))
    paths = [start_model.path_like(near, run, near.frequency, near.origin) for run, near in places]
    return start_model.refitted(model, paths)
