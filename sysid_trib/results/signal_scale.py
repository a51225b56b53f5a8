"""Displacements and tiny angles: computed in a unit of their own motion, and told in that of the record.

Every tolerance of a computation means radians. A displacement of 1e-9 m or of 900 px is therefore counted
in a power of two of its unit near the motion's own size, in which it looks like an angle; coefficients come
back in the record's unit. So is an angle of 1e-12 rad, unless a force knows a radian. A power of two rounds
nothing, so that results are the same in every unit.
"""

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.forces.constraints import Constraint, Constraints, ConstraintTable
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.library import library_of_text
from sysid_trib.forces.notation import Powers, signal_powers
from sysid_trib.records.signal import ANGLE_UNIT, checked_signal, unit_of_signal
from sysid_trib.results.variables import PER_FORCE_UNIT

P = ParamSpec("P")
R = TypeVar("R")

# rad; amplitudes for which a computation in radians loses no digit that counts.
USUAL_ANGLES = 1e-4, 1e4
# Variables in rad or rad/s that are no signal: phases and frequencies have no unit of length.
NO_SIGNAL = ("phase", "frequency", "refers_to", "omega0")
POWERS = {"rad": 1, "rad/s": 1, "rad/s^2": 1, "(rad/s^2)^2/Hz": 2}
UNIT_ATTR, SIZE_ATTR = "signal_unit", "signal_size"


def in_units_of_the_motion(function: Callable[P, R]) -> Callable[P, R]:
    """A function of decays, results and libraries that computes displacements in a unit of their motion.

    Parameters
    ----------
    function : callable
        Takes and gives Datasets, DataTrees, lists of them, force libraries, methods. Angles pass as they are.

    Raises
    ------
    UsageError
        The function does if a force is asked for that knows a radian, `sin(x)`, where no angle was measured.
    """
    names = list(inspect.signature(function).parameters)

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        given: dict[str, Any] = dict(zip(names, args, strict=False)) | kwargs
        scale = _scale_of(given)
        if scale is None:
            return function(*args, **kwargs)
        if isinstance(candidates := given.get("candidates"), ForceLibrary):
            # What may be missing is offered as far as it can be; what is asked for is refused by name.
            kept = tuple(force for force in candidates if scalable(force))
            given["candidates"] = replace(candidates, forces=kept)
        inside = {name: scale.inwards(argument) for name, argument in given.items()}
        if given.get("constraints"):
            inside["constraints"] = scale.constraints(given["constraints"])
        made = function(**inside)  # type: ignore[call-arg]
        return cast(R, scale.knowing(made).outwards(made))

    return run


def counts_angles(decay: xr.Dataset) -> bool:
    """True if the signal of a decay is an angle in rad."""
    return unit_of_signal(decay) == ANGLE_UNIT


def scalable(force: Force) -> bool:
    """True if a force has a meaning for a displacement: it knows no radian."""
    return signal_powers(force) is not None


