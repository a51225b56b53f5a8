"""Exact motion of a model: switchings, sticking and memory at their true times."""

from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.errors import SimulationError, UsageError
from sysid_trib.forces import Force
from sysid_trib.model import Model
from sysid_trib.motion import Run, Vector
from sysid_trib.sticking import settle


@dataclass(frozen=True)
class Trajectory:
    """Motion on the grid asked for: measured angle (rad), rate (rad/s), and its turning points (s)."""

    angle: Vector
    rate: Vector
    stop_time: float
    turning_times: Vector
    states: dict[str, Vector]
    engine: str


def simulate(
    model: Model,
    time: ArrayLike,
    angle: float = 0.3,
    rate: float = 0.0,
    *,
    engine: str | None = None,
) -> xr.Dataset:
    """Simulate the free motion of a model.

    Parameters
    ----------
    model : forces, coefficients and reference frequency.
    time : increasing times in s; `t` in a formula counts from the first.
    angle, rate : angle (rad) and its derivative (rad/s) at time[0].
    engine : `heyoka`, `scipy`, or None for the best there is.

    Returns
    -------
    Dataset with `angle(time)` in rad as measured (with the model's sensor terms), the true `rate(time)` in
    rad/s, `stop_time` in s (NaN if the motion does not stop), and the states of forces (`dahl.z(time)`).

    Raises
    ------
    SimulationError
        The motion diverges or switches without end.
    """
    time = np.asarray(time, dtype=float)
    acting = {k: c for k, c in model.coefficients.items() if c != 0.0}
    found = trajectory(model.with_coefficients(acting), time, angle, rate, engine=engine)
    marks = {"units": "rad", "long_name": "angle"}
    data: dict[str, Any] = {
        "angle": ("time", found.angle, marks),
        "rate": ("time", found.rate, {"units": "rad/s", "long_name": "angular rate"}),
        "stop_time": ((), found.stop_time, {"units": "s", "long_name": "time at which the motion stops"}),
    }
    for name, values in found.states.items():
        data[name] = ("time", values, {"units": "1", "long_name": f"state {name}"})
    coords = {"time": ("time", time, {"units": "s", "long_name": "time"})}
    return xr.Dataset(data, coords, {"engine": found.engine})


def trajectory(
    model: Model, time: Vector, angle: float = 0.3, rate: float = 0.0, *, engine: str | None = None
) -> Trajectory:
    """Simulate without labels: the fast way for repeated use.

    Forces with coefficient zero are carried along, states and all; the equations are compiled once per set
    of forces, and coefficients, shapes and frequency are free.
    """
    w = model.reference_frequency
    engines = (engine,) if engine else ("heyoka", "scipy") if find_spec("heyoka") else ("scipy",)
    grid = w * (time - time[0])
    failure = ""
    for name in engines:
        try:
            y, stop, run, field = _follow(
                _engine(name, model.forces), model, grid, np.array([angle, rate / w])
            )
            break
        except SimulationError as error:
            failure = str(error)
    else:
        raise SimulationError(failure)
    x = y[:, 0].copy()
    for sensor in model.sensors:
        term = sensor.value(x, y[:, 1], time - time[0], shapes=model.shapes)
        x = x + model.coefficients[sensor.symbol] * term
    turns = _turning_times(run, field.motion) / w + time[0]
    states = dict(zip(field.motion.variables[2:], y.T[2:], strict=True))
    return Trajectory(x, w * y[:, 1], stop / w + time[0], turns, states, name)


def _engine(name: str, forces: tuple[Force, ...]) -> Any:
    if name == "heyoka":
        from sysid_trib.engine_heyoka import compiled

        return compiled(forces)
    if name == "scipy":
        from sysid_trib.engine_scipy import interpreted

        return interpreted(forces)
    raise UsageError(f"There is no engine '{name}'; take heyoka or scipy.")


def _follow(field: Any, model: Model, grid: Vector, at: Vector) -> tuple[Vector, float, Run, Any]:
    motion = field.motion
    rows = np.empty((len(grid), len(motion.variables)))
    y, p = motion.start(np.concatenate([at, np.zeros(len(motion.variables) - 2)]), motion.parameters(model))
    run = Run(p, budget=1000 + int(50 * grid[-1] / (2 * np.pi)))
    rows[0], done, stop = y, 1, np.nan
    run.stuck = not settle(field, y, run.p, 0.0)
    run.note(0.0)
    tau = 0.0
    if not run.stuck and len(grid) > 1:
        found, y, tau = field.glide(run, y, grid)
        rows[done : done + len(found)] = found
        done += len(found)
    if run.failure:
        raise SimulationError(f"The motion {run.failure} at {tau / model.reference_frequency:.4g} s.")
    if run.stuck:
        stop = tau
        y = y.copy()
        y[1] = 0.0
        rows[done:] = y
    return rows, stop, run, field


def _turning_times(run: Run, motion: Any) -> Vector:
    if not motion.reverses:
        return np.empty(0)
    signs = np.array([p[motion.signs_at.start] for p in run.history])
    return np.array(run.times)[1:][np.diff(signs) != 0.0]
