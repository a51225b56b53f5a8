"""Scaling of displacements and tiny angles to a unit of the size of the motion, and back.

Every tolerance of a computation assumes radians. A displacement of 1e-9 m or of 900 px is therefore scaled by
a power of two to the size of a usual angle, and coefficients are converted back to the record's unit. The
same is done for an angle of 1e-12 rad, unless the formula of a force needs radians. A power of two causes no
rounding, so results are the same in every unit.
"""

import inspect
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import wraps
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np
import xarray as xr

from sysid_trib import forces, records
from sysid_trib.errors import UsageError
from sysid_trib.forces import notation
from sysid_trib.forces.constraints import Constraint, Constraints, ConstraintTable
from sysid_trib.forces.force import Force, ForceLibrary
from sysid_trib.forces.library import library_of_text
from sysid_trib.forces.symmetry import as_factor
from sysid_trib.records.signal import ANGLE_UNIT, checked_signal, unit_of_signal
from sysid_trib.results.variables import PER_FORCE_UNIT, refuse_whole_result, scaling_of

P = ParamSpec("P")
R = TypeVar("R")

# rad; range of amplitudes for which a computation in radians loses no significant digit.
USUAL_ANGLES = 1e-4, 1e4
POWERS = {"rad": 1, "rad/s": 1, "rad/s^2": 1, "(rad/s^2)^2": 2, "(rad/s^2)^2/Hz": 2}
# Units of variables over coefficients.
PER_FORCE = (PER_FORCE_UNIT, "1; rad/s for the frequency")
UNIT_ATTR = "signal_unit"
SIZE_ATTR = "signal_size"


