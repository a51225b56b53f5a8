"""Discovery in random records with random libraries of forces and candidates."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr

import sysid_trib as st
from benchmarks.hostile.libraries import library
from benchmarks.hostile.pieces import ANGLE, TIME, number, pick
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import ForceLibrary


def _own(random: np.random.Generator, folder: Path) -> ForceLibrary | None:
    """Forces that a stranger wrote down; none where they are refused."""
    place = folder / "own.toml"
    for _ in range(20):
        place.write_text(library(random), "utf-8", "replace")
        try:
            return st.load_library(place)
        except SysidTribError:
            continue
    return None


def _some(forces: ForceLibrary, random: np.random.Generator, most: int) -> ForceLibrary:
    count = int(random.integers(1, min(most, len(forces)) + 1))
    chosen = random.choice(len(forces), size=count, replace=False)
    return replace(forces, forces=tuple(forces.forces[at] for at in chosen))


def record(random: np.random.Generator, forces: ForceLibrary) -> xr.Dataset:
    """A few periods of a motion of some of these forces, with noise of any size; or of none."""
    time, angle = TIME, ANGLE
    viscous = st.load_library().select(["zeta"])
    moving = replace(
        forces, forces=(*viscous, *(f for f in forces if f.kind == "force" and f.symbol != "zeta"))
    )
    if random.random() < 0.7:
        coefficients = {s: float(random.normal() * 10.0 ** random.uniform(-5, -1.5)) for s in moving.symbols}
        coefficients["zeta"] = float(10.0 ** random.uniform(-2.5, -1.5))
        start = float(10.0 ** random.uniform(-2, 0.2))
        angle = st.simulate(
            st.Model(moving, coefficients, float(random.uniform(3, 30))), time, start
        ).angle.values
    angle = angle + 10.0 ** random.uniform(-7, -2) * random.standard_normal(len(time))
    if random.random() < 0.1:
        angle = angle * 10.0 ** random.uniform(-12, 3)
    if random.random() < 0.1:
        angle = angle + number(random)
    return xr.Dataset(
        {"angle": ("time", angle, {"units": "rad"})},
        {"time": ("time", time, {"units": "s"})},
        {"source": "hostile"},
    )


def case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """One to three runs, a start model and candidates."""
    shipped = [st.load_library("contact_forces"), st.load_library("candidate_effects")]
    own = _own(random, folder)
    pool = [*shipped, *([own, own] if own is not None else [])]
    model = _some(pool[int(random.integers(len(pool)))], random, 2)
    candidates = _some(pool[int(random.integers(len(pool)))], random, 6)
    moved = _some(pool[int(random.integers(len(pool)))], random, 3)
    count = int(pick(random, (1, 1, 1, 2)))

    def action() -> object:
        runs = [st.free_decay(record(random, moved)) for _ in range(count)]
        tree = st.discover(runs, model, candidates, max_effects=int(random.integers(1, 3)), time_limit=5.0)
        return st.save(tree, folder / "found.nc")

    return action
