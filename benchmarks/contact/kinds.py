"""The kinds of lab files, from tables: one is drawn, written, said to be what it is, and read."""

import re
import tomllib
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.contact import defects, writing
from benchmarks.contact.writing import Draw, Right, cells, swing, text_of
from sysid_trib.cycles.look import look
from sysid_trib.errors import SysidTribError
from sysid_trib.records.free_decay import free_decays
from sysid_trib.records.read import read_records
from sysid_trib.records.reading import Reading

KINDS, EXPORTS, SPELLINGS = (
    tomllib.loads(Path(__file__).with_name(name).read_text("utf-8"))
    for name in ("kinds.toml", "exports.toml", "spellings.toml")
)
KINDS |= EXPORTS
HEADS = ["Time (s),Angle (rad)", "t [s],theta [rad]", "time,angle_rad"]
KNOWN = {**vars(np), **vars(writing), **vars(defects), **SPELLINGS}
PARTS = {"sep": ",", "comma": False, "end": "\n", "tail": "", "encoding": "utf-8", "head": HEADS}


def make(name: str, path: Path, draw: Draw) -> Right:
    """Write a file of a kind; what is right of it."""
    kind = KINDS[name]
    names = {**KNOWN, "draw": draw, "pick": draw.pick, "within": draw.within, "path": path}

    def value(formula: object) -> Any:
        return eval(formula, names) if isinstance(formula, str) else formula

    def part_of(part: str) -> Any:
        given = kind.get(part, PARTS[part])
        return draw.pick(*given) if isinstance(given, list) else given

    m = swing(draw, **{key: value(given) for key, given in kind.get("swing", {}).items()})
    names |= vars(m) | {"m": m, "noise": lambda of: draw.noise(len(names["x"]), of)}
    names |= {"y": m.x + draw.noise(m.x.size, 1e-3), "n": m.x.size, "row": np.arange(m.x.size)}
    names |= {part: part_of(part) for part in PARTS if part != "head"} | {
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
        _text(path, kind, names, value, _filled(part_of("head"), value, draw))
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


PERIOD, DAMPING, AMPLITUDE = 0.01, 0.12, 0.12


def drawn(name: str, folder: Path, seed: int, number: int) -> tuple[str, str]:
    """Draw a file of a kind; its name, and what is wrong in its reading."""
    draw = Draw([seed, number, zlib.crc32(name.encode())])
    stem, _, suffix = name.partition(".")
    path = folder / f"{stem}_{number}.{suffix or 'csv'}"
    return path.name, wrong(path, make(name, path, draw))


def wrong(path: Path, right: Right) -> str:
    """Describe the error in the reading of a file; empty if there is none."""
    refused = not right.quantity
    try:
        records = read_records(path, Reading(**right.options))  # type: ignore[arg-type]
        decays = [decay for record in records for decay in free_decays(record)]
        tree = look(records, decays)
    except SysidTribError as error:
        said = str(error)
        if "\n" not in said:
            named = right.names and all(name in said for name in right.names)
            if named or any(word in said for word in right.words):
                return ""
        return f"refused: {said}"
    attrs = records[0].attrs
    seen = attrs["signal"], attrs["angle_unit_in_file"]
    if refused:
        return f"accepted as {' in '.join(seen)}, {attrs['angle_column']}"
    found = [] if seen == (right.quantity, right.unit or seen[1]) else [f"read as {' in '.join(seen)}"]
    if len(decays) != right.decays:
        found.append(f"{len(decays)} decays, not {right.decays}")
    for node in (tree[name].ds for name in tree.children if name.startswith("decay")):
        amplitude, instants = node.amplitude.values, node.instant_time.values
        w = 2.0 * np.pi / node.period.item()
        fall = float(np.log(amplitude[0] / amplitude[-1]) / (w * (instants[-1] - instants[0])))
        # At the rate of the first instants: dry friction lets it fall ever faster.
        at_start = node.first_damping_ratio.item() * w * (instants[0] - node.start.item())
        first = float(amplitude[0] * np.exp(at_start))
        found += _off("period", node.period.item(), right.period, PERIOD)
        found += _off("damping", fall, right.zeta, DAMPING)
        if seen[0] in ("angle", "displacement") and len(decays) == 1:
            found += _off("amplitude", first, right.amplitude, AMPLITUDE)
    return "; ".join(found)


def _off(name: str, seen: float, right: float, tolerance: float) -> list[str]:
    if np.isnan(right) or abs(seen / right - 1.0) <= tolerance:
        return []
    return [f"{name} {seen:.4g}, not {right:.4g}"]
