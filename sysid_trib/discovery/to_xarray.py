"""A search as datasets: records, ranking of the candidates, steps, omnibus tests, hold-out."""

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.discovery import demodulation, free_motion, omnibus_test, parts, unseen
from sysid_trib.discovery.fits import credible, probabilities
from sysid_trib.discovery.judged_models import judged_models
from sysid_trib.discovery.plain_start import PlainStart
from sysid_trib.discovery.search import Search
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.records.inputs import inputs_of
from sysid_trib.records.smoothing import sensor_noise
from sysid_trib.results import effects, variables
from sysid_trib.validation.residuals import with_noise_and_models
from sysid_trib.validation.separability import inseparable

# Variables of each group.
TABLES = tomllib.loads(Path(__file__).with_name("variables.toml").read_text(encoding="utf-8"))
Motions = Sequence[Sequence[free_motion.FreeMotion]]


def groups_of(
    seen: Sequence[xr.Dataset],
    whole: Sequence[xr.Dataset],
    search: Search,
    offered: ForceLibrary,
    plain: PlainStart | None = None,
) -> dict[str, xr.Dataset]:
    """Return the groups of the result of `discover`.

    `seen` : the records to which the models are fitted. `whole` : the run of each with all its samples.
    `plain` : the start model that replaces that of the search.
    """
    motions = [free_motion.free_motions(model) for model in search.models]
    if plain is not None:
        motions[0] = plain.motions
    # If the residual of the final model is more than noise, credible sets and errors include the change of
    # effects and coefficients between parts of the record. This also holds after a search that ran out of
    # time, because it is then unknown whether the residual is noise.
    final, complete = search.models[-1], search.noise_p_value >= 1.0
    error = None if complete else parts.error_of_model(final)
    names = variables.group_names("record", len(seen))
    records = _records(seen, whole, motions)
    groups: dict[str, xr.Dataset] = dict(zip(names, records, strict=True))
    for when, name, at in (("", "before", 0), ("_after", "after", -1)):
        spans, attrs = demodulation.demodulate(motions[at])
        groups[f"discrepancy{when}"] = group_of("discrepancy", spans, attrs=attrs)
        candidates, forces = parts.detectability(search.screenings[at])
        symbols = [force.symbol for force in forces]
        labels = labels_of(forces, ("name", "family", "formula", "unit"))
        coords = {"candidate": symbols, "other": symbols, **labels}
        groups[f"detectability{when}"] = group_of("detectability", candidates, coords)
        errors = search.screenings[at].widening, error if at else None
        model = search.models[at], motions[at]
        groups[name] = free_motion.model_identification(*model, seen, *errors)
    if plain is not None:
        # Without an effect the start model is the final one.
        groups |= dict.fromkeys(["before"] if search.effects else ["before", "after"], plain.result)
    groups["ranking"] = _ranking(search, offered)
    groups["steps"] = _steps(search, motions, error, offered)
    groups["omnibus"] = _omnibus(search)
    groups["holdout"] = _holdout(search, motions[-1])
    groups["judged"] = judged_models(groups, {"before": motions[0], "after": motions[-1]}, whole)
    if len(seen) > 1:
        groups["homogeneity"] = group_of("homogeneity", parts.homogeneity(search.models))
    return groups


def group_of(
    name: str,
    values: Mapping[str, Any],
    coords: Mapping[str, Any] | None = None,
    attrs: Mapping[str, Any] | None = None,
) -> xr.Dataset:
    """Return a group whose variables are described as in `variables.toml`."""
    return xr.Dataset(variables.described(TABLES[name], values), coords, attrs)


def texts_of(forces: Iterable[Force], names: Iterable[str]) -> dict[str, Any]:
    """Return the texts of forces by the names that results give them."""
    paths = {"unit": "units", "formula": "formula.text"}
    return {name: list(map(attrgetter(paths.get(name, name)), forces)) for name in names}


def labels_of(forces: Sequence[Force], names: Sequence[str]) -> dict[str, tuple[str, list[str]]]:
    """Return the texts of candidates as coordinates."""
    return {name: ("candidate", texts) for name, texts in texts_of(forces, names).items()}


def _records(seen: Sequence[xr.Dataset], whole: Sequence[xr.Dataset], motions: Motions) -> list[xr.Dataset]:
    """Return the fitted records, with the angles of the first and the last model.

    The noise is that of the whole run, as in a result of `identify`.
    """
    records = []
    for at, run in enumerate(seen):
        ends = [motions[0][at], motions[-1][at]]
        simulated = np.stack([run.angle.values - motion.residual for motion in ends])
        values = {"residual_noise": ends[-1].noise.standard_deviation}
        both = with_noise_and_models(run, ["before", "after"], simulated)
        if not inputs_of(run):
            both = both.assign(variables.described("record", {"noise": sensor_noise(whole[at])}))
        records.append(both.assign(variables.described(TABLES["records"], values)))
    return records


