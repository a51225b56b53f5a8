"""States of forces under a motion that is given.

They are found at once over the whole motion by Radau collocation on panels: every Newton step is one
banded system, so a stiff state (Dahl with a short presliding length) costs no more than a soft one, and a
steady cycle is the same system closed on itself.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.linalg import solve_banded

from sysid_trib.arrays import Array, Mask
from sysid_trib.errors import LibraryError
from sysid_trib.forces.force import Force
from sysid_trib.forces.formulas import Names

Index = NDArray[np.intp]
MAX_NEWTON = 60
MAX_HALVINGS = 45


@dataclass(frozen=True)
class Panels:
    """Intervals of tau (or phi) in order.

    Attributes
    ----------
    row : (panel,) array of int
        The motion, where there are several.
    segment : (panel,) array of int
        Its part between reversals.
    low, high : (panel,) array of float
        Ends of the interval.
    """

    row: Index
    segment: Index
    low: Array
    high: Array

    def halved(self, chosen: Mask) -> tuple["Panels", Index, Array]:
        """Halve the chosen ones; of each new panel its parent, and where in it its nodes begin."""
        parent = np.repeat(np.arange(self.low.size), 1 + chosen)
        second = np.concatenate(([False], parent[1:] == parent[:-1]))
        middle = 0.5 * (self.low + self.high)[parent]
        low = np.where(second, middle, self.low[parent])
        high = np.where(chosen[parent] & ~second, middle, self.high[parent])
        return Panels(self.row[parent], self.segment[parent], low, high), parent, 0.5 * second


@dataclass(frozen=True)
class States:
    """States on panels.

    Attributes
    ----------
    panels : Panels
        The panels, halved until the states are smooth on each.
    tau, weights : (panel, node) array of float
        Nodes, and weights of an integral over them.
    values : (panel, node, state) array of float
        States at the nodes.
    at_low : (panel, state) array of float
        States at each panel's low end.
    """

    panels: Panels
    tau: Array
    weights: Array
    values: Array
    at_low: Array


@lru_cache(maxsize=8)
def _radau(count: int) -> tuple[Array, Array, Array]:
    """Radau IIA (Hairer and Wanner 1996): nodes on (0, 1], integration matrix, inverse Legendre matrix."""
    nodes = legendre.legroots(np.eye(count + 1)[-1] - np.eye(count + 1)[-2])
    nodes[-1] = 1.0
    basis = legendre.legvander(nodes, count - 1)
    integrals = [legendre.legval(nodes, legendre.legint(row, lbnd=-1)) for row in np.eye(count)]
    inverse = np.linalg.inv(basis)
    matrix = 0.5 * np.array(integrals).T @ inverse
    return 0.5 * (nodes + 1.0), np.asarray(matrix), np.asarray(inverse)


def solve_states(
    force: Force,
    panels: Panels,
    names_at: Callable[[Index, Array], Names],
    *,
    start: Array | None = None,
    nodes: int = 8,
    tolerance: float = 1e-13,
) -> States:
    """States of a force along a given motion, on panels halved until the states are smooth on each.

    Parameters
    ----------
    force : Force
        One with states.
    panels : Panels
        First division of the motions.
    names_at : callable
        x, v, t, memory and shape parameters at (segment, tau), both of (panel, node).
    start : (row, state) array of float, optional
        Value at the start of each motion; None for the steady cycle.
    nodes : int
        Nodes of a panel.
    tolerance : float
        Error allowed on a panel, relative to the largest state.

    Returns
    -------
    States

    Raises
    ------
    LibraryError
        The states are not finite, or have no steady cycle.
    """
    place, matrix, inverse = _radau(nodes)
    guess = np.zeros((panels.low.size, nodes, len(force.state)))
    if start is not None:
        guess += start[panels.row, None, :]
    most_panels = MAX_HALVINGS * panels.low.size
    for _ in range(MAX_HALVINGS):
        width = panels.high - panels.low
        tau = panels.low[:, None] + width[:, None] * place
        names = names_at(panels.segment[:, None], tau)
        try:
            with np.errstate(all="ignore"):
                values, at_low = _newton(force, panels, names, guess, start=start, tolerance=tolerance)
        except np.linalg.LinAlgError:
            raise _not_finite(force) from None
        # The force is watched too: it is integrated, and may switch where its states do not.
        h = force.formula.evaluate({**names, **named_states(force, values)})
        h = np.broadcast_to(h, tau.shape)[..., None] * width[:, None, None]
        error = _error(inverse, np.concatenate((values, h), axis=-1))
        # Beside states that stay at zero the force's own size counts.
        largest = max(np.abs(values).max(), np.abs(h).max(), 1e-300)
        rough = (error > tolerance * largest) & (width > 1e-10)
        if not rough.any():
            return States(panels, tau, matrix[-1] * width[:, None], values, at_low)
        if rough.size > most_panels:
            break
        known = (np.arange(panels.low.size)[:, None] + place).ravel()
        panels, parent, offset = panels.halved(rough)
        at = parent[:, None] + offset[:, None] + np.where(rough[parent], 0.5, 1.0)[:, None] * place
        guess = np.stack([np.interp(at, known, z.ravel()) for z in np.moveaxis(values, -1, 0)], axis=-1)
    raise LibraryError(f"Force '{force.symbol}': its states are too rough to be followed.")


def _not_finite(force: Force) -> LibraryError:
    return LibraryError(f"Force '{force.symbol}': its states are not finite along the motion.")


def _error(inverse: Array, watched: Array) -> Array:
    """Error on each panel, from the decay of Legendre coefficients.

    Radau nodes are exact to twice the degree seen here: where the coefficients fall geometrically the error
    is that much smaller than the last of them; at a kink they do not fall, and nothing is gained.
    """
    size = np.abs(np.einsum("ks,psm->pkm", inverse[-4:], watched))
    before, last = size[:, :2].max(axis=1), size[:, 2:].max(axis=1)
    ratio = np.divide(last, before, out=np.ones_like(last), where=before > last)
    return np.asarray((last * ratio ** (len(inverse) // 2 - 1)).max(axis=-1))


def named_states(force: Force, values: Array) -> dict[str, Array]:
    """States by name, from an array with the states along its last axis."""
    return {k: values[..., i] for i, k in enumerate(force.state)}


def _slopes(force: Force, names: Names, values: Array) -> Array:
    """Right sides of the states' equations at the nodes, (panel, node, state)."""
    full = {**names, **named_states(force, values)}
    sides = [np.broadcast_to(f.evaluate(full), values.shape[:-1]) for f in force.state.values()]
    return np.stack(sides, axis=-1)


