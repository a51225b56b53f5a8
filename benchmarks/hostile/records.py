"""Records in memory with numbers of any size, through the public functions."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

import sysid_trib as st
from benchmarks.hostile.pieces import ANGLE, TIME, number, pick

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
