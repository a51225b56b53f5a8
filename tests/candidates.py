"""Forces written as data for tests: candidates of the literature, with parts of their closed signatures."""

import tomllib
from pathlib import Path
from typing import Any

from sysid_trib.forces.force import Force
from sysid_trib.forces.library import parse_library

_entries = tomllib.loads(Path(__file__).with_name("candidates.toml").read_text(encoding="utf-8"))["force"]
CANDIDATES: dict[str, dict[str, Any]] = {entry.pop("symbol"): entry for entry in _entries}


def force(formula: str, symbol: str = "g", **parts: Any) -> Force:
    """A force from its formula."""
    return parse_library({"force": [{"symbol": symbol, "formula": formula, **parts}]}, "test").forces[0]


def candidate(symbol: str) -> Force:
    """A force of the table."""
    return force(symbol=symbol, **CANDIDATES[symbol])
