"""Many records in sentences and tables: variation within a campaign, and the difference of two samples."""

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import scipy
import xarray as xr
from rich.table import Table

from sysid_trib.printing import ALWAYS, USUALLY, Block, Layer, layout
from sysid_trib.printing.law_difference import (
    law_blocks,
    law_difference_json,
    law_sentences,
    sample_name,
    sample_names,
)
from sysid_trib.printing.verdict import error_parts_sentence
from sysid_trib.results.effects import at_bound, sufficient_forces
from sysid_trib.results.judged import SEARCH_OUTCOME
from sysid_trib.results.kinds import SIDES, identifications_of
from sysid_trib.results.store import (
    EFFECT_P_VALUE,
    JUDGED_NAMES,
    TIED,
    Status,
    done_records,
    text_counts,
    unvisited_speeds,
)

REFUSALS, NAMES_LISTED = 5, 6
# Number of records whose judged variables are in the JSON output; the store has those of all records.
MOST_IN_JSON = 1000
# Standard deviations beyond which a record is an outlier.
STANDS_OUT = 4.0
VARIES, WITHOUT_RESULT = "Variation between the records", "Without a result"
AGAINST = "Coefficients against conditions"
SCATTER = "Mean, effects of conditions, scatter"
COLLINEAR = (
    "Condition '{}' is confounded with {} in these records and left out: an effect may be due to either."
)


def campaign_blocks(store: xr.Dataset, counts: Mapping[str, int], compared: xr.Dataset | None) -> list[Block]:
    """Return the blocks of a campaign.

    Parameters
    ----------
    store : Dataset
        Result of `campaign`.
    counts : mapping of str to int
        Number of records with each status.
    compared : Dataset, optional
        Variation between its records; None if there are too few.
    """
    # A message about a file begins with its name.
    reasons = [
        why if why.startswith(name.rpartition("/")[2]) else f"{name}: {why}"
        for name, why in _reasons(store).items()
    ]
    refused = layout.first_and_more(reasons, REFUSALS, ": see `message` in the store")
    varying = [] if compared is None else [*_varying(compared), Block([*other_units(store)], title=VARIES)]
    return [Block([*_counts(store, counts)]), *varying, Block(refused, title=WITHOUT_RESULT)]


def other_units(store: xr.Dataset) -> Iterator[str]:
    """Report records in another unit than the majority; they are excluded from the variation."""
    (usual, _), *others = Counter(_of_done(store, "signal_units")).most_common()
    for unit, count in others:
        records = "1 record is" if count == 1 else f"{count} records are"
        yield f"{records} in {unit} and left out of the mean, which is that of the records in {usual}."


def _reasons(store: xr.Dataset) -> dict[str, str]:
    """Return the reasons why records have no numbers, by record name."""
    return dict(store.message[store.status.values > Status.DONE].to_series())


def _of_done(store: xr.Dataset, name: str) -> list[str]:
    """Return one text for each finished record."""
    return store[name].values[store.status.values == Status.DONE].tolist()


def _most_first(words: Iterable[str]) -> dict[str, int]:
    """Count words, the most frequent first; empty words are ignored."""
    return dict(Counter(sorted(filter(None, words))).most_common())


def _counts(store: xr.Dataset, counts: Mapping[str, int]) -> Iterator[str]:
    """Describe the number of finished records, and how often each verdict and name occurs."""
    bad = ", ".join(f"{count:,} {name}" for name, count in counts.items() if count and name != "done")
    yield f"{counts['done']:,} of {sum(counts.values()):,} records done{f'; {bad}' if bad else ''}."
    if verdicts := text_counts(store, "verdict"):
        yield f"{'; '.join(f'{count:,} {verdict}' for verdict, count in verdicts.items())}."
    if outcomes := text_counts(store, SEARCH_OUTCOME):
        texts = "; ".join(f"{count:,} {outcome}" for outcome, count in outcomes.items())
        unconverged = np.count_nonzero(~done_records(store).converged.values)
        early = f"; {unconverged:,} ended before the search had converged" if unconverged else ""
        yield f"Outcomes of the searches: {texts}{early}."
    elif preferred := text_counts(store, "preferred"):
        models = [f"{model} in {count:,}" for model, count in preferred.items()]
        yield f"Preferred method: {', '.join(models)}."
    if unvisited := unvisited_speeds(store):
        yield f"No record visits the speed of {', '.join(unvisited)}: give smaller --speeds."
    if listed := [f"{symbol} in {count:,}" for symbol, count in named_counts(store).items()]:
        more = f", {len(listed) - NAMES_LISTED} more" if len(listed) > NAMES_LISTED else ""
        yield f"Named, or not separable from a name: {', '.join(listed[:NAMES_LISTED])}{more}."


