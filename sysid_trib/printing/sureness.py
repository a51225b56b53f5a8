"""How sure coefficients are: profiles, sensitivity, and two samples, in sentences, tables and plain data."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table
from scipy.stats import norm

from sysid_trib.printing import ALWAYS, Block, Layer, layout, verdict
from sysid_trib.results.effects import SIGNIFICANT_ERRORS, sufficient_forces
from sysid_trib.results.files import identifications_of
from sysid_trib.validation.findings import verdict_of
from sysid_trib.validation.samples import SIDES

NOISE_ALONE = (
    "The model does not explain the record: quote the standard errors, which allow for that. These intervals "
    "hold the noise alone."
)
PROFILE, CONTOUR, SENSITIVITY = "profile", "contour", "sensitivity"
# Probability with which a difference is found that the table names.
POWER_STATED = 0.9


def sureness_blocks(tree: xr.DataTree) -> list[Block]:
    """What profiles and a sensitivity say, where the result has them."""
    blocks = []
    if PROFILE in tree.children:
        lacking = "comparison" in tree.children and verdict_of(tree) in ("approximate", "not explained")
        blocks += _profile_blocks(tree[PROFILE].to_dataset(), lacking)
    if CONTOUR in tree.children:
        data = tree[CONTOUR].to_dataset()
        said = f"{' and '.join(data.parameter.values)} correlate by {data.correlation.item():.3f}."
        blocks.append(Block([said], ALWAYS, "Profiles"))
    if SENSITIVITY in tree.children:
        blocks += _sensitivity_blocks(tree[SENSITIVITY].to_dataset())
    return blocks


def _profile_blocks(data: xr.Dataset, lacking: bool) -> list[Block]:
    """Intervals by the profile likelihood, beside those by the standard error; `lacking` : of the model."""
    rows, misled = [], []
    for name, row in layout.by_label(data, "parameter").items():
        estimate, error, low, high = (row[k].item() for k in ("estimate", "standard_error", "low", "high"))
        rows.append(
            {
                "parameter": name,
                "by the motion": layout.value_with_error(estimate, error),
                **{k: f"{v:.4g}" if np.isfinite(v) else "none" for k, v in (("from", low), ("to", high))},
                "over the error": f"-{(estimate - low) / error:.2f} +{(high - estimate) / error:.2f}",
            }
        )
        misled += [name] * bool(row.asymmetric.item())
    said = [f"The standard error misleads for {', '.join(misled)}: quote the interval."] * bool(misled)
    caption = f"Intervals of {100.0 * data.attrs['confidence']:g} % by the profile likelihood"
    table = layout.text_table(rows, ("parameter",))
    return [Block([NOISE_ALONE] if lacking else said, ALWAYS, "Profiles", table, caption)]


def _sensitivity_blocks(data: xr.Dataset) -> list[Block]:
    """The range of each coefficient over all fits, and those that differ most."""
    rows, changed = [], []
    for symbol, row in layout.by_label(data, "force").items():
        change = np.nan_to_num(np.abs(row.change.values))
        at, kept = int(np.argmax(change)), int(np.isfinite(row.coefficient.values).sum())
        rows.append(
            {
                "force": symbol,
                "stated": layout.value_with_error(row.estimate.item(), row.stated_error.item()),
                "from": f"{row.low.item():.4g}",
                "to": f"{row.high.item():.4g}",
                "fits": f"{kept} of {data.sizes['fit']}",
                "largest change / its error": f"{change[at]:.1f}",
                "by": f"{row.kind.values[at]}, {row.fit.values[at]}",
            }
        )
        changed += [symbol] * bool(round(change[at], 1) > SIGNIFICANT_ERRORS)
    failed = [label for label, row in layout.by_label(data, "fit").items() if row.reason.item()]
    sentences = []
    if changed:
        sentences.append(f"Some fits are over {SIGNIFICANT_ERRORS:g} errors off: {', '.join(changed)}.")
    sentences += [f"Without a result: {', '.join(failed)}."] if failed else []
    caption = "Sensitivity: the same forces over windows, starts, sampling, noise models and methods"
    return [Block(sentences, ALWAYS, "Sensitivity", layout.text_table(rows, ("force", "by")), caption)]


def sureness_json(tree: xr.DataTree) -> dict[str, Any]:
    """Profiles and sensitivity as plain data; nothing where nothing was asked for."""
    tables = {PROFILE: ("parameter", layout.KEYS[PROFILE]), SENSITIVITY: layout.KEYS[SENSITIVITY]}
    return layout.mapped(tree, {name: (name, tables[name]) for name in tables if name in tree.children})


def difference_blocks(tree: xr.DataTree, record: Sequence[str] = ()) -> list[Block]:
    """What is said of two samples, in its order; `record` says what was read."""
    data = tree.to_dataset()
    said = (
        f"Coefficients are at w = {data.reference_frequency.item():.6g} rad/s. A detectable difference is "
        f"found with a probability of {POWER_STATED:g}, at the level {data.attrs['level']:g}."
    )
    return [
        Block([_first_sentence(tree)], ALWAYS),
        Block([_stiffness_sentence(data), *_warnings(tree)]),
        Block(record),
        Block([said], title="Coefficients", table=_table(tree, True)),
        Block(_details(tree), Layer.EXPLAIN, "Samples"),
        Block(layers=Layer.QUIET, table=_table(tree, False)),
    ]


def _names(data: xr.Dataset) -> list[str]:
    """What the samples are called: their files, or first and second where these are called alike."""
    names = [_name(data.attrs[f"{side}_record"], side) for side in SIDES]
    return list(SIDES) if names[0] == names[1] else names


def _name(sources: Sequence[str], otherwise: str) -> str:
    """A short name of records that are files."""
    names = [Path(source).name for source in sources if source]
    return f"{names[0]} and {len(names) - 1} more" if len(names) > 1 else "".join(names) or otherwise


def _runs(tree: xr.DataTree) -> list[tuple[str, xr.Dataset]]:
    """The identifications of all runs, with the names of their files."""
    results = identifications_of(tree).items()
    return [(_name(run.attrs["record_source"], label.replace("_", " ")), run) for label, run in results]


def _details(tree: xr.DataTree) -> list[str]:
    """The test of all forces, of what the errors of each run are made, and how far its model is off."""
    sentences = [f"All differences together: {_test_of_all(tree.to_dataset())}."]
    for name, run in _runs(tree):
        sentences.append(verdict.error_parts_sentence(name, run))
        if "held_out_rms" in run:
            ratio = f"{(run.held_out_rms / run.noise).item():.3g} times the noise"
            sentences.append(f"Of held-out parts of {name} its model leaves {ratio}.")
    return sentences


def _test_of_all(data: xr.Dataset) -> str:
    """The test of all forces together."""
    test = f"chi-square {data.chi_square.item():.3g} of {data.degrees_of_freedom.item():g}, p "
    return test + layout.p_value_text(data.p_value_of_all.item())


def _first_sentence(tree: xr.DataTree) -> str:
    """Which coefficients differ, and which do not."""
    data = tree.to_dataset()
    rows = layout.by_label(data, "force")
    held = [name for name, row in rows.items() if not np.isfinite(row.z)]
    others = [name for name, row in rows.items() if not row.differs.item() and name not in held]
    parts = []
    for name, row in rows.items():
        if row.differs.item():
            pair = " and ".join(
                layout.with_unit(layout.quantity(row, side), _unit(tree, name)) for side in SIDES
            )
            parts.append(f"{name} differs: {pair}, z = {abs(row.z.item()):.1f}")
    if parts:
        rest = f"; {', '.join(others)} {'does' if len(others) == 1 else 'do'} not" if others else ""
        rest += f"; not tested, since held in both: {', '.join(held)}" if held else ""
        return f"{'; '.join(parts)}{rest}."
    test = _test_of_all(data)
    if data.attrs["verdict"] == "together they differ":
        return f"The samples differ ({test}), though no coefficient shows it by itself{_sufficient(tree)}."
    return f"No difference was found in {', '.join(others) or 'the samples'} ({test})."


def _sufficient(tree: xr.DataTree) -> str:
    """The fewest coefficients whose difference suffices where all others are equal."""
    data = tree.to_dataset()
    contrast = data[["standard_error", "covariance"]].assign(
        coefficient=data.difference, active=("force", np.ones(data.sizes["force"], dtype=bool))
    )
    parts = []
    for choice in sufficient_forces(contrast):
        of_each = (
            f"{name} by {layout.with_unit(layout.value_with_error(*pair), _unit(tree, name))}"
            for name, pair in choice.items()
        )
        parts.append(" and ".join(of_each))
    return f"; where all others are equal it is {', or '.join(parts)}" if parts else ""


def _stiffness_sentence(data: xr.Dataset) -> str:
    """The ratio of the frequencies, as stiffness."""
    value, error = data.stiffness_difference.item(), data.stiffness_difference_standard_error.item()
    z = f", z = {abs(value) / error:.1f}" if error > 0.0 else ""
    first, second = _names(data)
    return f"Stiffness of {first} over that of {second}, less 1: {layout.value_with_error(value, error)}{z}."


def _warnings(tree: xr.DataTree) -> list[str]:
    """What the errors allow for, and methods that differ."""
    incomplete = [name for name, run in _runs(tree) if "error_of_model" in run]
    said = []
    if incomplete:
        said.append(
            f"The model leaves more than noise in {', '.join(incomplete)}: the errors allow for it "
            "(--explain splits them)."
        )
    if tree.attrs["first_method"] != tree.attrs["second_method"]:
        said.append(
            f"The methods differ, {tree.attrs['first_method']} and {tree.attrs['second_method']}: a part of "
            "the differences may be theirs."
        )
    return said


def _unit(tree: xr.DataTree, symbol: str) -> str:
    """The unit of a force's coefficient."""
    return str(_force(tree, symbol).unit.item())


