"""Hostile input from a seed: damaged files, formulas, libraries, results, and what becomes of them."""

from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import scipy.io

import sysid_trib as st

TIME = 0.01 * np.arange(400)
ANGLE = 0.3 * np.exp(-0.05 * TIME) * np.cos(9.0 * TIME)
TOKENS = (
    "x",
    "v",
    "t",
    "p",
    "sign",
    "abs",
    "exp",
    "sin",
    "(",
    ")",
    "+",
    "-",
    "*",
    "**",
    "/",
    ",",
    ".",
    "9" * 40,
)
TOKENS += (
    "1e400",
    "0",
    "__import__",
    "lambda",
    "²",
    "\x00",
    "😀",
    "[",
    "'",
    "if",
    "==",
    "nan",
    "inf",
    "1",
    "2",
)


def sound_files(folder: Path) -> list[Path]:
    """A sound record of every format that needs no extra."""
    places = {ending: folder / f"sound{ending}" for ending in (".csv", ".h5", ".nc", ".mat", ".xlsx")}
    rows = "\n".join(f"{t:.9g},{a:.9g}" for t, a in zip(TIME, ANGLE, strict=True))
    places[".csv"].write_text(f"time (s),angle (rad)\n{rows}\n", encoding="utf-8")
    with h5py.File(places[".h5"], "w") as file:
        file["time"], file["angle"] = TIME, ANGLE
        file["angle"].attrs["units"] = "rad"
    st.save(st.free_decay(st.paper_twin()).drop_attrs(), places[".nc"])
    scipy.io.savemat(places[".mat"], {"run": {"time": TIME, "angle": ANGLE}})
    book = openpyxl.Workbook()
    for row in zip(TIME.tolist(), ANGLE.tolist(), strict=True):
        book.active.append(row)
    book.save(places[".xlsx"])
    return list(places.values())


def damaged(content: bytes, random: np.random.Generator) -> bytes:
    """Some bytes changed, left out, doubled, or the end cut off."""
    changed = bytearray(content)
    for _ in range(random.integers(1, 8)):
        at = int(random.integers(len(changed))) if changed else 0
        kind = random.integers(4)
        if kind == 0 and changed:
            changed[at] = int(random.integers(256))
        elif kind == 1:
            del changed[at : at + int(random.integers(1, 40))]
        elif kind == 2:
            changed[at:at] = changed[at : at + int(random.integers(1, 40))]
        elif random.random() < 0.2:
            del changed[at:]
    return bytes(changed)


def formula(random: np.random.Generator) -> str:
    """Words and signs of formulas in any order."""
    return "".join(random.choice(TOKENS, size=random.integers(1, 14)))


def library(random: np.random.Generator) -> str:
    """A library with one force of such a formula, and numbers of all kinds."""
    numbers = ("1", "-1", "0", "1e308", "nan", "inf", "9" * 400, "18446744073709551616", '"1"', "true", "[]")
    default, low, high = random.choice(numbers, size=3)
    text = formula(random).replace("\x00", "").replace('"', "")
    return (
        f'title = "T"\n[[force]]\nsymbol = "s"\nname = "n"\nfamily = "damping"\nmeaning = "m"\nsource = "q"\n'
        f"formula = '''{text} '''\n"
        f'shape = {{ p = {{ default = {default}, low = {low}, high = {high}, meaning = "m" }} }}\n'
    )


def record(random: np.random.Generator) -> Callable[[], object]:
    """A decay in memory with numbers of any size, its free part cut and identified."""
    scale, step = 10.0 ** random.uniform(-60, 60), 10.0 ** random.uniform(-60, 60)
    time, angle = step * np.arange(200), scale * ANGLE[:200].copy()
    if random.random() < 0.5:
        angle[random.integers(200, size=3)] = random.choice([np.nan, np.inf, 0.0, -scale])
    data = st.paper_twin().isel(time=slice(0, 200)).assign_coords(time=time).assign(angle=("time", angle))
    forces = st.load_library("contact_forces").select(["lambda", "zeta"])
    return lambda: st.identify(st.free_decay(data), forces, st.methods.Direct())
