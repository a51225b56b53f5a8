"""Effects in a result: significant coefficients, and the names of a discovery."""

import math
from collections.abc import Callable, Iterable, Sequence
from itertools import combinations
from typing import TypeVar

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array, Mask
from sysid_trib.forces import force
from sysid_trib.forces.library import library_of_text

Item = TypeVar("Item")
# Number of standard errors above which an effect needs a name.
NAMED = 20.0


def birge_ratio(chi_square: float, degrees_of_freedom: int) -> float:
    """Return the root of the reduced chi-square (Birge 1932); 1 if the residual is noise.

    Parameters
    ----------
    chi_square : float
        Sum of the squared residuals over their standard errors.
    degrees_of_freedom : int
        Number of residuals without that of the parameters.
    """
    return float(np.sqrt(chi_square / max(1, degrees_of_freedom)))


# A coefficient with fewer standard errors may be zero (99.7 % of a Gaussian).
SIGNIFICANT_ERRORS = 3.0
# The same level as a probability.
BY_CHANCE = math.erfc(SIGNIFICANT_ERRORS / math.sqrt(2.0))


def at_bound(result: xr.Dataset) -> list[str]:
    """Return coefficients that a fit holds at one of their bounds."""
    if "constraint" not in result.coords:
        return []
    return [str(symbol) for symbol in result.force.values[result.constraint.values == "at its bound"]]


def significant(result: xr.Dataset) -> Mask:
    """Return the mask of significant coefficients; a held one counts if it is not zero.

    Parameters
    ----------
    result : Dataset
        An identification.

    Returns
    -------
    (force,) array of bool
    """
    size, error = np.abs(result.coefficient.values), result.standard_error.values
    return np.asarray(result.active.values & (size > 0.0) & (size >= SIGNIFICANT_ERRORS * error), dtype=bool)


def determines(result: xr.Dataset) -> bool:
    """Return true if at least one coefficient, or all together, differ from zero.

    If a record does not separate forces, their errors are as large as the coefficients, although one force is
    needed.
    """
    return bool(significant(result).any()) or bool(sufficient_forces(result))


def sufficient_forces(result: xr.Dataset) -> list[dict[str, tuple[float, float]]]:
    """Return the fewest forces that suffice: coefficients and errors by symbol, the most likely first.

    Parameters
    ----------
    result : Dataset
        An identification.

    Returns
    -------
    list of dict of str to (float, float)
        Empty if all may be zero together, or if some are held.

    Notes
    -----
    These are the conditional mean and covariance of the kept ones given that the others are zero: the others
    have no significant sum of squares (Wald 1943).
    """
    size, count = result.standard_error.values, result.sizes["force"]
    # With more forces, not all subsets can be tried.
    if count > 10 or not np.all(result.active.values & (size > 0.0) & np.isfinite(size)):
        return []
    score, correlation = result.coefficient.values / size, result.covariance.values / np.outer(size, size)
    for kept in range(count + 1):
        choices = [np.isin(np.arange(count), choice) for choice in combinations(range(count), kept)]
        # Chi-square of the coefficients that would be zero.
        among = [(score[~c], np.linalg.pinv(correlation[np.ix_(~c, ~c)])) for c in choices]
        squares = [float(part @ inverse @ part) for part, inverse in among]
        allowed = scipy.stats.chi2.isf(BY_CHANCE, max(1, count - kept))
        if min(squares) <= allowed:
            break
    likely = [choices[at] for at in np.argsort(squares) if squares[at] <= allowed]
    return [_where_others_are_zero(result, score, correlation, choice) for choice in likely if choice.any()]


def _where_others_are_zero(
    result: xr.Dataset, score: Array, correlation: Array, kept: Mask
) -> dict[str, tuple[float, float]]:
    gain = correlation[np.ix_(kept, ~kept)] @ np.linalg.pinv(correlation[np.ix_(~kept, ~kept)])
    variance = np.diag(correlation[np.ix_(kept, kept)] - gain @ correlation[np.ix_(~kept, kept)])
    size, symbols = result.standard_error.values[kept], result.force.values[kept].tolist()
    values, errors = size * (score[kept] - gain @ score[~kept]), size * np.sqrt(np.maximum(variance, 0.0))
    return dict(zip(symbols, zip(values.tolist(), errors.tolist(), strict=True), strict=True))


def candidates_of(tree: xr.DataTree) -> force.ForceLibrary:
    """Return the offered candidates."""
    return library_of_text(tree.attrs["candidates"], "candidates")


def steps_taken(tree: xr.DataTree) -> list[xr.Dataset]:
    """Return the steps of a discovery in order, one per effect."""
    # Without a step, only the count is stored.
    steps = tree["steps"].to_dataset()
    return [steps.isel(step=at) for at in range(steps.attrs["count"])]


def inseparable_groups(step: xr.Dataset) -> list[list[str]]:
    """Return the credible set of a step in groups of effects that no run of this kind separates."""
    groups: dict[float, list[str]] = {}
    for symbol in credible_set(step):
        number = step.inseparable.sel(candidate=symbol).item()
        groups.setdefault(number, []).append(symbol)
    return list(groups.values())


