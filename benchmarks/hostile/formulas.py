"""Signals that are computed from columns of any names and units: `--angle FORMULA`."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from command_line import write_table

import sysid_trib as st
from benchmarks.hostile.pieces import ANGLE, TIME, formula, number, pick, plain, text

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


def case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
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
