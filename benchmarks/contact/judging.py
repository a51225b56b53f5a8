"""Whether a file is read as it should be."""

import zlib
from pathlib import Path

import numpy as np

from benchmarks.contact.kinds import make
from benchmarks.contact.writing import Draw, Right
from sysid_trib.cycles.look import look
from sysid_trib.errors import SysidTribError
from sysid_trib.records.free_decay import free_decays
from sysid_trib.records.read import read_records
from sysid_trib.records.reading import Reading

PERIOD, DAMPING, AMPLITUDE = 0.01, 0.12, 0.12


def drawn(name: str, folder: Path, seed: int, number: int) -> tuple[str, str]:
    """Draw a file of a kind; its name, and what is wrong in its reading."""
    draw = Draw([seed, number, zlib.crc32(name.encode())])
    stem, _, suffix = name.partition(".")
    path = folder / f"{stem}_{number}.{suffix or 'csv'}"
    return path.name, wrong(path, make(name, path, draw))


def wrong(path: Path, right: Right) -> str:
    """What is wrong in the reading of a file; nothing where nothing is."""
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
