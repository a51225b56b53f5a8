"""Tables in JSON: columns by their names, rows that name them, or rows of numbers, in groups or not."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pandas as pd


def json_content(path: Path) -> Any:
    """What a file of JSON holds, an object a line or not; None of any other one."""
    content = path.read_bytes().removeprefix(b"\xef\xbb\xbf").strip()
    if not content.startswith((b"{", b"[")) or not content.endswith((b"}", b"]")):
        return None
    try:
        return json.loads(content)
    except RecursionError:
        return None
    except ValueError:
        lines = content.splitlines()
    try:
        # Where the first line is whole, the others are rows too.
        return [json.loads(line) for line in lines if line.strip()] if len(lines) > 1 else None
    except (ValueError, RecursionError):
        return None


def json_columns(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Columns by name, as `run.theta`.

    Parameters
    ----------
    value : dict, list or scalar
        Of `json.loads`.
    name : str
        Of the group that holds it.
    """
    if isinstance(value, dict):
        table = _split_table(value)
        if table is None and value and all(key.isdigit() for key in value):
            table = list(value.values())
        if table is not None:
            yield from json_columns(table, name)
            return
        for key, item in value.items():
            yield from json_columns(item, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and value and all(isinstance(item, dict) for item in value):
        frame = pd.json_normalize(value)
        for column in frame.columns:
            yield (f"{name}.{column}" if name else str(column)), frame[column].to_numpy()
    elif isinstance(value, list) and value and all(isinstance(item, list) for item in value):
        # Rows, or a few columns.
        frame = pd.DataFrame(value)
        for at, column in (frame if len(frame) >= frame.shape[1] else frame.T).items():
            yield f"{name or 'data'}[{at}]", column.to_numpy()
    elif isinstance(value, list) and value:
        yield name or "data", pd.Series(value).to_numpy()


def _split_table(value: dict[str, Any]) -> list[dict[str, Any]] | None:
    """Rows of `{"columns": [names], "data": [rows]}`, as pandas writes them."""
    names, rows = value.get("columns"), value.get("data")
    if not isinstance(names, list) or not isinstance(rows, list):
        return None
    if not all(isinstance(row, list) and len(row) == len(names) for row in rows):
        return None
    return [dict(zip(map(str, names), row, strict=True)) for row in rows]
