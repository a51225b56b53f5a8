"""Provenance of a result: record, methods, library, and the Python code that reproduces it."""

import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.forces.library import library_folder, library_of_text, load_library
from sysid_trib.methods import method_of
from sysid_trib.printing.equation import from_template
from sysid_trib.reporting.contents import Part
from sysid_trib.results.kinds import identifications_of, kind_of
from sysid_trib.results.models import NOT_KEPT
from sysid_trib.results.variables import record_groups
from sysid_trib.simulation.simulate import paper_twin

# Attributes of a record with their terms on the page; other attributes keep their names.
PROVENANCE_TERMS = {
    "source": "record",
    "record_source": "record",
    "record_checksum": "SHA-256 of its file",
    "free_decay": "part of it",
    "sysid_trib_version": "version of sysid_trib",
    "format_version": "version of the format of results",
}
LIBRARY = ("library_title", "library_source")
# Attributes that are shown elsewhere on the page, or are too long.
ELSEWHERE = ("method", "options", "library", "candidates", "command", "verdict", "search_outcome", "next")


def kept_records(tree: xr.DataTree) -> list[Mapping[Any, Any]]:
    """Return the attributes of the records stored in a result, in the order of the runs."""
    return [tree[group].attrs for group in record_groups(tree) if group in tree.children]


def facts(tree: xr.DataTree) -> list[tuple[str, str]]:
    """Return the known facts on a result and its records, as terms and texts."""
    first = next(iter(identifications_of(tree).values())).attrs
    general: dict[Any, Any] = {key: first[key] for key in ("sysid_trib_version", *LIBRARY)}
    records = kept_records(tree)
    # A result without its records still contains their names.
    kept = ("record_source", "record_checksum") if records else ()
    general |= {k: v for k, v in tree.attrs.items() if k not in (*general, *kept, *ELSEWHERE)}
    terms = _terms(general)
    for at, attrs in enumerate(records):
        terms += _terms(attrs, f"run {at + 1}, " if len(records) > 1 else "")
    return terms


def method_table(tree: xr.DataTree) -> Part:
    """Return each identification with its stored options and remarks."""
    rows = []
    for name, result in identifications_of(tree).items():
        remarks = {
            k: v for k, v in result.attrs.items() if k not in (*ELSEWHERE, *PROVENANCE_TERMS, *LIBRARY)
        }
        text = "; ".join(f"{term}: {value}" for term, value in _terms(remarks))
        rows.append([name, result.attrs["method"], _options(result.attrs["options"]), text])
    if "options" in tree.attrs and "method" in tree.attrs and "coefficient" not in tree.ds:
        rows.append([tree.attrs["method"], tree.attrs["method"], _options(tree.attrs["options"]), ""])
    heads = ["name", "method", "options", "remarks"]
    return {"title": "Methods and their options", "heads": heads, "rows": rows, "numbers": ()}


def libraries(tree: xr.DataTree) -> dict[str, str]:
    """Return complete libraries, as text by title."""
    first = next(iter(identifications_of(tree).values())).attrs
    attrs: Mapping[Any, Any] = tree.attrs if "library" in tree.attrs else first
    texts = {f"Force library ({attrs['library_source']})": attrs["library"]}
    return texts | ({"Candidates": tree.attrs["candidates"]} if "candidates" in tree.attrs else {})


def _options(text: str) -> str:
    """Return stored options, without those that are not set."""
    options = {k: v for k, v in json.loads(text).items() if not (isinstance(v, dict) and NOT_KEPT in v)}
    return ", ".join(f"{k} = {json.dumps(v)}" for k, v in options.items() if v not in (None, {}, []))