def named_counts(store: xr.Dataset) -> dict[str, int]:
    """Count the records in which each effect is named or inseparable from a named one; most first."""
    if TIED not in store:
        return {}
    texts = zip(_of_done(store, "named"), _of_done(store, TIED), strict=True)
    # Texts such as "nu, epsilon" and "epsilon or gravity; ...", some of them ending with "or 3 more".
    words = [set(re.split(r", |; | or ", f"{named}, {tied}")) for named, tied in texts]
    return _most_first(word for of_record in words for word in of_record if word in store.force.values)


def named_text(record: xr.Dataset) -> str:
    """Return the effects that a discovery named, each with its p-value and its competing effects."""
    if EFFECT_P_VALUE not in record or not record.named.item():
        return ""
    named = str(record.named.item())
    p_values = record[EFFECT_P_VALUE]
    pairs = [f"{s} (p {layout.p_value_text(p_values.sel(force=s).item())})" for s in named.split(", ")]
    tied = str(record[TIED].item())
    return f"{', '.join(pairs)}{f'; not separable: {tied}' if tied else ''}"


def _varying(compared: xr.Dataset) -> Iterator[Block]:
    """Describe each quantity: mean, effects of the conditions, deviation between the records, verdict."""
    terms, conditions = compared.term.values.tolist(), compared.condition.values.tolist()
    deviations = {"between records": "between_run"}
    deviations |= {k: k for k in ("repeatability", "reproducibility") if "repeatability" in compared}
    rows = []
    for name, row in layout.by_label(compared, "quantity").items():
        effects = layout.values_with_errors(row.effect, row.effect_standard_error)
        p_values = [layout.p_value_text(p, "") for p in row.condition_p_value.values.tolist()]
        rows.append(
            {
                "quantity": name,
                "unit": row.unit.item().removeprefix("1") if "unit" in row.coords else "",
                **dict(zip(terms, effects, strict=True)),
                **{f"p of {condition}": p for condition, p in zip(conditions, p_values, strict=True)},
                **{head: _interval(row, key) for head, key in deviations.items()},
                "verdict": row.verdict.item(),
            }
        )
    yield Block((), USUALLY, VARIES, layout.text_table(rows, ("quantity", "unit", "verdict")), SCATTER)
    collinear = (COLLINEAR.format(*pair) for pair in _collinear(compared).items())
    yield Block([*collinear, *_outliers(compared)], title=VARIES)
    yield Block(title=AGAINST)


def _interval(of_quantity: xr.Dataset, name: str) -> str:
    """Return a standard deviation with its interval."""
    value, lower, upper = (of_quantity[key].item() for key in (name, f"{name}_lower", f"{name}_upper"))
    return f"{value:.2g} ({lower:.2g} to {upper:.2g})" if np.isfinite(value) else "-"


def _collinear(compared: xr.Dataset) -> dict[str, str]:
    """Return the omitted conditions, and those with which each is confounded."""
    return dict(json.loads(compared.attrs.get("collinear", "{}")))


def _outliers(compared: xr.Dataset) -> list[str]:
    """Return outliers, and the quantities in which they deviate."""
    z = abs(compared.z.transpose("run", "quantity").to_pandas()).fillna(0.0)
    largest = z.max(axis=1).sort_values(ascending=False, kind="stable")
    sentences = [
        f"{run} is an outlier: {z.loc[run].idxmax()} by {distance:.1f} standard deviations."
        for run, distance in largest[largest > STANDS_OUT].items()
    ]
    return layout.first_and_more(sentences, REFUSALS)


def campaign_json(
    store: xr.Dataset, counts: Mapping[str, int], compared: xr.Dataset | None
) -> dict[str, Any]:
    """Return the campaign as plain data: counts, reasons, and the variation between the records."""
    made: dict[str, Any] = {
        "records": dict(counts),
        "without_result": _reasons(store),
        "verdicts": text_counts(store, "verdict"),
        "preferred": text_counts(store, "preferred"),
        "judged": _judged_json(store),
    }
    if SEARCH_OUTCOME in store:
        made["search_outcomes"] = text_counts(store, SEARCH_OUTCOME)
    if unvisited := unvisited_speeds(store):
        made["unvisited_speeds"] = unvisited
    if TIED in store:
        made["named_or_tied"] = named_counts(store)
    if compared is not None:
        made["between_records"] = layout.mapped(compared, "between_records")
        made["collinear_conditions"] = _collinear(compared)
    return made


