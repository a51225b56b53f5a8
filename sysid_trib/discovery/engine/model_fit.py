"""Exact fits: forces and errors of the sensor with their shapes, along the motion that they produce."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discovery.engine.fitted_model import FittedModel, table_of
from sysid_trib.discovery.engine.likelihood import Likelihood, likeliest_near, likelihood
from sysid_trib.discovery.engine.paths import RecordPath
from sysid_trib.discovery.engine.run_products import RunProducts
from sysid_trib.discovery.engine.run_rows import run_rows
from sysid_trib.discovery.engine.trials import TrialEffect
from sysid_trib.errors import SysidTribError

# Rounds with whole steps of the path; later rounds take half steps.
WHOLE_STEPS = 3
# The path may oscillate about its solution if a force has a kink. Then the deviances of the best two rounds
# must agree to this, the rise of the deviance at one standard error.
ROUNDS_AGREE = 1.0
# Last rounds of a fit that does not converge; it is accepted if they agree within the parameters' errors.
LAST_ROUNDS = 4
# Factors of the random force with which paths are smoothed after an error of the sensor was added. With the
# whole random force a path follows the record and its sensor errors, and a large error is mistaken for
# forces.
CONTINUATION = (1e-2, 1e-4, 1e-6, 1e-8)
# Errors of a fit whose path diverges until values are not finite, or whose rows contain no information.
NOT_FITTED = (SysidTribError, np.linalg.LinAlgError, ValueError)


def fit_model(
    paths: Sequence[RecordPath],
    trials: Sequence[TrialEffect],
    first: Array | None = None,
    *,
    worst: float = np.inf,
    possible: Callable[[FittedModel], bool] = lambda model: True,
    part: float = 1.0,
) -> FittedModel:
    """Fit coefficients, shapes, frequency and both variances of each run along smoothed motions.

    Parameters
    ----------
    paths : sequence of RecordPath
        First estimates of the motions.
    trials : sequence of TrialEffect
        The model, with first estimates of the shapes.
    first : (trial + 1,) array of float, optional
        First estimate of the coefficients and the stiffness, for the operator of small deviations.
    worst : float
        A deviance. A fit is abandoned if the gain of its last round shows that it cannot reach this.
    possible : callable
        Test of the physical range. A fit that is outside of this range for two rounds is abandoned.
    part : float
        Fraction of a full step that the first rounds take.

    Notes
    -----
    The next path is the most likely motion of the model at hand: without a random force it becomes a free
    motion (Newton's method on all samples), with one the smoothed motion.

    Shapes step along tangents. If a step raises the deviance, the next step is at most half as long;
    otherwise it may be twice as long (trust region: Conn, Gould, Toint 2000). With a narrow or
    history-dependent force, path and coefficients may oscillate about their solution.
    """
    guess, settings = np.zeros(len(trials) + 1) if first is None else first, paths[0].settings
    model = fitted_along(_of_any_ratio(paths), trials, guess)
    # Largest step of a shape in a round, as a fraction of its range.
    reach = longest = part * settings.shape_step
    rounds, before, unphysical = list[FittedModel](), 0.0, 0
    # Test for a sensor error that no fit has estimated yet.
    if any(t.force.kind == "sensor" and not c for t, c in zip(trials, guess[:-1], strict=True)):
        model = _continued(model, reach, part, worst)
        if not model.settled:
            return model
    for turn in range(settings.rounds):
        guess = guess + part * (model.estimate - guess) if turn else model.estimate
        after = _next_round(model, guess, reach, part, of_any_ratio=turn + 1 < WHOLE_STEPS)
        if after is None:
            # The path diverged: return the round of largest likelihood.
            best = min([*rounds, model], key=lambda fitted: fitted.likelihood.deviance)
            return replace(best, settled=False)
        fall, model = model.likelihood.deviance - after.likelihood.deviance, after
        # The decreases shrink at least as fast as a geometric series: the next one is the last one times
        # their ratio. A partial step gives a partial decrease.
        next_fall = abs(fall) * min(1.0, abs(fall / before)) if before else abs(fall)
        # A shape may still move along its tangent although the deviance hardly decreases.
        on_its_way = model.likelihood.deviance - model.stepped.deviance > ROUNDS_AGREE
        if next_fall < min(1.0, 2.0 * part) * settings.least_gain and not on_its_way:
            return model
        unphysical = 0 if possible(model) else unphysical + 1
        reachable = on_its_way or not _cannot_reach(worst, model, fall)
        if turn > 1 and (unphysical > 1 or not reachable):
            return replace(model, settled=False)
        uphill, swings = turn > 0 and fall < 0.0, turn > 1 and fall * before < 0.0
        reach = 0.5 * reach if uphill else min(2.0 * reach, longest)
        part = min(part, 0.5) if uphill or turn + 1 >= WHOLE_STEPS else part
        part, before = 0.5 * part if swings else part, fall
        rounds.append(model.without_caches())
    return _ended(rounds, on_its_way)


def _cannot_reach(worst: float, model: FittedModel, fall: float) -> bool:
    """Return true if the last decrease of the deviance is too small for the fit to reach `worst`."""
    return model.stepped.deviance - 2.0 * abs(fall) > worst


def _next_round(
    model: FittedModel,
    guess: Array,
    reach: float,
    part: float,
    *,
    of_any_ratio: bool = True,
    random_force: float = 1.0,
) -> FittedModel | None:
    """Return the model along its next paths, with the next shapes; None if it cannot be fitted."""
    paths, steps = model.next_paths(guess[:-1], part, random_force), model.next_steps(reach)
    nearer = _of_any_ratio(paths) if of_any_ratio else paths
    try:
        after = fitted_along(nearer, model.next_trials(steps), guess + model.ahead(steps))
    except NOT_FITTED:
        return None
    return after if after.is_finite else None


def _of_any_ratio(paths: Sequence[RecordPath]) -> list[RecordPath]:
    """Return paths without a known ratio: after a path has moved, a distant ratio may be most likely."""
    return [replace(path, ratio=0.0) for path in paths]


def _continued(model: FittedModel, reach: float, part: float, worst: float) -> FittedModel:
    """Fit in rounds whose paths follow the model ever more closely; mark the fit as unsettled if abandoned.

    This is a continuation in the random force, whose likelihood has a maximum about each path that follows
    the record (graduated non-convexity: Blake, Zisserman 1987).
    """
    for turn, random_force in enumerate(CONTINUATION):
        after = _next_round(model, model.estimate, reach, part, random_force=random_force)
        if after is None:
            return model
        fall, model = model.likelihood.deviance - after.likelihood.deviance, after
        if turn and _cannot_reach(worst, model, fall):
            return replace(model, settled=False)
    return model


def _ended(rounds: Sequence[FittedModel], on_its_way: bool) -> FittedModel:
    """Return the result of a fit that has used all of its rounds."""
    best, next_best = sorted(rounds, key=lambda fitted: fitted.likelihood.deviance)[:2]
    if next_best.likelihood.deviance - best.likelihood.deviance < ROUNDS_AGREE:
        return best
    # If a contact sticks, one more or one fewer reversal changes the deviance abruptly although the
    # parameters hardly change.
    sticks = any(rows.path.sticking.any() for rows in best.rows)
    last = [best, next_best] if sticks else rounds[-LAST_ROUNDS:]
    if _agree(last) and not on_its_way:
        return max(last, key=lambda fitted: fitted.likelihood.deviance)
    return replace(best, settled=False)


def _agree(rounds: Sequence[FittedModel]) -> bool:
    """Return true if no coefficient or shape differs between rounds by more than its standard error."""
    shapes = [[trial.part(name) for trial in of.trials for name in trial.force.shape] for of in rounds]
    ranges = [np.ptp([fitted.likelihood.coefficients for fitted in rounds], axis=0), np.ptp(shapes, axis=0)]
    errors = np.sqrt(np.diag(rounds[-1].likelihood.covariance))
    steady = len(errors) - len(shapes[0])
    return bool(np.all(ranges[0][:steady] <= errors[:steady]) and np.all(ranges[1] <= errors[steady:]))


def fitted_along(paths: Sequence[RecordPath], trials: Sequence[TrialEffect], guess: Array) -> FittedModel:
    """Return the most likely coefficients along fixed paths, and the shape steps fitted with them.

    The tangents are evaluated at these coefficients (variable projection: Golub, Pereyra 1973).
    """
    rows = tuple(run_rows(path, trials, guess) for path in paths)
    tables = [table_of(run, at, len(rows), trials) for at, run in enumerate(rows)]
    of_shapes = [at for at, trial in enumerate(trials) for _ in trial.force.shape]
    columns = tables[0].shape[1]
    kept = range(columns - len(of_shapes))
    runs = [partial(run.products, table) for run, table in zip(rows, tables, strict=True)]
    ratios = [path.ratio for path in paths]
    products, most_likely = likeliest_near(runs, ratios, [1 + column for column in kept])
    at_shapes = most_likely.among(kept, columns)
    stepped, at_ends = at_shapes, dict[int, tuple[float, float]]()
    if of_shapes:
        factors = np.concatenate([np.ones(len(kept)), at_shapes.coefficients[of_shapes]])
        tables = [table * factors for table in tables]
        stepped, at_ends = _within_ranges([run.scaled(factors) for run in products], columns, trials)
    likeliest = replace(at_shapes, covariance=stepped.covariance)
    return FittedModel(tuple(trials), rows, tuple(tables), likeliest, stepped, at_ends)


def _within_ranges(
    products: Sequence[RunProducts], count: int, trials: Sequence[TrialEffect]
) -> tuple[Likelihood, dict[int, tuple[float, float]]]:
    """Return the maximum likelihood in `count` columns, with shapes held at the ends of their ranges."""
    ends = [trial.end(name) for trial in trials for name in trial.force.shape]
    first = count - len(ends)
    held: dict[int, tuple[float, float]] = {}
    while True:
        free = [column for column in range(count) if column not in held]
        likeliest = likelihood(products, [1 + column for column in free])
        steps = dict(zip(free, likeliest.coefficients.tolist(), strict=True))
        leaving = [at for at, side in enumerate(ends, first) if side * steps.get(at, 0.0) > 0.0]
        if not leaving:
            return likeliest.among(free, count), held
        errors = dict(zip(free, np.sqrt(np.diag(likeliest.covariance)).tolist(), strict=True))
        held |= {column: (abs(steps[column]), errors[column]) for column in leaving}
