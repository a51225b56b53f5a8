"""Where a result is from: record, methods with their options, library."""

import json
from collections.abc import Mapping
from typing import Any

import xarray as xr

from sysid_trib.reporting.contents import identifications
from sysid_trib.reporting.parts import Table
from sysid_trib.results.per_run import record_groups

# Attributes of a record under the words of the page; the others keep their names.
WORDS = {
    "source": "record",
    "record_source": "record",
    "record_checksum": "SHA-256 of its file",
    "free_decay": "part of it",
    "sysid_trib_version": "version of sysid_trib",
    "format_version": "version of the format of results",
}
# Told elsewhere on the page, or long.
ELSEWHERE = ("method", "options", "library", "candidates", "command", "verdict")


def facts(tree: xr.DataTree) -> list[tuple[str, str]]:
    """What is known of the result and its records, as terms and texts."""
    first = next(iter(identifications(tree).values()))
    about = _plain(first.attrs, only=("sysid_trib_version", "library_title", "library_source"))
    records = [tree[group].attrs for group in record_groups(tree) if group in tree.children]
    # A result that keeps no record still names it.
    own = ("record_source", "record_checksum") if records else ()
    about |= _plain(tree.attrs, leave=(*about, *own, *ELSEWHERE))
    told = _worded(about)
    for at, attrs in enumerate(records):
        told += _worded(_plain(attrs), f"run {at + 1}, " if len(records) > 1 else "")
    return told


def method_table(tree: xr.DataTree) -> Table:
    """Each identification with the options and remarks that it carries."""
    rows = []
    for name, result in identifications(tree).items():
        remarks = _plain(result.attrs, leave=(*ELSEWHERE, *WORDS, "library_title", "library_source"))
        told = "; ".join(f"{key.replace('_', ' ')}: {value}" for key, value in remarks.items())
        rows.append([name, result.attrs["method"], options_told(result.attrs["options"]), told])
    if "options" in tree.attrs and "method" in tree.attrs and "coefficient" not in tree.ds:
        rows.append([tree.attrs["method"], tree.attrs["method"], options_told(tree.attrs["options"]), ""])
    return Table("Methods and their options", ["name", "method", "options", "remarks"], rows, frozenset())


def options_told(text: str) -> str:
    """Options as they are kept, without those that are not set."""
    options = json.loads(text)
    return ", ".join(f"{k} = {json.dumps(v)}" for k, v in options.items() if v not in (None, {}, []))


def texts(tree: xr.DataTree) -> dict[str, str]:
    """Libraries whole, by title."""
    first = next(iter(identifications(tree).values())).attrs
    attrs: Mapping[Any, Any] = tree.attrs if "library" in tree.attrs else first
    found = {f"Force library ({attrs['library_source']})": attrs["library"]}
    return found | ({"Candidates": tree.attrs["candidates"]} if "candidates" in tree.attrs else {})


def _plain(
    attrs: Mapping[Any, Any], only: tuple[str, ...] = (), leave: tuple[str, ...] = ()
) -> dict[str, str]:
    """Attributes as texts; empty ones tell nothing."""
    chosen = {
        str(key): value for key, value in attrs.items() if (not only or key in only) and key not in leave
    }
    texts = {key: _plain_text(value) for key, value in chosen.items()}
    return {key: text for key, text in texts.items() if text}


def _plain_text(value: Any) -> str:
    if isinstance(value, list):
        return "; ".join(filter(None, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _worded(about: Mapping[str, str], prefix: str = "") -> list[tuple[str, str]]:
    return [(prefix + WORDS.get(key, key.replace("_", " ")), text) for key, text in about.items()]
