"""Records in memory with numbers of any size, and discoveries in them with random libraries."""

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

FORCES = ("zeta", "lambda,zeta", "zeta,delta", "zeta,nu,epsilon")
METHODS = (
    st.methods.Direct(),
    st.methods.Averaging(),
    st.methods.Trajectory(),
    st.methods.Direct(random_force="estimated"),
)
COUNTS = (0, 1, 2, 3, 10, 50, 200, 400)


# What makes a record none.
CHANGES = (
    lambda data: data.drop_vars("angle"),
    lambda data: data.drop_vars("time"),
    lambda data: data.rename(time="t"),
    lambda data: data.expand_dims("run"),
    lambda data: data.isel(time=slice(0, 0)),
    lambda data: data.isel(time=slice(None, None, -1)),
    lambda data: data.assign(angle=data.angle.astype(complex)),
    lambda data: data.assign(angle=data.angle.astype(str)),
    lambda data: data.assign(angle=data.angle * np.nan),
    lambda data: data.assign(angle=data.angle * 1e90),
    lambda data: data.assign(angle=(data.angle * 0.0).assign_attrs(units="mm")),
)


def dataset(random: np.random.Generator) -> xr.Dataset:
    """A decay, or what nobody would call one."""
    count = int(pick(random, COUNTS)) if random.random() < 0.5 else 400
    time, angle = TIME[:count].copy(), ANGLE[:count] + 1e-4 * random.standard_normal(count)
    time = time * 10.0 ** (random.uniform(-60, 60) * (random.random() < 0.5))
    angle = angle * 10.0 ** (random.uniform(-60, 60) * (random.random() < 0.5))
    angle = angle + number(random) if random.random() < 0.3 else angle
    time = time + number(random) if random.random() < 0.2 else time
    if random.random() < 0.3 and count:
        angle[random.integers(count, size=3)] = number(random)
    if random.random() < 0.15 and count:
        time[random.integers(count, size=2)] = number(random)
    if random.random() < 0.1:
        angle = pick(random, (np.zeros(count), np.ones(count), np.sign(angle), random.standard_normal(count)))
    attrs = {"units": pick(random, ("rad", "rad", "rad", "mm", "", "deg", 3, None, "😀"))}
    data = xr.Dataset(
        {"angle": ("time", np.asarray(angle, dtype=pick(random, (float, float, float, "f4", "i8", object))))},
        {"time": ("time", time, {"units": "s"})},
        {"source": "hostile"},
    )
    data["angle"].attrs = {name: value for name, value in attrs.items() if value is not None}
    return pick(random, CHANGES)(data) if random.random() < 0.25 else data


def case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """The free part of a record, and what a method says of it."""
    data, method = dataset(random), pick(random, METHODS)
    forces = st.load_library().select(str(pick(random, FORCES)).split(","))
    given = (
        {}
        if random.random() < 0.7
        else {"window": (number(random), number(random)), "equilibrium": number(random)}
    )
    kind = random.integers(10)

    def action() -> object:
        if kind == 0:
            return st.identify(data, forces, method)
        if kind == 1:
            return st.records.envelope(data)
        with np.errstate(all="ignore"):
            decay = st.free_decay(data, **given)
        if kind == 2:
            return st.records.envelope(decay)
        return st.identify(decay, forces, method)

    return action


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


def moved_record(random: np.random.Generator, forces: ForceLibrary) -> xr.Dataset:
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


def discover_case(random: np.random.Generator, folder: Path) -> Callable[[], object]:
    """One to three runs, a start model and candidates."""
    shipped = [st.load_library("contact_forces"), st.load_library("candidate_effects")]
    own = _own(random, folder)
    pool = [*shipped, *([own, own] if own is not None else [])]
    model = _some(pool[int(random.integers(len(pool)))], random, 2)
    candidates = _some(pool[int(random.integers(len(pool)))], random, 6)
    moved = _some(pool[int(random.integers(len(pool)))], random, 3)
    count = int(pick(random, (1, 1, 1, 2)))

    def action() -> object:
        runs = [st.free_decay(moved_record(random, moved)) for _ in range(count)]
        tree = st.discover(runs, model, candidates, max_effects=int(random.integers(1, 3)), time_limit=5.0)
        return st.save(tree, folder / "found.nc")

    return action
