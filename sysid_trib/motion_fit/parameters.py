"""The parameters of a trajectory fit: names, blocks, bounds, fixed values and ties, in one vector."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sysid_trib.arrays import Array
from sysid_trib.errors import UsageError
from sysid_trib.forces.constraints import Constraints, tied_slopes, tied_value
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.formulas import Formula
from sysid_trib.forces.selection import is_free_to_move
from sysid_trib.simulation.model import FREQUENCY, Model

# Parameters of each run: angle (rad) and rate (rad/s) at its first sample, zero of the sensor (rad).
PER_RUN = ("start_angle", "start_rate", "offset")


@dataclass(frozen=True)
class Parameters:
    """Parameters in the order of their vector: coefficients, shapes, frequency, then three for each run.

    Parameters
    ----------
    library : ForceLibrary
        The forces, with one coefficient each.
    reference_frequency : float or None
        Reference frequency w (rad/s) if it is fixed; None if it is a parameter.
    fit_shapes : tuple of str
        Shape parameters that are fitted.
    shapes : mapping of str to float
        Values of the held shape parameters, and first values of the fitted ones.
    runs : int
        Number of runs.
    constraints : Constraints
        Fixed values, bounds and ties.
    """

    library: ForceLibrary
    reference_frequency: float | None = None
    fit_shapes: tuple[str, ...] = ()
    shapes: Mapping[str, float] = field(default_factory=dict)
    runs: int = 1
    constraints: Constraints = field(default_factory=Constraints)

    def completed(self) -> "Parameters":
        """Return the parameters with tied shapes fitted, fixed ones held, and the sensor's zero decided.

        Raises
        ------
        UsageError
            A shape or constraint does not belong to these forces.
        """
        library, constraints, shapes = self.library, self.constraints, self.library.shape_values()
        constraints.check(library)
        fitted = tuple(dict.fromkeys((*self.fit_shapes, *(k for k in constraints.ties if k in shapes))))
        for name in fitted:
            if name not in shapes:
                raise UsageError(f"There is no shape parameter '{name}' among the forces to identify.")
        for name in constraints.bounds:
            if name in shapes and name not in fitted:
                raise UsageError(
                    f"Shape parameter {name} is fixed, so its bound has no effect; name it in fit_shapes."
                )
        held = {**self.shapes, **{name: value for name, value in constraints.fixed.items() if name in shapes}}
        whole = replace(self, fit_shapes=fitted, shapes=held)
        if not (is_free_to_move(library, constraints.fixed) or library.has_common_zero):
            return whole
        # A free motion does not separate the sensor's zero from the start of a free body, or from a common
        # zero.
        return whole.fix({name: 0.0 for name in whole.names if name.startswith(PER_RUN[-1])})

    @cached_property
    def common(self) -> tuple[str, ...]:
        """Names of the parameters that all runs share."""
        frequency = (FREQUENCY,) if self.reference_frequency is None else ()
        return (*self.library.symbols, *self.fit_shapes, *frequency)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters; those of a run end with its number from 0."""
        return (*self.common, *(f"{name} of run {run}" for run in range(self.runs) for name in PER_RUN))

    def __len__(self) -> int:
        return len(self.common) + len(PER_RUN) * self.runs

    def index(self, name: str) -> int:
        """Return the index of a parameter in the vector."""
        return self.names.index(name)

    def of_run(self, run: int) -> slice:
        """Return the indices of the parameters of a run."""
        first = len(self.common) + len(PER_RUN) * run
        return slice(first, first + len(PER_RUN))

    def per_run(self, values: Array) -> Array:
        """Return the angle, rate and offset of each run, (run, 3) array of float."""
        return values[len(self.common) :].reshape(-1, len(PER_RUN))

    def acting(self, run: int) -> list[int]:
        """Return the indices of the common parameters that act in a run, without those of other runs."""
        symbols = {f.symbol for f in self.library if f.run not in (None, run + 1)}
        return [i for i, name in enumerate(self.common) if name.partition(".")[0] not in symbols]

    def model(self, values: Array, run: int = 0) -> Model:
        """Return the model with these values, in a run."""
        value = dict(zip(self.common, values.tolist(), strict=False))
        # The optimiser may step below zero: only the square of the frequency matters.
        frequency = abs(value[FREQUENCY]) if self.reference_frequency is None else self.reference_frequency
        library = self.library.in_run(run + 1)
        coefficients = {symbol: value[symbol] for symbol in library.symbols}
        shapes = {**self.shapes, **{name: value[name] for name in self.fit_shapes}}
        if len(library) < len(self.library):
            shapes = {name: shape for name, shape in shapes.items() if name in library.shape_values()}
        return Model(library, coefficients, frequency, shapes)

    def pack(self, values: Mapping[str, float], per_run: ArrayLike) -> Array:
        """Return all parameters as one vector.

        Parameters
        ----------
        values : mapping of str to float
            Common parameters by name; a missing coefficient is 0, a missing shape is fixed or nan.
        per_run : (run, 3) array of float
            Angle (rad), rate (rad/s) and offset (rad) of each run.
        """
        known = {**dict.fromkeys(self.fit_shapes, np.nan), **self.shapes, **values}
        common = [known.get(name, 0.0) for name in self.common]
        return np.array([*common, *np.ravel(per_run)])

    def fix(self, fixed: Mapping[str, float]) -> "Parameters":
        """Return the parameters with further ones held at these values."""
        return replace(self, constraints=self.constraints.holding(fixed))

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Lowest and highest value of each parameter, from the bounds and the shapes' ranges."""
        ranges = {f"{f.symbol}.{k}": (s.low, s.high) for f in self.library for k, s in f.shape.items()}
        ranges |= self.constraints.bounds
        low, high = np.array([ranges.get(name, (-np.inf, np.inf)) for name in self.names], dtype=float).T
        return low, high

    @cached_property
    def free(self) -> NDArray[np.intp]:
        """Indices of the parameters that are neither fixed nor tied."""
        held = {*self.constraints.fixed, *self.constraints.ties}
        return np.array([i for i, name in enumerate(self.names) if name not in held])

    def expand(self, free: Array) -> Array:
        """Return all parameters from the free ones: fixed and tied values are set.

        Parameters
        ----------
        free : (free,) array of float
            Values of the free parameters.
        """
        values = np.zeros(len(self))
        values[self.free] = free
        for name, value in self.constraints.fixed.items():
            if name in self.names:
                values[self.index(name)] = value
        for name, tie in self._ties.items():
            values[self.index(name)] = tied_value(tie, self._known(values))
        return values

    def jacobian(self, values: Array) -> Array:
        """Return the derivative of each parameter by the free ones, (parameter, free) array of float."""
        rows = np.zeros((len(self), len(self.free)))
        rows[self.free, range(len(self.free))] = 1.0
        for name, tie in self._ties.items():
            for other, slope in tied_slopes(tie, self._known(values)).items():
                if other in self.common:
                    rows[self.index(name)] += slope * rows[self.index(other)]
        return rows

    @cached_property
    def _ties(self) -> Mapping[str, Formula]:
        return self.constraints.formulas(self.library)

    def _known(self, values: Array) -> dict[str, float]:
        """Return the values by name, including held shapes."""
        held = self.library.shape_values(self.shapes)
        return held | dict(zip(self.common, values.tolist(), strict=False))