@dataclass(frozen=True)
class _SignalScale:
    """Unit of a record, and how much of it is counted as one; degrees of the forces by symbol.

    `inputs` are those in the unit of the signal; others stay as they are.
    """

    unit: str
    size: float
    degrees: dict[str, Powers] = field(default_factory=dict)
    inputs: frozenset[str] = frozenset()

    def knowing(self, made: Any) -> "_SignalScale":
        """With the forces of what was made: each run's own have names of their own."""
        return replace(self, degrees=_degrees([made]) | self.degrees)

    def inwards(self, given: Any) -> Any:
        """What is computed with."""
        if isinstance(given, ForceLibrary):
            refused = [force.symbol for force in given if not scalable(force)]
            if refused:
                raise UsageError(
                    f"Force '{refused[0]}' is a function of an angle, but a displacement in {self.unit} was "
                    "measured; leave it out, or give the pendulum's length, --length M (length= in Python)."
                )
            return given
        if isinstance(given, xr.Dataset):
            return self._dataset(given, 1.0 / self.size, self.unit, ANGLE_UNIT)
        if isinstance(given, xr.DataTree):
            return self._tree(given, 1.0 / self.size, self.unit, ANGLE_UNIT)
        if isinstance(given, (list, tuple)):
            return type(given)(self.inwards(item) for item in given)
        if isinstance(given, dict):
            return {key: self.inwards(item) for key, item in given.items()}
        return self._method(given) if is_dataclass(given) and hasattr(given, "identify") else given

    def outwards(self, made: Any) -> Any:
        """What comes out, in the unit of the record."""
        if isinstance(made, xr.Dataset):
            return self._dataset(made, self.size, ANGLE_UNIT, self.unit)
        if isinstance(made, xr.DataTree):
            return self._tree(made, self.size, ANGLE_UNIT, self.unit)
        if isinstance(made, (list, tuple)):
            return type(made)(self.outwards(item) for item in made)
        return made

    def _tree(self, tree: xr.DataTree, factor: float, old: str, new: str) -> xr.DataTree:
        groups = {node.path: node.to_dataset(inherit=False) for node in tree.subtree}
        changed = xr.DataTree.from_dict({k: self._dataset(d, factor, old, new) for k, d in groups.items()})
        return changed

    def _dataset(self, data: xr.Dataset, factor: float, old: str, new: str) -> xr.Dataset:
        """Every variable that is a signal, or a coefficient, times its factor; other ones as they are."""
        changed = data.copy()
        for name, variable in data.variables.items():
            units = unit_of_signal(data) if name == "angle" else str(variable.attrs.get("units", ""))
            power = _power(str(name), units, old)
            if variable.attrs.get("role") == "input" and name != "input":
                power, units = int(name in self.inputs), units or old
            if power:
                attrs = dict(variable.attrs) | {"units": units.replace(old, new)}
                changed[name] = (variable.dims, variable.values * factor**power, attrs)
            elif units == PER_FORCE_UNIT or _per_force(str(name), units):
                changed[name] = (
                    variable.dims,
                    variable.values * self._factors(data, variable, factor),
                    variable.attrs,
                )
        changed = self._shapes(changed, factor)
        dims = data["unit"].dims if "unit" in data.variables else ()
        labels = _labels(data, str(dims[0])) if len(dims) == 1 else None
        if labels is not None:
            inside = new == ANGLE_UNIT
            units_of = [self._unit(s, u, inside) for s, u in zip(labels, data.unit.values, strict=True)]
            changed["unit"] = (dims, units_of, data.unit.attrs)
        marks = {} if new == ANGLE_UNIT else {UNIT_ATTR: self.unit, SIZE_ATTR: self.size}
        kept = {k: v for k, v in data.attrs.items() if k not in (UNIT_ATTR, SIZE_ATTR)}
        changed.attrs = kept | marks
        return changed

    def _factors(self, data: xr.Dataset, variable: xr.Variable, factor: float) -> Any:
        """Factor of each coefficient along the dimensions that count forces: unit^(1-p)."""
        total: Any = 1.0
        for at, dim in enumerate(variable.dims):
            labels = _labels(data, str(dim))
            if labels is not None:
                powers = [self._coefficient_power(str(label)) for label in labels]
                shape = [1] * len(variable.dims)
                shape[at] = len(powers)
                total = total * (factor ** np.array(powers)).reshape(shape)
        return total

    def _coefficient_power(self, symbol: str) -> float:
        if "." in symbol:
            return self._shape_power(symbol)
        degree = self.degrees.get(symbol)
        return 0.0 if degree is None else degree.coefficient

    def _unit(self, symbol: str, unit: str, inside: bool) -> str:
        """Unit of a coefficient: a power of the signal's, and of s where it drifts."""
        power = self._coefficient_power(symbol)
        own, slash, of_inputs = unit.partition("/")
        time = next((part for part in own.split() if part.startswith("s-") or part == "s"), "")
        if inside or not power:
            return (time or "1") + slash + of_inputs
        signal = f"{self.unit}{'' if power == 1 else f'^{power:g}'}{f' {time}' if time else ''}"
        return signal + slash + of_inputs

    def _shapes(self, data: xr.Dataset, factor: float) -> xr.Dataset:
        for name in ("shape", "shape_standard_error", "competing_shape"):
            if name in data and str(dim := data[name].dims[-1]).endswith("shape_parameter"):
                powers = np.array([self._shape_power(str(key)) for key in data[dim].values])
                data[name] = data[name] * factor**powers
        return data

    def _shape_power(self, name: str) -> float:
        symbol, _, shape = name.partition(".")
        degree = self.degrees.get(symbol)
        return 0.0 if degree is None else degree.shapes.get(shape, 0.0)

    def _method(self, method: Any) -> Any:
        """A method whose options, given in the record's unit, are those of the scaled motion."""
        names = {part.name for part in fields(method)}
        changes: dict[str, Any] = {}
        if "shapes" in names and method.shapes:
            changes["shapes"] = {k: v * self.size ** -self._shape_power(k) for k, v in method.shapes.items()}
        if (start := getattr(method, "start", None)) is not None:
            scaled = [
                {name: value * self._of_parameter(name) for name, value in table.items()}
                for table in (start.coefficients, start.shapes)
            ]
            changes["start"] = replace(start, coefficients=scaled[0], shapes=scaled[1])
        if "random_force" in names and not isinstance(method.random_force, str):
            changes["random_force"] = method.random_force / self.size**2
        if "constraints" in names and method.constraints:
            changes["constraints"] = self.constraints(method.constraints)
        return replace(method, **changes) if changes else method

    def constraints(self, table: ConstraintTable) -> ConstraintTable:
        """Constraints on the parameters of the scaled motion."""
        asked = Constraints(table)
        if asked.ties:
            raise UsageError(
                f"A tie needs an angle, but a displacement in {self.unit} was measured; leave it out."
            )
        scaled: dict[str, Constraint] = {
            name: value * self._of_parameter(name) for name, value in asked.fixed.items()
        }
        for name, ends in asked.bounds.items():
            low, high = (end * self._of_parameter(name) if np.isfinite(end) else None for end in ends)
            scaled[name] = (low, high)
        return scaled

    def _of_parameter(self, name: str) -> float:
        power = self._shape_power(name) if "." in name else self._coefficient_power(name)
        return float(self.size**-power)


