"""Binary files: sound ones, damaged ones, and ones that their formats allow but nobody would write."""

import contextlib
import io
import json
import os
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import pandas as pd
import scipy.io
from command_line import write_table
from helpers import decay

import sysid_trib as st
from benchmarks.hostile.pieces import ANGLE, SECRET, TIME, damaged, number, pick, plain, text, words
from benchmarks.hostile.tables import options

ENDINGS = (".csv", ".h5", ".nc", ".cdf", ".mat", ".xlsx", ".parquet", ".tdms", ".npy", ".npz", ".json")
SECRET_FILE, SECRET_RAW = "secret.h5", "secret.raw"
ENTITIES = (
    '<?xml version="1.0"?><!DOCTYPE x [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY {chr(98 + at)} "{f"&{chr(97 + at)};" * 10}">' for at in range(9))
    + '<!ENTITY file SYSTEM "file:///etc/passwd">]><x>&j;&file;</x>'
)
ATTRIBUTES = words("units DIMENSION_LIST CLASS NAME _Netcdf4Dimid _FillValue scale_factor MATLAB_class")
H5_TYPES = ("f8", "f8", "f4", "f2", ">f8", "i8", "u1", "bool", "S10", "c16", "V4", [("a", "f8"), ("b", "S3")])


def sound_files(folder: Path) -> dict[str, Path]:
    """A sound record of every format, by its ending; without those whose packages are not installed."""
    places = {ending: folder / f"sound{ending}" for ending in ENDINGS}
    write_table(places[".csv"], "time (s),angle (rad)", TIME, ANGLE)
    with h5py.File(places[".h5"], "w") as file:
        file["time"], file["angle"] = TIME, ANGLE
        file["angle"].attrs["units"] = "rad"
    st.save(st.free_decay(st.records.paper_twin().isel(time=slice(0, 400))).drop_attrs(), places[".nc"])
    record = decay(TIME, ANGLE, units="rad")
    record.to_netcdf(places[".cdf"], engine="scipy")
    scipy.io.savemat(places[".mat"], {"run": {"time": TIME, "angle": ANGLE}}, do_compression=True)
    np.save(places[".npy"], np.c_[TIME, ANGLE])
    np.savez_compressed(places[".npz"], t=TIME, angle=ANGLE)
    places[".json"].write_text(json.dumps({"run": {"t": TIME.tolist(), "angle": ANGLE.tolist()}}))
    book = openpyxl.Workbook()
    for row in zip(TIME.tolist(), ANGLE.tolist(), strict=True):
        book.active.append(row)
    book.save(places[".xlsx"])
    try:
        record.to_dataframe().reset_index().to_parquet(places[".parquet"])
    except ImportError:
        del places[".parquet"]
    try:
        from nptdms import ChannelObject, TdmsWriter
    except ImportError:
        del places[".tdms"]
    else:
        with TdmsWriter(places[".tdms"]) as writer:
            rate = {"wf_increment": 0.01, "wf_start_offset": 0.0, "unit_string": "rad"}
            writer.write_segment([ChannelObject("run", "angle", ANGLE, properties=rate)])
    return places


@cache
def _sound(folder: Path) -> dict[str, bytes]:
    """Their contents, and the files that hostile ones point to."""
    for place, factor in ((SECRET_FILE, SECRET), (SECRET_RAW, SECRET)):
        angle = factor * ANGLE / ANGLE[0]
        if place.endswith("h5"):
            with h5py.File(folder / place, "w") as file:
                file["angle"] = angle
        else:
            (folder / place).write_bytes(angle.tobytes())
    contents = {ending: place.read_bytes() for ending, place in sound_files(folder).items()}
    scipy.io.savemat(folder / "plain.mat", {"time": TIME, "angle": ANGLE})
    return contents | {".plain.mat": (folder / "plain.mat").read_bytes()}


