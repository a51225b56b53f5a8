"""Stores of campaigns that were damaged or edited, and conditions of any letters: read, and gone on with."""

import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np

import sysid_trib as st
from benchmarks.hostile.pieces import ANGLE, TIME, damaged, number, pick, text, words
from sysid_trib.campaigns.conditions import read_conditions

TASK = st.campaigns.Task("identify", st.load_library().select(["zeta"]), {"direct": st.methods.Direct()})
KEYS = words("chunks compressor dtype fill_value filters order shape zarr_format")
PICKLE = {"id": "pickle"}
VALUES = (0, -1, 1, 10**10, [0], [10**10], [2, 2], None, "|O", "<f8", "<U9", PICKLE, [PICKLE], "NaN")
RECORDS = 3


@cache
def _sound(folder: Path) -> tuple[list[Path], Path]:
    """Some records and their store; the first process makes them."""
    kept = folder / "campaign"
    records = [kept / f"r{at}.csv" for at in range(RECORDS)]
    if not kept.exists():
        kept.mkdir()
        random = np.random.default_rng(0)
        for record in records:
            angle = ANGLE + 1e-4 * random.standard_normal(ANGLE.size)
            head = "time (s),angle (rad)"
            np.savetxt(record, np.c_[TIME, angle], "%.6g", ",", header=head, comments="")
        st.campaign(records[:-1], TASK, output=kept / "base.zarr", workers=0)
    return records, kept / "base.zarr"


def _edit(place: Path, random: np.random.Generator) -> None:
    files = sorted(file for file in place.rglob("*") if file.is_file())
    file = files[int(random.integers(len(files)))]
    if file.name == ".zarray" and random.random() < 0.8:
        data = json.loads(file.read_text())
        data[str(pick(random, KEYS))] = pick(random, VALUES)
        file.write_text(json.dumps(data))
    elif random.random() < 0.2:
        file.unlink()
    elif random.random() < 0.2:
        shutil.rmtree(file.parent)
    else:
        file.write_bytes(damaged(file.read_bytes(), random))


def case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A damaged store, opened, or gone on with; or a table of conditions."""
    records, base = _sound(folder)
    if random.random() < 0.3:
        table = folder / "conditions.csv"
        names = [record.name for record in records] if random.random() < 0.5 else [text(random)] * RECORDS
        rows = [f"{name},{number(random):g},{text(random)}" for name in names]
        table.write_bytes(damaged("\n".join(["record,load,x", *rows]).encode(errors="replace"), random))
        return lambda: read_conditions(table, [str(record) for record in records])
    place = folder / "store.zarr"
    shutil.rmtree(place, ignore_errors=True)
    shutil.copytree(base, place)
    for _ in range(int(random.integers(1, 3))):
        if place.exists():
            _edit(place, random)
    # Nothing is identified anew where a store is only gone on with.
    if random.random() < 0.7:
        return lambda: st.campaigns.open_store(place).load()
    return lambda: st.campaign(records[:-1], TASK, output=place, workers=0)