def _judged_json(store: xr.Dataset) -> dict[str, Any]:
    """Return the judged variables of each model for the first records that have a result, by record."""
    table = done_records(store)[list(JUDGED_NAMES)].isel(record=slice(MOST_IN_JSON)).load()
    # Models that do not apply to a record have no verdict and are left out.
    return {
        name: {
            label: dict(of_model.data_vars)
            for label, of_model in layout.by_label(of_record, "model").items()
            if of_model.verdict.item()
        }
        for name, of_record in layout.by_label(table.reset_coords(drop=True), "record").items()
    }


# Power of the test at which the detectable difference is stated in the table.
POWER_STATED = 0.9


def difference_blocks(tree: xr.DataTree, record: Sequence[str] = ()) -> list[Block]:
    """Return the blocks of two samples in order; `record` describes the records."""
    data = tree.to_dataset()
    said = (
        f"Coefficients refer to w = {data.reference_frequency.item():.6g} rad/s. Last column: the difference "
        f"that a test at the level {data.attrs['level']:g} finds with a probability of {POWER_STATED:g}."
    )
    return [
        Block([*law_sentences(tree)], ALWAYS),
        Block([_first_sentence(tree)], ALWAYS),
        Block([*_stiffness_and_warnings(tree)]),
        Block(record),
        Block([said], title="Coefficients", table=_table(tree, True)),
        *law_blocks(tree),
        Block([*_details(tree)], Layer.EXPLAIN, "Samples"),
        Block(layers=Layer.QUIET, table=_table(tree, False)),
    ]


def difference_json(tree: xr.DataTree) -> dict[str, Any]:
    """Return the difference of two samples as plain data, with that of their laws if requested."""
    judged = layout.judged_json(tree) if "judged" in tree.children else {}
    return layout.mapped(tree.to_dataset(), "difference") | judged | law_difference_json(tree)


def _runs(tree: xr.DataTree) -> list[tuple[str, xr.Dataset]]:
    """Return the identifications of all runs, with the names of their files."""
    results = identifications_of(tree).items()
    return [(sample_name(run.attrs["record_source"], label.replace("_", " ")), run) for label, run in results]


def _details(tree: xr.DataTree) -> Iterator[str]:
    """Describe the test of all forces, the parts of the errors of each run, and the residual of its model."""
    yield f"All differences together: {_test_of_all(tree.to_dataset())}."
    if "judged" in tree.children:
        judged = tree["judged"].to_dataset()
        for (name, _), label in zip(_runs(tree), judged.model.values, strict=True):
            of_model = judged.sel(model=label)
            ratio = f"{of_model.residual_over_noise.item():.3g} times the noise"
            yield f"Residual of {name}: {ratio}; verdict: {of_model.verdict.item()}."
    for name, run in _runs(tree):
        yield error_parts_sentence(name, run)
        if "held_out_rms" in run:
            ratio = f"{(run.held_out_rms / run.noise).item():.3g} times the noise"
            yield f"Held-out residual of {name}: {ratio}."


def _test_of_all(data: xr.Dataset) -> str:
    """Return the test of all forces together."""
    count = f"{data.degrees_of_freedom.item():g} degrees of freedom"
    test = f"chi-square {data.chi_square.item():.3g} for {count}, p "
    return test + layout.p_value_text(data.p_value_of_all.item())


def _first_sentence(tree: xr.DataTree) -> str:
    """Describe which coefficients differ, and which do not."""
    data = tree.to_dataset()
    rows, test = layout.by_label(data, "force"), _test_of_all(data)
    bounded = _at_a_bound(data)
    held = [name for name, row in rows.items() if not np.isfinite(row.z) and name not in bounded]
    others = [n for n, row in rows.items() if not row.differs.item() and n not in (*held, *bounded)]
    parts = []
    for name, row in rows.items():
        if row.differs.item():
            unit = _force(tree, name).unit.item()
            pair = " and ".join(layout.with_unit(layout.quantity(row, side), unit) for side in SIDES)
            parts.append(f"{name} differs: {pair}, |z| = {abs(row.z.item()):.1f}")
    if parts:
        rest = f"; no difference was found in {', '.join(others)}" if others else ""
        rest += f"; not tested (held in both): {', '.join(held)}" if held else ""
        rest += f"; not tested (at a bound): {', '.join(bounded)}" if bounded else ""
        return f"{'; '.join(parts)}{rest}."
    if data.attrs["verdict"] == "together they differ":
        unclear = "but the records do not determine in which coefficients"
        return f"The samples differ ({test}), {unclear}.{_sufficient(tree)}"
    rest = f"; not tested (at a bound): {', '.join(bounded)}" if bounded else ""
    return f"No difference was found in {', '.join(others) or 'the samples'} ({test}){rest}."


