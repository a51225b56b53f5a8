"""In how many parts of a record the names of a discovery stand, in a sentence and as plain data."""

from collections import Counter
from typing import Any

import xarray as xr

from sysid_trib.records.runs import RECORD_PARTS
from sysid_trib.results.discoveries import PAIRS, added_effects

# In an effect's place.
NOTHING = "no force"


def stability_sentences(tree: xr.DataTree) -> list[str]:
    """In how many parts of the record each name stands, and what is likelier where it does not."""
    # A result that an older version saved does not say.
    if not added_effects(tree) or "stands_in" not in tree["steps"]:
        return []
    steps = tree["steps"].to_dataset()
    texts = []
    for at, symbol in enumerate(steps.symbol.values.tolist()):
        others = Counter(steps.likeliest_in_parts.values[at].split(PAIRS))
        del others[symbol]
        likelier = [f"{name or NOTHING} is likelier in {count}" for name, count in others.items()]
        texts.append(f"{symbol} in {steps.stands_in.values[at]} of {len(RECORD_PARTS)}")
        texts[-1] += f" ({', '.join(likelier)})" if likelier else ""
    parts = ", ".join(RECORD_PARTS)
    return [f"Looked at again on parts of the record ({parts}), these names stand: {'; '.join(texts)}."]


def stability_json(step: xr.Dataset) -> dict[str, Any]:
    """The same of a step as plain data; null in a result that an older version saved."""
    if "stands_in" not in step:
        return {"stands_in": None, "parts": None, "likeliest_in": None}
    likeliest = step.likeliest_in_parts.item().split(PAIRS)
    return {
        "stands_in": int(step.stands_in),
        "parts": len(likeliest),
        "likeliest_in": dict(zip(RECORD_PARTS, likeliest, strict=True)),
    }
