"""A model: forces with coefficients at a reference frequency, and its equations as a switching system."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sysid_trib import forces
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.force import Channel, Force, ForceLibrary, channels_of
from sysid_trib.forces.formulas import Formula
from sysid_trib.forces.notation import parse
from sysid_trib.records.inputs import FORCING_CHANNEL, KnownInput
from sysid_trib.records.roles import INPUT
from sysid_trib.simulation.program import FUNCTIONS, Instructions, Listing, Slot

Vector = NDArray[np.float64]
RATE = parse("v", frozenset("v"), frozenset(), "v")
# Names of derivative parameters that are neither forces nor shape parameters. They contain a space, so they
# cannot collide.
FREQUENCY, BY_ANGLE, BY_RATE = "reference frequency", "start angle", "start rate"
# Common factor of all rates, equal to 1; its derivative gives that by the frequency at given times.
PACE = "pace of time"


@dataclass(frozen=True)
class Model:
    """theta'' + w^2 theta = -w^2 sum of coefficient * h(theta, theta'/w) (Le Bot et al. 2019, Eq. 1).

    Parameters
    ----------
    library : ForceLibrary, str, or what `library` takes
        Forces to choose from.
    coefficients : mapping of str to float
        Coefficients by symbol, dimensionless with angles in rad; missing forces have none.
    reference_frequency : float, rad/s
        Reference frequency w.
    shapes : mapping of str to float
        Shape parameters, `{"dahl.s": 0.02}`; default values of the library for missing ones.
    inputs : mapping of str to KnownInput
        Inputs that drive the motion, by their names in formulas; `input` is an acceleration (rad/s^2) on the
        right side of the equation. A missing input is zero.

    Raises
    ------
    UsageError
        The library does not have a symbol or shape parameter.
    LibraryError
        A coefficient or frequency is not a finite number, or the frequency is not positive.

    Examples
    --------
    Dry friction alone: the amplitude falls by 2 lambda in each half period, until the motion stops.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"lambda": 0.01}, reference_frequency=9.91)
    >>> motion = st.simulate(model, np.arange(0.0, 8.0, 0.01), angle=0.3)
    >>> round(motion.stop_time.item() / (np.pi / 9.91), 3)
    15.0
    >>> model.with_coefficients({"zeta": 0.0097}).forces[0].name
    'viscous friction'
    """

    library: ForceLibrary
    coefficients: Mapping[str, float]
    reference_frequency: float
    shapes: Mapping[str, float] = field(default_factory=dict)
    inputs: Mapping[str, KnownInput] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not isinstance(self.library, ForceLibrary):
            object.__setattr__(self, "library", forces.as_library(self.library, "Model"))
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
        """Terms that change the sensor's reading, not the motion."""
        return tuple(f for f in self.library if f.symbol in self.coefficients and f.kind == "sensor")

    @property
    def driven(self) -> tuple[Channel, ...]:
        """Input channels of the equation of motion; a direct forcing comes first."""
        forcing = (FORCING_CHANNEL,) if INPUT in self.inputs else ()
        return (*forcing, *channels_of(self.forces))

    @property
    def bound(self) -> "Model":
        """Model with numbers in place of the coefficients in formulas."""
        return replace(self, library=self.library.bound(self.coefficients))

    def with_coefficients(self, coefficients: Mapping[str, float]) -> "Model":
        """Return the model with other coefficients.

        Examples
        --------
        >>> import sysid_trib as st
        >>> model = st.Model("contact_forces", {"zeta": 0.0097}, reference_frequency=9.91)
        >>> [force.name for force in model.with_coefficients({"lambda": 1e-3, "zeta": 0.01}).forces]
        ['solid friction', 'viscous friction']
        """
        return replace(self, coefficients=dict(coefficients))


def rescaling_factors(forces: tuple[Force, ...], old: float, new: float) -> NDArray[np.float64]:
    """Return the factor of each coefficient when the reference frequency changes from `old` to `new` (rad/s).

    The factor is (old/new)^(2 - q) for a memoryless force that is homogeneous of degree q in v. It is NaN for
    the others, including sensor terms, which keep their reference.
    """
    degrees = [np.nan if f.speed_degree is None or f.kind == "sensor" else f.speed_degree for f in forces]
    return np.asarray((old / new) ** (2.0 - np.array(degrees)))