def _force(tree: xr.DataTree, symbol: str) -> xr.Dataset:
    """A force as the first identification that has it says it."""
    return next(r for r in identifications_of(tree).values() if symbol in r.force).sel(force=symbol)


def _table(tree: xr.DataTree, between: bool) -> Table:
    """A row each force: both samples, difference, how sure, and what would be found."""
    data, rows = tree.to_dataset(), []
    names = dict(zip(SIDES, _names(data), strict=True))
    factor = norm.isf(0.5 * float(data.attrs["level"]) / data.sizes["force"]) + norm.isf(1.0 - POWER_STATED)
    several = [side for side in SIDES if between and np.isfinite(data[f"{side}_between_runs"]).any()]
    for symbol, row in layout.by_label(data, "force").items():
        error = row.standard_error.item()
        rows.append(
            {
                "force": symbol,
                "": layout.name_and_unit(_force(tree, symbol)["name"].item(), _unit(tree, symbol)),
                **{name: layout.quantity(row, side) for side, name in names.items()},
                "difference": layout.value_with_error(row.difference.item(), error),
                "z": f"{row.z.item():+.1f}" if np.isfinite(row.z) else "-",
                "p": layout.p_value_text(row.p_value.item(), ""),
                "detectable": f"{factor * error:.2g}" if error > 0.0 else "-",
                **{f"{names[s]} between its runs": f"{row[f'{s}_between_runs'].item():.2g}" for s in several},
            }
        )
    return layout.text_table(rows, ("force", ""))


def difference_json(tree: xr.DataTree) -> dict[str, Any]:
    """A difference as plain data."""
    return layout.mapped(tree.to_dataset(), layout.KEYS["difference"])