def _ranking(search: Search, offered: ForceLibrary) -> xr.Dataset:
    """Return score, p-value, coefficient and shapes of every candidate before each effect and at the end."""
    symbols, level = list(offered.symbols), search.models[0].settings.level
    names = [f"{force.symbol}.{name}" for force in offered for name in force.shape]
    z, p_value, coefficient = np.full((3, len(search.screenings), len(symbols)), np.nan)
    shapes = np.full((len(search.screenings), len(names)), np.nan)
    reasons = np.full(z.shape, "in the model", dtype=object)
    for i, screening in enumerate(search.screenings):
        for at in screening.best(testable=False):
            j = symbols.index(screening.trials[at].force.symbol)
            reasons[i, j] = screening.reasons[at]
            for name, value in screening.trials[at].shapes.items():
                shapes[i, names.index(name)] = value
            if not screening.reasons[at]:
                z[i, j], p_value[i, j] = screening.z[at], screening.p_values[at]
                coefficient[i, j] = screening.coefficients[at]
    tests = np.array([screening.tests for screening in search.screenings])
    values: dict[str, Any] = {"z": z, "p_value": p_value, "significant": p_value < level}
    values |= {"coefficient": coefficient, "testable": reasons == "", "reason": reasons}
    values |= {"independent_tests": tests, "threshold": scipy.stats.norm.isf(level / (2.0 * tests))}
    values |= {"significance_level": level}
    coords: dict[str, Any] = {"candidate": symbols, **labels_of(offered.forces, ("name", "family", "unit"))}
    if names:
        # netCDF has no empty axis.
        values["shape"], coords["shape_parameter"] = shapes, names
    return group_of("ranking", values, coords)


def _steps(search: Search, motions: Motions, error: Array | None, offered: ForceLibrary) -> xr.Dataset:
    """Return the effects added, in order, with their final coefficients and the deviance each explains."""
    if not search.effects:
        # netCDF has no empty axis: without a step, store only the count.
        return xr.Dataset(attrs={"count": 0})
    final, widening = search.models[-1], search.screenings[-1].widening
    symbols = [trial.force.symbol for trial in final.trials]
    places = [symbols.index(symbol) for symbol in search.effects]
    coefficients = final.coefficients[places]
    errors = np.sqrt(np.diag(free_motion.total_covariance(final, widening, error)))[places]
    improved = unseen.improvements(search.predictions)
    values = texts_of(
        [final.trials[at].force for at in places], ("symbol", "name", "family", "kind", "unit", "formula")
    )
    values |= {
        "coefficient": coefficients,
        "standard_error": errors,
        "z": coefficients / errors,
        "significant": np.abs(coefficients / errors) >= scipy.stats.norm.isf(0.5 * final.settings.level),
        "gain": -np.diff([model.deviance for model in search.models]),
        "p_value": search.p_values,
        "selection_step": [_selected_at(search, symbol) for symbol in search.effects],
        "collinear": np.isin(search.effects, search.collinear),
        "prediction_z": improved,
        "worsens_holdout": improved < -final.settings.refuted,
    }
    residuals = [np.concatenate([run.residual for run in of_model]) for of_model in motions]
    of_each_run = map(free_motion.random_forces, search.models)
    of_models: dict[str, list[Any]] = {
        "residual": [root_mean_square(residual) for residual in residuals],
        "whitened_residual": _whitened(search),
        "random_force": [np.mean([f.density for f in forces]) for forces in of_each_run],
    }
    for name, of_each in of_models.items():
        values |= {f"{name}_before": of_each[:-1], f"{name}_after": of_each[1:]}
    coords: dict[str, Any] = {
        "candidate": list(offered.symbols),
        "part": list(variables.PARTS_OF_RECORD),
    }
    values |= _competition(search, list(offered.symbols), error is None) | _pairs(search)
    if shapes := final.shapes:
        held = {name: widening * its_error for name, its_error in final.shape_errors().items()}
        of_effect = np.array([[name.startswith(f"{s}.") for name in shapes] for s in search.effects])
        pair = [np.where(of_effect, [table[name] for name in shapes], np.nan) for table in (shapes, held)]
        values["shape"], coords["shape_parameter"] = tuple(pair), list(shapes)
    if competing := _competing_shapes(search):
        # netCDF has no empty axis.
        values["competing_shape"] = np.transpose([*competing.values()])
        coords["competing_shape_parameter"] = list(competing)
    return group_of("steps", values, coords, {"count": len(places)})


def _whitened(search: Search) -> list[float]:
    """Return each model's RMS residual about the final path, in the final model's noise: it never rises."""
    final = search.screenings[-1].model
    tables = np.concatenate(final.white_tables())
    kept = [final.columns_without(search.effects[count:]) for count in range(len(search.effects) + 1)]
    squares = [parts.squares_left(tables[:, columns], tables[:, 0], 1e-12)[0] for columns in kept]
    return [float(np.sqrt(rest / len(tables))) for rest in squares]


def _selected_at(search: Search, symbol: str) -> int:
    """Return the selection step after which an effect remained in the model."""
    absent = [symbol not in {t.force.symbol for t in s.model.trials} for s in search.screenings]
    return max((at for at, out in enumerate(absent[:-1]) if out), default=0)