def _at_a_bound(data: xr.Dataset) -> list[str]:
    """Return the forces at a bound in one of the runs, which are therefore not tested."""
    return [name for name in str(data.attrs.get("at_a_bound", "")).split(", ") if name]


def _sufficient(tree: xr.DataTree) -> str:
    """Return the smallest sets of coefficients whose difference is sufficient if all others are equal."""
    data, parts = tree.to_dataset(), []
    contrast = data[["standard_error", "covariance"]].assign(
        coefficient=data.difference, active=("force", np.ones(data.sizes["force"], dtype=bool))
    )
    contrast = contrast.drop_sel(force=_at_a_bound(data), other_force=_at_a_bound(data))
    for choice in sufficient_forces(contrast):
        of_each = [
            f"{name} by {layout.with_unit(layout.value_with_error(*pair), _force(tree, name).unit.item())}"
            for name, pair in choice.items()
        ]
        parts.append(" and ".join(of_each))
    return f" These differences explain it if the others are zero: {'; or '.join(parts)}." if parts else ""


def _stiffness_and_warnings(tree: xr.DataTree) -> Iterator[str]:
    """Describe the ratio of the frequencies as stiffness, the parts of the errors, and differing methods."""
    data, (first, second) = tree.to_dataset(), sample_names(tree.to_dataset())
    value, error = data.stiffness_difference.item(), data.stiffness_difference_standard_error.item()
    z = f", |z| = {abs(value) / error:.1f}" if error > 0.0 else ""
    yield f"Stiffness of {first} over that of {second}, minus 1: {layout.value_with_error(value, error)}{z}."
    if incomplete := [name for name, run in _runs(tree) if "error_of_model" in run]:
        yield (
            f"The residual exceeds the noise in {', '.join(incomplete)}: the errors include the model error "
            "(--explain shows both parts)."
        )
    at_bounds = [f"{symbol} in {name}" for name, run in _runs(tree) for symbol in at_bound(run)]
    if at_bounds:
        yield (
            f"Not tested, because it is at a bound: {', '.join(at_bounds)}. There the error is one-sided and "
            "z is too large (--bound NAME=-1:1 frees it)."
        )
    methods = [tree.attrs[f"{side}_method"] for side in SIDES]
    if methods[0] != methods[1]:
        yield f"The methods differ ({' and '.join(methods)}): part of the differences may come from them."


def _force(tree: xr.DataTree, symbol: str) -> xr.Dataset:
    """Return the row of a force, with its name and unit."""
    return tree.to_dataset().sel(force=symbol)


def _table(tree: xr.DataTree, between: bool) -> Table:
    """Return a row for each force: both samples, difference, significance, and detectable difference."""
    data, rows = tree.to_dataset(), []
    names = dict(zip(SIDES, sample_names(data), strict=True))
    factor = scipy.stats.norm.isf(
        0.5 * float(data.attrs["level"]) / data.sizes["force"]
    ) + scipy.stats.norm.isf(1.0 - POWER_STATED)
    several = [side for side in SIDES if between and np.isfinite(data[f"{side}_between_runs"]).any()]
    for symbol, row in layout.by_label(data, "force").items():
        error, force = row.standard_error.item(), _force(tree, symbol)
        rows.append(
            {
                "force": symbol,
                "": layout.name_and_unit(force["name"].item(), force.unit.item()),
                **{name: layout.quantity(row, side) for side, name in names.items()},
                "difference": layout.value_with_error(row.difference.item(), error),
                "z": f"{row.z.item():+.1f}" if np.isfinite(row.z) else "-",
                "p": layout.p_value_text(row.p_value.item(), ""),
                "detectable": f"{factor * error:.2g}" if error > 0.0 else "-",
                **{f"{names[s]} between its runs": f"{row[f'{s}_between_runs'].item():.2g}" for s in several},
            }
        )
    return layout.text_table(rows, ("force", ""))