def _array(random: np.random.Generator) -> np.ndarray:
    """Numbers or texts of any type and form."""
    shape = pick(random, ((), (0,), (1,), (400,), (400,), (400,), (400, 2), (2, 400), (3, 4, 5), (0, 3)))
    kind = pick(random, H5_TYPES)
    values = np.resize(ANGLE if random.random() < 0.5 else TIME, shape)
    if random.random() < 0.2:
        values = values * number(random)
    with np.errstate(all="ignore"):
        if isinstance(kind, list):
            return np.zeros(shape, dtype=kind)
        return values.astype("S4").astype("V4") if kind == "V4" else values.astype(kind)


def _hdf5_item(group: h5py.Group, name: str, random: np.random.Generator, folder: Path) -> None:
    secret = str(pick(random, (SECRET_FILE, folder / SECRET_FILE, f"../{folder.name}/{SECRET_FILE}")))
    raw = [(str(pick(random, (SECRET_RAW, folder / SECRET_RAW))), 0, h5py.h5f.UNLIMITED)]
    vast = int(pick(random, (2**20, 2**27, 2**33, 2**40)))
    layout = h5py.VirtualLayout(shape=ANGLE.shape, dtype="f8")
    layout[:] = h5py.VirtualSource(secret, "angle", shape=ANGLE.shape)
    references = np.array([group.ref, group.file.ref] * 2, dtype=h5py.ref_dtype)
    packed = {"chunks": (1024,), "compression": "gzip", "fillvalue": 1.0}
    kinds = (
        lambda: group.__setitem__(name, h5py.ExternalLink(secret, "/angle")),
        lambda: group.create_virtual_dataset(name, layout),
        lambda: group.create_dataset(name, shape=ANGLE.shape, dtype="f8", external=raw),
        lambda: group.__setitem__(
            name, h5py.SoftLink(str(pick(random, ("/", "..", "/none", name, "/time"))))
        ),
        lambda: group.__setitem__(name, group.file if random.random() < 0.5 else group),
        lambda: group.__setitem__(name, np.dtype("f8")),
        lambda: group.__setitem__(name, h5py.Empty("f8")),
        lambda: group.create_dataset(name, shape=(vast,), dtype="f8", **packed),
        lambda: group.create_dataset(name, data=references, dtype=h5py.ref_dtype),
        lambda: group.create_dataset(name, data=["a", "b" * 1000], dtype=h5py.string_dtype()),
        lambda: _hdf5_items(group.create_group(name), random, folder),
        *[lambda: group.__setitem__(name, _array(random))] * 5,
    )
    kinds[random.integers(len(kinds))]()
    if random.random() < 0.3 and isinstance(group.get(name, getlink=True), h5py.HardLink):
        many, texts = np.array(["rad", "s"], dtype="S3"), plain(text(random)).replace("\0", "")
        key = str(pick(random, ATTRIBUTES))
        group[name].attrs[key] = pick(random, ("rad", b"rad", 3.0, many, h5py.Empty("f8"), texts))


def _hdf5_items(group: h5py.Group, random: np.random.Generator, folder: Path) -> None:
    for at in range(int(random.integers(1, 4))):
        _hdf5_item(group, f"i{at}", random, folder)


def hdf5(random: np.random.Generator, folder: Path) -> bytes:
    """A tree of groups, links and datasets of any kind."""
    place = folder / "made.h5"
    place.unlink(missing_ok=True)
    with h5py.File(place, "w", userblock_size=512 if random.random() < 0.1 else 0) as file:
        if random.random() < 0.7:
            file["time"] = TIME
        if random.random() < 0.4:
            file["angle"] = ANGLE
        for _ in range(int(random.integers(1, 5))):
            name = pick(
                random, (*words("angle x time z g/h #refs# 😀"), plain(text(random)).replace("\0", ""))
            )
            # Names that are taken, or none, are the format's own business.
            if str(name).strip("/. ") and str(name) not in file:
                # What HDF5 does not write reaches nobody.
                with contextlib.suppress(OSError):
                    _hdf5_item(file, str(name), random, folder)
    return place.read_bytes()


