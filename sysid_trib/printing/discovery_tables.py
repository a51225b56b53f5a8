"""A discovery as tables: the effects that were added, and the candidates with their scores."""

import numpy as np
import xarray as xr
from rich.table import Table

from sysid_trib.likelihood.random_force import DENSITY_UNITS
from sysid_trib.printing.layout import coefficient_text, p_value_text, text_table, value_with_error, with_unit
from sysid_trib.results.discoveries import (
    added_effects,
    alternatives_of,
    named_effect,
    or_others,
    shapes_of,
    strongest,
)
from sysid_trib.validation.verdict import record_noise

# Candidates in the table: those of the highest score at any step, and at the last.
ROWS, LAST = 10, 3
# Candidates that are named with an effect which cannot be separated from them.
TIES_NAMED = 2
RANKING = (
    "Named and strongest candidates, |z| before each step and at the end (-: in the model, or untested), and "
    "the coefficient of five standard errors, at the shapes and frequencies of the highest score"
)


def steps_of(tree: xr.DataTree) -> list[xr.Dataset]:
    """The steps of a discovery, in their order."""
    steps = tree["steps"].to_dataset()
    return [steps.isel(step=at) for at in range(steps.attrs["count"])]


def effects_table(tree: xr.DataTree, *, details: bool = False) -> Table:
    """The effects that were added, in order, with the residuals before and after over the noise.

    Parameters
    ----------
    tree : DataTree
        Result of `discover`.
    details : bool
        Show also how far each lowers the deviance, and the random force before and after.
    """
    noise, held, rows, units = record_noise(tree), tree["holdout"].rms.values, [], DENSITY_UNITS
    for at, step in enumerate(steps_of(tree)):
        of_sensor = " (error of the sensor)" if step.kind.item() == "sensor" else ""
        name = f"{step['name'].item()}{of_sensor}"
        residuals = [step.residual_before.item(), step.residual_after.item()]
        ratios = [_to(residuals, noise), _to(held[at : at + 2], noise)]
        words = [effect_name(step), name, formula_text(step), coefficient_text(step)]
        rows.append([*words, p_value_text(step.p_value.item(), ""), *ratios])
        if details:
            units = step.random_force_before.attrs.get("units", units)
            forces = [step.random_force_before.item(), step.random_force_after.item()]
            rows[-1] += [f"{step.gain.item():.3g}", _to(forces)]
    heads = [
        "effect",
        "name",
        "formula",
        "coefficient",
        "corrected p",
        "residual / noise",
        "held out / noise",
    ]
    heads += ["fall of the deviance", f"random force ({units})"] if details else []
    return text_table(heads, rows, whole=(0,), numbers=tuple(range(3, len(heads))))


def _to(values: list[float], unit: float = 1.0) -> str:
    """From a value before a step to that after it; a model that diverges has none."""
    return " to ".join(f"{value / unit:.3g}" if np.isfinite(value) else "-" for value in values)


def effect_name(step: xr.Dataset) -> str:
    """Symbol of an effect; one that is less probable than another stands for that one."""
    symbol, named = step.symbol.item(), named_effect(step)
    return symbol if named == symbol else f"{named} (fitted by {symbol})"


def effect_with_ties(step: xr.Dataset) -> str:
    """An effect with what it cannot be separated from: "epsilon (or gravity or magnet)"."""
    others = [symbol for symbol in alternatives_of(step) if symbol != step.symbol.item()]
    return f"{effect_name(step)}{f' (or {or_others(others, TIES_NAMED)})' if others else ''}"


def formula_text(step: xr.Dataset) -> str:
    """The formula of an effect with its shape parameters and their errors."""
    symbol = step.symbol.item()
    shapes, errors = (shapes_of(step, symbol, values) for values in ("shape", "shape_standard_error"))
    texts = (f"{name} = {_shape_text(value, errors.get(name, np.nan))}" for name, value in shapes.items())
    return ", ".join([step.formula.item(), *texts])


def _shape_text(value: float, error: float) -> str:
    """A fitted shape parameter; one at an end of its range has no error that a record tells."""
    return value_with_error(value, error) if error != 0.0 else f"{value:.3g} (end of its range)"


def ranking_table(tree: xr.DataTree) -> Table:
    """|z| of named and best candidates before each step and after the last; those in the model have none."""
    ranking, detectable = tree["ranking"].to_dataset(), tree["detectability_after"].to_dataset()
    named = [symbol for symbol in added_effects(tree) if symbol in ranking.candidate]
    last = strongest(ranking.isel(selection_step=[-1]), LAST)
    count = ranking.sizes["selection_step"]
    heads = ["candidate", "name", *(f"step {at + 1}" for at in range(count - 1)), "end", "detectable"]
    rows = []
    for symbol in dict.fromkeys([*named, *strongest(ranking, ROWS), *last]):
        candidate = ranking.sel(candidate=symbol)
        cells = [f"{abs(z):.3g}" if np.isfinite(z) else "-" for z in candidate.z.values]
        rows.append([symbol, candidate["name"].item(), *cells, _detectable(detectable, symbol)])
    rows.append(["threshold", "", *(f"{z:.3g}" for z in ranking.threshold.values), ""])
    return text_table(heads, rows, whole=(0,), numbers=tuple(range(2, len(heads))))


def _detectable(detectable: xr.Dataset, symbol: str) -> str:
    """The coefficient at which a candidate would stand out beside the final model."""
    if symbol not in detectable.candidate:
        return "-"
    candidate = detectable.sel(candidate=symbol)
    value = candidate.detectable.item()
    return with_unit(f"{value:.2g}", candidate.unit.item()) if np.isfinite(value) else "-"
