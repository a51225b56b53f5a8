"""Exact motion of a model: switchings, sticking and memory at their true times."""

from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.errors import SimulationError, UsageError
from sysid_trib.forces.force import Force
from sysid_trib.simulation.equations import Vector
from sysid_trib.simulation.integrate import DivergenceError, Engine, NormalisedMotion, integrate
from sysid_trib.simulation.model import Model

FAST = "fast"
# Kicks a period of a motion that is pushed at random: their law is then right to a percent.
KICKS_PER_PERIOD = 40


@dataclass(frozen=True)
class SimulatedMotion:
    """A motion at the times asked for.

    Attributes
    ----------
    angle : (sample,) array of float, rad
        As measured, with the sensor terms of the model.
    position, rate : (sample,) array of float, rad and rad/s
        The true motion.
    stop_time : float, s
        NaN if the motion goes on.
    reversals : array of float, s
        Exact times of v = 0, known where a force switches there.
    hidden : dict of str to (sample,) array of float
        States and memory of forces, as `dahl.z`.
    engine : str
        What integrated it.
    """

    angle: Vector
    position: Vector
    rate: Vector
    stop_time: float
    reversals: Vector
    hidden: dict[str, Vector]
    engine: str


def simulate(
    model: Model,
    time: ArrayLike,
    angle: float = 0.3,
    rate: float = 0.0,
    *,
    engine: str | None = None,
    tolerance: float = 1e-12,
    random_force: float = 0.0,
    seed: int = 0,
) -> xr.Dataset:
    """Simulate the free motion of a model, pushed at random where that is asked for.

    Parameters
    ----------
    model : Model
        Forces, coefficients and reference frequency.
    time : (time,) array of float, s
        Increasing, not necessarily evenly spaced; `t` in a formula counts from the first.
    angle, rate : float, rad and rad/s
        Angle and its derivative at time[0].
    engine : str, optional
        `heyoka`, `scipy`, or None for the best that is installed, and the other if that fails.
    tolerance : float
        Relative tolerance of scipy; heyoka always goes to 1e-13.
    random_force : float, (rad/s^2)^2/Hz
        One-sided density of a white acceleration in the motion.
    seed : int
        Of the random force.

    Returns
    -------
    Dataset
        `angle(time)` in rad as measured (with the sensor terms of the model), the true `rate(time)` in rad/s,
        `stop_time` in s (NaN if the motion does not stop), and states and memory of forces (`dahl.z(time)`).

    Raises
    ------
    SimulationError
        The motion diverges or switches without end, or the times do not increase.
    UsageError
        The density is negative or not finite.
    """
    time = np.asarray(time, dtype=float)
    if not (np.isfinite(random_force) and random_force >= 0.0):
        raise UsageError(f"random_force={random_force} is no density; give (rad/s^2)^2/Hz, zero or more.")
    if not all(model.coefficients.values()):
        model = model.with_coefficients({k: c for k, c in model.coefficients.items() if c != 0.0})
    if random_force:
        motion = pushed_trajectory(model, time, (angle, rate), random_force, seed)
    else:
        motion = trajectory(model, time, angle, rate, engine=engine, tolerance=tolerance)
    data: dict[str, Any] = {
        "angle": ("time", motion.angle, {"units": "rad", "long_name": "angle"}),
        "rate": ("time", motion.rate, {"units": "rad/s", "long_name": "angular rate"}),
        "stop_time": ((), motion.stop_time, {"units": "s", "long_name": "time at which the motion stops"}),
    }
    for name, values in motion.hidden.items():
        data[name] = ("time", values, {"units": "1", "long_name": f"{name}, state or memory of a force"})
    data["time"] = ("time", time, {"units": "s", "long_name": "time"})
    return xr.Dataset(data, attrs={"engine": motion.engine})


def trajectory(
    model: Model,
    time: Vector,
    angle: float = 0.3,
    rate: float = 0.0,
    *,
    engine: str | None = None,
    tolerance: float = 1e-12,
) -> SimulatedMotion:
    """Simulate without labels, the fast way for repeated use (see `simulate`).

    Parameters
    ----------
    model, time, angle, rate, tolerance
        See `simulate`.
    engine : str, optional
        Also `FAST`: the best that is installed, and no other if that fails, which may take a thousand times
        longer (a stiff state).

    Returns
    -------
    SimulatedMotion

    Notes
    -----
    The equations are compiled once per set of forces; coefficients, shapes and frequency are free. Forces
    with coefficient zero stay in: their states and memory follow the motion.
    """
    if time.ndim != 1 or not len(time) or not np.all(np.isfinite(time)) or np.any(np.diff(time) <= 0.0):
        raise SimulationError(
            "The times of a simulation must be finite and increase; sort them, drop repeats."
        )
    if not (np.isfinite(angle) and np.isfinite(rate)):
        raise SimulationError(f"A motion cannot start from angle {angle} rad and rate {rate} rad/s.")
    w, start = model.reference_frequency, float(time[0])
    grid = w * (time - start)
    path, name = _path(model, grid, (angle, rate / w), engine, tolerance)
    x, v = path.y[:, 0], path.y[:, 1]
    measured = x.copy()
    for sensor in model.sensors:
        measured += model.coefficients[sensor.symbol] * sensor.value(x, v, time - start, shapes=model.shapes)
    stop, reversals = start + path.stop / w, start + path.reversals / w
    return SimulatedMotion(measured, x, w * v, stop, reversals, path.hidden, name)


