"""The equations of motion and their derivatives at many instants at once, on the branches that are given.

Derivatives are complex steps (Squire and Trapp 1998): on a branch every formula is analytic, and the
imaginary part of its value at z + i e is e times the derivative, without a difference of near numbers.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.forces.formulas import ANALYTIC, IMAGINARY_STEP, NUMPY, SWITCHING, Functions, power
from sysid_trib.simulation.equations import SMOOTHED, Motion
from sysid_trib.simulation.model import Model


def _power(base: Array, exponent: complex) -> Array:
    """Whole powers; broken ones smoothed where the base is zero, as the compiled engine does."""
    if isinstance(exponent, int | float) and float(exponent).is_integer():
        return np.asarray(power(base, int(exponent)))
    return np.asarray(base * (base * base + SMOOTHED**2) ** (0.5 * (exponent - 1.0)))


FUNCTIONS: Functions = {
    **NUMPY,
    "power": _power,
    "sqrt": lambda u: _power(u, 0.5),
    "log": lambda u: 0.5 * np.log(u * u + SMOOTHED**2),
    "below": lambda u, then, other: np.where(np.asarray(u) < 0.0, then, other),
}

# The same where no sign is given: branches by the real part.
BRANCHING: Functions = {**FUNCTIONS, **{name: ANALYTIC[name] for name in SWITCHING}}


@dataclass(frozen=True)
class Instants:
    """States of a motion at many instants, each on a branch of its own.

    Attributes
    ----------
    y : (state, instant) array of float
        x, v, internal states, memory.
    tau : (instant,) array of float
        Or complex, for a derivative.
    signs : (switch, instant) array of float
        On which side of each switching surface it is.
    stuck : (instant,) array of bool
        Whether friction holds it.
    """

    y: Array
    tau: Any
    signs: Array
    stuck: Mask

    def at(self, chosen: Index) -> "Instants":
        """Some of the instants."""
        return Instants(self.y[:, chosen], self.tau[chosen], self.signs[:, chosen], self.stuck[chosen])


@dataclass(frozen=True)
class VectorField:
    """The equations of motion of a model, with derivatives by the state and by some of its parameters.

    Parameters
    ----------
    model : Model
    names : tuple of str
        Coefficients and shape parameters by which derivatives are taken.
    frequency : bool
        Whether the last derivative is by the reference frequency.
    """

    model: Model
    names: tuple[str, ...] = ()
    frequency: bool = False

    @cached_property
    def motion(self) -> Motion:
        """The switching system of the forces; sensor terms do not act."""
        return Motion(self.model.forces, self._push)

    @cached_property
    def _push(self) -> Callable[[Any], Any] | None:
        known, frequency = self.model.known_input, self.model.reference_frequency
        return None if known is None else lambda tau: known.over_stiffness(tau, frequency)

    @cached_property
    def size(self) -> int:
        """Number of states, memory among them."""
        return len(self.motion.variables) + len(self.motion.memory)

    @cached_property
    def _fixed(self) -> list[float]:
        return self.motion.parameters(self.model)[: self.motion.memory_at.start].tolist()

    def parameters(self, here: Instants, signs: Sequence[Array] | None = None) -> list[Array]:
        """`p` of `Motion` at the instants: what is fixed, the memory, the signs."""
        memory = here.y[len(self.motion.variables) :]
        return [*self._fixed, *memory, *(here.signs if signs is None else signs)]

    def rates(self, here: Instants) -> Array:
        """Derivative of the state by tau, (state, instant); at rest x and v do not change."""
        rates = self._rates(list(here.y), self._fixed, here)
        return np.where(here.stuck & (np.arange(self.size) < 2)[:, None], 0.0, rates)

    def _rates(self, y: Sequence[Array], fixed: Sequence[Array | float], here: Instants) -> Array:
        count = len(self.motion.variables)
        p = [*fixed, *y[count:], *here.signs]
        return self._table(self.motion.rates(y[:count], p, here.tau, FUNCTIONS), here.tau.shape)

    def _table(self, rates: Sequence[Any], shape: tuple[int, ...]) -> Array:
        """Rates as (state, *shape); memory has none."""
        table = np.zeros((self.size, *shape), np.result_type(*rates))
        for row, rate in zip(table, rates, strict=False):
            row[...] = rate
        return table

    def derivatives(self, here: Instants) -> tuple[Array, Array, Array]:
        """Rates of the state, and their derivatives.

        Returns
        -------
        rates : (state, instant) array of float
        by_state : (state, state, instant) array of float
        by_parameter : (state, parameter, instant) array of float

        Notes
        -----
        Time in formulas is held when the frequency changes: d(rates)/dw = rates/w in tau of a given time, and
        that of a known input over w^2 is -2/w of it besides.
        """
        # Each state has its imaginary step in a row of its own, so that one evaluation serves all.
        y = np.repeat(here.y[:, None].astype(complex), self.size, axis=1)
        y[range(self.size), range(self.size)] += 1j * IMAGINARY_STEP
        values, stepped = self._stepped_rates(y, here)
        by_state, rates = stepped.imag / IMAGINARY_STEP, stepped[:, 0].real.copy()
        by_parameter = np.zeros((self.size, len(self.names) + self.frequency, here.y.shape[1]))
        for k, name in enumerate(self.names):
            place = self._places.get(name)
            if place in values:
                by_parameter[1, k] = -np.real(values[place])
            elif place is not None:
                fixed = list[Any](self._fixed)
                fixed[place] += 1j * IMAGINARY_STEP
                by_parameter[:, k] = self._rates(list(here.y), fixed, here).imag / IMAGINARY_STEP
        if self.frequency:
            by_parameter[:, -1] = rates / self.model.reference_frequency
            if self._push is not None:
                by_parameter[1, -1] -= 2.0 * self._push(here.tau) / self.model.reference_frequency
        if here.stuck.any():
            for table in (rates, by_state, by_parameter):
                table[:2, ..., here.stuck] = 0.0
            by_state[:, 1, here.stuck] = 0.0
        return rates, by_state, by_parameter

    def _stepped_rates(self, y: Array, here: Instants) -> tuple[dict[int, Array], Array]:
        """What each coefficient multiplies, by its place in `p`, (instant,); rates, (state, row, instant)."""
        motion, count = self.motion, len(self.motion.variables)
        variables, p = list(y[:count]), [*self._fixed, *y[count:], *here.signs]
        values, acceleration = {}, motion.unforced(variables, here.tau)
        for i, force in enumerate(motion.forces):
            # A force that is off must not act even where it is singular.
            if p[i] or force.symbol in self.names:
                value = motion.force_value(i, variables, p, here.tau, FUNCTIONS)
                values[i] = np.broadcast_to(value, y.shape[1:])[0]
                acceleration = acceleration - p[i] * value if p[i] else acceleration
        rates = [y[1], acceleration, *motion.state_rates(variables, p, here.tau, FUNCTIONS)]
        return values, self._table(rates, y.shape[1:])

    @cached_property
    def _places(self) -> dict[str, int]:
        """Where coefficients and shape parameters stand in `p`."""
        symbols = [force.symbol for force in self.motion.forces]
        return {name: i for i, name in enumerate((*symbols, *self.motion.shapes))}

    def surfaces(self, here: Instants) -> Array:
        """Value of each switching surface on the present branch, (switch, instant)."""
        return self._surfaces(list(here.y), self._fixed, here)

    def _surfaces(self, y: Sequence[Array], fixed: Sequence[Array | float], here: Instants) -> Array:
        count = len(self.motion.variables)
        p = [*fixed, *y[count:], *here.signs]
        values = self.motion.surfaces(y[:count], p, here.tau, FUNCTIONS, frozen=True)
        if not values:
            return np.empty((0, here.y.shape[1]))
        return np.stack([np.broadcast_to(value, here.tau.shape) for value in values])

    def surface_derivatives(self, here: Instants) -> tuple[Array, Array, Array]:
        """Derivatives of the surfaces.

        Returns
        -------
        by_state : (switch, state, instant) array of float
        by_parameter : (switch, parameter, instant) array of float
        by_tau : (switch, instant) array of float
        """
        y, fixed, step = list(here.y.astype(complex)), self._fixed, 1j * IMAGINARY_STEP
        by_state = np.stack(
            [
                self._surfaces([*y[:j], y[j] + step, *y[j + 1 :]], fixed, here).imag / IMAGINARY_STEP
                for j in range(self.size)
            ],
            axis=1,
        )
        by_parameter = np.zeros((len(by_state), len(self.names) + self.frequency, here.y.shape[1]))
        for k, name in enumerate(self.names):
            if name in self.motion.shapes:
                stepped = list[Any](fixed)
                stepped[self._places[name]] += step
                by_parameter[:, k] = self._surfaces(y, stepped, here).imag / IMAGINARY_STEP
        later = replace(here, tau=np.asarray(here.tau + step))
        return by_state, by_parameter, self._surfaces(y, fixed, later).imag / IMAGINARY_STEP

    def replaced_derivatives(self, here: Instants) -> tuple[Array, Array]:
        """Derivatives of the memory after a reversal, by state and by parameter: (memory, ..., instant)."""
        count, fixed, step = len(self.motion.variables), self._fixed, 1j * IMAGINARY_STEP
        y = list(here.y.astype(complex))

        def by(y: Sequence[Array], fixed: Sequence[Array | float]) -> Array:
            p = [*fixed, *y[count:], *here.signs]
            memory = self.motion.replaced(y[:count], p, here.tau, BRANCHING)
            return (
                np.stack([np.broadcast_to(np.imag(value), here.tau.shape) for value in memory])
                / IMAGINARY_STEP
            )

        by_state = [by([*y[:j], y[j] + step, *y[j + 1 :]], fixed) for j in range(self.size)]
        by_parameter = [np.zeros_like(by_state[0])] * (len(self.names) + self.frequency)
        for k, name in enumerate(self.names):
            if name in self.motion.shapes:
                stepped = list[Any](fixed)
                stepped[self._places[name]] += step
                by_parameter[k] = by(y, stepped)
        empty = np.zeros((len(by_state[0]), 0, len(here.tau)))
        return np.stack(by_state, axis=1), np.stack(by_parameter, axis=1) if by_parameter else empty
