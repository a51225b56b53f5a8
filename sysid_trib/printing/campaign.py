"""A campaign in words and tables: what was done, what varies between the records, which stand out."""

import json
import re
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import xarray as xr
from rich.table import Table

from sysid_trib.campaigns.rows import EFFECT_P_VALUE, TIED
from sysid_trib.printing import USUALLY, Block, layout

REFUSALS, NAMES_LISTED = 5, 6
# Standard deviations beyond which a record stands out.
STANDS_OUT = 4.0
VARIES, WITHOUT_RESULT = "What varies between the records", "Without a result"
AGAINST = "Coefficients against conditions"
SCATTER = "Mean, effects of conditions, scatter"


def campaign_blocks(store: xr.Dataset, counts: Mapping[str, int], compared: xr.Dataset | None) -> list[Block]:
    """What is shown of a campaign.

    Parameters
    ----------
    store : Dataset
        As `campaign` returns it.
    counts : mapping of str to int
        How many records have which status.
    compared : Dataset, optional
        What varies between its records; None of too few.
    """
    blocks = [Block([_counts(counts), *_verdicts(store), *named_sentences(store)])]
    if compared is not None:
        blocks.append(Block((), USUALLY, VARIES, _between_records(compared), SCATTER))
        blocks.append(Block([*_collinear_sentences(compared), *_outliers(compared)], title=VARIES))
        blocks.append(Block(title=AGAINST))
    return [*blocks, Block(_refusals(store), title=WITHOUT_RESULT)]


def _counts(counts: Mapping[str, int]) -> str:
    """How many records are done, and how many have no result."""
    bad = ", ".join(f"{count:,} {name}" for name, count in counts.items() if count and name != "done")
    return f"{counts['done']:,} of {sum(counts.values()):,} records done{f'; {bad}' if bad else ''}."


def _reasons(store: xr.Dataset) -> dict[str, str]:
    """Why records have no numbers, by their names."""
    bad = store.isel(record=np.flatnonzero(store.status.values > 1))
    return dict(zip(bad.record.values.tolist(), bad.message.values.tolist(), strict=True))


def _refusals(store: xr.Dataset) -> list[str]:
    """Why records have no numbers: each of the first few, then how many more."""
    # A message on a file begins with its name.
    sentences = [
        why if why.startswith(name.rpartition("/")[2]) else f"{name}: {why}"
        for name, why in _reasons(store).items()
    ]
    return layout.first_and_more(sentences, REFUSALS, ": see `message` in the store")


def _of_done(store: xr.Dataset, name: str) -> list[str]:
    """A text of each record that is done."""
    return store[name].values[store.status.values == 1].tolist()


def _most_first(words: Iterable[str]) -> dict[str, int]:
    """How often each word stands there; an empty one is none."""
    counts = Counter(filter(None, words))
    return dict(sorted(counts.items(), key=lambda pair: (-pair[1], pair[0])))


def _verdicts(store: xr.Dataset) -> list[str]:
    """How often each verdict was given."""
    counts = [*_most_first(_of_done(store, "verdict")).items()][:REFUSALS]
    return ["; ".join(f"{count:,} {verdict}" for verdict, count in counts) + "."] if counts else []


def named_counts(store: xr.Dataset) -> dict[str, int]:
    """In how many records each effect is named, or cannot be separated from one that is; most first."""
    if TIED not in store:
        return {}
    texts = zip(_of_done(store, "named"), _of_done(store, TIED), strict=True)
    # "nu, epsilon" and "epsilon or gravity; ...", of many "or 3 more".
    words = [set(re.split(r", |; | or ", f"{named}, {tied}")) for named, tied in texts]
    return _most_first(word for of_record in words for word in of_record if word in store.force.values)


def named_sentences(store: xr.Dataset) -> list[str]:
    """A sentence that counts the names of a campaign."""
    counts = named_counts(store)
    if not counts:
        return []
    listed = [f"{symbol} in {count:,}" for symbol, count in [*counts.items()][:NAMES_LISTED]]
    more = len(counts) - len(listed)
    return [f"Named, or not to be separated from a name: {', '.join(listed)}{f', {more} more' * (more > 0)}."]


def named_text(record: xr.Dataset) -> str:
    """The effects that a discovery named, each with its p-value, and what they cannot be separated from."""
    named = str(record.named.item())
    # A store that was begun by an older version has the names alone.
    if not named or EFFECT_P_VALUE not in record:
        return named
    p_values = record[EFFECT_P_VALUE]
    pairs = [f"{s} (p {layout.p_value_text(p_values.sel(force=s).item())})" for s in named.split(", ")]
    tied = str(record[TIED].item())
    return f"{', '.join(pairs)}{f'; not to be separated: {tied}' if tied else ''}"


def _between_records(compared: xr.Dataset) -> Table:
    """Each quantity: mean, effects of the conditions, standard deviation between the records, verdict."""
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
    return layout.text_table(rows, ("quantity", "unit", "verdict"))


def _interval(of_quantity: xr.Dataset, name: str) -> str:
    """A standard deviation with its interval."""
    value, lower, upper = (of_quantity[key].item() for key in (name, f"{name}_lower", f"{name}_upper"))
    return f"{value:.2g} ({lower:.2g} to {upper:.2g})" if np.isfinite(value) else "-"


def _collinear_sentences(compared: xr.Dataset) -> list[str]:
    """Which conditions are left out of the comparison, since they go with others."""
    text = "Condition '{}' goes with {} in these records: it is left out, and an effect may be of either."
    return [text.format(name, others) for name, others in _collinear(compared).items()]


def _collinear(compared: xr.Dataset) -> dict[str, str]:
    """Conditions that are left out, and with which each goes."""
    return dict(json.loads(compared.attrs.get("collinear", "{}")))


def _outliers(compared: xr.Dataset) -> list[str]:
    """Records that stand out, and in what."""
    z = np.abs(compared.z.transpose("run", "quantity").values)
    largest = np.nanmax(np.where(np.isnan(z), -1.0, z), axis=1)
    order = [at for at in np.argsort(-largest) if largest[at] > STANDS_OUT]
    sentences = [
        f"{compared.run.values[at]} stands out: {compared.quantity.values[np.nanargmax(z[at])]} by "
        f"{largest[at]:.1f} standard deviations."
        for at in order
    ]
    return layout.first_and_more(sentences, REFUSALS)


def campaign_json(
    store: xr.Dataset, counts: Mapping[str, int], compared: xr.Dataset | None
) -> dict[str, Any]:
    """The campaign as plain data: counts, reasons, and what varies between the records."""
    made: dict[str, Any] = {"records": dict(counts), "without_result": _reasons(store)}
    if TIED in store:
        made["named_or_tied"] = named_counts(store)
    if compared is not None:
        made["between_records"] = layout.per_label(compared, "quantity", layout.KEYS["between_records"])
        made["collinear_conditions"] = _collinear(compared)
    return made
