"""A search as datasets: records, ranking of the candidates, steps, omnibus tests, hold-out."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import xarray as xr
from scipy.stats import norm

from sysid_trib.arrays import Array
from sysid_trib.discovery.demodulation import demodulate
from sysid_trib.discovery.fits import credible, probabilities
from sysid_trib.discovery.free_motion import FreeMotion, free_motions, model_identification, total_covariance
from sysid_trib.discovery.missing_force import detectability, texts_of
from sysid_trib.discovery.parts import Stability, homogeneity
from sysid_trib.discovery.screen import Screening
from sysid_trib.discovery.search import Search
from sysid_trib.discovery.unseen import Prediction, improvements
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.random_force import DENSITY_UNITS, RandomForce
from sysid_trib.records.decay import RECORD_PARTS, root_mean_square
from sysid_trib.results.effects import PAIR, PAIRS
from sysid_trib.results.variables import (
    PER_FORCE_UNIT,
    Variables,
    group_names,
    text_variable,
    variable,
    with_error,
)

STEP_TEXTS = ("symbol", "name", "family", "kind", "unit", "formula")
# In an effect's place: nothing, and a random force takes the blame.


def groups_of(
    seen: Sequence[xr.Dataset],
    search: Search,
    stability: Stability,
    offered: ForceLibrary,
    frequency: float | None,
) -> dict[str, xr.Dataset]:
    """What `discover` returns, group by group; `seen` : what the models are fitted to."""
    motions = [free_motions(model) for model in search.models]
    records = zip(group_names("record", len(seen)), _records(seen, motions), strict=True)
    groups: dict[str, xr.Dataset] = dict(records)
    ends = (("", motions[0], search.screenings[0]), ("_after", motions[-1], search.screenings[-1]))
    for when, of_model, _ in ends:
        groups[f"discrepancy{when}"] = demodulate(of_model)
    for when, _, screening in ends:
        groups[f"detectability{when}"] = detectability(screening)
    groups["ranking"] = _ranking(search, offered)
    groups["steps"] = _steps(search, motions, stability, offered)
    groups["omnibus"] = _omnibus(search)
    for name, at in (("before", 0), ("after", -1)):
        model, factor = search.models[at], _error_factor(search, at)
        error = stability.model_error if at else None
        groups[name] = model_identification(model, motions[at], seen, frequency, factor, error)
    groups["holdout"] = _holdout(motions[-1], stability.predictions)
    if len(seen) > 1:
        groups["homogeneity"] = homogeneity(search.models)
    return groups


def _error_factor(search: Search, at: int = -1) -> float:
    """By how much the errors of a model are widened: by the omnibus test, where something is missing."""
    return search.screenings[at].omnibus.widening(search.models[0].settings.level)


def _records(seen: Sequence[xr.Dataset], motions: Sequence[Sequence[FreeMotion]]) -> list[xr.Dataset]:
    """What the models are fitted to, with the angle of the first and the last of them."""
    records = []
    for at, run in enumerate(seen):
        ends = [motions[0][at], motions[-1][at]]
        simulated = np.stack([run.angle.values - motion.residual for motion in ends])
        angle = variable(("model", "time"), simulated, "angle of the model", "rad")
        level = ends[-1].noise.standard_deviation
        noise = variable((), level, "standard deviation of the sensor's noise in a sample", "rad")
        both = run.assign_coords(model=["before", "after"])
        records.append(both.assign(simulated_angle=angle, residual_noise=noise))
    return records


def _ranking(search: Search, offered: ForceLibrary) -> xr.Dataset:
    """Score, p-value, coefficient and shapes of every candidate before each effect and at the end."""
    symbols = list(offered.symbols)
    names = [f"{force.symbol}.{name}" for force in offered for name in force.shape]
    z, p_value, coefficient = np.full((3, len(search.screenings), len(symbols)), np.nan)
    shapes = np.full((len(search.screenings), len(names)), np.nan)
    reasons = np.full(z.shape, "in the model", dtype=object)
    for i, screening in enumerate(search.screenings):
        for symbol, at in _best_trials(screening).items():
            j = symbols.index(symbol)
            reasons[i, j] = screening.reasons[at]
            for name, value in screening.trials[at].shapes.items():
                shapes[i, names.index(name)] = value
            if not screening.reasons[at]:
                z[i, j], p_value[i, j] = screening.z[at], screening.p_values[at]
                coefficient[i, j] = screening.coefficients[at]
    step, both = "selection_step", ("selection_step", "candidate")
    tests = np.array([screening.tests for screening in search.screenings])
    level = search.models[0].settings.level
    limit = norm.isf(level / (2.0 * tests))
    family_wise = "family-wise significance level at which an effect is named"
    gained = "score, the root of the deviance that it gains"
    data: Variables = {
        "z": variable(both, z, gained, "1"),
        "p_value": variable(both, p_value, "p-value of the score, corrected for the number of tests", "1"),
        "significant": variable(both, p_value < level, "whether the p-value is below the level"),
        "coefficient": variable(both, coefficient, "coefficient by the score", PER_FORCE_UNIT),
        "testable": variable(both, reasons == "", "whether the record can test it"),
        "reason": text_variable(both, reasons, "why it is not tested"),
        "independent_tests": variable(step, tests, "number of independent tests", "1"),
        "threshold": variable(step, limit, "|z| of the level, corrected for the number of tests", "1"),
        "significance_level": variable((), level, family_wise, "1"),
    }
    if names:
        # netCDF has no empty axis.
        data["shape"] = variable((step, "shape_parameter"), shapes, "shape parameter of the highest score")
    texts = texts_of(offered, ("name", "family", "unit"))
    labels = {name: ("candidate", values) for name, values in texts.items()}
    return xr.Dataset(data, {"candidate": symbols, **labels} | ({"shape_parameter": names} if names else {}))


def _best_trials(screening: Screening) -> dict[str, int]:
    """The trial of each candidate that gains most."""
    best: dict[str, int] = {}
    for at in np.argsort(-screening.gains, kind="stable").tolist():
        best.setdefault(screening.trials[at].force.symbol, at)
    return best


def _steps(
    search: Search, motions: Sequence[Sequence[FreeMotion]], stability: Stability, offered: ForceLibrary
) -> xr.Dataset:
    """The effects added, in order, with their final coefficients and what each explains."""
    if not search.effects:
        # netCDF has no empty axis: without a step there is but the count.
        return xr.Dataset(attrs={"count": 0})
    final = search.models[-1]
    symbols = [trial.force.symbol for trial in final.trials]
    places = [symbols.index(symbol) for symbol in search.effects]
    forces = [final.trials[at].force for at in places]
    values = final.coefficients
    errors = np.sqrt(np.diag(total_covariance(final, _error_factor(search), stability.model_error)))
    z = values[places] / errors[places]
    chosen = np.array([_selected_at(search, symbol) for symbol in search.effects])
    gains = -np.diff([model.deviance for model in search.models])
    collinear = np.isin(search.effects, search.collinear)
    residual = [root_mean_square(np.concatenate([run.residual for run in of_model])) for of_model in motions]
    white = _whitened(search)
    improved = improvements(stability.predictions)
    density = [_density(model) for model in search.models]
    column = partial(variable, "step")
    of_density = "one-sided density of the random force {}, on the mean"
    of_whitened = "RMS of the residual {}, in which the final model's is white, over the noise"
    data = {
        "coefficient": column(values[places], "coefficient in the final model", PER_FORCE_UNIT),
        "standard_error": column(errors[places], "standard error of the coefficient", PER_FORCE_UNIT),
        "z": column(z, "coefficient over its standard error", "1"),
        "significant": column(
            np.abs(z) >= norm.isf(0.5 * final.settings.level), "whether it is significant in the end"
        ),
        "gain": column(gains, "by how much the effect lowers the deviance", "1"),
        "p_value": column(search.p_values, "p-value of what it explains beside the others, corrected", "1"),
        "selection_step": column(chosen, "selection step at which the effect was chosen", "1"),
        "residual_before": column(residual[:-1], "RMS residual of the free motion before", "rad"),
        "residual_after": column(residual[1:], "RMS residual of the free motion after", "rad"),
        "whitened_residual_before": column(white[:-1], of_whitened.format("before"), "1"),
        "whitened_residual_after": column(white[1:], of_whitened.format("after"), "1"),
        "random_force_before": column(density[:-1], of_density.format("before"), DENSITY_UNITS),
        "random_force_after": column(density[1:], of_density.format("after"), DENSITY_UNITS),
        "collinear": column(collinear, "whether it is not separately identifiable"),
        "prediction_z": column(
            improved, "better prediction of what was held out by the final model, in standard errors", "1"
        ),
        "worsens_holdout": column(
            improved < -final.settings.refuted, "whether it makes the prediction worse"
        ),
    }
    texts = texts_of(forces, STEP_TEXTS)
    data |= {name: text_variable("step", text, f"{name} of the effect") for name, text in texts.items()}
    data |= _competition(search, offered, stability) | _pairs(search) | _step_shapes(search)
    data |= _in_parts(search, stability)
    shaped = {"shape_parameter": list(_shapes(final))} if "shape" in data else {}
    competing = _competing_shapes(search)
    if competing:
        # netCDF has no empty axis.
        shaped["competing_shape_parameter"] = list(competing)
        text = "shape parameter of a candidate in the effect's place, nan of one that is not in the set"
        dims = ("step", "competing_shape_parameter")
        data["competing_shape"] = variable(dims, np.transpose([*competing.values()]), text)
    return xr.Dataset(data, {"candidate": list(offered.symbols)} | shaped, {"count": len(forces)})


def _density(model: FittedModel) -> float:
    """Density of the random force, mean over the runs."""
    per_tau = float(np.mean(model.likelihood.ratios * model.likelihood.variances))
    return RandomForce.density_of(per_tau, model.rows[0].path.frequency)


def _whitened(search: Search) -> Array:
    """RMS residual of each model about the final path, in the noise of the final model: it never rises."""
    final = search.screenings[-1].model
    tables = np.concatenate(final.white_tables())
    later = [set(range(final.columns))]
    kept = later[0]
    for symbol in reversed(search.effects):
        kept = kept - set(final.columns_of(symbol))
        later.insert(0, kept)
    target = tables[:, 0]
    rms = []
    for columns in later:
        design = tables[:, [1 + column for column in sorted(columns)]]
        residual = target - design @ np.linalg.lstsq(design, target, rcond=1e-12)[0]
        rms.append(root_mean_square(residual))
    return np.array(rms)


def _selected_at(search: Search, symbol: str) -> int:
    """The selection step after which an effect came into the model for good."""
    absent = [symbol not in {t.force.symbol for t in s.model.trials} for s in search.screenings]
    return max((at for at, out in enumerate(absent[:-1]) if out), default=0)


def _in_parts(search: Search, stability: Stability) -> Variables:
    """In how many parts of the record each name stands, and which is the likeliest in each."""
    names = [stability.names[symbol] for symbol in search.effects]
    likeliest = [PAIRS.join(of_effect.likeliest) for of_effect in names]
    where = f"of {len(RECORD_PARTS)} parts of the record, {', '.join(RECORD_PARTS)}"
    return {
        "stands_in": variable(
            "step",
            [int(np.sum(of_effect.stands)) for of_effect in names],
            f"number {where}, where it stands",
            "1",
        ),
        "likeliest_in_parts": text_variable("step", likeliest, f"likeliest in its place, {where}"),
    }


def _competition(search: Search, offered: ForceLibrary, stability: Stability) -> Variables:
    """What each candidate explains in the place of each effect, and what chance does.

    Where the final model leaves more than noise, by the mean of its probabilities over the record and its
    parts.
    """
    symbols = list(offered.symbols)
    probability, deviance = np.full((2, len(search.effects), len(symbols)), np.nan)
    p_value_of = np.zeros(len(search.effects))
    for at, symbol in enumerate(search.effects):
        rivals = search.rivals[symbol]
        in_parts = stability.names[symbol]
        likely = (
            probabilities(list(rivals.values())) if stability.is_complete else in_parts.probabilities(rivals)
        )
        inside = credible(likely, search.models[0].settings.credible)
        for name, excess, p, tied in zip(rivals, rivals.values(), likely, inside, strict=True):
            if not name:
                p_value_of[at] = p if tied else 0.0
                continue
            deviance[at, symbols.index(name)] = excess
            if tied or name == symbol:
                probability[at, symbols.index(name)] = p
    dims = ("step", "candidate")
    odds = "-2 ln of the odds against the effect, inf of a fit that failed, nan untried"
    tied_text = (
        "probability in the effect's place if all were as likely before, nan outside of the credible set"
    )
    by_chance = "probability of no force in the effect's place, 0 outside of the credible set"
    return {
        "tie_probability": variable(dims, probability, tied_text, "1"),
        "chance_probability": variable("step", p_value_of, by_chance, "1"),
        "credible": variable(dims, np.isfinite(probability), "whether it is in the 95 % credible set"),
        "penalised_deviance": variable(dims, deviance, odds, "1"),
    }


def _pairs(search: Search) -> Variables:
    """Pairs of candidates that may be the truth in the place of each effect."""
    pairs = [search.pairs[symbol] for symbol in search.effects]
    texts = [PAIRS.join(PAIR.join(names) for names in of_effect) for of_effect in pairs]
    best = np.array([min(of_effect.values(), default=np.nan) for of_effect in pairs])
    return {
        "pairs": text_variable("step", texts, "pairs that cannot be separated from the effect"),
        "pair_odds": variable(
            "step", np.exp(-0.5 * best), "odds of the likeliest pair to it, nan of none", "1"
        ),
    }


def _shapes(model: FittedModel) -> dict[str, float]:
    return {k: value for trial in model.trials for k, value in trial.shapes.items()}


def _competing_shapes(search: Search) -> dict[str, Array]:
    """Shape parameters (step,) of the candidates that were fitted in the place of each effect."""
    competing: dict[str, Array] = {}
    for at, symbol in enumerate(search.effects):
        for name in search.rivals[symbol]:
            fitted = search.fits.kept.get(frozenset(search.effects) - {symbol} | {name})
            shapes = {} if fitted is None else _shapes(fitted)
            for key in (key for key in shapes if key.startswith(f"{name}.")):
                competing.setdefault(key, np.full(len(search.effects), np.nan))[at] = shapes[key]
    return competing


def _step_shapes(search: Search) -> Variables:
    """Shape parameters of each effect in the final model, nan those of the others."""
    final = search.models[-1]
    shapes, factor = _shapes(final), _error_factor(search)
    errors = {name: factor * error for name, error in final.shape_errors().items()}
    if not shapes:
        return {}
    of_effect = np.array([[name.startswith(f"{s}.") for name in shapes] for s in search.effects])
    pair = [np.where(of_effect, [table[name] for name in shapes], np.nan) for table in (shapes, errors)]
    return with_error("shape", ("step", "shape_parameter"), (pair[0], pair[1]), "shape parameter", "")


def _omnibus(search: Search) -> xr.Dataset:
    """At each selection step the tests that know no candidate."""
    tests = [screening.omnibus for screening in search.screenings]
    p_value = np.array([test.p_value for test in tests])
    factors = [_error_factor(search, at) for at in range(len(tests))]
    return xr.Dataset(
        {
            "z": variable(("selection_step", "trial_force"), [test.z for test in tests], "score", "1"),
            "widening": variable("selection_step", factors, "by how much errors are widened for it", "1"),
            "p_value": variable("selection_step", p_value, "p-value of all together", "1"),
            "significant": variable(
                "selection_step", p_value < search.models[0].settings.level, "whether it is below the level"
            ),
        },
        {"trial_force": list(tests[0].names)},
    )


def _holdout(final: Sequence[FreeMotion], predictions: Sequence[Prediction]) -> xr.Dataset:
    noise = root_mean_square([run.noise.standard_deviation for run in final])
    rms = np.array([prediction.rms for prediction in predictions])
    above = rms**2 - noise**2
    ratio = above / above[0] if above[0] > 0.0 else np.full(len(above), np.nan)
    # A part that is shorter than a period has no score.
    of_periods = [np.concatenate(prediction.scores) for prediction in predictions]
    score = [float(np.mean(scores)) if len(scores) else np.nan for scores in of_periods]
    excess = "squared residual above the noise, over the start model's"
    return xr.Dataset(
        {
            "rms": variable("model", rms, "RMS residual of the free motion", "rad"),
            "log_score": variable("model", score, "mean logarithm of the predictive density of a row", "1"),
            "residual_noise": variable(
                (), noise, "standard deviation of the sensor's noise in a sample", "rad"
            ),
            "residual_above_noise": variable("model", ratio, excess, "1"),
        }
    )