def check_shapes(names: Iterable[str], library: ForceLibrary) -> None:
    """Raise an error for a shape parameter, such as `dahl.s`, that no force of the library has.

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
    """Return the sensor error (sample,), its derivatives by x and v, and those by the names `by`."""
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

    Parameters
    ----------
    forces : tuple of Force
        The forces.
    forced : bool
        Whether an imposed acceleration is added: it is the first channel, before those of the forces.
    paced : bool
        Whether all rates are multiplied by `PACE`, for derivatives by the frequency.
    """

    forces: tuple[Force, ...]
    forced: bool = False
    paced: bool = False

    @cached_property
    def hidden(self) -> tuple[str, ...]:
        """Names of internal states (`dahl.z`), then of the memory between reversals (`jenkins.xr`)."""
        states = (f"{f.symbol}.{k}" for f in self.forces for k in f.state)
        return (*states, *(f"{f.symbol}.{k}" for f in self.forces for k in f.memory))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the initial values (x, v, internal states) and of the parameters."""
        shapes = (f"{f.symbol}.{k}" for f in self.forces for k in f.shape)
        # A formula may contain the coefficient of a sensor term, which is not among the forces.
        symbols = dict.fromkeys([*(f.symbol for f in self.forces), *(s for f in self.forces for s in f.uses)])
        return (BY_ANGLE, BY_RATE, *self.hidden, PACE, *symbols, *shapes, "1/w")

    @cached_property
    def channels(self) -> tuple[Channel, ...]:
        """Input channels over time."""
        return (FORCING_CHANNEL,) * self.forced + channels_of(self.forces)

    @cached_property
    def switches(self) -> dict[str, tuple[Force, Formula]]:
        """Switching surfaces, each with a force that has its names; v comes first if reversals matter."""
        switches: dict[str, tuple[Force, Formula]] = {}
        for force in self.forces:
            for surface in force.surfaces:
                switches.setdefault(surface_key(force, surface), (force, surface))
        reverses = any(f.memory or any("v" in surface.names for surface in f.surfaces) for f in self.forces)
        return {"v": (self.forces[0], RATE)} | switches if reverses else switches

    def start(self, model: Model, x: float, v: float, by: Sequence[str] = ()) -> tuple[Vector, Vector]:
        """Return the initial values of the `names` for a model, (name,), and slopes, (name, parameter)."""
        w, place = model.reference_frequency, {name: at for at, name in enumerate(self.names)}
        given = {**model.coefficients, BY_ANGLE: x, BY_RATE: v, PACE: 1.0, "1/w": 1.0 / w}
        for force in self.forces:
            given |= {f"{force.symbol}.{k}": value for k, value in force.shape_values(model.shapes).items()}
        values = np.array([given.get(name, 0.0) for name in self.names])
        slopes = np.zeros((len(place), len(by)))
        for column, name in enumerate(by):
            if name == FREQUENCY:
                # The initial v is rate/w; after it, a higher frequency speeds up the whole motion.
                slopes[place[BY_RATE], column], slopes[place[PACE], column] = -v / w, 1.0 / w
            elif name in place:
                slopes[place[name], column] = 1.0 / w if name == BY_RATE else 1.0
        for force in self.forces:
            at = {"x": place[BY_ANGLE], "v": place[BY_RATE]}
            at |= {name: place[f"{force.symbol}.{name}"] for name in force.shape}
            names = {"t": 0.0, **{name: values[its] for name, its in at.items()}}
            for name, formula in force.start.items():
                its = place[f"{force.symbol}.{name}"]
                values[its] = formula.evaluate(names)
                for origin in sorted(formula.names & at.keys()):
                    slopes[its] += float(formula.derivative(names, origin)) * slopes[at[origin]]
        return values, slopes

    @cached_property
    def program(self) -> Instructions:
        """The equations as a program of the engine, with the memory after the parameters."""
        memory = sum(len(force.memory) for force in self.forces)
        states, channels = 2 + len(self.hidden) - memory, len(self.channels)
        rows = Listing(states + 1 + channels, len(self.names) - states)
        slots = [Slot(rows, i) for i in range(rows.inputs)]
        first, behind = states + 1 + channels, rows.inputs - memory
        own = [*slots[:states], *slots[behind:], *slots[first:behind]]
        named = dict(zip(self.names, own, strict=True))
        tau, given = slots[states], slots[states + 1 : first]
        inputs = zip((channel.name for channel in self.channels), given, strict=True)
        x, v = named[BY_ANGLE], named[BY_RATE]
        common = {"x": x, "v": v, "t": tau * named["1/w"], **dict(inputs)}
        signs: dict[str, Slot] = {}
        surfaces: list[int] = []

        def names(force: Force) -> dict[str, Any]:
            """Return the names in the formulas of a force."""
            its = (*force.state, *force.shape, *force.memory)
            used = {symbol: named.get(symbol, 0.0) for symbol in force.uses}
            return common | used | {k: named[f"{force.symbol}.{k}"] for k in its}

        def value(force: Force, formula: Formula) -> Any:
            """Return the value of a formula of a force on the branch of the signs."""
            # Inner surfaces come first, so their signs are known when an outer surface is evaluated.
            known = {s.text: signs.get(surface_key(force, s), 0.0) for s in force.surfaces}
            return formula.evaluate(names(force), FUNCTIONS, known)

        for key, switch in self.switches.items():
            surfaces.append(rows.slot(value(*switch)))
            signs[key] = np.sign(Slot(rows, surfaces[-1]))
        acceleration = -x
        for force in self.forces:
            acceleration = acceleration - named[force.symbol] * value(force, force.formula)
        if self.forced:
            acceleration = acceleration + given[0]
        rates = [v, acceleration, *(value(force, f) for force in self.forces for f in force.state.values())]
        ends = [rows.slot(named[PACE] * rate if self.paced else rate) for rate in rates]
        main = len(rows.rows)
        next_values = [
            f.evaluate(names(force), FUNCTIONS) for force in self.forces for f in force.memory.values()
        ]
        outputs = ends, surfaces, [sign.index for sign in signs.values()], [*map(rows.slot, next_values)]
        return rows.tidied(main, (states, channels), outputs)


@lru_cache(maxsize=512)
def motion_of(forces: tuple[Force, ...], *, forced: bool, paced: bool) -> Motion:
    """Return the equations of motion with these forces (see `Motion`); their program is cached."""
    return Motion(forces, forced, paced)


def surface_key(force: Force, surface: Formula) -> str:
    """Return the name of a force's surface: surfaces of x, v and t are shared, those of states are not."""
    common = {"x", "v", "t", *(channel.name for channel in force.channels), *force.uses}
    return surface.text if surface.names <= common else f"{force.symbol}: {surface.text}"
