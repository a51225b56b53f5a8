"""Which candidates explain as much as an effect of a model in its place, and how probable each is."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.discrepancy.baseline import Baseline, orthonormal_basis, project_out
from sysid_trib.discrepancy.candidate_fits import Hint, Refit, refit, without_force
from sysid_trib.discrepancy.candidate_sensitivities import ReferenceMotion
from sysid_trib.discrepancy.model_probabilities import credible, narrowness, over_shapes, probabilities
from sysid_trib.discrepancy.score_tests import Scores, finer
from sysid_trib.forces.force import Force

# Scores are linear in an effect: off by up to this part of what it explains, more where shapes come from a
# grid. Below `SURE` that is no matter, and nothing is fitted.
SLACK = 0.001
SLACK_OF_SHAPES = 0.003
SURE = 0.5
# Twins that are fitted: so many at most without shapes, and as many with.
FITTED = 5
# Shapes are looked at more finely, in so many rounds, within this part of what the effect explains.
ROUNDS = 3
COARSE = 0.1
# A candidate that costs so much more is no twin. What small deviations take for one is fitted to its end,
# unless its few steps leave it further off than they can be wrong, and so far.
FAR = 12.0
LOST = 5000.0
REACH = 100.0
# Another model takes the place of one if it costs less by more than fits are uncertain.
SWAP = 0.5


@dataclass(frozen=True)
class Twin:
    """A candidate in an effect's place.

    Attributes
    ----------
    cost : chi-square, with the price of its shapes. refit : None where small deviations tell enough.
    """

    force: Force
    cost: float
    refit: Refit | None = None


@dataclass(frozen=True)
class Place:
    """What an effect of a model explains, for another to explain.

    Attributes
    ----------
    model : the fit without the effect, but with its part still in the motion.
    left : (sample,) that part and the residual, outside of what the other unknowns can move; space : these.
    own : chi-square of the model with the effect.
    """

    model: Baseline
    left: Array
    space: Array
    own: float

    @property
    def explained(self) -> float:
        """Chi-square that the effect takes away."""
        return max(0.0, float(self.left @ self.left) - self.own)


def cost_of(fitted: Baseline, symbol: str) -> float:
    """Chi-square of a model, with the price of an effect's shapes."""
    return fitted.chi_square + narrowness(fitted, fitted.problem.parameters.library[symbol])


def tie_class(fitted: Baseline, symbol: str, found: Sequence[Twin]) -> dict[str, float]:
    """The effect, and the candidates that may as well be the truth in its place, with their probabilities.

    The effect comes first, then the likeliest; beside this class others may share what is left of 1.
    """
    others = sorted(found, key=lambda twin: twin.cost)
    each = probabilities([cost_of(fitted, symbol), *(twin.cost for twin in others)])
    names, inside = [symbol, *(twin.force.symbol for twin in others)], credible(each)
    inside[0] = True
    return {name: float(p) for name, p, tied in zip(names, each, inside, strict=True) if tied}


def twins(fitted: Baseline, symbol: str, found: Scores, references: Sequence[ReferenceMotion]) -> list[Twin]:
    """Candidates that may explain as much as an effect of the model in its place, the likeliest first.

    `found` : scores of the others about the same motion, `references`. What small deviations leave open is
    fitted, and so is what they take for likelier than the effect.
    """
    place, own = _place(fitted, symbol), cost_of(fitted, symbol)
    found = _refined(place, found, fitted, references)
    hints, near, prices = _predicted(place, found)
    near = [twin for twin in near if twin.cost < own + FAR + _slack(place, twin.force)]
    wanted: list[Twin] = []
    for shaped in (False, True):
        same = [twin for twin in near if bool(twin.force.shape) is shaped]
        wanted += [twin for twin in same if _slack(place, twin.force) > SURE][:FITTED]
    wanted += [twin for twin in near if twin not in wanted and twin.cost < own - SWAP]
    done = []
    for twin in near:
        if twin in wanted:
            name = twin.force.symbol
            one = refit(place.model, hints[name], own + max(LOST, _slack(place, twin.force)))
            twin = Twin(twin.force, one.chi_square + prices[name], one)
        # A fit that failed is kept, to be told.
        if twin.cost < own + FAR or not np.isfinite(twin.cost):
            done.append(twin)
    return sorted(done, key=lambda twin: twin.cost)


def _place(fitted: Baseline, symbol: str) -> Place:
    problem, values = without_force(fitted, symbol)
    before = fitted.problem.parameters
    others, at = problem.parameters.take(before, fitted.table), before.index(symbol)
    whole = fitted.residual + fitted.table[:, at] * fitted.values[at]
    model = replace(fitted, problem=problem, values=values, residual=whole, table=others)
    space = orthonormal_basis(others)
    return Place(model, project_out(whole, space), space, fitted.chi_square)


def _slack(place: Place, force: Force) -> float:
    return (SLACK_OF_SHAPES if force.shape else SLACK) * place.explained


def _along(place: Place, found: Scores) -> tuple[Array, Array]:
    """Coefficient of each trial in the place, and the chi-square that it would leave, inf if it cannot be.

    Of a direction u it leaves |y|^2 - (y.u)^2.
    """
    outside = project_out(found.moved, place.space)
    size = np.linalg.norm(outside, axis=0)
    along = np.divide(outside.T @ place.left, size, out=np.zeros_like(size), where=size > 0.0)
    coefficient = np.divide(along, size, out=np.zeros_like(size), where=size > 0.0)
    able = [found.can_be(at, float(c), instead=True) for at, c in enumerate(coefficient)]
    return coefficient, np.where(able, float(place.left @ place.left) - along**2, np.inf)


def _refined(place: Place, found: Scores, fitted: Baseline, references: Sequence[ReferenceMotion]) -> Scores:
    """The scores with finer grids of the shapes that come near to the effect."""
    for _ in range(ROUNDS):
        _, left = _along(place, found)
        best: dict[str, int] = {}
        for at in np.argsort(left).tolist():
            if found.trials[at].force.shape and left[at] < place.own + REACH + COARSE * place.explained:
                best.setdefault(found.trials[at].force.symbol, at)
        found = finer(found, list(best.values()), fitted, references)
    return found


def _predicted(place: Place, found: Scores) -> tuple[dict[str, Hint], list[Twin], dict[str, float]]:
    """Of each force its best trial, its cost by small deviations, and the price of its shapes."""
    coefficient, left = _along(place, found)
    members: dict[str, list[int]] = {}
    for at, trial in enumerate(found.trials):
        members.setdefault(trial.force.symbol, []).append(at)
    hints, near, prices = {}, [], {}
    for symbol, rows in members.items():
        each = left[rows]
        at = rows[int(np.argmin(each))]
        if not np.isfinite(left[at]):
            continue
        # Shapes that cannot be leave all.
        each = np.where(np.isfinite(each), each, float(place.left @ place.left))
        least, prices[symbol] = over_shapes([found.trials[i] for i in rows], each)
        hints[symbol] = Hint(found.trials[at], float(coefficient[at]), found.moved[:, at])
        near.append(Twin(found.trials[at].force, least + prices[symbol]))
    return hints, sorted(near, key=lambda twin: twin.cost), prices