def pushed_trajectory(
    model: Model, time: Vector, start: tuple[float, float], random_force: float, seed: int
) -> SimulatedMotion:
    """Motion of a model that is pushed at random: exact between kicks, at least `KICKS_PER_PERIOD` a period.

    Parameters
    ----------
    model : Model
    time : (sample,) array of float, s
    start : (float, float), rad and rad/s
        Angle and rate at time[0].
    random_force : float, (rad/s^2)^2/Hz
        One-sided density of the acceleration.
    seed : int

    Returns
    -------
    SimulatedMotion
        The next kick moves a body that friction holds: it never stops for good.

    Notes
    -----
    Over an interval h of tau a white acceleration adds to (x, v) a Gaussian vector of covariance
    per_tau [[h^3/3, h^2/2], [h^2/2, h]] to lowest order in h; per_tau = density/(2 w^3).
    """
    w = model.reference_frequency
    if time.ndim != 1 or len(time) < 2 or not np.all(np.isfinite(time)) or np.any(np.diff(time) <= 0.0):
        raise SimulationError("A motion that is pushed at random wants two or more times that increase.")
    tau = w * (time - time[0])
    parts = np.maximum(1, np.ceil(np.diff(tau) * KICKS_PER_PERIOD / (2.0 * np.pi))).astype(int)
    instants = np.concatenate(
        [[0.0], tau[:-1].repeat(parts) + _fractions(parts) * np.diff(tau).repeat(parts)]
    )
    compiled = _engine("heyoka" if _has_heyoka() else "scipy", model.forces, 1e-12)
    y, p = compiled.motion.start(model, start[0], start[1] / w)
    h = np.diff(instants)
    # A stream of its own: noise that is added with the same seed is independent of it.
    random = np.random.default_rng([seed, 1]).standard_normal((2, len(h)))
    kick_v = np.sqrt(0.5 * random_force / w**3 * h) * random[0]
    # Of the variance h^3/3 of x three quarters are by what v gains, a quarter is its own.
    kick_x = 0.5 * h * kick_v + np.sqrt(0.5 * random_force / w**3 * h**3 / 12.0) * random[1]
    rows, paths = [y], []
    with compiled.lock:
        for at in range(len(h)):
            path = integrate(compiled, y, p, instants[at : at + 2])
            y = path.y[-1].copy()
            y[:2] += kick_x[at], kick_v[at]
            rows.append(y)
            paths.append(path)
    samples = np.concatenate([[0], np.cumsum(parts)])
    states = np.array(rows)[samples]
    hidden = {
        name: np.array([q.hidden[name][-1] for q in (paths[0], *paths)])[samples] for name in paths[0].hidden
    }
    x, v = states[:, 0], states[:, 1]
    measured = x.copy()
    for sensor in model.sensors:
        measured += model.coefficients[sensor.symbol] * sensor.value(
            x, v, time - time[0], shapes=model.shapes
        )
    engine = "heyoka" if _has_heyoka() else "scipy"
    return SimulatedMotion(measured, x, w * v, float("nan"), np.empty(0), hidden, engine)


def _fractions(parts: np.ndarray) -> Vector:
    """Where in its interval each kick is, as a part of it, one interval after the other."""
    return np.concatenate([np.arange(1, count + 1) / count for count in parts])


def _path(
    model: Model, grid: Vector, at: tuple[float, float], engine: str | None, tolerance: float
) -> tuple[NormalisedMotion, str]:
    choice: tuple[str, ...] = ("heyoka", "scipy") if _has_heyoka() else ("scipy",)
    if engine:
        choice = choice[:1] if engine == FAST else (engine,)
    for name in choice:
        compiled = _engine(name, model.forces, tolerance)
        y, p = compiled.motion.start(model, *at)
        try:
            with compiled.lock:
                return integrate(compiled, y, p, grid), name
        except SimulationError as error:
            if isinstance(error, DivergenceError) or name == choice[-1]:
                raise
    raise AssertionError


def _engine(name: str, forces: tuple[Force, ...], tolerance: float) -> Engine:
    if name == "scipy":
        from sysid_trib.simulation.engine_scipy import interpreted

        return interpreted(forces, tolerance)
    if name != "heyoka" or not _has_heyoka():
        raise UsageError(f"There is no engine '{name}' here; take scipy, or heyoka where it is installed.")
    from sysid_trib.simulation.engine_heyoka import compiled

    return compiled(forces)


@cache
def _has_heyoka() -> bool:
    return find_spec("heyoka") is not None
