"""A model: forces with coefficients at a reference frequency, and its motion as a switching system."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.force import Channel, Force, ForceLibrary, channels_of
from sysid_trib.forces.formulas import Formula, parse
from sysid_trib.records.inputs import FORCING_CHANNEL, INPUT, KnownInput
from sysid_trib.simulation.program import FUNCTIONS, SIGN, Instructions, Listing, Slot, live_functions

Vector = NDArray[np.float64]
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
class Motion:
    """The equations of motion under some forces, for any coefficients, shapes and frequency.

    The states `y` are x, v, the states of forces, then what is given over time; the parameters `p` the
    coefficients, the shapes, 1/w and the memory.

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
    def switches(self) -> dict[str, tuple[int, Formula]]:
        """Switching surfaces and a force whose names each holds; v comes first where a reversal matters."""
        switches: dict[str, tuple[int, Formula]] = {}
        for i, force in enumerate(self.forces):
            for surface in force.surfaces:
                switches.setdefault(self.key(i, surface), (i, surface))
        v = switches.pop("v", (0, RATE))
        reverses = any("v" in surface.names for f in self.forces for surface in f.surfaces)
        return {"v": v, **switches} if reverses or self.memory else switches

    def key(self, i: int, surface: Formula) -> str:
        """Name of a force's surface: forces share those of x, v and t, and keep those of their own states."""
        force = self.forces[i]
        common = {"x", "v", "t", *(channel.name for channel in force.channels)}
        return surface.text if surface.names <= common else f"{force.symbol}: {surface.text}"

    @cached_property
    def memory_at(self) -> slice:
        """Where the memory stands in `p`."""
        first = len(self.forces) + len(self.shapes) + 1
        return slice(first, first + len(self.memory))

    def parameters(self, model: Model) -> Vector:
        """`p` of a model, memory still zero."""
        coefficients = [model.coefficients.get(f.symbol, 0.0) for f in self.forces]
        shapes = [value for f in self.forces for value in f.shape_values(model.shapes).values()]
        return np.array([*coefficients, *shapes, 1.0 / model.reference_frequency, *[0.0] * len(self.memory)])

    def names(self, i: int, y: Sequence[Any], p: Sequence[Any], tau: Any) -> dict[str, Any]:
        """Values of all that the formulas of a force hold."""
        names = {"x": y[0], "v": y[1]}
        if self.forces[i].holds_time:
            names["t"] = tau * p[self.memory_at.start - 1]
        names |= {name: y[j] for name, j in self._in_y[i].items()}
        return names | {name: p[j] for name, j in self._in_p[i].items()}

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

    @cached_property
    def _in_y(self) -> tuple[dict[str, int], ...]:
        first = len(self.variables)
        return tuple(
            {k: self.variables.index(f"{f.symbol}.{k}") for k in f.state}
            | {channel.name: first + self.channels.index(channel) for channel in f.channels}
            for f in self.forces
        )

    @cached_property
    def _in_p(self) -> tuple[dict[str, int], ...]:
        shapes, memory = len(self.forces), self.memory_at.start
        return tuple(
            {k: shapes + self.shapes.index(f"{f.symbol}.{k}") for k in f.shape}
            | {k: memory + self.memory.index(f"{f.symbol}.{k}") for k in f.memory}
            for f in self.forces
        )


@lru_cache(maxsize=512)
def program_of(
    forces: tuple[Force, ...], *, forced: bool = False, paced: bool = False
) -> tuple[Motion, Instructions]:
    """The equations of motion under these forces, and their program, for any coefficients and shapes.

    Its parameters are `p` of `Motion`, and one more in front of them: where `paced`, what all rates are
    multiplied by, 1 but for its derivative, which is that by the frequency at given times. Where `forced`, an
    acceleration is added that the engine is given: the first channel, before the forces' own.
    """
    motion = Motion(forces)
    states, fixed = len(motion.variables), motion.memory_at.stop
    channels = int(forced) + len(motion.channels)
    rows = Listing(states + 1 + channels, 1 + fixed)
    slots = [Slot(rows, i) for i in range(rows.inputs)]
    tau, given, (pace, *p) = slots[states], slots[states + 1 : -1 - fixed], slots[-1 - fixed :]
    y = [*slots[:states], *given[int(forced) :]]
    signs: dict[str, Slot] = {}
    surfaces: list[int] = []

    def value(i: int, formula: Formula) -> Any:
        """Value of a formula of a force on the branch of the signs."""
        # Inner surfaces come first: their signs are known where an outer one is reached.
        own = {s.text: signs.get(motion.key(i, s), 0.0) for s in forces[i].surfaces}
        return formula.evaluate(motion.names(i, y, p, tau), FUNCTIONS, own)

    for key, (i, surface) in motion.switches.items():
        at_zero = rows.slot(value(i, surface))
        surfaces.append(at_zero)
        signs[key] = Slot(rows, rows.add(SIGN, at_zero))
    acceleration = -y[0]
    for i, force in enumerate(forces):
        acceleration = acceleration - p[i] * value(i, force.formula)
    if forced:
        acceleration = acceleration + given[0]
    rates = [
        y[1],
        acceleration,
        *(value(i, f) for i, force in enumerate(forces) for f in force.state.values()),
    ]
    ends = [rows.slot(pace * rate if paced else rate) for rate in rates]
    main = len(rows.rows)
    live = live_functions(rows)
    replaced = [
        rows.slot(formula.evaluate(motion.names(i, y, p, tau), live))
        for i, force in enumerate(forces)
        for formula in force.memory.values()
    ]
    outputs = ends, surfaces, [sign.index for sign in signs.values()], replaced
    return motion, rows.tidied(main, (states, channels), outputs)
