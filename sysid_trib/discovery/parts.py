"""Summary of a search: its verdict, detectability, and differences between runs or parts of a record."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from scipy.linalg import block_diag

from sysid_trib.arrays import Array
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.engine.start_model import refitted
from sysid_trib.discovery.fits import evidence, probabilities
from sysid_trib.discovery.screen import Screening
from sysid_trib.discovery.search import Search, may_gain
from sysid_trib.discovery.unseen import improvements
from sysid_trib.forces.force import Force
from sysid_trib.results.effects import NAMED
from sysid_trib.results.variables import PARTS_OF_RECORD
from sysid_trib.validation.model_error import covariance_by_parts


def homogeneity(models: Sequence[FittedModel]) -> dict[str, Any]:
    """Test for each model whether the runs differ, by small deviations.

    Parameters
    ----------
    models : sequence of FittedModel
        Models of several runs each; the last is the final one.

    Returns
    -------
    dict
        Over `model`: `chi_square`, the part of the residual explained by separate coefficients, shapes and
        frequency of each run, with `degrees_of_freedom`, `p_value` and `differ`; `most`, the parameter that
        alone explains most of it; and `gain`, the decrease of the deviance by the effect added next, nan for
        the last model.

    Notes
    -----
    This is Rao's score test, in both noises of each run. A missing force changes with the amplitude from run
    to run. So the test shows that the runs need different coefficients, but not why.
    """
    # `validation.identify.run_agreement` fits each run alone, which takes longer and gives values of each
    # run.
    names = ("chi_square", "degrees_of_freedom", "most")
    tests = dict(zip(names, map(list, zip(*map(_differing, models), strict=True)), strict=True))
    p_value = scipy.stats.chi2.sf(tests["chi_square"], tests["degrees_of_freedom"])
    gains = [before.deviance - after.deviance for before, after in pairwise(models)]
    differ = p_value < models[0].settings.level
    return {**tests, "p_value": p_value, "differ": differ, "gain": [*gains, np.nan]}


def _differing(model: FittedModel) -> tuple[float, int, str]:
    """Return the gain by separate parameters of the runs, their number, and the name of the largest."""
    trials = len(model.trials)
    shapes = {column: f"{model.trials[at].force.symbol}.{name}" for at, name, column in model.shape_columns}
    names = dict(enumerate(trial.force.symbol for trial in model.trials)) | shapes
    names |= {trials: "w"} if model.frequency_free else {}
    tables = model.white_tables()
    single = {name: _explained(tables, [column])[0] for column, name in names.items()}
    return *_explained(tables, list(names)), max(single, key=lambda name: single[name])


def _explained(tables: Sequence[Array], columns: Sequence[int]) -> tuple[float, int]:
    """Return the squares explained by separate columns in all runs but the first, and their number."""
    whole = np.concatenate(tables)
    target, common = whole[:, 0], whole[:, 1:]
    # The separate columns of each run except the first.
    own = block_diag(*(table[:, 1:][:, list(columns)] for table in tables))[:, len(columns) :]
    squares, rank = squares_left(common, target)
    more, full = squares_left(np.hstack([common, own]), target)
    return max(0.0, squares - more), max(1, full - rank)


def squares_left(design: Array, target: Array, least: float = 1e-5) -> tuple[float, int]:
    """Return the residual sum of squares of least squares, and the rank of the design.

    Directions shorter than this fraction of the longest are ignored: by default those that a run does not
    determine.
    """
    size = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    basis, singular, _ = np.linalg.svd(design / size, full_matrices=False)
    basis = basis[:, singular > least * singular[0]]
    residual = target - basis @ (basis.T @ target)
    return float(residual @ residual), basis.shape[1]


def costs_in_parts(search: Search, symbol: str) -> dict[str, Array]:
    """Return the evidence of an effect and its competitors in parts of the record.

    Returns
    -------
    dict of str to (part,) array of float
        For each rival: minus twice the logarithm of its evidence over the effect's. It is computed with the
        rows along the rival's own path, with coefficients of the part.
    """
    rest, scores = frozenset(search.effects) - {symbol}, dict[str, Array]()
    for name in search.rivals[symbol]:
        model = search.fits.kept.get(rest | {name} - {""})
        if model is not None:
            scores[name] = _deviances(model) + (evidence(model) - model.deviance)
    own = scores.setdefault(symbol, np.zeros(len(PARTS_OF_RECORD)))
    return {name: score - own for name, score in scores.items()}


def probabilities_in_parts(costs: Mapping[str, Array], whole: Mapping[str, float]) -> Array:
    """Return the probability of each rival, (rival,): the mean of the `whole` record's and its parts'."""
    missing = np.full(len(PARTS_OF_RECORD), np.inf)
    table = [np.append(costs.get(name, missing), of_whole) for name, of_whole in whole.items()]
    return np.asarray(np.mean([probabilities(of_part) for of_part in np.transpose(table)], axis=0))


def error_of_model(model: FittedModel) -> Array:
    """Return the part of the errors of coefficients and frequency (rad/s) not due to noise, (trial + 1,).

    It is the change between parts of the record beyond the change due to fewer data; shapes are held. It
    replaces `validation.model_error`, and uses the rows along the path of the whole record, because a search
    has no time to fit the parts again.
    """
    count, kept = len(model.trials), 1 + model.columns - len(model.shape_columns)
    tables = [table[:, :kept] for table in model.white_tables()]
    fits = [_solved(_in_part(tables, *part)) for part in ((0.0, 1.0), *PARTS_OF_RECORD.values())]
    values, variances = (np.array(part)[:, : count + 1] for part in zip(*fits, strict=True))
    errors = np.sqrt(variances)
    covariance = covariance_by_parts(values[1:] - values[0], errors[1:], errors[0], equal_parts=True)
    error = np.sqrt(np.diag(covariance))
    # The stiffness changes by twice the relative change of the frequency; it has no error if the frequency is
    # held.
    error[count:] *= 0.5 * model.rows[0].path.frequency * model.frequency_free
    return error


def _in_part(of_runs: Sequence[Array], low: float, high: float) -> Array:
    """Return the values of each run within a part of the record."""
    return np.concatenate([run[round(low * len(run)) : round(high * len(run))] for run in of_runs])


def _deviances(model: FittedModel) -> Array:
    """Return the deviance of a model on the rows of each part, (part,), with the noises of the whole."""
    tables, of_fit = model.white_tables(), model.likelihood
    runs = zip(model.rows, of_fit.ratios.tolist(), of_fit.variances, strict=True)
    logarithms = [2.0 * np.log(rows.factor(ratio)[0]) + np.log(variance) for rows, ratio, variance in runs]
    deviances = []
    for part in PARTS_OF_RECORD.values():
        inside = _in_part(tables, *part)
        squares, _ = squares_left(inside[:, 1:], inside[:, 0], 1e-10)
        deviances.append(squares + float(np.sum(_in_part(logarithms, *part))))
    return np.array(deviances)


def _solved(whole: Array) -> tuple[Array, Array]:
    """Return the least-squares coefficients of white rows, the target first, and their variances."""
    size = np.maximum(np.linalg.norm(whole[:, 1:], axis=0), 1e-300)
    design = whole[:, 1:] / size
    inverse = np.linalg.pinv(design.T @ design, rcond=1e-10, hermitian=True)
    return inverse @ (design.T @ whole[:, 0]) / size, np.diag(inverse) / size**2


def detectability(screening: Screening) -> tuple[dict[str, Any], list[Force]]:
    """Return the detectable coefficient of each candidate given the residual, and inseparable candidates.

    Parameters
    ----------
    screening : Screening
        The candidates with a model.

    Returns
    -------
    values : dict of str to array
        Over `candidate`: `detectable`, the coefficient of five standard errors (at the best of the tried
        values of its shape parameters; nan if not testable); `independent_fraction`, the fraction of its
        column outside the span of the model's columns; `testable`, and the `reason` if not. Also
        `cosine(candidate, other)` between these independent parts, and `alike` for two candidates that a
        credible set would not separate if one of them had 20 standard errors.
    forces : list of Force
        The candidates.
    """
    symbols = dict.fromkeys(trial.force.symbol for trial in screening.trials)
    at = np.array([_best(screening, symbol) for symbol in symbols], dtype=int)
    reasons = [screening.reasons[i] for i in at]
    # No candidate remains if the search added all of them.
    testable = np.array([not reason for reason in reasons], dtype=bool)
    cosine = np.abs(screening.correlation[np.ix_(at, at)])
    np.fill_diagonal(cosine, 1.0)
    nearest = np.sqrt(1.0 - screening.model.settings.outside_of_set / NAMED**2)
    values = {
        # An effect of this many standard errors is detectable.
        "detectable": np.where(testable, 5.0 * screening.errors[at], np.nan),
        "independent_fraction": screening.outside[at],
        "testable": testable,
        "reason": reasons,
        "alike": (cosine > nearest) & testable[:, None] & testable & ~np.eye(len(at), dtype=bool),
        "cosine": cosine,
    }
    return values, [screening.trials[i].force for i in at]


def _best(screening: Screening, symbol: str) -> int:
    """Return the testable trial of a force with the smallest error, in units of its force; else any."""
    of_force = [i for i, trial in enumerate(screening.trials) if trial.force.symbol == symbol]
    good = [i for i in of_force if not screening.reasons[i]]
    size = screening.errors * screening.relative_force
    return min(good, key=lambda i: float(size[i])) if good else of_force[0]


def closing_effect(done: Search) -> str:
    """Return the effect that only `max_effects` excludes and that would complete the model; else empty."""
    settings, model = done.models[-1].settings, done.next_best
    if model is None or not len(done.effects) == settings.max_effects > 0:
        return ""
    last = done.fits.screened(model)
    missing = last.omnibus_p_value < settings.level or may_gain(last)
    return "" if missing or not done.fits.is_complete(refitted(model)) else model.effects[-1]


def not_improving(done: Search) -> str:
    """Return the most likely effect that was left out because it does not improve the prediction."""
    model = done.next_best
    asked = model is not None and done.converged and len(done.effects) < model.settings.max_effects
    return model.effects[-1] if model is not None and asked else ""


def outcome_of(done: Search, closing: str = "") -> str:
    """Return one of `results.judged.SEARCH_OUTCOMES`.

    `closing` : the only missing effect, which `max_effects` excludes.
    """
    # This is the outcome of the search; `validation.judge.verdict_word` gives the verdict on a model. Effects
    # that nearly cancel each other, or that do not predict, may imitate an effect that is not in the library.
    # A model whose motion does not follow the record explains nothing. The outcome of a search that did not
    # converge is unknown.
    last, settings = done.screenings[-1], done.models[0].settings
    refuted = np.any(improvements(done.predictions) < -settings.refuted)
    unphysical = bool(done.effects) and not done.followed
    if done.collinear or refuted or unphysical or not done.converged:
        return "unknown effect"
    noisy = done.noise_p_value >= settings.level and last.omnibus_p_value >= settings.level
    if closing or (noisy and not done.outstanding):
        return "explained" if done.effects else "nothing missing"
    return "unknown effect"