def _competition(search: Search, symbols: Sequence[str], complete: bool) -> dict[str, Any]:
    """Return the probabilities of candidates, and of no force, in place of each effect; also in parts.

    If the final model leaves more than noise (not `complete`), the probabilities are the mean over the whole
    record and its parts.
    """
    probability: list[list[float]] = []
    by_chance: list[float] = []
    stands: list[int] = []
    likeliest: list[list[str]] = []
    settings = search.models[0].settings
    for symbol in search.effects:
        rivals, costs = search.rivals[symbol], parts.costs_in_parts(search, symbol)
        likely = (
            probabilities([*rivals.values()]) if complete else parts.probabilities_in_parts(costs, rivals)
        )
        of_rivals = dict(zip(rivals, likely.tolist(), strict=True))
        inside = {
            name for name, tied in zip(rivals, credible(likely, settings.credible), strict=True) if tied
        }
        by_chance.append(of_rivals[""] if "" in inside else 0.0)
        probability.append([of_rivals[s] if s in inside | {symbol} else np.nan for s in symbols])
        table, names = np.array([*costs.values()]), list(costs)
        stands.append(int(np.sum(table.min(axis=0) > -settings.outside_of_set)))
        # "" for no force in the effect's place.
        likeliest.append([names[best] for best in table.argmin(axis=0)])
    return {
        "tie_probability": probability,
        "chance_probability": by_chance,
        "credible": np.isfinite(probability),
        "penalised_deviance": [[search.rivals[of].get(s, np.nan) for s in symbols] for of in search.effects],
        "stands_in": stands,
        "likeliest_in_parts": likeliest,
    }


def _pairs(search: Search) -> dict[str, Any]:
    """Return the pairs of candidates that may be the true forces in place of each effect."""
    pairs = [search.pairs[symbol] for symbol in search.effects]
    best = np.array([min(of_effect.values(), default=np.nan) for of_effect in pairs])
    odds = {"pair_odds": np.exp(-0.5 * best)}
    most = max(map(len, pairs))
    if not most:
        # netCDF has no empty axis.
        return odds
    nothing = ("", "")
    return odds | {"pairs": [[*of_effect, *[nothing] * (most - len(of_effect))] for of_effect in pairs]}


def with_inseparable(tree: xr.DataTree) -> xr.DataTree:
    """Return a discovery whose steps state which competing effects no run of this kind separates.

    Forces are compared in motions up to the largest angle of the records, in their unit.
    """
    offered = effects.candidates_of(tree)
    size = max(float(np.abs(tree[group].angle).max()) for group in variables.record_groups(tree))
    steps = tree["steps"].to_dataset()
    numbers = np.full((steps.attrs["count"], len(offered)), np.nan)
    for at, step in enumerate(effects.steps_taken(tree)):
        fitted = [step[name].to_series().dropna() for name in ("shape", "competing_shape") if name in step]
        shapes = {name: value for part in fitted for name, value in part.items()}
        forces = [offered[symbol] for symbol in effects.credible_set(step)]
        alike = partial(inseparable, amplitude=size, shapes=shapes)
        for number, group in enumerate(effects.grouped(forces, alike)):
            for force in group:
                numbers[at, steps.candidate.values.tolist().index(force.symbol)] = number
    if len(numbers):
        described = variables.described(TABLES["steps"], {"inseparable": numbers})
        tree["steps"] = xr.DataTree(steps.assign(described))
    return tree


def _competing_shapes(search: Search) -> dict[str, Array]:
    """Return the shape parameters (step,) of the candidates that were fitted in the place of each effect."""
    competing: dict[str, Array] = {}
    for at, symbol in enumerate(search.effects):
        for name in search.rivals[symbol]:
            fitted = search.fits.kept.get(frozenset(search.effects) - {symbol} | {name})
            shapes = {} if fitted is None else fitted.shapes
            for key in (key for key in shapes if key.startswith(f"{name}.")):
                competing.setdefault(key, np.full(len(search.effects), np.nan))[at] = shapes[key]
    return competing


def _omnibus(search: Search) -> xr.Dataset:
    """Return the omnibus tests of each selection step."""
    names = {"z": "omnibus_z", "widening": "widening", "p_value": "omnibus_p_value"}
    values = {name: np.array([getattr(s, of) for s in search.screenings]) for name, of in names.items()}
    values["significant"] = values["p_value"] < search.models[0].settings.level
    return group_of("omnibus", values, {"trial_force": omnibus_test.trial_names()})


def _holdout(search: Search, final: Sequence[free_motion.FreeMotion]) -> xr.Dataset:
    noise = root_mean_square([run.noise.standard_deviation for run in final])
    of_periods = [prediction.log_densities for prediction in search.predictions]
    rms = np.array([prediction.rms for prediction in search.predictions])
    above = rms**2 - noise**2
    values = {
        "rms": rms,
        # Parts that are shorter than a period have no score.
        "log_score": [float(np.mean(scores)) if len(scores) else np.nan for scores in of_periods],
        "residual_noise": noise,
        "residual_above_noise": above / above[0] if above[0] > 0.0 else np.full(len(above), np.nan),
    }
    return group_of("holdout", values)
