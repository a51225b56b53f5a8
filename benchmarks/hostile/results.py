"""Saved results that were damaged or edited: loaded, and shown as pages."""

import shutil
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import xarray as xr
from helpers import decay as record_of

import sysid_trib as st
from benchmarks.hostile.pieces import ANGLE, TIME, damaged, number, pick, plain, text
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
