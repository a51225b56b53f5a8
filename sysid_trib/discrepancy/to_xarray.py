"""A search as datasets: records, ranking of the candidates, steps, omnibus tests, hold-out."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import xarray as xr
from scipy.stats import chi2, norm

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.baseline import Baseline
from sysid_trib.discrepancy.collinearity import collinear_effects
from sysid_trib.discrepancy.competing_models import cost_of, tie_class
from sysid_trib.discrepancy.demodulation import demodulate
from sysid_trib.discrepancy.detectability import detectability, texts_of
from sysid_trib.discrepancy.homogeneity_test import homogeneity
from sysid_trib.discrepancy.model_sequence import WORSE, model_identification, residual_rms
from sysid_trib.discrepancy.stepwise_search import Search, SelectionStep
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.records.runs import root_mean_square
from sysid_trib.results.per_run import group_names
from sysid_trib.results.variables import PER_FORCE_UNIT, Variables, text_variable, variable, with_error

# An effect of fewer standard errors in the final model is not significant there.
SIGNIFICANT_Z = 3.0
STEP_TEXTS = ("symbol", "name", "family", "kind", "unit", "formula")


def groups_of(
    runs: Sequence[xr.Dataset],
    search: Search,
    models: Sequence[Baseline],
    holdout: Array,
    offered: ForceLibrary,
    level: float,
) -> dict[str, xr.Dataset]:
    """What `discover` returns, group by group; an effect is named at the family-wise `level`."""
    records = zip(group_names("record", len(runs)), _records(runs, models), strict=True)
    groups: dict[str, xr.Dataset] = dict(records)
    ends = ("", search.selection_steps[0]), ("_after", search.selection_steps[-1])
    for when, step in ends:
        groups[f"discrepancy{when}"] = demodulate(step.before, step.references)
    for when, step in ends:
        groups[f"detectability{when}"] = detectability(step.found)
    groups["ranking"] = _ranking(search, offered, level)
    groups["steps"] = _steps(search, models, holdout, offered)
    groups["omnibus"] = _omnibus(search, level)
    groups["before"] = model_identification(models[0], runs)
    groups["after"] = model_identification(models[-1], runs)
    groups["holdout"] = _holdout(models[-1], holdout)
    if len(runs) > 1:
        groups["homogeneity"] = homogeneity(models, level)
    return groups


def _records(runs: Sequence[xr.Dataset], models: Sequence[Baseline]) -> list[xr.Dataset]:
    """The records, with the angle of the first and the last model."""
    ends = (models[0], models[-1])
    residuals = [model.problem.residuals(model.values) for model in ends]
    records = []
    for at, run in enumerate(runs):
        simulated = np.stack([run.angle.values + residual[at] for residual in residuals])
        angle = variable(("model", "time"), simulated, "angle of the model", "rad")
        level = ends[-1].noises[at].standard_deviation
        noise = variable((), level, "what no modulated harmonic of the motion follows, of a sample", "rad")
        both = run.assign_coords(model=["before", "after"])
        records.append(both.assign(simulated_angle=angle, residual_noise=noise))
    return records


def _ranking(search: Search, offered: ForceLibrary, level: float) -> xr.Dataset:
    """Score, p-value, coefficient and shapes of every candidate at each selection step and at the end."""
    symbols = list(offered.symbols)
    names = [f"{force.symbol}.{name}" for force in offered for name in force.shape]
    z, p_value, coefficient = np.full((3, len(search.selection_steps), len(symbols)), np.nan)
    shapes = np.full((len(search.selection_steps), len(names)), np.nan)
    reasons = np.full(z.shape, "in the model", dtype=object)
    for i, selection in enumerate(search.selection_steps):
        scores = selection.found
        for symbol, at in _best_trials(selection).items():
            j = symbols.index(symbol)
            reasons[i, j] = scores.reasons[at]
            for name, value in scores.trials[at].shapes.items():
                shapes[i, names.index(name)] = value
            if not scores.reasons[at]:
                z[i, j], p_value[i, j] = scores.z[at], scores.p_values[at]
                coefficient[i, j] = scores.z[at] / scores.size[at]
    step, both = "selection_step", ("selection_step", "candidate")
    tests = np.array([step.found.tests for step in search.selection_steps])
    limit = norm.isf(level / (2.0 * tests))
    family_wise = "family-wise significance level at which an effect is named"
    data: Variables = {
        "z": variable(both, z, "score", "1"),
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


def _best_trials(selection: SelectionStep) -> dict[str, int]:
    """Of each candidate the trial that scores highest."""
    best: dict[str, int] = {}
    for at in np.argsort(-np.abs(selection.found.z)).tolist():
        best.setdefault(selection.found.trials[at].force.symbol, at)
    return best


def _steps(search: Search, models: Sequence[Baseline], holdout: Array, offered: ForceLibrary) -> xr.Dataset:
    """The effects added, in order, with their final coefficients and what each explains."""
    if not search.added:
        # netCDF has no empty axis: without a step there is but the count.
        return xr.Dataset(attrs={"count": 0})
    parameters = search.final.problem.parameters
    forces = [parameters.library[symbol] for symbol in search.added]
    places = [parameters.index(symbol) for symbol in search.added]
    values, errors = search.final.values, np.sqrt(np.diag(search.final.covariance))
    z = values[places] / errors[places]
    chosen = np.array([_selected_at(search, symbol) for symbol in search.added])
    tests = np.array([search.selection_steps[at].found.tests for at in chosen])
    chi_square = np.array([model.chi_square for model in models])
    p_value = tests * chi2.sf(-np.diff(chi_square), [1 + len(force.shape) for force in forces])
    collinear = np.isin(search.added, collinear_effects(search.final, search.added))
    residual = [residual_rms(model) for model in models]
    whitened = np.sqrt(chi_square / [len(model.residual) for model in models])
    worse = holdout[1:] > WORSE * holdout[:-1]
    of_whitened = "RMS of the whitened residual {}, over the noise"
    column = partial(variable, "step")
    data = {
        "coefficient": column(values[places], "coefficient in the final model", PER_FORCE_UNIT),
        "standard_error": column(errors[places], "standard error of the coefficient", PER_FORCE_UNIT),
        "z": column(z, "coefficient over its standard error", "1"),
        "significant": column(np.abs(z) >= SIGNIFICANT_Z, "whether it is significant in the end"),
        "p_value": column(np.minimum(p_value, 1.0), "p-value of what the effect explains, corrected", "1"),
        "selection_step": column(chosen, "selection step at which the effect was chosen", "1"),
        "residual_before": column(residual[:-1], "RMS residual before", "rad"),
        "residual_after": column(residual[1:], "RMS residual after", "rad"),
        "whitened_residual_before": column(whitened[:-1], of_whitened.format("before"), "1"),
        "whitened_residual_after": column(whitened[1:], of_whitened.format("after"), "1"),
        "collinear": column(collinear, "whether it is not separately identifiable"),
        "worsens_holdout": column(worse, "whether it makes the prediction worse"),
    }
    texts = texts_of(forces, STEP_TEXTS)
    data |= {name: text_variable("step", text, f"{name} of the effect") for name, text in texts.items()}
    data |= _competition(search, offered) | _step_shapes(search, errors)
    shaped = {"shape_parameter": list(parameters.fit_shapes)} if "shape" in data else {}
    return xr.Dataset(data, {"candidate": list(offered.symbols)} | shaped, {"count": len(forces)})


def _selected_at(search: Search, symbol: str) -> int:
    """The selection step after which an effect came into the model for good."""
    before = [symbol not in step.before.problem.parameters.library.symbols for step in search.selection_steps]
    return max((at for at, absent in enumerate(before[:-1]) if absent), default=0)


def _competition(search: Search, offered: ForceLibrary) -> Variables:
    """What each candidate explains in the place of each effect."""
    symbols = list(offered.symbols)
    probability, deviance = np.full((2, len(search.added), len(symbols)), np.nan)
    for at, symbol in enumerate(search.added):
        effect_deviance = cost_of(search.final, symbol)
        for name, value in tie_class(search.final, symbol, search.ties[symbol]).items():
            probability[at, symbols.index(name)] = value
        for competitor in search.ties[symbol]:
            deviance[at, symbols.index(competitor.force.symbol)] = competitor.cost - effect_deviance
        deviance[at, symbols.index(symbol)] = 0.0
    dims = ("step", "candidate")
    odds = "-2 ln of the odds against the effect, inf of a fit that failed, nan untried"
    likely = "probability in the effect's place if all were as likely before, nan outside of the credible set"
    return {
        "tie_probability": variable(dims, probability, likely, "1"),
        "credible": variable(dims, np.isfinite(probability), "whether it is in the 95 % credible set"),
        "penalised_deviance": variable(dims, deviance, odds, "1"),
    }


def _step_shapes(search: Search, errors: Array) -> Variables:
    """Shape parameters of each effect in the final model, nan those of the others."""
    parameters = search.final.problem.parameters
    if not parameters.fit_shapes:
        return {}
    names = parameters.fit_shapes
    of_effect = np.array([[name.startswith(f"{symbol}.") for name in names] for symbol in search.added])
    places = [parameters.index(name) for name in names]
    pair = [np.where(of_effect, values[places], np.nan) for values in (search.final.values, errors)]
    return with_error("shape", ("step", "shape_parameter"), (pair[0], pair[1]), "shape parameter", "")


def _omnibus(search: Search, level: float) -> xr.Dataset:
    """At each selection step the tests that know no candidate."""
    tests = [step.generic for step in search.selection_steps]
    p_value = np.array([test.p_value for test in tests])
    return xr.Dataset(
        {
            "z": variable(("selection_step", "trial_force"), [test.z for test in tests], "score", "1"),
            "p_value": variable("selection_step", p_value, "p-value of all together", "1"),
            "significant": variable("selection_step", p_value < level, "whether it is below the level"),
        },
        {"trial_force": list(tests[0].names)},
    )


def _holdout(final: Baseline, rms: Array) -> xr.Dataset:
    noise = root_mean_square([n.standard_deviation for n in final.noises])
    above = rms**2 - noise**2
    ratio = above / above[0] if above[0] > 0.0 else np.full(len(above), np.nan)
    unexplained = "RMS over the runs of what no modulated harmonic of the motion follows"
    excess = "squared residual above the noise, over the start model's"
    return xr.Dataset(
        {
            "rms": variable("model", rms, "RMS residual of the prediction", "rad"),
            "residual_noise": variable((), noise, unexplained, "rad"),
            "residual_above_noise": variable("model", ratio, excess, "1"),
        }
    )
