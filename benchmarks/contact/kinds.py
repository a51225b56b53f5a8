"""The kinds of lab files, from a table: a file of one is drawn, written, and said to be what it is."""

import re
import tomllib
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.contact import defects, spellings, writing
from benchmarks.contact.writing import Draw, Right, cells, swing, text_of

KINDS, SPELLINGS = (
    tomllib.loads(Path(__file__).with_name(name).read_text("utf-8"))
    for name in ("kinds.toml", "spellings.toml")
)
HEADS = ["Time (s),Angle (rad)", "t [s],theta [rad]", "time,angle_rad"]
KNOWN = {**vars(np), **vars(writing), **vars(spellings), **vars(defects), **SPELLINGS}
PARTS = {"sep": ",", "comma": False, "end": "\n", "tail": "", "encoding": "utf-8", "head": HEADS}


def make(name: str, path: Path, draw: Draw) -> Right:
    """Write a file of a kind; what is right of it."""
    kind = KINDS[name]
    names = {**KNOWN, "draw": draw, "pick": draw.pick, "within": draw.within, "path": path}

    def value(formula: object) -> Any:
        return eval(formula, names) if isinstance(formula, str) else formula

    def drawn(part: str) -> Any:
        given = kind.get(part, PARTS[part])
        return draw.pick(*given) if isinstance(given, list) else given

    m = swing(draw, **{key: value(given) for key, given in kind.get("swing", {}).items()})
    names |= vars(m) | {"m": m, "noise": lambda of: draw.noise(len(names["x"]), of)}
    names |= {"y": m.x + draw.noise(m.x.size, 1e-3), "n": m.x.size, "row": np.arange(m.x.size)}
    names |= {part: drawn(part) for part in PARTS if part != "head"} | {
        "right": m.right,
        "as_unit": m.as_unit,
    }
    for words, formula in kind.get("let", {}).items():
        made = value(formula)
        names |= dict(zip(words.split(), made, strict=True)) if " " in words else {words: made}
    if "y" in kind or len(names["x"]) != m.x.size:
        names["y"] = value(kind.get("y", "x + noise(1e-3)"))
    if "write" in kind:
        value(kind["write"])
    else:
        if len(names["time"]) != len(names["y"]):
            names["time"] = np.arange(len(names["y"])) / m.rate
        _text(path, kind, names, value, _filled(drawn("head"), value, draw))
    if "refused" in kind:
        return Right(words=tuple(kind["refused"]))
    found = value(kind.get("right", "right('angle', 'rad')"))
    assert isinstance(found, Right)
    return found


def _filled(head: str, value: Any, draw: Draw) -> str:
    chosen = re.sub(r"<([^<>]*~[^<>]*)>", lambda found: draw.pick(*found[1].split("~")), head)
    return re.sub(r"{([^{}]+)}", lambda found: str(value(found[1])), chosen)


def _text(path: Path, kind: dict[str, Any], names: dict[str, Any], value: Any, head: str) -> None:
    """A text file; `comma`: as the sign of decimals."""
    pairs = [text.split(" ", 1) for text in kind.get("columns", ["%.4f time", "%.5f y"])]
    columns = [(form, value(formula)) for form, formula in pairs]
    names["rows"] = cells(*zip(*((form, made) for form, made in columns if made is not None), strict=True))
    rows = value(kind.get("rows", "rows"))
    given = {part: names[part] for part in PARTS if part != "head"}
    path.write_bytes(text_of(rows, head, **given))
