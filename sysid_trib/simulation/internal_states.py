"""Internal states of history-dependent forces along a given motion, of a record or a model.

They are exact to rounding, from the compiled engine. The force itself does not act on the motion: an imposed
acceleration moves the body along the given path.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, LibraryError, SimulationError, SysidTribError
from sysid_trib.forces.force import Force, ForceLibrary, ShapeValues
from sysid_trib.forces.formulas import Formula
from sysid_trib.forces.notation import parse
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.motions import Forcing, integrate

NO_FORCE = parse("0", frozenset(), frozenset(), "no force")
# rad/s; with such a frequency `t` is constant, however long the motion is.
FROZEN = 1e300


def watched(force: Force, shapes: ShapeValues | None, frequency: float) -> Model:
    """Return a model in which a force has states but does not act; `t` is tau over a frequency."""
    idle = replace(force, formula=NO_FORCE, kind="force")
    values = {f"{force.symbol}.{k}": value for k, value in force.shape_values(shapes).items()}
    return Model(ForceLibrary("watched", (idle,)), {force.symbol: 0.0}, frequency, values)


def begun_with(force: Force, values: Mapping[str, float]) -> Force:
    """Return a force that starts with these states and memory."""
    nothing = frozenset[str]()
    starts = {name: parse(repr(value), nothing, nothing, force.symbol) for name, value in values.items()}
    return replace(force, start=starts)


def leading(force: Force, tau: Array, x: Array, v: Array) -> Forcing:
    """Return the forcing that moves a free body along Hermite cubics through angles and rates."""
    cube, square, slope, value = CubicHermiteSpline(tau, x, v).c
    forcing = np.zeros((len(tau) - 1, 1 + len(force.channels), 4))
    # x'' + x of each cubic; inputs of the force, which does not act, are zero.
    forcing[:, 0] = np.stack([value + 2.0 * square, slope + 6.0 * cube, square, cube], axis=1)
    return Forcing(tau[:-1] - tau[0], forcing, np.zeros((len(forcing), 2)))


def states_along(
    force: Force,
    tau: ArrayLike,
    x: ArrayLike,
    v: ArrayLike,
    shapes: Mapping[str, float] | None = None,
    *,
    time: ArrayLike = 0.0,
) -> dict[str, Array]:
    """Return the states and memory of a force along a given motion.

    Parameters
    ----------
    force : Force
        A force; for a memoryless one the result is empty.
    tau : (sample,) array of float
        w t, increasing.
    x, v : (sample,) array of float, rad
        Angle and dx/dtau.
    shapes : mapping of str to float, optional
        Shape parameters, `{"dahl.s": 0.02}`; default values for missing ones.
    time : (sample,) array of float, s
        The `t` of formulas, proportional to tau, or one number.

    Returns
    -------
    dict of str to (sample,) array
        States and memory for the argument `hidden` of `Force.value`. Cubics interpolate the motion; memory is
        replaced at its reversals. The first sample has the force's `start`, or zero.

    Raises
    ------
    DecayError
        There are fewer than four samples, the lengths differ, values are not finite, or tau does not
        increase.
    LibraryError
        The states or memory cannot be computed along this motion, are not finite, or contain an input.
    """
    if force.memoryless:
        return {}
    if any(channel.name in f.names for channel in force.channels for f in force.formulas[1:]):
        raise LibraryError(
            f"Force '{force.symbol}': its states contain an input, which only "
            f"methods.Trajectory follows, from "
            "a start= that is given; take that method."
        )
    tau, x, v = (np.asarray(a, dtype=float) for a in (tau, x, v))
    good = tau.ndim == 1 and tau.shape == x.shape == v.shape and tau.size >= 4
    if not (good and np.all(np.isfinite([tau, x, v])) and np.all(np.diff(tau) > 0)):
        raise DecayError(
            f"Force '{force.symbol}' depends on history: give at least four finite samples of tau, x and v, "
            "all of equal length and in order of time."
        )
    elapsed = np.broadcast_to(np.asarray(time, dtype=float), tau.shape)
    force, span = force.counted_from(float(elapsed[0])), float(elapsed[-1] - elapsed[0])
    model = watched(force, shapes, float(tau[-1] - tau[0]) / span if span > 0.0 else FROZEN)
    return _followed(force, model, tau - tau[0], (float(x[0]), float(v[0])), leading(force, tau, x, v))


def begun_after(
    force: Force, tau: ArrayLike, x: ArrayLike, v: ArrayLike, shapes: Mapping[str, float], time: ArrayLike
) -> Force:
    """Return a force that starts with the states and memory at the end of a motion (see `states_along`).

    A force without states, or whose states cannot be computed, is returned unchanged.
    """
    try:
        hidden = states_along(force, tau, x, v, shapes, time=time)
        return begun_with(force, {name: float(values[-1]) for name, values in hidden.items()})
    except SysidTribError:
        return force


def history_on_cycle(force: Force, phase: Array, a: float, shapes: ShapeValues | None) -> dict[str, Array]:
    """Return states along x = a cos phi, v = -a sin phi, for ordered phases (phase,), at constant `t`."""
    start = a * float(np.cos(phase[0])), -a * float(np.sin(phase[0]))
    return _followed(force, watched(force, shapes, FROZEN), phase - phase[0], start, None)


def _followed(
    force: Force, model: Model, grid: Array, start: tuple[float, float], forcing: Forcing | None
) -> dict[str, Array]:
    try:
        motion = integrate(model, grid, start, forcing=forcing)
    except SimulationError:
        raise LibraryError(
            f"Force '{force.symbol}': its states could not be followed along the motion."
        ) from None
    if not all(np.all(np.isfinite(values)) for values in motion.hidden.values()):
        raise LibraryError(f"Force '{force.symbol}': its states or memory are not finite along the motion.")
    return {name.removeprefix(f"{force.symbol}."): values for name, values in motion.hidden.items()}


@lru_cache(maxsize=1024)
def is_stepped(force: Force) -> bool:
    """Return true if the formulas of a force are suitable for `values_along`.

    The memory must not depend on a state. There may be one state, or several with constant coefficients.
    """
    if any(f.names & set(force.state) for f in force.memory.values()):
        return False
    return len(force.state) < 2 or _slopes_are_constant(force, [*force.state.values()], [*force.state])


@lru_cache(maxsize=1024)
def is_linear(force: Force) -> bool:
    """Return true if a force is linear in the motion with constant coefficients."""
    formulas, names = [force.formula, *force.state.values()], ["x", "v", "t", *force.state]
    at_rest = force.test_points | dict.fromkeys(names, 0.0)
    with np.errstate(all="ignore"):
        values = [formula.evaluate(at_rest) for formula in (*formulas, *force.start.values())]
    vanishes = all(np.all(value == 0.0) for value in values)
    return not force.memory and vanishes and _slopes_are_constant(force, formulas, names)


def _slopes_are_constant(force: Force, formulas: Sequence[Formula], names: Sequence[str]) -> bool:
    with np.errstate(all="ignore"):
        slopes = [formula.derivative(force.test_points, name) for formula in formulas for name in names]
    return all(np.allclose(slope, np.ravel(slope)[0], rtol=1e-9, atol=1e-12) for slope in slopes)
