"""What this package wrote itself and is no record: results, their JSON, pages, stores of campaigns."""

import json
from pathlib import Path

from sysid_trib.errors import SysidTribError

RESULT_ENDINGS = (".nc", ".nc4", ".cdf")
# Bytes; what a command prints with --json is far smaller.
MOST_JSON = 2**24
# Of either version of Zarr.
STORE_FILES = ("zarr.json", ".zgroup")
PROGRAM = "sysid-trib"


def what_else(path: Path) -> str:
    """What a file is that is no record, and what shows it; empty where it is none of this package's.

    Parameters
    ----------
    path : path
        A file, or folder, that could not be read as a record.
    """
    name, page = path.name, f"{path.stem}.html"
    if path.is_dir():
        store = any((path / file).is_file() for file in STORE_FILES)
        return (
            f"{name}: this is the store of a campaign, no record; its page {page} shows it." if store else ""
        )
    if not path.is_file():
        return ""
    try:
        with path.open("rb") as file:
            start = file.read(1024).lstrip().lower()
    except OSError:
        return ""
    if start.startswith((b"<!doctype html", b"<html")):
        return f"{name}: this is a page of HTML, no record; a browser shows it."
    if start.startswith(b"{") and _is_printed(path):
        return (
            f"{name}: this is what a command printed with --json, no record; -o RESULT.nc keeps what "
            f"{PROGRAM} report shows."
        )
    if path.suffix.lower() in RESULT_ENDINGS and (maker := _maker_of(path)):
        return f"{name}: this is a result of {maker}, no record; {PROGRAM} report {name} -o {page} shows it."
    return ""


def _is_printed(path: Path) -> bool:
    """Whether a file is the JSON that a command printed."""
    if path.stat().st_size > MOST_JSON:
        return False
    try:
        data = json.loads(path.read_bytes())
    except (ValueError, RecursionError):
        return False
    return str(data.get("next")).startswith(f"{PROGRAM} ") or {"records", "without_result"} <= data.keys()


def _maker_of(path: Path) -> str:
    """The command that wrote a result, or its method; empty of what is no result."""
    from sysid_trib.results.files import load

    try:
        tree = load(path)
    except SysidTribError:
        return ""
    methods = [node.attrs.get("method") for node in tree.subtree if "sysid_trib_version" in node.attrs]
    words = str(tree.attrs.get("command", "")).split()
    return (words[1] if len(words) > 1 else str(methods[0])) if methods else ""