def _newton(
    force: Force, panels: Panels, names: Names, guess: Array, *, start: Array | None, tolerance: float
) -> tuple[Array, Array]:
    """Solve the collocation equations of all panels together: (values at the nodes, at the low ends)."""
    count, nodes, states = guess.shape
    matrix = _radau(nodes)[1] * (panels.high - panels.low)[:, None, None]
    identity = np.broadcast_to(np.tile(np.eye(states), (nodes, 1)), (count, nodes * states, states))
    values = guess
    best = np.inf
    for _ in range(MAX_NEWTON):
        slopes = _slopes(force, names, values)
        jacobian = _jacobian(force, names, values)
        if not (np.all(np.isfinite(slopes)) and np.all(np.isfinite(jacobian))):
            raise _not_finite(force)
        rest = slopes - np.einsum("psab,psb->psa", jacobian, values)
        system = -np.einsum("pij,pjab->piajb", matrix, jacobian).reshape(count, nodes * states, -1)
        system += np.eye(nodes * states)
        fixed = np.einsum("pij,pja->pia", matrix, rest).reshape(count, -1, 1)
        solved = np.linalg.solve(system, np.concatenate((fixed, identity), axis=-1))
        at_low = _chained(force, solved[:, -states:, 1:], solved[:, -states:, 0], panels.row, start)
        new = (solved[..., 0] + np.einsum("pij,pj->pi", solved[..., 1:], at_low)).reshape(values.shape)
        change = np.abs(new - values).max() / max(np.abs(new).max(), 1e-300)
        values = new
        # Finite differences and rounding leave a floor: stop there, not at a fixed level.
        if change <= 0.01 * tolerance or (change < 1e-4 and change > 0.3 * best):
            return values, at_low
        best = min(best, change)
    raise LibraryError(f"Force '{force.symbol}': its states could not be followed along the motion.")


def _jacobian(force: Force, names: Names, values: Array) -> Array:
    """Derivatives of the slopes by the states, (panel, node, slope, state), by central differences."""
    step = 1e-5 * max(float(np.abs(values).max()), 1e-3)
    shifts = step * np.eye(values.shape[-1])
    columns = [_slopes(force, names, values + s) - _slopes(force, names, values - s) for s in shifts]
    return np.stack(columns, axis=-1) / (2.0 * step)


def _chained(force: Force, gain: Array, offset: Array, row: Index, start: Array | None) -> Array:
    """Value at the low end of each panel, when the high end is gain @ low end + offset.

    Panels of one row follow each other; a row begins at `start`, or (None) where it ends.
    """
    count, states = offset.shape
    first = np.concatenate(([True], row[1:] != row[:-1]))
    last = np.concatenate((first[1:], [True]))
    bands = np.zeros((2 * states, count * states))
    bands[0] = 1.0
    linked = np.flatnonzero(~first)
    i, j = np.indices((states, states))
    bands[states + i - j, (linked[:, None, None] - 1) * states + j] = -gain[linked]
    right = np.concatenate((offset[..., None], np.where(first[:, None, None], gain, 0.0)), axis=-1)
    ends = solve_banded((2 * states - 1, 0), bands, right.reshape(count * states, -1), check_finite=False)
    ends = ends.reshape(right.shape)
    if start is None:
        start = _closed(force, ends[last][..., 1:], ends[last][..., 0], np.abs(ends[..., 0]).max())
    ends = ends[..., 0] + np.einsum("pij,pj->pi", ends[..., 1:], start[row])
    return np.where(first[:, None], start[row], np.concatenate((ends[:1], ends[:-1])))


def _closed(force: Force, gain: Array, offset: Array, size: float) -> Array:
    """Fixed point of one period, the smallest one where it is not unique (a state that only integrates)."""
    left, sizes, right = np.linalg.svd(np.eye(gain.shape[-1]) - gain)
    inverse = np.divide(1.0, sizes, out=np.zeros_like(sizes), where=sizes > 1e-13)
    start = np.einsum("rji,rj,rkj,rk->ri", right, inverse, np.swapaxes(left, 1, 2), offset)
    drift = np.abs(start - np.einsum("rij,rj->ri", gain, start) - offset).max()
    if drift > 1e-9 * size:
        raise LibraryError(
            f"Force '{force.symbol}': a state drifts at each cycle; it has no steady cycle, no signature."
        )
    return start
