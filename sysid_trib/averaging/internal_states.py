"""States and memory of forces carried along a measured motion."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from sysid_trib.averaging.collocation import Array, Index, Panels, solve_states
from sysid_trib.errors import DecayError, LibraryError
from sysid_trib.forces.force import Force

STAGES = 4
# Below this the error of the interpolated motion rules.
ACCEPTED = 1e-8


def states_along(
    force: Force,
    tau: ArrayLike,
    x: ArrayLike,
    v: ArrayLike,
    shapes: Mapping[str, float] | None = None,
    *,
    time: ArrayLike = 0.0,
) -> dict[str, Array]:
    """States and memory of a force along a measured motion.

    Parameters
    ----------
    force : any force; one without a past gives an empty mapping.
    tau : (sample,) w t, increasing.
    x, v : (sample,) rad, angle and dx/dtau.
    shapes : shape parameters, `{"dahl.s": 0.02}`; defaults where left out.
    time : (sample,) s, the `t` of formulas.

    Returns
    -------
    `{name: (sample,)}`, to be given to `Force.value` as `hidden`. The motion is interpolated by cubics;
    memory is replaced at the zeros of v so found. The first sample holds the force's `start`, else zero.

    Raises
    ------
    DecayError
        Fewer than four samples, unequal lengths, not finite, or tau not increasing.
    LibraryError
        The states or memory are not finite along this motion.
    """
    if force.memoryless:
        return {}
    tau, x, v = (np.asarray(a, dtype=float) for a in (tau, x, v))
    good = tau.ndim == 1 and tau.shape == x.shape == v.shape and tau.size >= 4
    if not (good and np.all(np.isfinite([tau, x, v])) and np.all(np.diff(tau) > 0)):
        raise DecayError(
            f"Force '{force.symbol}' has a past: give at least four finite samples of tau, x and v, "
            "all of one length and in order of time."
        )
    path = _Path(force, tau, x, v, np.broadcast_to(np.asarray(time, dtype=float), tau.shape), shapes)
    return path.carried()


class _Path:
    """A measured motion made continuous, cut at its reversals."""

    def __init__(
        self, force: Force, tau: Array, x: Array, v: Array, time: Array, shapes: Mapping[str, float] | None
    ) -> None:
        self.force, self.tau, self.time = force, tau, time
        self.x, self.v = CubicHermiteSpline(tau, x, v), CubicSpline(tau, v)
        self.shapes = force.shape_values(shapes)
        zeros = self.v.roots(extrapolate=False)
        # Not the release itself: there the start values hold.
        self.reversals = np.unique(zeros[np.isfinite(zeros) & (zeros > tau[0] + 1e-9)])
        edges = np.unique(np.concatenate((tau, self.reversals)))
        middle = 0.5 * (edges[:-1] + edges[1:])
        segment = np.searchsorted(self.reversals, middle)
        self.panels = Panels(np.zeros(middle.size, dtype=np.intp), segment, edges[:-1], edges[1:])
        here = self.names(tau[:1]) | {"x": x[:1], "v": v[:1]}
        self.start = dict.fromkeys((*force.state, *force.memory), np.zeros(1))
        self.start |= {k: np.broadcast_to(f.evaluate(here), (1,)) for k, f in force.start.items()}

    def names(self, tau: Array) -> dict[str, Any]:
        """Variables of the formulas that the motion gives."""
        time = np.interp(tau, self.tau, self.time)
        return {"x": self.x(tau), "v": self.v(tau), "t": time, **self.shapes}

    def carried(self) -> dict[str, Array]:
        """States and memory at the samples."""
        states = {
            k: np.full(self.reversals.size, z[0]) for k, z in self.start.items() if k in self.force.state
        }
        # A memory may take the value of a state and a state may see the memory: each turn settles at least
        # one more half period.
        for _ in range(self.reversals.size + 2):
            memory = self.remembered(states)
            found = self.followed(memory)
            before, states = states, {k: z[1] for k, z in found.items()}
            settled = all(np.allclose(states[k], before[k], rtol=1e-9, atol=1e-12) for k in states)
            if settled or not (self.force.state and self.force.memory):
                break
        segment = np.searchsorted(self.reversals, self.tau)
        return {k: z[0] for k, z in found.items()} | {k: m[segment] for k, m in memory.items()}

    def remembered(self, states: Mapping[str, Array]) -> dict[str, Array]:
        """Memory in each segment, given the states at the reversals."""
        force, names = self.force, self.names(self.reversals) | {"v": np.zeros(self.reversals.size)}
        moving = {k: names[k] for k in "xvt"} | dict(states)
        held = [{k: float(self.start[k][0]) for k in force.memory}]
        for i in range(self.reversals.size if force.memory else 0):
            at = {k: float(value[i]) for k, value in moving.items()} | self.shapes | held[-1]
            held.append({k: float(f.evaluate(at)) for k, f in force.memory.items()})
        memory = {k: np.array([h[k] for h in held]) for k in force.memory}
        if not all(np.all(np.isfinite(m)) for m in memory.values()):
            raise LibraryError(f"Force '{force.symbol}': its memory is not finite along the motion.")
        return memory

    def followed(self, memory: Mapping[str, Array]) -> dict[str, tuple[Array, Array]]:
        """States (at the samples, at the reversals), given the memory of each segment."""
        if not self.force.state:
            return {}

        def names_at(segment: Index, tau: Array) -> dict[str, Any]:
            return self.names(tau) | {k: m[segment] for k, m in memory.items()}

        start = np.array([[float(self.start[k][0]) for k in self.force.state]])
        found = solve_states(
            self.force, self.panels, names_at, start=start, stages=STAGES, tolerance=ACCEPTED
        )
        edges = np.append(found.panels.low, found.panels.high[-1])
        values = np.concatenate((found.left, found.values[-1:, -1]))
        places = np.searchsorted(edges, self.tau), np.searchsorted(edges, self.reversals)
        return {k: (values[places[0], i], values[places[1], i]) for i, k in enumerate(self.force.state)}