def _terms(attrs: Mapping[Any, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Return attributes as terms and texts, without empty ones."""
    terms = []
    for key, value in attrs.items():
        text = "; ".join(filter(None, value)) if isinstance(value, list) else str(value)
        text = f"{value:g}" if isinstance(value, float) else text
        terms += [(prefix + PROVENANCE_TERMS.get(key, key.replace("_", " ")), text)] if text else []
    return terms


def python_text(tree: xr.DataTree) -> str:
    """Return the lines of Python that read the records and compute the result."""
    kind, named = kind_of(tree), identifications_of(tree)
    checked = tree["judged"].attrs if kind in ("cross_check", "laws", "driven") else {}
    models = tree["judged"].model.values.tolist() if checked else [next(iter(named))]
    first, last = named[models[0]], named[models[-1]]
    options = json.loads(tree.attrs["options"]) if kind == "discover" else {}
    known = [last[name].item() for name in ("omega0", "omega0_standard_error") if name in last]
    return from_template(
        "again.txt",
        {
            "kind": kind,
            "decay": "\n".join(_decay(tree)),
            "library": _library(tree.attrs if kind == "discover" else first.attrs),
            "methods": {json.dumps(name): _method(result) for name, result in named.items()},
            "first": _method(first),
            "last": _method(last),
            "checked": checked,
            "asked": _asked(json.loads(checked["options"])) if kind == "laws" else "",
            "contactless": ", ".join(map(repr, known)),
            "runs": "runs" in tree.children,
            "runs_of_first": sum(name.startswith("sample_first") for name in named),
            "options": _given({k: v for k, v in options.items() if v not in (None, {})}),
        },
    ).rstrip()


def _asked(options: Mapping[str, Any]) -> str:
    """Return the options of `laws` other than its records, as further arguments."""
    table = {
        name: tuple(value) if isinstance(value, list) else value
        for name, value in options["constraints"].items()
    }
    usual = {"system": "", "constraints": {}, "random_force": "off"}
    given = dict(options) | {"constraints": table}
    # Other options are stored only if they are given.
    changed = {name: value for name, value in given.items() if name not in usual or value != usual[name]}
    # An infinite bound.
    return "".join(f", {name}={value!r}" for name, value in changed.items()).replace("inf", 'float("inf")')


def _decay(tree: xr.DataTree) -> list[str]:
    if kind_of(tree) == "identify":
        # A single identification contains neither its record nor the cut.
        reads = [f"st.free_decay(st.read_record({name!r}))" for name in tree.attrs["record_source"]]
    else:
        decays = (_one_decay(tree[group].to_dataset()) for group in record_groups(tree))
        # Sections of a long record belong to one record.
        reads = list(dict.fromkeys(decays)) if tree.attrs.get("stretches") else list(decays)
    lines = ["decay = [", *(f"    {read}," for read in reads), "]"]
    return lines if len(reads) > 1 else [f"decay = {reads[0]}"]


def _one_decay(data: xr.Dataset) -> str:
    """Return the code for the record as read, and for the part that was kept, about its equilibrium."""
    attrs = data.attrs
    if not attrs.get("record_checksum"):
        synthetic = attrs.get("source") == paper_twin().attrs["source"]
        # Only its author can reproduce a record made in Python.
        read = "st.records.paper_twin()" if synthetic else "record"
    else:
        read = f"st.read_record({_given(_reading(attrs), attrs['source'])})"
    # The record of a discovery ends where the held-out part begins.
    window = tuple(np.asarray(attrs.get("kept_window", data.time.values[[0, -1]])).tolist())
    if "input_columns" in attrs:
        first, last = window
        return f"{read}.sel(time=slice({first!r}, {last!r}))"
    if "free_decay" not in attrs or "equilibrium" not in data:
        return read
    cut = {"window": window, "equilibrium": data.equilibrium.item()}
    return f"st.free_decay({read}, {_given(cut)})"


def _reading(attrs: Mapping[Any, Any]) -> dict[str, Any]:
    timeless = attrs["time_column"].startswith("none, ")
    options: dict[str, Any] = {} if timeless else {"time": attrs["time_column"]}
    options |= {"angle": attrs["angle_column"], "units": attrs["angle_unit_in_file"].removesuffix("/s")}
    options |= {"signal": attrs["signal"]} if attrs["signal"] != "angle" else {}
    if timeless:
        options["sampling_rate"] = float(attrs["time_column"].removeprefix("none, ").removesuffix(" Hz"))
    elif attrs["time_unit_in_file"] != "s":
        options["time_units"] = attrs["time_unit_in_file"]
    if "input_columns" in attrs:
        inputs = json.loads(attrs["input_columns"])
        options |= {"input": inputs} | {key: attrs[key] for key in ("between",) if key in attrs}
    if "length" in attrs:
        options["length"] = float(attrs["length"])
    return options


def _library(attrs: Mapping[Any, Any]) -> str:
    offered = library_of_text(attrs["library"], attrs["library_source"])
    name = attrs["library_source"].removesuffix(".toml")
    if not (library_folder() / f"{name}.toml").is_file():
        return f"library = st.load_library({attrs['library_source']!r})"
    shipped = load_library(name).symbols
    if not {*offered.symbols} <= {*shipped}:
        return 'library = st.load_library("library.toml")  # the text below, as a file'
    chosen = "" if shipped == offered.symbols else f".select({json.dumps(list(offered.symbols))})"
    return f"library = st.load_library({name!r}){chosen}"


def _method(result: xr.Dataset) -> str:
    """Return the method with the options that differ from the defaults."""
    try:
        method = method_of(result)
    except UsageError:
        return "method"  # of the user's own
    kept = {field.name: getattr(method, field.name) for field in fields(method)}
    options, usual = {name: _python(value) for name, value in kept.items()}, type(method)()
    given = {name: value for name, value in options.items() if value != getattr(usual, name)}
    return f"st.methods.{type(method).__name__}({_given(given)})"


def _python(value: Any) -> Any:
    """Restore values from JSON, which has no tuples; an infinite bound becomes None."""
    if isinstance(value, dict):
        return {key: _python(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return tuple(map(_python, value))
    return None if isinstance(value, float) and np.isinf(value) else value


def _given(options: Mapping[str, Any], *first: str) -> str:
    """Return the arguments of a call as text."""
    return ", ".join([*map(repr, first), *(f"{key}={value!r}" for key, value in options.items())])
