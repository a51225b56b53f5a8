"""Where a result is from: record, methods with their options, library."""

import json
from collections.abc import Mapping
from typing import Any

import xarray as xr

from sysid_trib.reporting.parts import PageTable
from sysid_trib.results.kinds import identifications_of
from sysid_trib.results.per_run import record_groups

# Attributes of a record under the words of the page; the others keep their names.
PROVENANCE_TERMS = {
    "source": "record",
    "record_source": "record",
    "record_checksum": "SHA-256 of its file",
    "free_decay": "part of it",
    "sysid_trib_version": "version of sysid_trib",
    "format_version": "version of the format of results",
}
LIBRARY = ("library_title", "library_source")
# Elsewhere on the page, or long.
ELSEWHERE = ("method", "options", "library", "candidates", "command", "verdict", "next")


def kept_records(tree: xr.DataTree) -> list[Mapping[Any, Any]]:
    """Attributes of the records that a result keeps, in the order of the runs."""
    return [tree[group].attrs for group in record_groups(tree) if group in tree.children]


def facts(tree: xr.DataTree) -> list[tuple[str, str]]:
    """What is known of the result and its records, as terms and texts."""
    first = next(iter(identifications_of(tree).values())).attrs
    general: dict[Any, Any] = {key: first[key] for key in ("sysid_trib_version", *LIBRARY)}
    records = kept_records(tree)
    # A result that keeps no record still names it.
    kept = ("record_source", "record_checksum") if records else ()
    general |= {k: v for k, v in tree.attrs.items() if k not in (*general, *kept, *ELSEWHERE)}
    terms = _terms(general)
    for at, attrs in enumerate(records):
        terms += _terms(attrs, f"run {at + 1}, " if len(records) > 1 else "")
    return terms


def method_table(tree: xr.DataTree) -> PageTable:
    """Each identification with the options and remarks that it carries."""
    rows = []
    for name, result in identifications_of(tree).items():
        remarks = {
            k: v for k, v in result.attrs.items() if k not in (*ELSEWHERE, *PROVENANCE_TERMS, *LIBRARY)
        }
        text = "; ".join(f"{term}: {value}" for term, value in _terms(remarks))
        rows.append([name, result.attrs["method"], _options(result.attrs["options"]), text])
    if "options" in tree.attrs and "method" in tree.attrs and "coefficient" not in tree.ds:
        rows.append([tree.attrs["method"], tree.attrs["method"], _options(tree.attrs["options"]), ""])
    return PageTable("Methods and their options", ["name", "method", "options", "remarks"], rows, frozenset())


def libraries(tree: xr.DataTree) -> dict[str, str]:
    """Libraries whole, as text by title."""
    first = next(iter(identifications_of(tree).values())).attrs
    attrs: Mapping[Any, Any] = tree.attrs if "library" in tree.attrs else first
    candidates = {"Candidates": tree.attrs["candidates"]} if "candidates" in tree.attrs else {}
    return {f"Force library ({attrs['library_source']})": attrs["library"]} | candidates


def _options(text: str) -> str:
    """Options as they are kept, without those that are not set."""
    options = json.loads(text)
    return ", ".join(f"{k} = {json.dumps(v)}" for k, v in options.items() if v not in (None, {}, []))


def _terms(attrs: Mapping[Any, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Attributes as terms and texts; an empty one says nothing."""
    texts = {str(key): _plain_text(value) for key, value in attrs.items()}
    return [
        (prefix + PROVENANCE_TERMS.get(k, k.replace("_", " ")), text) for k, text in texts.items() if text
    ]


def _plain_text(value: Any) -> str:
    if isinstance(value, list):
        return "; ".join(filter(None, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
