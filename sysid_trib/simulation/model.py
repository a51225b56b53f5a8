"""A model: forces with coefficients at a reference frequency, and its motion as a switching system."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.force import Channel, Force, ForceLibrary, channels_of
from sysid_trib.forces.formulas import Formula, Functions, parse
from sysid_trib.records.inputs import FORCING_CHANNEL, INPUT, KnownInput

Values: TypeAlias = Sequence[Any]
Vector = NDArray[np.float64]
# Below this distance from a surface (rad), what is infinite there is smoothed.
SMOOTHED = 1e-9
RATE = parse("v", frozenset("v"), frozenset(), "v")


@dataclass(frozen=True)
class Model:
    """theta'' + w^2 theta = -w^2 sum of coefficient * h(theta, theta'/w) (Le Bot et al. 2019, Eq. 1).

    Parameters
    ----------
    library : ForceLibrary
        Forces to choose from.
    coefficients : mapping of str to float
        By symbol, dimensionless with angles in rad; forces left out are absent.
    reference_frequency : float, rad/s
        w.
    shapes : mapping of str to float
        `{"dahl.s": 0.02}`; defaults of the library where left out.
    inputs : mapping of str to KnownInput
        What drives the motion, by the names that forces hold; `input` is an acceleration (rad/s^2) on the
        right side of the equation. An input that is not given is zero.

    Raises
    ------
    UsageError
        A symbol or shape parameter that the library does not have.
    LibraryError
        A coefficient or frequency that is not a finite number (the frequency: positive).
    """

    library: ForceLibrary
    coefficients: Mapping[str, float]
    reference_frequency: float
    shapes: Mapping[str, float] = field(default_factory=dict)
    inputs: Mapping[str, KnownInput] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for symbol, value in self.coefficients.items():
            if not np.isfinite(value):
                raise LibraryError(f"Coefficient {symbol} = {value} of a model must be a finite number.")
            self.library[symbol]
        if not (np.isfinite(self.reference_frequency) and self.reference_frequency > 0):
            raise LibraryError(f"Reference frequency {self.reference_frequency} must be positive (rad/s).")
        check_shapes(self.shapes, self.library)

    @property
    def forces(self) -> tuple[Force, ...]:
        """Forces that act on the motion, in the library's order."""
        return tuple(f for f in self.library if f.symbol in self.coefficients and f.kind == "force")

    @property
    def sensors(self) -> tuple[Force, ...]:
        """Terms that change what is measured, not the motion."""
        return tuple(f for f in self.library if f.symbol in self.coefficients and f.kind == "sensor")

    @property
    def driven(self) -> tuple[Channel, ...]:
        """What the equation of motion holds of inputs: first one that pushes by itself, if there is one."""
        forcing = (FORCING_CHANNEL,) if INPUT in self.inputs else ()
        return (*forcing, *channels_of(self.forces))

    def with_coefficients(self, coefficients: Mapping[str, float]) -> "Model":
        """The model with other coefficients."""
        return replace(self, coefficients=dict(coefficients))


def rescaling_factors(forces: tuple[Force, ...], old: float, new: float) -> NDArray[np.float64]:
    """Factor of each coefficient when the reference frequency changes from `old` to `new` (rad/s).

    A force homogeneous of degree q in v and without states gets (old/new)^(2 - q); NaN marks the others,
    which keep their reference, terms of the sensor among them.
    """
    degrees = [np.nan if f.speed_degree is None or f.kind == "sensor" else f.speed_degree for f in forces]
    return np.asarray((old / new) ** (2.0 - np.array(degrees)))


def check_shapes(names: Iterable[str], library: ForceLibrary) -> None:
    """Refuse a shape parameter, such as `dahl.s`, that no force of the library has.

    Raises
    ------
    UsageError
        The force or the parameter does not exist.
    """
    for key in names:
        symbol, _, name = key.partition(".")
        if name not in library[symbol].shape:
            raise UsageError(f"Force '{symbol}' has no shape parameter '{name}'.")


@dataclass(frozen=True)
class Switch:
    """A switching surface; forces share those of x, v and t, and keep those of their own states.

    Parameters
    ----------
    key : str
        The expression's text, with the force's symbol where it holds a state.
    surface : Formula
        The expression.
    force : int
        Index of a force whose names it holds.
    """

    key: str
    surface: Formula
    force: int


@dataclass(frozen=True)
class Motion:
    """The equations of motion under some forces, for any coefficients, shapes and frequency.

    Parameters
    ----------
    forces : tuple of Force
        The forces, in the order of their coefficients in `p`.
    """

    forces: tuple[Force, ...]

    @cached_property
    def variables(self) -> tuple[str, ...]:
        """Names of the entries of `y`: x, v and the states as `dahl.z`."""
        return ("x", "v", *(f"{f.symbol}.{k}" for f in self.forces for k in f.state))

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """What the forces hold of inputs."""
        return channels_of(self.forces)

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
        switches: dict[str, Switch] = {}
        for i, force in enumerate(self.forces):
            for surface in force.surfaces:
                common = {"x", "v", "t", *(channel.name for channel in force.channels)}
                key = surface.text if surface.names <= common else f"{force.symbol}: {surface.text}"
                switches.setdefault(key, Switch(key, surface, i))
        v = switches.pop("v", Switch("v", RATE, 0))
        reverses = any("v" in surface.names for f in self.forces for surface in f.surfaces)
        return (v, *switches.values()) if reverses or self.memory else tuple(switches.values())

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

    def rates(self, y: Values, p: Values, tau: Any, functions: Functions) -> list[Any]:
        """Derivative of `y` on the branch that the signs in `p` select."""
        acceleration = -y[0]
        for i in range(len(self.forces)):
            # In numbers, a force that is off must not act even where it is singular.
            if not (isinstance(p[i], float) and p[i] == 0.0):
                acceleration = acceleration - p[i] * self.force_value(i, y, p, tau, functions)
        return [y[1], acceleration, *self.state_rates(y, p, tau, functions)]

    def force_value(self, i: int, y: Values, p: Values, tau: Any, functions: Functions) -> Any:
        """What the coefficient of a force multiplies, on the branch that the signs in `p` select."""
        names, signs = self._names(i, y, p, tau), self._signs(i, p)
        return self.forces[i].formula.evaluate(names, functions, signs)

    def state_rates(self, y: Values, p: Values, tau: Any, functions: Functions) -> list[Any]:
        """Derivative of the states of the forces on that branch."""
        return [
            formula.evaluate(self._names(i, y, p, tau), functions, self._signs(i, p))
            for i, force in enumerate(self.forces)
            for formula in force.state.values()
        ]

    def surface(
        self, switch: Switch, y: Values, p: Values, tau: Any, functions: Functions, *, frozen: bool = True
    ) -> Any:
        """Value of a switching surface; `frozen` takes inner branches by the signs in `p`."""
        signs = self._signs(switch.force, p) if frozen else None
        return switch.surface.evaluate(self._names(switch.force, y, p, tau), functions, signs)

    def replaced(self, y: Values, p: Values, tau: Any, functions: Functions) -> list[Any]:
        """Memory after a reversal, from the old memory."""
        return [
            formula.evaluate(self._names(i, y, p, tau), functions)
            for i, force in enumerate(self.forces)
            for formula in force.memory.values()
        ]

    def start(self, model: Model, x: float, v: float) -> tuple[Vector, Vector]:
        """`y` with the states, and `p` with the memory, that the forces of a model start with."""
        y, p = np.zeros(len(self.variables)), self.parameters(model)
        y[:2] = x, v
        for i, force in enumerate(self.forces):
            for name, value in force.start_values(self._at_start(i, p, x, v)).items():
                if name in force.state:
                    y[self._in_y[i][name]] = value
                else:
                    p[self._in_p[i][name]] = value
        return y, p

    def start_derivatives(self, model: Model, at: tuple[float, float], dy: Vector, dp: Vector) -> None:
        """Add what states and memory start with to the derivatives of `y` and `p`, (entry, parameter)."""
        p = self.parameters(model)
        for i, force in enumerate(self.forces):
            names = self._at_start(i, p, *at)
            origins = {"x": dy[0], "v": dy[1], **{k: dp[self._in_p[i][k]] for k in force.shape}}
            for name, formula in force.start.items():
                target = dy[self._in_y[i][name]] if name in force.state else dp[self._in_p[i][name]]
                for origin in sorted(formula.names & origins.keys()):
                    target += float(formula.derivative(names, origin)) * origins[origin]

    def _at_start(self, i: int, p: Vector, x: float, v: float) -> dict[str, float]:
        return {"x": x, "v": v, "t": 0.0, **{k: p[j] for k, j in self._in_p[i].items()}}

    def _names(self, i: int, y: Values, p: Values, tau: Any) -> dict[str, Any]:
        names = {"x": y[0], "v": y[1]}
        if self._uses_time[i]:
            names["t"] = tau * p[self.memory_at.start - 1]
        names |= {name: y[j] for name, j in self._in_y[i].items()}
        names |= {channel.name: y[j] for channel, j in self._channels_in_y[i].items()}
        return names | {name: p[j] for name, j in self._in_p[i].items()}

    def _signs(self, i: int, p: Values) -> dict[str, Any]:
        return {text: p[j] for text, j in self._signs_in_p[i].items()}

    @cached_property
    def _uses_time(self) -> tuple[bool, ...]:
        return tuple(force.holds_time for force in self.forces)

    @cached_property
    def _in_y(self) -> tuple[dict[str, int], ...]:
        return tuple({k: self.variables.index(f"{f.symbol}.{k}") for k in f.state} for f in self.forces)

    @cached_property
    def _channels_in_y(self) -> tuple[dict[Channel, int], ...]:
        places = {channel: len(self.variables) + at for at, channel in enumerate(self.channels)}
        return tuple({channel: places[channel] for channel in force.channels} for force in self.forces)

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
        index = {s.key: self.signs_at.start + j for j, s in enumerate(self.switches)}
        return tuple(
            {s.text: index.get(s.text, index.get(f"{f.symbol}: {s.text}", -1)) for s in f.surfaces}
            for f in self.forces
        )
