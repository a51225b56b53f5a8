"""Forces that may be missing: what a residual asks for, and what a record could show or tell apart."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.stats import binned_statistic_2d

from sysid_trib.arrays import Array
from sysid_trib.discovery.free_motion import FreeMotion
from sysid_trib.discovery.screen import Screening
from sysid_trib.discovery.single_columns import projected
from sysid_trib.forces.force import Force
from sysid_trib.likelihood.fitted_model import FittedModel
from sysid_trib.likelihood.run_products import RunProducts
from sysid_trib.records.smoothing import smooth
from sysid_trib.results.effects import NAMED

# Cells of the map, each way.
CELLS = 11


def mean_missing_force(runs: Sequence[FreeMotion]) -> dict[str, Array]:
    """Mean force that residuals ask for, in cells of angle and rate.

    Returns
    -------
    dict
        `x` and `v` (rad); over both `force` as a part of I w^2 (nan without samples), its `standard_error` by
        the noise alone, and the number of `samples`.
    """
    cells = [(run.motion.x, run.motion.v, _force(run), _force_of_noise(run)) for run in runs]
    x, v, force, drawn = (np.concatenate(part, axis=-1) for part in zip(*cells, strict=True))
    size = 1.001 * float(np.max(np.hypot(x, v)))
    edges = np.linspace(-size, size, CELLS + 1)
    good = np.isfinite(force)
    if not np.any(good):
        # Where a smoothed residual has no middle, as in a record of a period: every cell is empty.
        good, force = np.ones(len(x), dtype=bool), np.full(len(x), np.nan)
    values = np.concatenate([np.ones((1, len(x))), force[None], drawn])[:, good]
    binned = binned_statistic_2d(x[good], v[good], values, "sum", bins=[edges, edges]).statistic
    samples = binned[0]
    mean, *scatter = np.where(samples > 0, binned[1:] / np.maximum(samples, 1.0), np.nan)
    error = np.sqrt(np.mean(np.square(scatter), axis=0))
    middle = 0.5 * (edges[1:] + edges[:-1])
    return {"x": middle, "v": middle, "force": mean, "standard_error": error, "samples": samples}


def _force(run: FreeMotion) -> Array:
    """The force that would make the residual over I w^2, by its equation of motion.

    Both motions are smoothed alike, so that what smoothing takes from them cancels.
    """
    model, motion, time = run.model, run.motion, run.time - run.time[0]
    tau = model.reference_frequency * time
    angle, rate, curvature, _ = smooth(tau, run.residual)
    asked = -(curvature + angle)
    for force in model.library:
        if force.memoryless and force.kind == "force":
            with_residual, without = (
                force.value(motion.x + part * angle, motion.v + part * rate, time, shapes=model.shapes)
                for part in (1.0, 0.0)
            )
            asked = asked - model.coefficients.get(force.symbol, 0.0) * (with_residual - without)
    # A spline bends freely in the quarter period before its ends.
    inside = np.minimum(tau, tau[-1] - tau) > 0.5 * np.pi
    return np.where(inside, asked, np.nan)


def _force_of_noise(run: FreeMotion) -> Array:
    """Forces that drawings of the noise ask for, (draw, sample); the model's forces change little."""
    # Drawings of noise, for the errors of the map.
    drawn = run.noise.draws(len(run.time), 32)
    angle, _, curvature, _ = smooth(run.model.reference_frequency * run.time, drawn.T)
    return np.asarray(-(curvature + angle).T)


def collinear_effects(
    model: FittedModel, products: Sequence[RunProducts], effects: Sequence[str]
) -> list[str]:
    """Effects of a model that are collinear with others and not well enough determined to be named.

    Parameters
    ----------
    model : FittedModel
    products : sequence of RunProducts
        The model's columns come first.
    effects : sequence of str
        Symbols besides the start model's.

    Notes
    -----
    Several flexible forces fit nearly anything: that they do is no evidence for any of them.
    """
    if len(effects) < 2:
        return []
    every = {symbol: set(model.columns_of(symbol)) for symbol in effects}
    errors = np.sqrt(np.diag(model.likelihood.covariance))
    collinear = []
    for symbol in effects:
        at = model.columns_of(symbol)[0]
        others = set().union(*every.values())
        sizes = [
            projected(
                products, model.likelihood, [1 + c for c in range(model.columns) if c not in gone], [1 + at]
            )[0].item()
            for gone in (others, every[symbol])
        ]
        z = abs(model.coefficients[at]) / max(errors[at], 1e-300)
        if sizes[1] < model.settings.independent * sizes[0] and z < model.settings.determined:
            collinear.append(symbol)
    return collinear


def detectability(screening: Screening) -> tuple[dict[str, Any], list[Force]]:
    """Detectable coefficient of each candidate, and which are alike, from what the model cannot explain.

    Parameters
    ----------
    screening : Screening
        The candidates with a model.

    Returns
    -------
    values : dict of str to array
        Over `candidate`: `detectable`, the coefficient that would stand out by five standard errors (at the
        best value of its shape parameters, of those tried; nan if not testable), `independent_fraction` of
        its column that those of the model cannot make, `testable` and the `reason` why not; and
        `cosine(candidate, other)` between what is outside of the model's columns, `alike` where two differ by
        less than a credible set spans if one of them has 20 standard errors.
    forces : list of Force
        The candidates.
    """
    symbols = dict.fromkeys(trial.force.symbol for trial in screening.trials)
    at = np.array([_best(screening, symbol) for symbol in symbols], dtype=int)
    reasons = [screening.reasons[i] for i in at]
    # Where every candidate was added there is none.
    testable = np.array([not reason for reason in reasons], dtype=bool)
    cosine = np.abs(screening.correlation[np.ix_(at, at)])
    np.fill_diagonal(cosine, 1.0)
    nearest = np.sqrt(1.0 - screening.model.settings.outside_of_set / NAMED**2)
    values = {
        # An effect of this many standard errors is detected.
        "detectable": np.where(testable, 5.0 * screening.errors[at], np.nan),
        "independent_fraction": screening.outside[at],
        "testable": testable,
        "reason": reasons,
        "alike": (cosine > nearest) & testable[:, None] & testable & ~np.eye(len(at), dtype=bool),
        "cosine": cosine,
    }
    return values, [screening.trials[i].force for i in at]


def _best(screening: Screening, symbol: str) -> int:
    """The testable trial of a force with the least error, in units of its force; else any."""
    of_force = [i for i, trial in enumerate(screening.trials) if trial.force.symbol == symbol]
    good = [i for i in of_force if not screening.reasons[i]]
    size = screening.errors * screening.relative_force
    return min(good, key=lambda i: float(size[i])) if good else of_force[0]
