"""How sure coefficients are: profiles and sensitivity, in sentences, tables and plain data."""

from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.printing.blocks import ALWAYS, Block
from sysid_trib.printing.layout import (
    Source,
    by_label,
    mapped,
    number,
    per_label,
    same,
    text_table,
    value_with_error,
)
from sysid_trib.results.significance import SIGNIFICANT_ERRORS
from sysid_trib.validation.findings import verdict_of

NOISE_ALONE = (
    "The model does not explain the record: quote the standard errors, which allow for that. These intervals "
    "hold the noise alone."
)
PROFILE, CONTOUR, SENSITIVITY = "profile", "contour", "sensitivity"


def sureness_blocks(tree: xr.DataTree) -> list[Block]:
    """What profiles and a sensitivity say, where the result has them."""
    blocks = []
    if PROFILE in tree.children:
        lacking = "comparison" in tree.children and verdict_of(tree) in ("approximate", "not explained")
        blocks += _profile_blocks(tree[PROFILE].to_dataset(), lacking)
    if CONTOUR in tree.children:
        data = tree[CONTOUR].to_dataset()
        said = f"{' and '.join(data.parameter.values)} correlate by {data.correlation.item():.3f}."
        blocks.append(Block([said], title="Contours", figures=CONTOUR))
    if SENSITIVITY in tree.children:
        blocks += _sensitivity_blocks(tree[SENSITIVITY].to_dataset())
    return blocks


def _profile_blocks(data: xr.Dataset, lacking: bool) -> list[Block]:
    """Intervals by the profile likelihood, beside those by the standard error; `lacking` : of the model."""
    rows = []
    for name, row in by_label(data, "parameter").items():
        estimate, error = row.estimate.item(), row.standard_error.item()
        lower, upper = estimate - row.low.item(), row.high.item() - estimate
        ends = [f"{row[end].item():.4g}" if np.isfinite(row[end]) else "none" for end in ("low", "high")]
        by_error = f"-{lower / error:.2f} +{upper / error:.2f}"
        rows.append([name, value_with_error(estimate, error), *ends, by_error])
    misled = [name for name, row in by_label(data, "parameter").items() if row.asymmetric.item()]
    said = f"The standard error misleads for {', '.join(misled)}: quote the interval." if misled else ""
    said = NOISE_ALONE if lacking else said
    heads = ["parameter", "by the motion", "from", "to", "over the error"]
    table = text_table(heads, rows, numbers=(1, 2, 3, 4))
    caption = f"Intervals of {100.0 * data.attrs['confidence']:g} % by the profile likelihood"
    return [
        Block([said] if said else [], ALWAYS, "Profiles", table, caption, PROFILE),
    ]


def _sensitivity_blocks(data: xr.Dataset) -> list[Block]:
    """The range of each coefficient over all fits, and those that differ most."""
    count = data.sizes["fit"]
    rows, sentences = [], []
    for symbol, row in by_label(data, "force").items():
        estimate, error = row.estimate.item(), row.stated_error.item()
        change = np.nan_to_num(np.abs(row.change.values))
        at, kept = int(np.argmax(change)), int(np.isfinite(row.coefficient.values).sum())
        rows.append(
            [
                symbol,
                value_with_error(estimate, error),
                f"{row.low.item():.4g}",
                f"{row.high.item():.4g}",
                f"{kept} of {count}",
                f"{change[at]:.1f}",
                f"{row.kind.values[at]}, {row.fit.values[at]}",
            ]
        )
    failed = [label for label, row in by_label(data, "fit").items() if row.reason.item()]
    changed = [row[0] for row in rows if float(row[5]) > SIGNIFICANT_ERRORS]
    if changed:
        sentences.append(f"Beyond {SIGNIFICANT_ERRORS:g} errors of a fit moves {', '.join(changed)}.")
    sentences += [f"Without a result: {', '.join(failed)}."] if failed else []
    heads = ["force", "stated", "from", "to", "fits", "largest change / its error", "by"]
    table = text_table(heads, rows, numbers=(1, 2, 3, 4, 5))
    caption = "Sensitivity: the same forces over windows, starts, sampling, noise models and methods"
    return [Block(sentences, title="Sensitivity", table=table, caption=caption, figures=SENSITIVITY)]


PROFILE_JSON: dict[str, Source] = same("estimate", "standard_error", "low", "high", "asymmetric")
REFITS_JSON: dict[str, Source] = same("estimate", "stated_error", "low", "high")


def sureness_json(tree: xr.DataTree) -> dict[str, Any]:
    """Profiles and sensitivity as plain data; nothing where nothing was asked for."""
    made: dict[str, Any] = {}
    if PROFILE in tree.children:
        made[PROFILE] = per_label(tree[PROFILE].to_dataset(), "parameter", PROFILE_JSON)
    if SENSITIVITY in tree.children:
        data = tree[SENSITIVITY].to_dataset()
        fits = {
            label: {"kind": row.kind.item(), "reason": row.reason.item()}
            | {
                "coefficients": {
                    symbol: number(value)
                    for symbol, value in zip(data.force.values, row.coefficient.values.tolist(), strict=True)
                }
            }
            for label, row in by_label(data, "fit").items()
        }
        made[SENSITIVITY] = {
            "forces": {symbol: mapped(row, REFITS_JSON) for symbol, row in by_label(data, "force").items()},
            "fits": fits,
        }
    return made