def in_units_of_the_motion(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function of decays, results and libraries that computes in a unit of the motion.

    Parameters
    ----------
    function : callable
        A function of Datasets, DataTrees, lists of them, force libraries and methods. Usual angles are not
        scaled.

    Raises
    ------
    UsageError
        Raised by the returned function if a force needs radians, `sin(x)`, but no angle was measured.
    """
    parameters = inspect.signature(function).parameters
    names = list(parameters)
    one_identification = "result" in parameters and parameters["result"].annotation is xr.Dataset

    @wraps(function)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        given: dict[str, Any] = dict(zip(names, args, strict=False)) | kwargs
        given |= _usual_forms(function.__name__, given)
        if one_identification:
            refuse_whole_result(given.get("result"))
        scale = _scale_of(given)
        if scale is None:
            return function(**given)  # type: ignore[call-arg]
        if isinstance(candidates := given.get("candidates"), ForceLibrary):
            # Leave out default candidates that need radians; raise an error for named forces.
            kept = tuple(force for force in candidates if scalable(force))
            given["candidates"] = replace(candidates, forces=kept)
        inside = scale.inwards(given)
        if given.get("constraints"):
            inside["constraints"] = scale.constraints(given["constraints"])
        return cast(R, scale.outwards(function(**inside)))  # type: ignore[call-arg]

    return run


def _usual_forms(name: str, given: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the record and the library of a call to Datasets and a `ForceLibrary`."""
    changed: dict[str, Any] = {}
    decay = given.get("decay")
    library_given = given.get("library")
    runs = decay if isinstance(decay, list | tuple) else [decay]
    if decay is not None and not all(isinstance(run, xr.Dataset) for run in runs):
        changed["decay"] = records.as_decays(decay, name)
    if library_given is not None and not isinstance(library_given, ForceLibrary):
        changed["library"] = forces.as_library(library_given, name)
    return changed


def counts_angles(decay: xr.Dataset) -> bool:
    """Return true if the signal of a decay is an angle in rad."""
    return unit_of_signal(decay) == ANGLE_UNIT


def scalable(force: Force) -> bool:
    """Return true if a force is defined for a displacement: its formula does not need radians."""
    return notation.signal_powers(force) is not None


@dataclass(frozen=True)
class _SignalScale:
    """Scale of a signal: its unit, the size counted as one, and the degrees of the forces by symbol.

    `inputs` are those in the unit of the signal; the others are unchanged.
    """

    unit: str
    size: float
    degrees: dict[str, notation.Powers] = field(default_factory=dict)
    inputs: frozenset[str] = frozenset()

    def inwards(self, given: Any) -> Any:
        """Convert arguments to the scaled signal used in computations."""
        return _changed(given, self._scaled)

    def outwards(self, made: Any) -> Any:
        """Convert results to the unit of the record; separate forces of runs have their own names."""
        whole = replace(self, degrees=_degrees(made) | self.degrees)
        return _changed(made, lambda part: whole._dataset(part) if isinstance(part, xr.Dataset) else part)

    def _scaled(self, given: Any) -> Any:
        if isinstance(given, ForceLibrary):
            if refused := [force.symbol for force in given if not scalable(force)]:
                raise UsageError(
                    f"Force '{refused[0]}' is a function of an angle, but a displacement in {self.unit} was "
                    "measured; leave it out, or give the pendulum's length, --length M (length= in Python)."
                )
            return given
        if isinstance(given, xr.Dataset):
            return self._dataset(given, inside=True)
        return self._method(given) if is_dataclass(given) and hasattr(given, "identify") else given

    def _dataset(self, data: xr.Dataset, inside: bool = False) -> xr.Dataset:
        """Multiply every variable that is a signal or a coefficient by its factor; others are unchanged."""
        factor = self.size
        old = ANGLE_UNIT
        new = self.unit
        if inside:
            factor, old, new = 1.0 / factor, new, old
        changed = data.copy()
        for key, variable in data.variables.items():
            name = str(key)
            attrs = dict(variable.attrs)
            units = unit_of_signal(data) if name == "angle" else str(attrs.get("units", ""))
            scaling = scaling_of(name)
            power = _power(units, old) if scaling == "unit" else 0
            if attrs.get("role") == "input" and name != "input":
                power = int(name in self.inputs)
                units = units or old
            if power:
                values = variable.values * factor**power
                changed[name] = (variable.dims, values, attrs | {"units": units.replace(old, new)})
            elif units in PER_FORCE or scaling in ("coefficient", "shape"):
                # The shapes of competing effects of each step are in one row.
                dims = variable.dims[-1:] if scaling == "shape" else variable.dims
                changed[name] = (variable.dims, (variable * self._factors(data, dims, factor)).values, attrs)
        dims = data["unit"].dims if "unit" in data.variables else ()
        labels = _labels(data, str(dims[0])) if len(dims) == 1 else None
        if labels is not None:
            units_of = [self._unit(s, u, inside) for s, u in zip(labels, data.unit.values, strict=True)]
            changed["unit"] = (dims, units_of, data.unit.attrs)
        marks = {} if new == ANGLE_UNIT else {UNIT_ATTR: self.unit, SIZE_ATTR: self.size}
        kept = {k: v for k, v in data.attrs.items() if k not in (UNIT_ATTR, SIZE_ATTR)}
        changed.attrs = kept | marks
        return changed

    def _factors(self, data: xr.Dataset, dims: Sequence[Hashable], factor: float) -> Any:
        """Return the factor of each coefficient along the dimensions that count forces: unit^(1-p)."""
        total: Any = 1.0
        for dim in dims:
            if (labels := _labels(data, str(dim))) is not None:
                powers = np.array([self._power_of(str(label)) for label in labels])
                total = total * xr.Variable((dim,), factor**powers)
        return total

    def _power_of(self, name: str) -> float:
        """Return the power of the signal in a coefficient, or in a shape parameter such as `dahl.s`."""
        symbol, _, shape = name.partition(".")
        return self.degrees.get(symbol, {}).get(shape, 0.0)

    def _unit(self, symbol: str, unit: str, inside: bool) -> str:
        """Return the unit of a coefficient: a power of the signal's unit, and of s for a drift."""
        power = self._power_of(symbol)
        own, slash, of_inputs = unit.partition("/")
        time = next((part for part in own.split() if part.startswith("s-") or part == "s"), "")
        if inside or not power:
            return (time or "1") + slash + of_inputs
        signal = self.unit if power == 1 else f"{as_factor(self.unit)}^{power:g}"
        return (f"{signal} {time}" if time else signal) + slash + of_inputs

    def _method(self, method: Any) -> Any:
        """Return a method whose options, given in the record's unit, are those of the scaled motion."""
        given = {part.name: getattr(method, part.name) for part in fields(method)}
        changes: dict[str, Any] = {}
        if given.get("shapes"):
            changes["shapes"] = self._parameters(given["shapes"])
        if (start := given.get("start")) is not None:
            scaled = {name: self._parameters(getattr(start, name)) for name in ("coefficients", "shapes")}
            changes["start"] = replace(start, **scaled)
        if not isinstance(given.get("random_force", ""), str):
            changes["random_force"] = method.random_force / self.size**2
        if given.get("constraints"):
            changes["constraints"] = self.constraints(method.constraints)
        return replace(method, **changes) if changes else method

    def constraints(self, table: ConstraintTable) -> ConstraintTable:
        """Return the constraints on the parameters of the scaled motion."""
        asked = Constraints(table)
        if asked.ties:
            raise UsageError(
                f"A tie needs an angle, but a displacement in {self.unit} was measured; leave it out."
            )
        scaled: dict[str, Constraint] = dict(self._parameters(asked.fixed))
        for name, ends in asked.bounds.items():
            low, high = (end * self._of_parameter(name) if np.isfinite(end) else None for end in ends)
            scaled[name] = (low, high)
        return scaled

    def _parameters(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the coefficients and shape parameters of the scaled motion."""
        return {name: value * self._of_parameter(name) for name, value in values.items()}

    def _of_parameter(self, name: str) -> float:
        return float(self.size ** -self._power_of(name))


def _scale_of(given: dict[str, Any]) -> _SignalScale | None:
    """Return the scale of a result, or of the motions of decays; None for usual angles."""
    datasets = [part for part in _parts(given) if isinstance(part, xr.Dataset)]
    known = [d for d in datasets if UNIT_ATTR in d.attrs]
    decays = [d for d in datasets if "angle" in d and UNIT_ATTR not in d.attrs]
    for decay in decays:
        checked_signal(decay)
    _refuse_mixed_units([unit_of_signal(decay) for decay in decays] + _units_of_results(datasets))
    largest = max((float(np.abs(decay["angle"].values).max()) for decay in decays), default=0.0)
    displacements = [decay for decay in decays if not counts_angles(decay)]
    if not known and not displacements:
        usual = USUAL_ANGLES[0] <= largest <= USUAL_ANGLES[1] or not largest
        wanted = {name: argument for name, argument in given.items() if name != "candidates"}
        tables = [of for of in given.values() if isinstance(of, dict)]
        tables += [getattr(argument, "constraints", {}) for argument in given.values()]
        tied = any(isinstance(value, str) for table in tables for value in table.values())
        if usual or tied or not all(map(scalable, _forces(wanted))):
            return None
    degrees = _degrees(given)
    inputs = frozenset(c.input for force in _forces(given) for c in force.channels if c.kind)
    if known:
        return _SignalScale(str(known[0].attrs[UNIT_ATTR]), float(known[0].attrs[SIZE_ATTR]), degrees, inputs)
    # A signal that is constant or not finite is rejected where it is used. The largest displacement becomes
    # 1/4 to 1/2: a usual angle in rad.
    size = 2.0 ** np.ceil(np.log2(largest / 0.5)) if 0.0 < largest < np.inf else 1.0
    unit = unit_of_signal((displacements or decays)[0])
    return _SignalScale(unit, float(size), degrees, inputs)


def _units_of_results(datasets: Sequence[xr.Dataset]) -> list[str]:
    """Return the units in which results were identified: those of their noise."""
    noises = [
        d["noise"].attrs.get("units") for d in datasets if {"noise", "coefficient"} <= d.variables.keys()
    ]
    return [str(units).partition("/")[0] for units in noises if units]


def _refuse_mixed_units(units: Sequence[str]) -> None:
    """Raise an error for records and results that do not all have the same unit."""
    if len(different := sorted({*units})) > 1:
        raise UsageError(
            f"The records and results are in different units ({', '.join(different)}); convert them to one."
        )


def _degrees(given: Any) -> dict[str, notation.Powers]:
    """Return the degree of each given force that has one, by symbol."""
    return {force.symbol: degree for force in _forces(given) if (degree := notation.signal_powers(force))}


def _changed(given: Any, change: Callable[[Any], Any]) -> Any:
    """Apply a change to each part of trees, lists and dicts."""
    if isinstance(given, xr.DataTree):
        groups = {node.path: change(node.to_dataset(inherit=False)) for node in given.subtree}
        return xr.DataTree.from_dict(groups)
    if isinstance(given, (list, tuple)):
        return type(given)(_changed(item, change) for item in given)
    if isinstance(given, dict):
        return {key: _changed(item, change) for key, item in given.items()}
    return change(given)


def _parts(given: Any) -> list[Any]:
    """Return the parts of trees, lists and dicts."""
    parts: list[Any] = []
    _changed(given, parts.append)
    return parts


def _forces(given: Any) -> Iterator[Force]:
    """Yield the forces of given libraries, and those in results."""
    for part in _parts(given):
        if isinstance(part, ForceLibrary):
            yield from part
        elif isinstance(part, xr.Dataset):
            for name in ("library", "candidates"):
                if name in part.attrs:
                    yield from library_of_text(str(part.attrs[name]), "")


def _power(units: str, old: str) -> int:
    """Return the power of the signal in a variable's unit."""
    return POWERS.get(units.replace(old, ANGLE_UNIT), 0) if old in units else 0


def _labels(data: xr.Dataset, dim: str) -> Any:
    """Return the symbols of the forces along a dimension; None if it is a dimension of other items."""
    counting = ("force", "other_force", "candidate", "quantity", "parameter")
    if (dim in counting or dim.endswith("shape_parameter")) and dim in data.coords:
        return data[dim].values
    if dim == "step" and "symbol" in data.variables and data["symbol"].dims == ("step",):
        return data["symbol"].values
    return None
