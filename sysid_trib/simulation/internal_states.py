"""Internal states of history-dependent forces along a given motion, a record's or a model's.

To rounding by the compiled engine; for many values of the shape parameters by steps from sample to sample.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, CubicSpline, PPoly
from scipy.ndimage import uniform_filter1d

from sysid_trib.arrays import Array, Index
from sysid_trib.errors import DecayError, LibraryError, SysidTribError
from sysid_trib.forces.force import Force
from sysid_trib.forces.library import force_counted_from
from sysid_trib.simulation.stepped_states import (
    RADAU_STAGES,
    begun_with,
    history_along,
    is_linear,
    is_stepped,
    stepped_states,
)

# Part by which a motion is larger, of which a force changes to this order.
LARGER = 1e-5


class GivenMotion:
    """A motion made continuous by cubics, and its reversals.

    Parameters
    ----------
    tau : (sample,) array of float
        w t, increasing.
    x, v : (sample,) array of float, rad
        Angle and dx/dtau.
    time : (sample,) array of float, s
        The `t` of formulas.
    """

    def __init__(self, tau: Array, x: Array, v: Array, time: Array) -> None:
        self.tau, self.time = tau, time
        self.x, self.v = CubicHermiteSpline(tau, x, v), CubicSpline(tau, v)
        zeros = np.sort(roots_of(self.v))
        # Not the release itself: there the start values hold. One at a sample is found in both steps.
        self.reversals = zeros[np.diff(zeros, prepend=tau[0]) > 1e-9]
        # What a force with values of its shape parameters was along this motion.
        self.followed: dict[tuple[Force, tuple[float, ...]], Array] = {}

    @cached_property
    def larger(self) -> "GivenMotion":
        """A motion larger by the part `LARGER`, of the same reversals."""
        larger, factor = copy(self), 1.0 + LARGER
        larger.x, larger.v = (PPoly(factor * spline.c, spline.x) for spline in (self.x, self.v))
        larger.at_samples = self.at_samples | {k: factor * self.at_samples[k] for k in "xv"}
        larger.at_stages = self.at_stages | {k: factor * self.at_stages[k] for k in "xv"}
        larger.followed = {}
        return larger

    def names(self, tau: Array) -> dict[str, Any]:
        """Variables of the formulas that the motion gives."""
        return {"x": self.x(tau), "v": self.v(tau), "t": np.interp(tau, self.tau, self.time)}

    @cached_property
    def at_samples(self) -> dict[str, Any]:
        """Variables at the samples, (sample,)."""
        return self.names(self.tau)

    @cached_property
    def at_stages(self) -> dict[str, Any]:
        """Variables at the stages of steps from sample to sample, (stage, step)."""
        return self.names(self.tau[:-1] + np.outer(RADAU_STAGES, np.diff(self.tau)))

    def segment(self, tau: Array) -> Index:
        """Number of reversals before each instant."""
        return np.searchsorted(self.reversals, tau)


def roots_of(spline: PPoly) -> Array:
    """Zeros of a continuous spline of cubics, (zero,), between its ends.

    Looked for where the spline's Bernstein coefficients, between which it lies, differ in sign: in one step
    of dozens, where a motion is followed closely.
    """
    length = np.diff(spline.x)
    cubic, square, slope, value = spline.c * length ** np.arange(3, -1, -1)[:, None]
    bounds = [value, value + slope / 3.0, value + (2.0 * slope + square) / 3.0]
    bounds.append(value + slope + square + cubic)
    at = np.flatnonzero((np.min(bounds, axis=0) <= 0.0) & (np.max(bounds, axis=0) >= 0.0))
    # Steps of unit length side by side, between them what has no zero.
    parts = np.zeros((4, 2 * len(at)))
    parts[:, ::2], parts[-1, 1::2] = [cubic[at], square[at], slope[at], value[at]], 1.0
    zeros = PPoly(parts, np.arange(2.0 * len(at) + 1.0)).roots(False, False) if len(at) else np.empty(0)
    zeros = zeros[np.isfinite(zeros)]
    step = np.minimum((zeros // 2.0).astype(int), len(at) - 1)
    return np.asarray(spline.x[at[step]] + (zeros - 2.0 * step) * length[at[step]])


def states_along(
    force: Force,
    tau: ArrayLike,
    x: ArrayLike,
    v: ArrayLike,
    shapes: Mapping[str, float] | None = None,
    *,
    time: ArrayLike = 0.0,
) -> dict[str, Array]:
    """States and memory of a force along a given motion.

    Parameters
    ----------
    force : Force
        One that does not depend on history gives an empty mapping.
    tau : (sample,) array of float
        w t, increasing.
    x, v : (sample,) array of float, rad
        Angle and dx/dtau.
    shapes : mapping of str to float, optional
        Shape parameters, `{"dahl.s": 0.02}`; defaults where left out.
    time : (sample,) array of float, s
        The `t` of formulas, in proportion to tau, or one number.

    Returns
    -------
    dict of str to (sample,) array
        To be given to `Force.value` as `hidden`. The motion is interpolated by cubics; memory is replaced at
        its reversals. The first sample holds the force's `start`, else zero.

    Raises
    ------
    DecayError
        Fewer than four samples, unequal lengths, not finite, or tau not increasing.
    LibraryError
        The states or memory are not finite along this motion, or hold an input.
    """
    if force.memoryless:
        return {}
    if any(channel.name in f.names for channel in force.channels for f in force.formulas[1:]):
        raise LibraryError(
            f"Force '{force.symbol}': its states hold an input, which only methods.Trajectory follows, from "
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
    return history_along(force_counted_from(force, float(elapsed[0])), tau, x, v, shapes, elapsed)


def begun_after(
    force: Force, tau: ArrayLike, x: ArrayLike, v: ArrayLike, shapes: Mapping[str, float], time: ArrayLike
) -> Force:
    """A force that begins with states and memory as they are at the end of a motion (see `states_along`).

    As it was where it has none, or cannot be followed.
    """
    try:
        hidden = states_along(force, tau, x, v, shapes, time=time)
        return begun_with(force, {name: float(values[-1]) for name, values in hidden.items()})
    except SysidTribError:
        return force


def values_along(motion: GivenMotion, force: Force, shapes: Sequence[Mapping[str, float]]) -> Array | None:
    """Values of a history-dependent force along a motion for many values of its shape parameters, fast.

    Parameters
    ----------
    motion : GivenMotion
        Densely sampled: a sample is a step.
    force : Force
        With states or memory.
    shapes : sequence of mapping of str to float
        Values of its shape parameters, as `{"dahl.s": 0.02}`, for each column.

    Returns
    -------
    (sample, column) array of float, or None
        None unless `is_stepped`. A column that cannot be followed is not finite.
    """
    if not is_stepped(force):
        return None
    keys = [(force, tuple(force.shape_values(column).values())) for column in shapes]
    # The columns of a fit are asked for again, those of a screen are too many to keep.
    # Values of the shape parameters of a force that are followed at once and kept with their motion.
    followed = motion.followed if len(shapes) <= 4 else dict(motion.followed)
    missing = [key for key in dict.fromkeys(keys) if key not in followed]
    if missing:
        values = dict(zip(force.shape, np.array([key[1] for key in missing]).T, strict=True))
        with np.errstate(all="ignore"):
            memory = _memory_at_samples(motion, force, values, len(missing))
            # Column by column: what is not finite in one leaves the others alone.
            for i, key in enumerate(missing):
                column, held = ({k: q[i] for k, q in values.items()}, {k: m[:, i] for k, m in memory.items()})
                followed[key] = _stepped_value(motion, force, column, held)
    return np.stack([followed[key] for key in keys]).T


def tangent_along(motion: GivenMotion, force: Force, shapes: Mapping[str, float]) -> tuple[Array, Array]:
    """By how much a history-dependent force changes with the angle and its rate, (sample,) each.

    Parameters
    ----------
    motion : GivenMotion
        Densely sampled.
    force : Force
        Of one that is not `is_stepped` it is zero.
    shapes : mapping of str to float

    Notes
    -----
    Of a motion that is a little larger, or a little ahead of itself, each all along: the two changes of a
    swing that are not forgotten. A state is not what it was at another angle, and so not a spring there.
    What is linear may ring by itself, which is no answer to the motion: then of a period, in the mean.
    """
    x, v, still = motion.at_samples["x"], motion.at_samples["v"], np.zeros_like(motion.tau)
    linear, values = is_linear(force), values_along(motion, force, [shapes])
    # What is linear grows with the motion, and need not be followed along a larger one.
    of_larger = values if linear else values_along(motion.larger, force, [shapes])
    if values is None or of_larger is None:
        return still, still
    here = values[:, 0]
    by_size = here if linear else (of_larger[:, 0] - here) / LARGER
    by_advance = np.gradient(here, motion.tau)
    # Of the first the angle changes by x and the rate by v, of the second by v and -x, w = 1.
    square = x**2 + v**2 + np.finfo(float).tiny
    along, across = x * by_size + v * by_advance, v * by_size - x * by_advance
    if linear:
        period = min(1 + int(2.0 * np.pi / np.median(np.diff(motion.tau))), len(x))
        square, along, across = (
            uniform_filter1d(part, period, mode="nearest") for part in (square, along, across)
        )
    of_x, of_v = along / square, across / square
    return np.nan_to_num(of_x, posinf=0.0, neginf=0.0), np.nan_to_num(of_v, posinf=0.0, neginf=0.0)


def _start_of(motion: GivenMotion, force: Force, shapes: Mapping[str, Any]) -> dict[str, Any]:
    """States and memory of a force at the first sample."""
    return force.start_values({k: value[0] for k, value in motion.at_samples.items()} | dict(shapes))


def _memory_at_samples(
    motion: GivenMotion, force: Force, shapes: Mapping[str, Any], count: int
) -> dict[str, Array]:
    """Memory that depends on no state, (sample, column), for `count` values of the shape parameters."""
    if not force.memory:
        return {}
    rows, segment = motion.reversals.size + 1, motion.segment(motion.tau)
    memory = {k: np.reshape(m, (rows, -1)) for k, m in _memory(motion, force, shapes).items()}
    return {k: np.broadcast_to(m, (rows, count))[segment] for k, m in memory.items()}


def _stepped_value(
    motion: GivenMotion, force: Force, shapes: Mapping[str, Any], memory: Mapping[str, Array]
) -> Array:
    """The force at the samples, its states followed by steps from sample to sample."""
    # A step lies between two reversals but for the one that holds it; there the new memory rules.
    names = motion.at_stages | dict(shapes) | {k: m[1:] for k, m in memory.items()}
    states = stepped_states(force, np.diff(motion.tau), names, _start_of(motion, force, shapes))
    here = motion.at_samples | dict(shapes) | dict(memory) | states
    return np.broadcast_to(force.formula.evaluate(here), motion.tau.shape)


def _memory(motion: GivenMotion, force: Force, shapes: Mapping[str, Any]) -> dict[str, Array]:
    """Memory in each segment of a motion, (segment, ...), for one value of each shape or for many."""
    tau, start = motion.reversals, _start_of(motion, force, shapes)
    given = motion.names(tau) | {"v": np.zeros(tau.size)}
    rows, columns = 1 + tau.size, np.broadcast_shapes(*map(np.shape, shapes.values()))
    given = {k: np.reshape(value, (-1, *[1] * len(columns))) for k, value in given.items()}
    held = {k: np.empty((rows, *columns)) for k in force.memory}
    for k in force.memory:
        held[k][0] = start[k]
    after_held = {k: f for k, f in force.memory.items() if f.names & set(force.memory)}
    used = frozenset[str]().union(*(formula.names for formula in after_held.values()))
    # What is not finite is refused by whoever asks.
    with np.errstate(all="ignore"):
        # What does not depend on what was held is replaced at all reversals at once.
        for k in force.memory.keys() - after_held:
            held[k][1:] = force.memory[k].evaluate(given | dict(shapes))
        series = {k: value for k, value in (given | held).items() if k in used}
        for i in range(tau.size):
            here = {k: value[i] for k, value in series.items()} | dict(shapes)
            for k, formula in after_held.items():
                held[k][i + 1] = formula.evaluate(here)
    return held
