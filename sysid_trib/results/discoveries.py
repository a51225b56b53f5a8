"""What a result of `discover` says of its effects: names, credible sets, shapes, selection steps."""

import numpy as np
import xarray as xr

from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import library_of_text


def candidates_of(tree: xr.DataTree) -> ForceLibrary:
    """The candidates that were offered."""
    return library_of_text(tree.attrs["candidates"], "candidates")


def added_effects(tree: xr.DataTree) -> list[str]:
    """Symbols of the effects that were added, in the order of the steps."""
    # Without a step there is but the count.
    return tree["steps"].symbol.values.tolist() if tree["steps"].attrs["count"] else []


def credible_set(step: xr.Dataset) -> dict[str, float]:
    """The effect of a step and the candidates that may be the truth in its place, with their probabilities.

    Parameters
    ----------
    step : xr.Dataset
        The group `steps` at one step.

    Returns
    -------
    dict of str to float
        Probability of each candidate. The effect comes first, then the others, the most probable first.
    """
    effect = step.symbol.item()
    inside = step.isel(candidate=step.credible.values)
    others = inside.isel(candidate=np.argsort(inside.penalised_deviance.values, kind="stable"))
    likely = dict(zip(others.candidate.values.tolist(), others.tie_probability.values.tolist(), strict=True))
    return {effect: likely.pop(effect), **likely}


def likeliest_effect(step: xr.Dataset) -> str:
    """The most probable of the effects that may be the truth in the place of a step's effect, or itself."""
    likely = credible_set(step)
    return max(likely, key=lambda symbol: likely[symbol])


def failed_competitors(step: xr.Dataset) -> list[str]:
    """Candidates that were tried in the place of a step's effect, but whose fits failed."""
    return step.candidate.values[np.isposinf(step.penalised_deviance.values)].tolist()


def shapes_of(step: xr.Dataset, symbol: str) -> dict[str, float]:
    """Shape parameters of one force, by their names in the force.

    Parameters
    ----------
    step : xr.Dataset
        One step of the group `steps`, or one selection step of the group `ranking`.
    symbol : str
        Symbol of the force.
    """
    if "shape" not in step:
        return {}
    pairs = zip(step.shape_parameter.values.tolist(), step["shape"].values.tolist(), strict=True)
    return {
        name.removeprefix(f"{symbol}."): value
        for name, value in pairs
        if name.startswith(f"{symbol}.") and np.isfinite(value)
    }
