"""Internal states and memory of a force along a motion that is given, by the compiled engine.

The force itself does not act: what pushes the engine's body is what leads it along the given path.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.errors import LibraryError, SimulationError
from sysid_trib.forces.force import Force, ForceLibrary, ShapeValues
from sysid_trib.forces.formulas import parse
from sysid_trib.simulation.integrate import NormalisedMotion, integrate
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.pushes import UNPUSHED, Pushes

NO_FORCE = parse("0", frozenset(), frozenset(), "no force")
# rad/s; at such a frequency `t` stands still, whatever the length of the motion.
FROZEN = 1e300


def watched(force: Force, shapes: ShapeValues | None, frequency: float) -> Model:
    """A model in which a force has its history and does not act; `t` counts tau over this frequency."""
    idle = replace(force, formula=NO_FORCE, kind="force")
    values = {f"{force.symbol}.{k}": value for k, value in force.shape_values(shapes).items()}
    return Model(ForceLibrary("watched", (idle,)), {force.symbol: 0.0}, frequency, values)


def begun_with(force: Force, values: Mapping[str, float]) -> Force:
    """A force that begins with these states and memory."""
    nothing = frozenset[str]()
    starts = {name: parse(repr(value), nothing, nothing, force.symbol) for name, value in values.items()}
    return replace(force, start=starts)


def leading(tau: Array, x: Array, v: Array) -> Pushes:
    """What leads a body without forces along the cubics through angles and rates (Hermite), from tau = 0."""
    h, rise = np.diff(tau), np.diff(x)
    square = (3.0 * rise / h - 2.0 * v[:-1] - v[1:]) / h
    cube = (v[:-1] + v[1:] - 2.0 * rise / h) / h**2
    # x'' + x of each cubic.
    push = np.stack([x[:-1] + 2.0 * square, v[:-1] + 6.0 * cube, square, cube], axis=1)
    return Pushes(tau[:-1] - tau[0], push[:, None], np.zeros((len(h), 2)), pushed=True)


def history_along(
    force: Force, tau: Array, x: Array, v: Array, shapes: ShapeValues | None, elapsed: Array
) -> dict[str, Array]:
    """States and memory of a force along a given motion.

    Parameters
    ----------
    force : Force
        One that depends on history; its `t` counts from the first sample.
    tau : (sample,) array of float
        w t, increasing.
    x, v : (sample,) array of float, rad
        Angle and dx/dtau; between samples a cubic.
    shapes : mapping of str to float, optional
        Shape parameters, `{"dahl.s": 0.02}`.
    elapsed : (sample,) array of float, s
        The `t` of formulas, in proportion to tau from the first sample on, or at rest.

    Returns
    -------
    dict of str to (sample,) array
        By their names in the force.

    Raises
    ------
    LibraryError
        They are not finite along this motion, or cannot be followed.
    """
    span = float(elapsed[-1] - elapsed[0])
    frequency = float(tau[-1] - tau[0]) / span if span > 0.0 else FROZEN
    model = watched(force, shapes, frequency)
    return _of(force, model, tau - tau[0], (float(x[0]), float(v[0])), leading(tau, x, v))


def history_on_cycle(force: Force, phase: Array, a: float, shapes: ShapeValues | None) -> dict[str, Array]:
    """The same along x = a cos phi, v = -a sin phi, (phase,) in order, with `t` at rest."""
    start = a * float(np.cos(phase[0])), -a * float(np.sin(phase[0]))
    return _of(force, watched(force, shapes, FROZEN), phase - phase[0], start, UNPUSHED)


def _of(
    force: Force, model: Model, grid: Array, start: tuple[float, float], pushes: Pushes
) -> dict[str, Array]:
    try:
        motion: NormalisedMotion = integrate(model, grid, start, pushes=pushes)
    except SimulationError:
        raise LibraryError(
            f"Force '{force.symbol}': its states could not be followed along the motion."
        ) from None
    if not all(np.all(np.isfinite(values)) for values in motion.hidden.values()):
        raise LibraryError(f"Force '{force.symbol}': its states or memory are not finite along the motion.")
    return {name.removeprefix(f"{force.symbol}."): values for name, values in motion.hidden.items()}