def matlab(random: np.random.Generator) -> bytes:
    """Structs in cells in structs."""

    def content(depth: int) -> object:
        kind = random.integers(8)
        if kind == 0 and depth < 4:
            return {f"f{at}": content(depth + 1) for at in range(random.integers(1, 4))}
        if kind == 1 and depth < 4:
            cells = np.empty(int(random.integers(0, 4)), dtype=object)
            cells[:] = [content(depth + 1) for _ in cells]
            return cells
        if kind == 2:
            return plain(text(random)).replace("\0", "")[:200]
        if kind == 3:
            return scipy.sparse.eye(5).tocsc()
        if kind < 7:
            return TIME if kind == 4 else ANGLE
        return _array(random).astype(complex, casting="unsafe") if random.random() < 0.5 else ANGLE[:3]

    whole = io.BytesIO()
    with np.errstate(all="ignore"):
        try:
            variables = {f"v{at}": content(0) for at in range(random.integers(1, 4))}
            scipy.io.savemat(whole, variables, do_compression=bool(random.integers(2)))
        except (TypeError, ValueError):
            return b"MATLAB 5.0"
    return whole.getvalue()


def excel(random: np.random.Generator, sound: bytes) -> bytes:
    """A workbook whose parts are damaged, swollen or not what they say."""
    with zipfile.ZipFile(io.BytesIO(sound)) as book:
        parts = {name: book.read(name) for name in book.namelist()}
    name = str(pick(random, tuple(parts)))
    kind = random.integers(7)
    if kind < 3:
        parts[name] = damaged(parts[name], random)
    elif kind == 3:
        parts[name] = ENTITIES.encode()
    elif kind == 4:
        sheet, cell = "xl/worksheets/sheet1.xml", pick(random, words("XFD1048576 A1048576 ZZZZ9 A0 😀 A-1"))
        parts[sheet] = parts[sheet].replace(b'r="A7"', f'r="{cell}"'.encode())
    elif kind == 5:
        parts[f"../{name}"] = parts[name] + b" " * 2**26
    else:
        del parts[name]
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as book:
        for inner, content in parts.items():
            entry = zipfile.ZipInfo(inner)
            # A link, as far as an archive can say so.
            entry.external_attr = 0o120777 << 16 if random.random() < 0.05 else 0
            entry.compress_type = zipfile.ZIP_DEFLATED
            book.writestr(entry, content)
    return whole.getvalue()


def parquet(random: np.random.Generator) -> bytes:
    """A table of columns of any type."""
    rows = int(pick(random, (0, 1, 400)))
    kinds = (
        *(TIME[:rows], ANGLE[:rows], [[1.0]] * rows, [{"a": 1}] * rows, [None] * rows, np.ones(rows, bool)),
        *(np.arange(rows).astype(kind) for kind in ("M8[ns]", "m8[us]")),
        *(pd.Categorical(["a"] * rows), [text(random).encode("utf-8", "replace") for _ in range(rows)]),
    )
    count, whole = int(random.integers(0, 5)), io.BytesIO()
    names = [plain(text(random)) if random.random() < 0.3 else f"c{at}" for at in range(count)]
    chosen = {name: kinds[int(random.integers(len(kinds)))] for name in names}
    pd.DataFrame(chosen).to_parquet(whole)
    return whole.getvalue()


def case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A binary file, read as a record, or as a result."""
    sounds = _sound(folder)
    ending = str(pick(random, tuple(sounds)))
    content, made = sounds[ending], random.random() < 0.5
    if made and ending == ".xlsx":
        content = excel(random, content)
    elif made and ending in (".h5", ".nc"):
        content = hdf5(random, folder)
    elif made and ending.endswith(".mat"):
        content = matlab(random)
    elif made and ending == ".parquet":
        content = parquet(random)
    if not made or random.random() < 0.2:
        content = damaged(content, random)
    place = folder / f"any{Path(ending).suffix or ending}"
    if place.is_symlink() or place.exists():
        os.unlink(place)
    place.write_bytes(content)
    how = options(random) if random.random() < 0.3 else {}

    def action() -> None:
        if ending in (".nc", ".h5") and len(content) % 2:
            values = [item.values for node in st.load(place).subtree for item in node.data_vars.values()]
        else:
            values = [st.read_record(place, **how).angle.values]
        for numbers in values:
            leaked = numbers.dtype.kind == "f" and np.any(np.isclose(numbers, SECRET, rtol=1e-6))
            assert not leaked, "numbers of another file"

    return action
