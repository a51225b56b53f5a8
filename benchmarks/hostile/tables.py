"""Records in text: headers, numbers, clocks, delimiters and encodings of any kind; computed signals."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from command_line import write_table

import sysid_trib as st
from benchmarks.hostile.pieces import ANGLE, NUMBERS, TIME, WORDS, damaged, formula, number, pick, plain, text

DELIMITERS = (",", ",", ",", ";", "\t", ";", "\t", " ", "  ", ", ", "|", ",,")
ENCODINGS = ("utf-8", "utf-8", "utf-8-sig", "utf-16", "latin-1", "utf-32")


def table(random: np.random.Generator) -> bytes:
    """A table that is nearly one, or not at all."""
    rows = int(random.integers(0, 300)) if random.random() < 0.3 else 300
    time, angle = TIME[:rows].copy(), ANGLE[:rows].copy()
    if random.random() < 0.2:
        time, angle = time * number(random), angle * number(random)
    if random.random() < 0.2 and rows:
        random.shuffle(time) if random.random() < 0.5 else time.sort()
        time[random.integers(rows, size=3)] = number(random)
    digits = int(pick(random, (9, 9, 12, 17, 17, 1, 4)))
    columns = [[f"{value:.{digits}g}" for value in values] for values in (time, angle)]
    for _ in range(int(random.integers(0, 4)) if random.random() < 0.3 else 0):
        columns.insert(
            int(random.integers(len(columns) + 1)), list(random.choice(columns[0] or ["1"], size=rows))
        )
    if random.random() < 0.1:
        columns = columns[: int(random.integers(1, 3))]
    delimiter, newline = str(pick(random, DELIMITERS)), str(pick(random, ("\n", "\n", "\r\n", "\r")))
    lines = [delimiter.join(row) for row in zip(*columns, strict=True)]
    for _ in range(int(random.integers(0, 4)) if lines and random.random() < 0.4 else 0):
        at = int(random.integers(len(lines)))
        cells = lines[at].split(delimiter)
        cells[int(random.integers(len(cells)))] = (
            str(pick(random, NUMBERS)) if random.random() < 0.7 else text(random)
        )
        lines[at] = delimiter.join(cells)
    head = [delimiter.join(["time (s)", "angle (rad)", *"xyzu"][: len(columns)])]
    if random.random() < 0.4:
        heads = int(random.integers(0, 3))
        head = [delimiter.join(str(pick(random, WORDS)) for _ in columns) for _ in range(heads)]
    notes = [f"# {text(random)}: {pick(random, NUMBERS)} Hz" for _ in range(int(random.integers(0, 3)))]
    notes = notes if random.random() < 0.5 else []
    whole = newline.join([*notes, *head, *lines, *notes[:1]])
    return plain(whole).encode(str(pick(random, ENCODINGS)), "replace")


def options(random: np.random.Generator) -> dict[str, object]:
    """Draw options for reading a file, mostly none."""
    if random.random() < 0.6:
        return {}
    choices = {
        "angle": (0.3, (0, 1, -1, 2**70, *["1", "angle", "²", "x*2", "1/0"], "atan2(x, 0)", text(random))),
        "time": (0.2, (0, 1, 99, "0", "time", text(random))),
        "units": (0.2, (*["rad", "deg", "mm", "px", "g", "rad/s", "deg/s^2", "V"], text(random))),
        "signal": (0.2, (*["angle", "displacement", "rate", "acceleration", "accelerometer"], text(random))),
        "sampling_rate": (0.2, (number(random),)),
        "time_units": (0.1, (*["s", "ms", "us", "min"], text(random))),
        "length": (0.1, (number(random),)),
    }
    return {name: pick(random, of) for name, (often, of) in choices.items() if random.random() < often}


def case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A text file, read and its decay cut out."""
    place = folder / str(pick(random, ("a.csv", "a.txt", "a.dat", "a.mat", "a.nc", "a")))
    content = table(random)
    place.write_bytes(damaged(content, random) if random.random() < 0.3 else content)
    how = options(random)
    return lambda: st.free_decay(st.read_record(place, **how))


# Signals that are computed from columns of any names and units: `--angle FORMULA`.
NAMES = ("x", "X", "v", "t", "a b", "theta", "µ", "sin", "time", "x#1", "", "data.Y[0]", "ω")
UNITS = ("deg", "rad", "mm", "m/s^2", "g", "%", "V_pp", r"$\si{V}$", "", "=1+1", " " * 800)


def _column(random: np.random.Generator) -> str:
    name, unit = (
        str(pick(random, items)) if random.random() < 0.9 else text(random) for items in (NAMES, UNITS)
    )
    return plain(f"{name} ({unit})").replace(",", "").replace("\n", "")


def _asked(random: np.random.Generator) -> str:
    first, second = (formula(random) for _ in range(2))
    formulas = f"-{first}", f"atan2({first}, {second})", f"{number(random):g}*x + {first}", "-x"
    return str(pick(random, (first, *formulas, text(random))))


def formula_case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """A text file with a signal by a formula, or a name."""
    columns = [_column(random) for _ in range(int(random.integers(1, 5)))]
    factors = [number(random) if random.random() < 0.2 else 1.0 for _ in columns]
    header = ",".join(["time (s)", *columns])
    place = write_table(folder / "formula.csv", header, TIME, *(factor * ANGLE for factor in factors))
    how = {
        "angle": _asked(random),
        "units": str(pick(random, ("rad", "mm", "V"))) if random.random() < 0.3 else None,
    }
    return lambda: st.free_decay(st.read_record(place, **how))
