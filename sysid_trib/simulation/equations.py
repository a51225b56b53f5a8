"""A model's motion as a switching system, the same for every engine.

In tau = w t: dx/dtau = v, dv/dtau = -x - sum of coefficient * h, and the states of the forces. Two flat
vectors describe an instant: `y` = (x, v, states) and `p` = (coefficients, shape parameters, 1/w, memory,
signs). `p` holds all that a run may change without changing the equations; the signs say on which side of
each switching surface the motion is, so that between two switchings every right side is analytic.
"""

import ast
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid_trib.forces.force import Force
from sysid_trib.forces.formulas import Formula, evaluate_tree
from sysid_trib.simulation.model import Model

Functions = Mapping[str, Callable[..., Any]]
Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Switch:
    """A switching surface; forces share those of x, v and t, and keep those of their own states."""

    key: str
    tree: ast.expr
    names: frozenset[str]
    force: int


@dataclass(frozen=True)
class Motion:
    """The equations of motion under some forces, for any coefficients, shapes and frequency."""

    forces: tuple[Force, ...]

    @cached_property
    def variables(self) -> tuple[str, ...]:
        """Names of the entries of `y`: x, v and the states as `dahl.z`."""
        return ("x", "v", *(f"{f.symbol}.{k}" for f in self.forces for k in f.state))

    @cached_property
    def shapes(self) -> tuple[str, ...]:
        """Shape parameters, as `dahl.s`."""
        return tuple(f"{f.symbol}.{k}" for f in self.forces for k in f.shape)

    @cached_property
    def memory(self) -> tuple[str, ...]:
        """Values held between reversals, as `jenkins.xr`."""
        return tuple(f"{f.symbol}.{k}" for f in self.forces for k in f.memory)

    @cached_property
    def switches(self) -> tuple[Switch, ...]:
        """Switching surfaces; v comes first wherever a reversal matters."""
        found: dict[str, Switch] = {}
        for i, force in enumerate(self.forces):
            for surface in force.surfaces:
                names = Formula(surface.text, surface.tree).names
                key = surface.text if names <= set("xvt") else f"{force.symbol}: {surface.text}"
                found.setdefault(key, Switch(key, surface.tree, names, i))
        v = found.pop("v", Switch("v", ast.Name("v"), frozenset("v"), 0))
        reverses = "v" in {name for f in self.forces for s in f.surfaces for name in _names(s)}
        return (v, *found.values()) if reverses or self.memory else tuple(found.values())

    @cached_property
    def reverses(self) -> bool:
        """Whether something changes at v = 0; the sign of v is then the first sign."""
        return bool(self.switches) and self.switches[0].key == "v"

    @cached_property
    def holds_time(self) -> bool:
        """Whether a formula holds `t`."""
        return any(force.holds_time for force in self.forces)

    @cached_property
    def signs_at(self) -> slice:
        """Where the signs stand in `p`."""
        return slice(self.memory_at.stop, self.memory_at.stop + len(self.switches))

    @cached_property
    def memory_at(self) -> slice:
        """Where the memory stands in `p`."""
        start = len(self.forces) + len(self.shapes) + 1
        return slice(start, start + len(self.memory))

    def parameters(self, model: Model) -> Vector:
        """`p` of a model, memory and signs still zero."""
        p = np.zeros(self.signs_at.stop)
        p[: len(self.forces)] = [model.coefficients.get(f.symbol, 0.0) for f in self.forces]
        shapes = [value for f in self.forces for value in f.shape_values(model.shapes).values()]
        p[len(self.forces) : self.memory_at.start - 1] = shapes
        p[self.memory_at.start - 1] = 1.0 / model.reference_frequency
        return p

    def rates(self, y: Sequence[Any], p: Sequence[Any], tau: Any, functions: Functions) -> list[Any]:
        """Derivative of `y` on the branch that the signs in `p` select."""
        acceleration, states = -y[0], []
        for i, force in enumerate(self.forces):
            names, signs = self._names(i, y, p, tau), self._signs(i, p)
            # In numbers, a force that is off must not act even where it is singular.
            if not (isinstance(p[i], float) and p[i] == 0.0):
                acceleration = acceleration - p[i] * force.formula.evaluate(names, functions, signs)
            states += [f.evaluate(names, functions, signs) for f in force.state.values()]
        return [y[1], acceleration, *states]

    def surfaces(
        self, y: Sequence[Any], p: Sequence[Any], tau: Any, functions: Functions, *, frozen: bool = False
    ) -> list[Any]:
        """Value of each switching surface; `frozen` takes inner branches by the signs in `p`."""
        return [
            evaluate_tree(
                s.tree,
                self._names(s.force, y, p, tau),
                functions,
                self._signs(s.force, p) if frozen else None,
            )
            for s in self.switches
        ]

    def replaced(self, y: Sequence[Any], p: Sequence[Any], tau: Any, functions: Functions) -> list[Any]:
        """Memory after a reversal, from the old memory."""
        found = []
        for i, force in enumerate(self.forces):
            names = self._names(i, y, p, tau) if force.memory else {}
            found += [formula.evaluate(names, functions) for formula in force.memory.values()]
        return found

    def start(self, y: Vector, p: Vector) -> tuple[Vector, Vector]:
        """`y` with the states, and `p` with the memory, that the forces start with."""
        y, p = y.copy(), p.copy()
        for i, force in enumerate(self.forces):
            names = {"x": y[0], "v": y[1], "t": 0.0, **{k: p[j] for k, j in self._in_p[i].items()}}
            for name, formula in force.start.items():
                value = float(formula.evaluate(names))
                if name in force.state:
                    y[self._in_y[i][name]] = value
                else:
                    p[self._in_p[i][name]] = value
        return y, p

    def _names(self, i: int, y: Sequence[Any], p: Sequence[Any], tau: Any) -> dict[str, Any]:
        names = {"x": y[0], "v": y[1]}
        if self._uses_time[i]:
            names["t"] = tau * p[self.memory_at.start - 1]
        for name, j in self._in_y[i].items():
            names[name] = y[j]
        for name, j in self._in_p[i].items():
            names[name] = p[j]
        return names

    def _signs(self, i: int, p: Sequence[Any]) -> dict[str, Any]:
        return {text: p[j] for text, j in self._signs_in_p[i].items()}

    @cached_property
    def _uses_time(self) -> tuple[bool, ...]:
        return tuple(force.holds_time for force in self.forces)

    @cached_property
    def _in_y(self) -> tuple[dict[str, int], ...]:
        return tuple({k: self.variables.index(f"{f.symbol}.{k}") for k in f.state} for f in self.forces)

    @cached_property
    def _in_p(self) -> tuple[dict[str, int], ...]:
        shapes, memory = len(self.forces), self.memory_at.start
        return tuple(
            {k: shapes + self.shapes.index(f"{f.symbol}.{k}") for k in f.shape}
            | {k: memory + self.memory.index(f"{f.symbol}.{k}") for k in f.memory}
            for f in self.forces
        )

    @cached_property
    def _signs_in_p(self) -> tuple[dict[str, int], ...]:
        place = {s.key: self.signs_at.start + j for j, s in enumerate(self.switches)}
        return tuple(
            {s.text: place.get(s.text, place.get(f"{f.symbol}: {s.text}", -1)) for s in f.surfaces}
            for f in self.forces
        )


class Run:
    """One run under way: its parameters, when they changed, and how it ended."""

    def __init__(self, p: Vector, *, budget: int, steps: int) -> None:
        self.p = p
        self.budget = budget  # switchings it may still take
        self.steps = steps  # steps of the integrator it may still take
        self.stuck = False
        self.failure = ""
        self._times: list[float] = []
        self._past: list[bytes] = []

    @property
    def times(self) -> Vector:
        """When the parameters changed, in tau."""
        return np.array(self._times)

    @property
    def past(self) -> Vector:
        """The parameters from each of `times` on."""
        return np.frombuffer(b"".join(self._past)).reshape(-1, len(self.p))

    def note(self, tau: float) -> None:
        """Remember the parameters from `tau` on."""
        self._times.append(tau)
        self._past.append(self.p.tobytes())

    def count(self) -> bool:
        """Take one switching from the budget; False if none is left."""
        self.budget -= 1
        if self.budget < 0:
            self.failure = "switches without end"
        return self.budget >= 0


@lru_cache(maxsize=256)
def motion_of(forces: tuple[Force, ...]) -> Motion:
    """The motion under these forces, made once."""
    return Motion(forces)


def _names(surface: Any) -> frozenset[str]:
    return Formula(surface.text, surface.tree).names
