"""Records in memory with numbers of any size, through the public functions."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import xarray as xr

import sysid_trib as st
from hostile.pieces import ANGLE, TIME, number, pick

FORCES = ("zeta", "lambda,zeta", "zeta,delta", "zeta,nu,epsilon")
METHODS = (
    st.methods.Direct(),
    st.methods.Averaging(),
    st.methods.Trajectory(),
    st.methods.Direct(random_force="estimated"),
)
COUNTS = (0, 1, 2, 3, 10, 50, 200, 400)


def dataset(random: np.random.Generator) -> xr.Dataset:
    """A decay, or what nobody would call one."""
    count = int(pick(random, COUNTS)) if random.random() < 0.5 else 400
    time, angle = TIME[:count].copy(), ANGLE[:count] + 1e-4 * random.standard_normal(count)
    if random.random() < 0.5:
        time = time * 10.0 ** random.uniform(-60, 60)
    if random.random() < 0.5:
        angle = angle * 10.0 ** random.uniform(-60, 60)
    if random.random() < 0.3:
        angle = angle + number(random)
    if random.random() < 0.2:
        time = time + number(random)
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
    kind = random.integers(30)
    if kind == 0:
        return data.drop_vars("angle")
    if kind == 1:
        return data.drop_vars("time")
    if kind == 2:
        return data.rename(time="t")
    if kind == 3:
        return data.expand_dims("run")
    if kind == 4:
        return data.assign(angle=data.angle.astype(complex))
    if kind == 5:
        return data.assign(angle=data.angle.astype(str))
    if kind == 6:
        return data.assign_coords(
            time=np.datetime64("2020-01-01") + (1e3 * np.arange(count)).astype("m8[ms]")
        )
    return data


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
