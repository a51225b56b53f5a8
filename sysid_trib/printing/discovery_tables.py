"""A discovery as tables."""

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from sysid_trib.printing.layout import coefficient_text, p_value_text, text_table, value_with_error
from sysid_trib.printing.residual import noise_of
from sysid_trib.results.discoveries import added_effects, named_effect, or_others, others_in_place, shapes_of

if TYPE_CHECKING:
    from rich.table import Table

# Candidates in the table: those of the highest score at any step, and at the last.
ROWS, LAST = 10, 3
# Candidates that are named with an effect which cannot be separated from them.
TIES_NAMED = 2
RANKING = "Named and strongest candidates, |z| before each step and at the end (-: in the model, or untested)"


def effects_table(tree: xr.DataTree) -> "Table":
    """The effects that were added, in order, with the residuals before and after over the noise."""
    noise, held = noise_of(tree), tree["holdout"].rms.values
    rows = []
    for at in range(tree["steps"].attrs["count"]):
        step = tree["steps"].to_dataset().isel(step=at)
        residuals = ((step.residual_before.item(), step.residual_after.item()), (held[at], held[at + 1]))
        ratios = [" to ".join(f"{residual / noise:.3g}" for residual in pair) for pair in residuals]
        words = [effect_name(step), step["name"].item(), formula_text(step), coefficient_text(step)]
        rows.append([*words, p_value_text(step.p_value.item(), ""), *ratios])
    heads = [
        "effect",
        "name",
        "formula",
        "coefficient",
        "corrected p",
        "residual / noise",
        "held out / noise",
    ]
    return text_table(heads, rows, whole=(0,), numbers=(3, 4, 5, 6))


def effect_name(step: xr.Dataset) -> str:
    """Symbol of an effect; one that is less probable than another stands for that one."""
    symbol, named = step.symbol.item(), named_effect(step)
    return symbol if named == symbol else f"{named} (fitted by {symbol})"


def effect_with_ties(step: xr.Dataset) -> str:
    """The same with what it cannot be separated from: "epsilon (or gravity or magnet)"."""
    others = [symbol for symbol in others_in_place(step) if symbol != step.symbol.item()]
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


def ranking_table(tree: xr.DataTree) -> "Table":
    """|z| of named and best candidates before each step and after the last; those in the model have none."""
    ranking = tree["ranking"].to_dataset()
    named = [symbol for symbol in added_effects(tree) if symbol in ranking.candidate]
    last = strongest(ranking.isel(selection_step=[-1]), LAST)
    count = ranking.sizes["selection_step"]
    heads = ["candidate", "name", *(f"step {at + 1}" for at in range(count - 1)), "end"]
    rows = []
    for symbol in dict.fromkeys([*named, *strongest(ranking, ROWS), *last]):
        candidate = ranking.sel(candidate=symbol)
        cells = [f"{abs(z):.3g}" if np.isfinite(z) else "-" for z in candidate.z.values]
        rows.append([symbol, candidate["name"].item(), *cells])
    rows.append(["threshold", "", *(f"{z:.3g}" for z in ranking.threshold.values)])
    return text_table(heads, rows, whole=(0,), numbers=tuple(range(2, count + 2)))


def strongest(ranking: xr.Dataset, count: int) -> list[str]:
    """Candidates of the highest |z| at any selection step, ordered by that of the first."""
    size = np.nan_to_num(np.abs(ranking.z.values), nan=-1.0)
    order = np.argsort(-size.max(axis=0), kind="stable")[:count].tolist()
    chosen = [i for i in order if size[:, i].max() >= 0.0]
    return [str(ranking.candidate.values[i]) for i in sorted(chosen, key=lambda i: -size[0, i])]
