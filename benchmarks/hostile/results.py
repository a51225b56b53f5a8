"""Saved results and stores of campaigns that were damaged or edited: loaded, shown as pages, gone on with."""

import json
import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import xarray as xr
from helpers import decay as record_of

import sysid_trib as st
from benchmarks.hostile.pieces import ANGLE, TIME, damaged, number, pick, plain, text, words
from sysid_trib.campaigns.conditions import read_conditions
from sysid_trib.reporting.page import page

SCRIPT = "<script>alert(1)</script>"


@cache
def sound_results(folder: Path) -> dict[str, tuple[bytes, xr.DataTree]]:
    """A result of each command of a short record, as a file and as a tree; the first process makes them."""
    kept = folder / "sound"
    if not kept.exists():
        fresh = folder / "fresh"
        fresh.mkdir(exist_ok=True)
        for name, tree in _made_results().items():
            st.save(tree, fresh / f"{name}.nc")
        fresh.rename(kept)
    found = {}
    for place in sorted(kept.iterdir()):
        shutil.copy(place, folder)
        found[place.stem] = (place.read_bytes(), st.load(place))
    return found


def _made_results() -> dict[str, xr.DataTree]:
    decay = st.free_decay(record_of(TIME, ANGLE, 0, units="rad").assign_attrs(source="a"))
    forces = st.load_library().select(["zeta", "delta"])
    averaging = st.identify(decay, forces, st.methods.Averaging())
    direct = st.identify(decay, forces, st.methods.Direct())
    return {
        "identify": xr.DataTree(direct),
        "cross_check": st.cross_check(decay, averaging, direct),
        "compare": st.compare(decay, forces, [st.methods.Averaging(), st.methods.Direct()]),
        "discover": st.discover(decay, forces.select(["zeta"]), forces, max_effects=1),
    }


def _attribute(random: np.random.Generator) -> object:
    texts = ("", SCRIPT, "{}", "[", '{"a": 1}', plain(text(random)))
    return pick(random, (0, -1, 2**62, np.nan, [], ["a", "b"], np.arange(3), *texts))


def edited(tree: xr.DataTree, random: np.random.Generator) -> xr.DataTree:
    """A result with parts left out, exchanged or replaced."""
    groups = {node.path: node.to_dataset(inherit=False) for node in tree.subtree}
    for _ in range(int(random.integers(1, 4))):
        path = str(pick(random, tuple(groups)))
        data = groups[path]
        name = pick(random, (*data.variables, "coefficient"))
        kind = int(random.integers(10))
        if kind == 0 and name in data.variables:
            data = data.drop_vars(name)
        elif kind == 1 and len(groups) > 1 and path != "/":
            del groups[path]
            continue
        elif kind == 2 and data.sizes:
            data = data.isel({pick(random, tuple(data.sizes)): slice(0, int(random.integers(0, 2)))})
        elif kind == 3 and name in data.data_vars:
            values = np.full(data[name].shape, number(random))
            data = data.assign({name: (data[name].dims, values, data[name].attrs)})
        elif kind == 4 and name in data.data_vars:
            data = data.assign({name: (data[name].dims, np.full(data[name].shape, SCRIPT))})
        elif kind == 5 and name in data.data_vars:
            data = data.assign({name: ((), _attribute(random) if random.random() < 0.1 else 1.0)})
        elif kind == 6 and name in data.variables:
            data = data.rename({name: f"{name}_"})
        elif kind < 9 and data.attrs:
            data = data.assign_attrs({pick(random, tuple(data.attrs)): _attribute(random)})
        elif data.attrs:
            chosen = pick(random, tuple(data.attrs))
            data = data.drop_attrs(deep=False).assign_attrs(
                {k: v for k, v in data.attrs.items() if k != chosen}
            )
        groups[path] = data
    return xr.DataTree.from_dict({path: groups[path] for path in sorted(groups)})


def damaged_case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A result with some bytes changed."""
    content, _ = sound_results(folder)[str(pick(random, ("identify", "cross_check", "compare", "discover")))]
    place = folder / "damaged.nc"
    place.write_bytes(damaged(content, random))
    return lambda: st.load(place)


def page_case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """The page of a result that was edited."""
    _, tree = sound_results(folder)[str(pick(random, ("cross_check", "compare", "discover", "identify")))]
    while True:
        try:
            changed = edited(tree, random)
            break
        # Some edits no dataset can hold.
        except (ValueError, KeyError, TypeError):
            continue

    def action() -> None:
        place = folder / "edited.nc"
        try:
            content = changed.to_netcdf(engine="h5netcdf")
        except Exception:
            # What netCDF cannot hold is no file.
            return
        place.write_bytes(bytes(content))
        assert SCRIPT not in page(st.load(place)), "a script of the result"

    return action


TASK = st.campaigns.Task("identify", st.load_library().select(["zeta"]), {"direct": st.methods.Direct()})
KEYS = words("chunks compressor dtype fill_value filters order shape zarr_format")
PICKLE = {"id": "pickle"}
VALUES = (0, -1, 1, 10**10, [0], [10**10], [2, 2], None, "|O", "<f8", "<U9", PICKLE, [PICKLE], "NaN")
RECORDS = 3


@cache
def _sound_store(folder: Path) -> tuple[list[Path], Path]:
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


def store_case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A damaged store, opened, or gone on with; or a table of conditions."""
    records, base = _sound_store(folder)
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
