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
from sysid_trib.simulation.program import FUNCTIONS, Instructions, Listing, Slot

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


def sensor_error(
    model: Model, elapsed: Vector, x: Vector, v: Vector, by: Sequence[str]
) -> tuple[Vector, Vector, Vector]:
    """What the sensor adds to the angle (sample,), and its derivatives by x and v, and by `by`."""
    error, by_motion = np.zeros_like(x), np.zeros((len(x), 2))
    by_names = np.zeros((len(x), len(by)))
    for sensor in model.sensors:
        coefficient, shapes = model.coefficients[sensor.symbol], sensor.shape_values(model.shapes)
        names = {"x": x, "v": v, "t": elapsed, **shapes}
        value = sensor.value(x, v, elapsed, shapes=model.shapes)
        error += coefficient * value
        for at, name in enumerate("xv"):
            by_motion[:, at] += coefficient * sensor.formula.derivative(names, name)
        for at, name in enumerate(by):
            symbol, _, shape = name.partition(".")
            if name == sensor.symbol:
                by_names[:, at] = value
            elif symbol == sensor.symbol:
                by_names[:, at] = coefficient * sensor.formula.derivative(names, shape)
    return error, by_motion, by_names


@dataclass(frozen=True)
class Motion:
    """The equations of motion under some forces, for any coefficients, shapes and frequency.

    The states `y` are x, v and the states of forces; the parameters `p` the coefficients, the shapes, 1/w and
    the memory.

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
    def switches(self) -> dict[str, tuple[Force, Formula]]:
        """Switching surfaces and a force whose names each holds; v comes first where a reversal matters."""
        switches: dict[str, tuple[Force, Formula]] = {}
        for force in self.forces:
            for surface in force.surfaces:
                switches.setdefault(surface_key(force, surface), (force, surface))
        reverses = self.memory or any("v" in surface.names for f in self.forces for surface in f.surfaces)
        return {"v": (self.forces[0], RATE)} | switches if reverses else switches

    @cached_property
    def memory_at(self) -> slice:
        """Where the memory stands in `p`."""
        first = len(self.forces) + len(self.shapes) + 1
        return slice(first, first + len(self.memory))

    def start(self, model: Model, x: float, v: float) -> tuple[Vector, Vector]:
        """`y` with the states, and `p` with the memory, that the forces of a model start with."""
        begun: dict[str, float] = {}
        for force in self.forces:
            if not force.memoryless:
                values = force.start_values(_at_start(force, model, x, v))
                begun |= {f"{force.symbol}.{k}": value for k, value in values.items()}
        coefficients = [model.coefficients.get(f.symbol, 0.0) for f in self.forces]
        shapes = [value for f in self.forces for value in f.shape_values(model.shapes).values()]
        memory = [begun[name] for name in self.memory]
        p = np.array([*coefficients, *shapes, 1.0 / model.reference_frequency, *memory])
        return np.array([x, v, *(begun[name] for name in self.variables[2:])], dtype=float), p

    def start_derivatives(self, model: Model, at: tuple[float, float], dy: Vector, dp: Vector) -> None:
        """Add what states and memory start with to the derivatives of `y` and `p`, (entry, parameter)."""
        fixed = dp[len(self.forces) :]
        of = dict(zip((*self.shapes, "1/w", *self.memory), fixed, strict=True))
        of |= dict(zip(self.variables, dy, strict=True))
        for force in self.forces:
            names = _at_start(force, model, *at)
            for name, formula in force.start.items():
                for origin in sorted(formula.names & {"x", "v", *force.shape}):
                    source = of[f"{force.symbol}.{origin}" if origin in force.shape else origin]
                    of[f"{force.symbol}.{name}"] += float(formula.derivative(names, origin)) * source


def surface_key(force: Force, surface: Formula) -> str:
    """Name of a force's surface: forces share those of x, v and t, and keep those of their own states."""
    common = {"x", "v", "t", *(channel.name for channel in force.channels)}
    return surface.text if surface.names <= common else f"{force.symbol}: {surface.text}"


def _at_start(force: Force, model: Model, x: float, v: float) -> dict[str, float]:
    return {"x": x, "v": v, "t": 0.0, **force.shape_values(model.shapes)}


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
    own = (*motion.variables, *motion.shapes, "1/w", *motion.memory)
    named = dict(zip(own, [*slots[:states], *p[len(forces) :]], strict=True))
    inputs = zip((channel.name for channel in motion.channels), given[int(forced) :], strict=True)
    common = {"x": named["x"], "v": named["v"], "t": tau * named["1/w"], **dict(inputs)}
    signs: dict[str, Slot] = {}
    surfaces: list[int] = []

    def names(force: Force) -> dict[str, Any]:
        """All that the formulas of a force hold."""
        its = (*force.state, *force.shape, *force.memory)
        return common | {k: named[f"{force.symbol}.{k}"] for k in its}

    def value(force: Force, formula: Formula) -> Any:
        """Value of a formula of a force on the branch of the signs."""
        # Inner surfaces come first: their signs are known where an outer one is reached.
        known = {s.text: signs.get(surface_key(force, s), 0.0) for s in force.surfaces}
        return formula.evaluate(names(force), FUNCTIONS, known)

    for key, switch in motion.switches.items():
        surfaces.append(rows.slot(value(*switch)))
        signs[key] = np.sign(Slot(rows, surfaces[-1]))
    x, v = slots[:2]
    acceleration = -x
    for coefficient, force in zip(p, forces, strict=False):
        acceleration = acceleration - coefficient * value(force, force.formula)
    if forced:
        acceleration = acceleration + given[0]
    rates = [v, acceleration, *(value(force, f) for force in forces for f in force.state.values())]
    ends = [rows.slot(pace * rate if paced else rate) for rate in rates]
    main = len(rows.rows)
    next_values = (f.evaluate(names(force), FUNCTIONS) for force in forces for f in force.memory.values())
    replaced = [rows.slot(value) for value in next_values]
    outputs = ends, surfaces, [sign.index for sign in signs.values()], replaced
    return motion, rows.tidied(main, (states, channels), outputs)