def grouped(items: Iterable[Item], alike: Callable[[Item, Item], bool]) -> list[list[Item]]:
    """Return groups in which all members are alike, unlike a chain of neighbours with distant ends."""
    groups: list[list[Item]] = []
    for item in items:
        home = next((group for group in groups if all(alike(other, item) for other in group)), None)
        if home is None:
            groups.append([item])
        else:
            home.append(item)
    return groups


def added_effects(tree: xr.DataTree) -> list[str]:
    """Return the symbols of the effects that were added, in the order of the steps."""
    return [step.symbol.item() for step in steps_taken(tree)]


def misnamed_effects(tree: xr.DataTree) -> dict[str, float]:
    """Return effects whose coefficient differs from the known one, and the known one."""
    offered, steps = candidates_of(tree), tree["steps"].to_dataset()
    known = {symbol: offered[symbol].coefficient for symbol in added_effects(tree)}
    # Number of standard errors by which a coefficient must differ from its known physical value to belong to
    # another force.
    return {
        symbol: value
        for at, (symbol, value) in enumerate(known.items())
        if value is not None
        and abs(steps.coefficient.values[at] - value) > 2.58 * steps.standard_error.values[at]
    }


def error_widening(tree: xr.DataTree) -> float:
    """Return the factor by which the errors of the final model are multiplied."""
    return float(tree["omnibus"].widening[-1])


def credible_set(step: xr.Dataset) -> dict[str, float]:
    """Return the effect of a step and its competing candidates, with their probabilities.

    Parameters
    ----------
    step : xr.Dataset
        The group `steps` at one step.

    Returns
    -------
    dict of str to float
        Probability of each candidate: first the effect, then the others, the most probable first.
    """
    effect = step.symbol.item()
    inside = step.isel(candidate=step.credible.values)
    others = inside.isel(candidate=np.argsort(inside.penalised_deviance.values, kind="stable"))
    likely = dict(zip(others.candidate.values.tolist(), others.tie_probability.values.tolist(), strict=True))
    return {effect: likely.pop(effect), **likely}


def replacing_pairs(step: xr.Dataset) -> list[list[str]]:
    """Return pairs of candidates that compete with the effect of a step."""
    pairs = step.pairs.values.tolist() if "pairs" in step else []
    return [pair for pair in pairs if pair[0]]


def alternatives_of(step: xr.Dataset) -> list[str]:
    """Return candidates, then pairs of them, that cannot be separated from the named effect."""
    named = named_effect(step)
    pairs = (" and ".join(pair) for pair in replacing_pairs(step))
    return [*(symbol for symbol in credible_set(step) if symbol != named), *pairs]


def named_effect(step: xr.Dataset) -> str:
    """Return the effect that is named."""
    symbol, likely = step.symbol.item(), credible_set(step)
    likeliest = max(likely, key=lambda name: likely[name])
    # Fits of equal quality have no order. Name another effect only if it is more probable than the fitted one
    # by this much.
    return likeliest if likely[likeliest] - likely[symbol] > 0.5 else symbol


def tied_name(step: xr.Dataset, most: int) -> str:
    """Name an effect or its competing effects, at most `most` by name: "epsilon or 2 more"."""
    return or_others([named_effect(step), *alternatives_of(step)], most)


def or_others(symbols: Sequence[str], most: int) -> str:
    """Return the symbols of competing effects, the first `most` by name; one further one is named too."""
    named = list(symbols[: most if len(symbols) > most + 1 else most + 1])
    more = len(symbols) - len(named)
    return " or ".join([*named, *([f"{more} more"] if more else [])])


def failed_competitors(step: xr.Dataset) -> list[str]:
    """Return candidates that were tried in place of a step's effect, but whose fits failed."""
    return step.candidate.values[np.isposinf(step.penalised_deviance.values)].tolist()


def shapes_of(step: xr.Dataset, symbol: str, values: str = "shape") -> dict[str, float]:
    """Return the shape parameters of one force, or their errors, by their names in the force.

    Parameters
    ----------
    step : xr.Dataset
        One step of the group `steps`, or one selection step of the group `ranking`.
    symbol : str
        Symbol of the force.
    values : str
        Variable with the values: `shape`, or `shape_standard_error` of a step.
    """
    if values not in step:
        return {}
    pairs = zip(step.shape_parameter.values.tolist(), step[values].values.tolist(), strict=True)
    return {
        name.removeprefix(f"{symbol}."): value
        for name, value in pairs
        if name.startswith(f"{symbol}.") and np.isfinite(value)
    }


def strongest(ranking: xr.Dataset, count: int) -> list[str]:
    """Return the candidates with the highest |z| at any selection step, ordered by their first |z|."""
    size = np.nan_to_num(np.abs(ranking.z.values), nan=-1.0)
    order = np.argsort(-size.max(axis=0), kind="stable")[:count].tolist()
    chosen = [i for i in order if size[:, i].max() >= 0.0]
    return [str(ranking.candidate.values[i]) for i in sorted(chosen, key=lambda i: -size[0, i])]
