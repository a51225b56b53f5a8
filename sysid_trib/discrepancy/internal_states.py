"""What forces remember of a motion that is given: held values from reversal to reversal, states by steps.

A candidate is tried along a model's motion, which it does not change: its states are then driven by known
angles and rates; if their rates are linear in them, so is each step in the last: one triangular system for
each value of the shape parameters.
"""

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dtbtrs

from sysid_trib.forces.force import Force
from sysid_trib.trajectory_fit.sensitivities import Tangent

Array = NDArray[np.float64]

# Radau's method of order 3 (Hairer and Wanner 1996, IV.5): stages at a third and at the end of a step. It is
# stiffly accurate: a state that follows at once is followed.
STAGES = (1.0 / 3.0, 1.0)
WEIGHTS = np.array([[5.0 / 12.0, -1.0 / 12.0], [3.0 / 4.0, 1.0 / 4.0]])


def values_along(about: Tangent, force: Force, shapes: Sequence[Mapping[str, float]]) -> Array | None:
    """Values of a force with a past along a motion, (point, probe); None if they cannot be found so.

    Parameters
    ----------
    shapes : values of its shape parameters for each probe, as `{"dahl.s": 0.02}`.
    """
    if not is_driven(force):
        return None
    given: dict[str, Any] = {
        name: np.array([one[f"{force.symbol}.{name}"] for one in shapes]) for name in force.shape
    }
    begin = {"x": about.x[0], "v": about.v[0], "t": 0.0, **given}
    with np.errstate(all="ignore"):
        first = {
            name: np.broadcast_to(formula.evaluate(begin), len(shapes))
            for name, formula in force.start.items()
        }
        zero = np.zeros(len(shapes))
        start = {name: first.get(name, zero) for name in (*force.state, *force.memory)}
        held = _held(about, force, given, start)
        states = {name: _state(about, force, given | held, start[name]) for name in force.state}
        names = {"x": about.x[:, None], "v": about.v[:, None], "t": about.time[:, None], **given}
        found = force.formula.evaluate(names | held | states)
    return np.broadcast_to(found, (len(about.x), len(shapes)))


def _held(about: Tangent, force: Force, given: dict[str, Any], start: dict[str, Array]) -> dict[str, Array]:
    """What is held between reversals, (point, probe) each."""
    if not force.memory:
        return {}
    x, v, tau = about.x, about.v, about.tau
    turns = np.flatnonzero(v[1:] * v[:-1] < 0.0)
    part = v[turns] / (v[turns] - v[turns + 1])
    # The rate changes evenly between two points.
    ends = x[turns] + 0.5 * v[turns] * part * (tau[turns + 1] - tau[turns])
    rows = [{name: start[name] for name in force.memory}]
    for end, t in zip(ends.tolist(), about.time[turns].tolist(), strict=True):
        names = {"x": end, "v": 0.0, "t": t, **given, **rows[-1]}
        rows.append({name: formula.evaluate(names) for name, formula in force.memory.items()})
    at = np.searchsorted(turns, np.arange(len(x)), side="left")
    return {
        name: np.stack([np.broadcast_to(row[name], len(start[name])) for row in rows])[at]
        for name in force.memory
    }


def _state(about: Tangent, force: Force, given: dict[str, Any], start: Array) -> Array:
    """The only state at the points, (point, probe)."""
    h = np.diff(about.tau)[:, None]
    (name,) = force.state
    push, pull = [], []
    for part in STAGES:
        driven = _driven(about, force, given, part)
        alone, unit = (force.state[name].evaluate(driven | {name: value}) for value in (0.0, 1.0))
        push.append(h * alone)
        pull.append(h * (unit - alone))
    # The rates of both stages hold both: two equations with two unknowns, of which the second ends the step.
    (a, b), (c, d) = WEIGHTS.tolist()
    first, second = a * push[0] + b * push[1], c * push[0] + d * push[1]
    one, other = 1.0 - a * pull[0], c * pull[0]
    determinant = one * (1.0 - d * pull[1]) - b * pull[1] * other
    kept = (one + other) / determinant
    added = (one * second + other * first) / determinant
    shape = (len(h), len(start))
    # From step to step, each probe by itself: what is not finite comes out so, and is told.
    steps = zip(start, np.broadcast_to(kept, shape).T, np.broadcast_to(added, shape).T, strict=True)
    return np.column_stack([_followed(*each) for each in steps])


def _followed(start: float, kept: Array, added: Array) -> Array:
    """y with y[0] = start and y[n + 1] = kept[n] y[n] + added[n], a triangular banded system."""
    band = np.ones((2, len(kept) + 1))
    band[1, :-1] = -kept
    found, _ = dtbtrs(band, np.append(start, added)[:, None], uplo="L", diag="U")
    return np.asarray(found[:, 0])


@lru_cache(maxsize=1024)
def is_driven(force: Force) -> bool:
    """Whether what a force remembers follows from a motion at once (by its formulas).

    It has at most one state, with a rate that is linear in it, and holds nothing that depends on the state.
    """
    if len(force.state) > 1 or any(f.names & set(force.state) for f in force.memory.values()):
        return False
    for name, formula in force.state.items():
        here = force.test_points[name]
        none, one, other = (formula.evaluate(force.test_points | {name: p * here}) for p in (0.0, 1.0, -2.0))
        if not np.allclose(other - none, -2.0 * (one - none), rtol=1e-9, atol=1e-12):
            return False
    return True


def _driven(about: Tangent, force: Force, given: dict[str, Any], part: float) -> dict[str, Any]:
    """Names at a part of each step: the angle by Hermite's cubic, of which the rates are the slopes."""
    x, v, h, p = about.x, about.v, np.diff(about.tau), part
    angle = (1 + 2 * p) * (1 - p) ** 2 * x[:-1] + p * (1 - p) ** 2 * h * v[:-1]
    angle += p**2 * (3 - 2 * p) * x[1:] + p**2 * (p - 1) * h * v[1:]
    rate = 6 * p * (1 - p) * np.diff(x) / h + (1 - p) * (1 - 3 * p) * v[:-1] + p * (3 * p - 2) * v[1:]
    time = about.time[:-1] + p * np.diff(about.time)
    held = {name: given[name][1:] for name in force.memory}
    return given | held | {"x": angle[:, None], "v": rate[:, None], "t": time[:, None]}