def _scale_of(given: dict[str, Any]) -> _SignalScale | None:
    """The scale of what is given: that of a result, or of the motions of decays; None of usual angles."""
    arguments = list(given.values())
    datasets = list(_datasets(arguments))
    known = [d for d in datasets if UNIT_ATTR in d.attrs]
    decays = [d for d in datasets if "angle" in d and UNIT_ATTR not in d.attrs]
    largest = 0.0
    for decay in decays:
        checked_signal(decay)
        largest = max(largest, float(np.abs(decay["angle"].values).max()))
    displacements = [decay for decay in decays if not counts_angles(decay)]
    if not known and not displacements:
        usual = USUAL_ANGLES[0] <= largest <= USUAL_ANGLES[1] or not largest
        wanted = [argument for name, argument in given.items() if name != "candidates"]
        if usual or not all(map(scalable, _forces(wanted))) or _has_ties(wanted):
            return None
    degrees = _degrees(arguments)
    inputs = frozenset(c.input for force in _forces(arguments) for c in force.channels if c.kind)
    if known:
        return _SignalScale(str(known[0].attrs[UNIT_ATTR]), float(known[0].attrs[SIZE_ATTR]), degrees, inputs)
    # What does not move, or is no number, is refused where it is used.
    # The largest displacement becomes 1/4 to 1/2: a usual angle in rad.
    size = 2.0 ** np.ceil(np.log2(largest / 0.5)) if 0.0 < largest < np.inf else 1.0
    unit = unit_of_signal((displacements or decays)[0])
    return _SignalScale(unit, float(size), degrees, inputs)


def _degrees(given: Any) -> dict[str, Powers]:
    """Degree of each force that is given and has one, by symbol."""
    return {force.symbol: degree for force in _forces(given) if (degree := signal_powers(force))}


def _has_ties(given: Sequence[Any]) -> bool:
    """True if a table of constraints, or the methods, tie parameters to others."""
    tables = [getattr(argument, "constraints", {}) for argument in given]
    tables += [argument for argument in given if isinstance(argument, dict)]
    return any(isinstance(value, str) for table in tables for value in table.values())


def _datasets(given: Any) -> Iterator[xr.Dataset]:
    if isinstance(given, xr.Dataset):
        yield given
    elif isinstance(given, xr.DataTree):
        yield from (node.to_dataset(inherit=False) for node in given.subtree)
    elif isinstance(given, (list, tuple)):
        for item in given:
            yield from _datasets(item)
    elif isinstance(given, dict):
        yield from _datasets(list(given.values()))


def _forces(given: Any) -> Iterator[Force]:
    """Forces of libraries that are given, and of those that results hold."""
    if isinstance(given, ForceLibrary):
        yield from given
    elif isinstance(given, (list, tuple)):
        for item in given:
            yield from _forces(item)
    elif isinstance(given, dict):
        yield from _forces(list(given.values()))
    else:
        for data in _datasets(given):
            for name in ("library", "candidates"):
                if name in data.attrs:
                    yield from library_of_text(str(data.attrs[name]), "")


def _power(name: str, units: str, old: str) -> int:
    """Power of the signal in a variable's unit; zero of frequencies and phases."""
    if any(part in name for part in NO_SIGNAL) or old not in units:
        return 0
    return POWERS.get(units.replace(old, ANGLE_UNIT), 0)


def _per_force(name: str, units: str) -> bool:
    """True if a variable with a frequency's unit is one by coefficients: their covariance with it."""
    return name == "frequency_covariance" or units == "1; rad/s for the frequency"


def _labels(data: xr.Dataset, dim: str) -> Any:
    """Symbols of the forces along a dimension; None if it counts something else."""
    if dim in ("force", "other_force", "candidate", "quantity", "parameter") and dim in data.coords:
        return data[dim].values
    if dim == "step" and "symbol" in data.variables and data["symbol"].dims == ("step",):
        return data["symbol"].values
    return None
