"""A search by motions as datasets: the groups and attributes that every discovery has."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.discovery import demodulation, omnibus_test
from sysid_trib.discovery.fits import credible, probabilities
from sysid_trib.discovery.free_motion import FreeMotion
from sysid_trib.discovery.judged_models import judged_models
from sysid_trib.discovery.motion_fits import Gain, MotionModel
from sysid_trib.discovery.motion_search import MotionSearch
from sysid_trib.discovery.screen import SAME_EFFECT
from sysid_trib.discovery.to_xarray import group_of, labels_of, texts_of
from sysid_trib.forces.constraints import Constraints
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.sensor_noise import NoiseModel
from sysid_trib.motion_fit.free_fit import identification_of_fit
from sysid_trib.results import variables
from sysid_trib.results.effects import NAMED
from sysid_trib.simulation.initial_conditions import FittedMotion
from sysid_trib.simulation.trajectory import trajectory
from sysid_trib.validation.driven import predict
from sysid_trib.validation.residuals import with_noise_and_models


def groups_of_motions(
    search: MotionSearch, offered: ForceLibrary, whole: Sequence[xr.Dataset], unseen: Sequence[xr.Dataset]
) -> dict[str, xr.Dataset]:
    """Return the groups of the result of a search by motions.

    Parameters
    ----------
    search : MotionSearch
    offered : ForceLibrary
        The candidates.
    whole : sequence of Dataset
        The runs with all their samples.
    unseen : sequence of Dataset
        Runs that took no part.
    """
    fits, ends = search.fits, (search.models[0], search.models[-1])
    simulated = [
        np.stack([run.angle.values + model.residuals[at] for model in ends])
        for at, run in enumerate(fits.runs)
    ]
    records = [
        with_noise_and_models(run, ["before", "after"], of_run)
        for run, of_run in zip(fits.runs, simulated, strict=True)
    ]
    noises = [record.noise.item() for record in records]
    motions = [_motions(model, fits.runs, noises) for model in ends]
    groups = {
        name: record.assign(group_of("records", {"residual_noise": noise}).data_vars)
        for name, record, noise in zip(
            variables.group_names("record", len(records)), records, noises, strict=True
        )
    }
    for when, name, at in (("", "before", 0), ("_after", "after", -1)):
        spans, attrs = demodulation.demodulate(motions[at])
        groups[f"discrepancy{when}"] = group_of("discrepancy", spans, attrs=attrs)
        groups[f"detectability{when}"] = _detectability(search, search.models[at], search.gains[at], offered)
        groups[name] = _identification(search, search.models[at])
    groups["ranking"] = _ranking(search, offered)
    groups["steps"] = _steps(search, offered, groups["after"])
    steps = len(search.models)
    # No force is drawn without a name: the residual of the final model is tested as a whole.
    untested: dict[str, Any] = {"z": np.full((steps, len(omnibus_test.trial_names())), np.nan)}
    untested |= {"widening": np.ones(steps), "p_value": np.full(steps, np.nan)}
    untested |= {"significant": np.zeros(steps, dtype=bool)}
    groups["omnibus"] = group_of("omnibus", untested, {"trial_force": omnibus_test.trial_names()})
    groups["holdout"] = _holdout(search, root_mean_square(noises), unseen)
    groups["judged"] = judged_models(groups, {"before": motions[0], "after": motions[1]}, whole)
    return groups


def _identification(search: MotionSearch, model: MotionModel) -> xr.Dataset:
    held = Constraints(dict(search.fits.fixed))
    return identification_of_fit(search.fits.method(model.effects), model.fit, model.fit, held)


def _motions(model: MotionModel, runs: Sequence[xr.Dataset], noises: Sequence[float]) -> list[FreeMotion]:
    """Return the motion of a model in each run."""
    parameters, motions = model.fit.parameters, list[FreeMotion]()
    for at, (run, noise) in enumerate(zip(runs, noises, strict=True)):
        record = model.fit.problem.records[at]
        acting = replace(parameters.model(model.fit.values, at), inputs=record.inputs)
        angle, rate, offset = model.per_run[at].tolist()
        time = run.time.values.astype(float)
        simulated = trajectory(acting, time, angle, rate)
        v = simulated.rate / acting.reference_frequency
        motion = FittedMotion(
            angle, rate, offset, simulated.position, v, simulated.stop_time, simulated.hidden, None
        )
        sensor = NoiseModel(noise, np.ones(1))
        motions.append(FreeMotion(time, motion, -model.residuals[at], sensor, acting, record.inputs))
    return motions


def _detectability(
    search: MotionSearch, model: MotionModel, gains: dict[str, Gain], offered: ForceLibrary
) -> xr.Dataset:
    """Return the detectable coefficients of candidates that a model lacks, and which of them look alike."""
    forces = [force for force in offered if force.symbol not in model.effects]
    tested = np.array([force.symbol in gains for force in forces], dtype=bool)
    nowhere = np.zeros(len(model.fit.residual))
    directions = [gains[f.symbol].direction if f.symbol in gains else nowhere for f in forces]
    cosine = np.abs(np.reshape(directions, (len(forces), -1)) @ np.reshape(directions, (len(forces), -1)).T)
    np.fill_diagonal(cosine, 1.0)
    # Two differ by less than a credible set spans if one of them has so many standard errors.
    nearest = np.sqrt(1.0 - search.fits.settings.outside_of_set / NAMED**2)
    values = {
        # An effect of this many standard errors is detected.
        "detectable": [5.0 * _of(gains, f.symbol, "error") for f in forces],
        "independent_fraction": [gains[f.symbol].outside if f.symbol in gains else 0.0 for f in forces],
        "testable": tested,
        "reason": np.where(tested, "", SAME_EFFECT),
        "alike": (cosine > nearest) & tested[:, None] & tested & ~np.eye(len(forces), dtype=bool),
        "cosine": cosine,
    }
    symbols = [force.symbol for force in forces]
    coords = {
        "candidate": symbols,
        "other": symbols,
        **labels_of(forces, ("name", "family", "formula", "unit")),
    }
    return group_of("detectability", values, coords)


def _of(gains: dict[str, Gain], symbol: str, name: str) -> float:
    """Return a number of a candidate; nan if it is not tested."""
    return float(getattr(gains[symbol], name)) if symbol in gains else float("nan")


def _ranking(search: MotionSearch, offered: ForceLibrary) -> xr.Dataset:
    """Return score, p-value and coefficient of every candidate before each effect and at the end."""
    symbols, level = list(offered.symbols), search.fits.settings.level
    tables: dict[str, Array] = {
        name: np.array([[_of(gains, symbol, name) for symbol in symbols] for gains in search.gains])
        for name in ("coefficient", "error", "p_value")
    }
    tests = len(symbols)
    reasons = [
        ["in the model" if s in of.effects else "" if s in gains else SAME_EFFECT for s in symbols]
        for of, gains in zip(search.models, search.gains, strict=True)
    ]
    thresholds = [model.threshold for model in search.models]
    values: dict[str, Any] = {
        "z": tables["coefficient"] / tables["error"],
        "p_value": tables["p_value"],
        "significant": tables["p_value"] < level,
        "coefficient": tables["coefficient"],
        "testable": np.isfinite(tables["coefficient"]),
        "reason": reasons,
        "independent_tests": np.full(len(search.models), float(tests)),
        "threshold": thresholds,
        "significance_level": level,
    }
    return group_of(
        "ranking", values, {"candidate": symbols, **labels_of(offered.forces, ("name", "family", "unit"))}
    )


def _steps(search: MotionSearch, offered: ForceLibrary, after: xr.Dataset) -> xr.Dataset:
    """Return the effects with their final coefficients and what each explains.

    `after` : the identification of the final model.
    """
    if not search.effects:
        return xr.Dataset(attrs={"count": 0})
    final, effects = search.models[-1], search.effects
    forces = [search.fits.whole[symbol] for symbol in effects]
    of_effects = after.sel(force=list(effects))
    coefficients, errors = of_effects.coefficient.values, of_effects.standard_error.values
    rms = np.array([model.rms for model in search.models])
    improved = np.array([_improvement(before, final) for before in search.models[:-1]])
    count = len(final.fit.residual) if final.is_complete else final.clusters
    values: dict[str, Any] = texts_of(forces, ("symbol", "name", "family", "kind", "unit", "formula"))
    values |= {
        "coefficient": coefficients,
        "standard_error": errors,
        "z": coefficients / errors,
        "significant": [final.p_value(symbol) < search.fits.settings.level for symbol in effects],
        "gain": -2.0 * count * np.diff(np.log(rms)),
        "p_value": [final.p_value(symbol) for symbol in effects],
        "selection_step": np.arange(len(effects)),
        "collinear": np.zeros(len(effects), dtype=bool),
        "prediction_z": improved,
        "worsens_holdout": np.zeros(len(effects), dtype=bool),
        "residual_before": rms[:-1],
        "residual_after": rms[1:],
        "whitened_residual_before": rms[:-1] / rms[-1],
        "whitened_residual_after": rms[1:] / rms[-1],
        "random_force_before": np.zeros(len(effects)),
        "random_force_after": np.zeros(len(effects)),
        "pair_odds": np.full(len(effects), np.nan),
    }
    symbols = list(offered.symbols)
    values |= _competition(search, symbols)
    coords: dict[str, Any] = {"candidate": symbols}
    names = [name for name in final.values if name.partition(".")[0] in effects and "." in name]
    if names:
        of_effect = np.array([[name.startswith(f"{symbol}.") for name in names] for symbol in effects])
        pair = [[final.values[name] for name in names], [final.error(name) for name in names]]
        values["shape"] = tuple(np.where(of_effect, of, np.nan) for of in pair)
        coords["shape_parameter"] = names
    return group_of("steps", values, coords, {"count": len(effects)})


def _improvement(before: MotionModel, after: MotionModel) -> float:
    """Return the improvement of the prediction of left-out parts, in standard errors."""
    falls = before.left_out_squares - after.left_out_squares
    error = float(np.std(falls, ddof=1)) / np.sqrt(len(falls))
    return float(np.mean(falls)) / error if error > 0.0 else 0.0


def _competition(search: MotionSearch, symbols: Sequence[str]) -> dict[str, Any]:
    """Return the probabilities of candidates in place of each effect, and of no force."""
    table: dict[str, list[Any]] = {
        name: []
        for name in (
            "tie_probability",
            "credible",
            "penalised_deviance",
            "inseparable",
            "chance_probability",
        )
    }
    for effect in search.effects:
        rivals = search.rivals[effect]
        likely = probabilities([*rivals.values()])
        inside = dict(zip(rivals, credible(likely, search.fits.settings.credible).tolist(), strict=True))
        inside[effect] = True
        by_name = dict(zip(rivals, likely.tolist(), strict=True))
        tied = [by_name[s] if inside.get(s) else np.nan for s in symbols]
        table["tie_probability"].append(tied)
        table["credible"].append(np.isfinite(tied))
        table["penalised_deviance"].append([rivals.get(s, np.nan) for s in symbols])
        # Runs with other inputs separate forces that these runs do not.
        table["inseparable"].append(np.where(np.isfinite(tied), np.arange(len(symbols)), np.nan))
        table["chance_probability"].append(by_name[""] if inside.get("") else 0.0)
    return table


def _holdout(search: MotionSearch, noise: float, unseen: Sequence[xr.Dataset]) -> xr.Dataset:
    """Return the residual of what was left out, or of the records that are held out, by each model."""
    rms = np.array([model.left_out_rms for model in search.models])
    if unseen:
        results = [_identification(search, model) for model in search.models]
        predicted = [[predict(result, run).residual_rms.item() for run in unseen] for result in results]
        rms = np.array([root_mean_square(of_model) for of_model in predicted])
    above = rms**2 - noise**2
    values = {
        "rms": rms,
        "log_score": np.full(len(rms), np.nan),
        "residual_noise": noise,
        "residual_above_noise": above / above[0] if above[0] > 0.0 else np.full(len(rms), np.nan),
    }
    return group_of("holdout", values)


def held_out_of(search: MotionSearch, unseen: int) -> str:
    """Return the words for the parts that were held out."""
    if unseen:
        return f"{unseen} run{'s' * (unseen > 1)}"
    runs = len(search.fits.runs)
    clusters = search.models[-1].clusters
    part = "run" if clusters == runs else f"of {clusters} parts of the runs"
    return f"each {part} in turn, to first order"
