"""The equations of a motion as a straight-line program, with one row per operation, for the engine.

A formula is evaluated once on `Slot`s, which record the operations as rows. Slots are numbered: the states
`y`, tau, the inputs over time, the parameters `p` up to the memory, then one slot per row.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from sysid_trib.forces.formulas import Functions, divided

# Operations. PARTNER is the second of two rows that need each other, such as cos for sin. LINEAR is a + c d b
# with constant d, the most frequent operation of an equation of motion.
ADD, SUB, LINEAR, MUL, SCALE, DIV, NEG, CONST, SIGN, SIN, PARTNER, EXP, LOG, POWER, TANH = range(15)
Integers = NDArray[np.int64]
# Distance from a surface (rad) below which infinite values are smoothed.
SMOOTHED = 1e-9
# Most coefficients of a function of time, which is a polynomial in tau between knots.
FORCING_NUMBERS = 8


class Instructions(NamedTuple):
    """List of operations, and the places of their inputs and results.

    Attributes
    ----------
    code : (slot, 4) array of int
        Operation and operands a, b, d of each slot; those of the inputs are not used.
    c : (slot,) array of float
        Value of a constant, or exponent of a power.
    rows : (row,) array of int
        Slots that change along a motion, in order.
    inputs, main : int
        Number of input slots; first slot that only the memory needs.
    states, channels, memory : int
        Numbers of states, of inputs over time (channels), and of memory values.
    rates, surfaces, signs, replaced : array of int
        Slots of the states' rates, of the switching surfaces and their signs, and of the memory's next
        values.
    """

    code: Integers
    c: NDArray[np.float64]
    rows: Integers
    inputs: int
    main: int
    states: int
    channels: int
    memory: int
    rates: Integers
    surfaces: Integers
    signs: Integers
    replaced: Integers


class Listing:
    """A program under construction.

    Parameters
    ----------
    changing, parameters : int
        Number of inputs that change along a motion, and of those that are constant.
    """

    def __init__(self, changing: int, parameters: int) -> None:
        self.inputs = changing + parameters
        # Operation, operands a, b and d, and number c of each row.
        self.rows: list[tuple[int, int, int, int, float]] = [(0, 0, 0, 0, 0.0)] * self.inputs
        self.still = [False] * changing + [True] * parameters
        self._known: dict[tuple[int, int, int, int, float], int] = {}

    def add(self, op: int, a: int = 0, b: int = 0, c: float = 0.0, d: int = 0) -> int:
        """Return the slot of an operation; equal operations share one slot."""
        row = (op, a, b, d, c)
        if row not in self._known:
            self.rows.append(row)
            still = op in (CONST, SIGN) or (self.still[a] and (op > DIV or self.still[b]))
            self.still.append(still)
            self._known[row] = len(self.rows) - 1
        return self._known[row]

    def pair(self, op: int, a: int, partner: Callable[[int], tuple[int, int, int]]) -> tuple[int, int]:
        """Return two rows; the first reads the second."""
        first = self.add(op, a, -1)
        if self.rows[first][2] < 0:
            self.rows[first] = (op, a, self.add(*partner(first)), 0, 0.0)
        return first, self.rows[first][2]

    def sum(self, a: int, b: int, way: float = 1.0) -> int:
        """Return the slot of a + way b."""
        op, factor, of, *_ = self.rows[b]
        if op == SCALE:
            return self.add(LINEAR, a, of, way, factor)
        return self.add(ADD if way > 0.0 else SUB, a, b)

    def product(self, a: int, b: int) -> int:
        """Return the slot of a b; the product with a constant factor has its own operation."""
        if self.still[b] and not self.still[a]:
            a, b = b, a
        if not self.still[a]:
            return self.add(MUL, a, b)
        op, first, of, *_ = self.rows[b]
        if op == SCALE and not self.still[b]:
            return self.product(self.product(a, first), of)
        return self.add(SCALE, a, b)

    def quotient(self, a: int, b: int) -> int:
        """Return the slot of a / b."""
        if self.still[b] and not self.still[a]:
            return self.product(a, self.quotient(self.slot(1.0), b))
        return self.add(DIV, a, b)

    def circular(self, a: int) -> tuple[int, int]:
        """Return the slots of sine and cosine."""
        return self.pair(SIN, a, lambda sine: (PARTNER, a, sine))

    def tanh(self, a: int) -> int:
        """Return the slot of a hyperbolic tangent; its partner is the slope."""
        return self.pair(TANH, a, lambda tanh: (SUB, self.slot(1.0), self.product(tanh, tanh)))[0]

    def slot(self, value: Any) -> int:
        """Return the slot of a value."""
        return value.index if isinstance(value, Slot) else self.add(CONST, c=float(value))

    def tidied(self, main: int, counts: tuple[int, int], outputs: tuple[list[int], ...]) -> Instructions:
        """Return the program without unused rows; only the memory needs rows from `main` on."""
        needed, further = set(range(self.inputs)), [i for output in outputs for i in output]
        while further:
            if (slot := further.pop()) not in needed:
                needed.add(slot)
                further += self.rows[slot][1:4]
        kept = np.array(sorted(needed))
        table = np.array(self.rows, dtype=float)[kept]
        code = table[:, :4].astype(np.int64)
        # New index of a slot among the kept ones.
        code[:, 1:] = np.searchsorted(kept, code[:, 1:])
        changing = [i for i in kept if self.inputs <= i < main and not self.still[i]]
        places = [np.searchsorted(kept, output).astype(np.int64) for output in (changing, *outputs)]
        return Instructions(
            code,
            table[:, 4].copy(),
            places[0],
            self.inputs,
            int(np.searchsorted(kept, main)),
            *counts,
            len(outputs[3]),
            *places[1:],
        )


# Results of NumPy's functions on slots.
ROWS_OF: dict[np.ufunc, Callable[..., int]] = {
    np.add: Listing.sum,
    np.subtract: lambda rows, a, b: rows.sum(a, b, -1.0),
    np.multiply: Listing.product,
    np.divide: Listing.quotient,
    np.negative: lambda rows, a: rows.add(NEG, a),
    np.sign: lambda rows, a: rows.add(SIGN, a),
    np.sin: lambda rows, a: rows.circular(a)[0],
    np.cos: lambda rows, a: rows.circular(a)[1],
    np.tanh: Listing.tanh,
    np.exp: lambda rows, a: rows.add(EXP, a),
    np.log: lambda rows, a: rows.add(LOG, a),
}


class Slot(NDArrayOperatorsMixin):
    """A value in a program; arithmetic and functions of NumPy add rows to the program.

    Parameters
    ----------
    rows : Listing
    index : int
    """

    __slots__ = ("index", "rows")

    def __init__(self, rows: Listing, index: int) -> None:
        self.rows, self.index = rows, index

    def __array_ufunc__(self, function: np.ufunc, method: str, *values: Any) -> "Slot":
        operands = [self.rows.slot(value) for value in values]
        return Slot(self.rows, ROWS_OF[function](self.rows, *operands))


def _power(base: Any, exponent: Any) -> Any:
    """Return whole powers as products; others as b (b^2 + e^2)^((p-1)/2), analytic if b changes sign."""
    if isinstance(exponent, int | float) and float(exponent).is_integer():
        whole = _product(base, abs(int(exponent)))
        return whole if exponent >= 0 else divided(1.0, whole)
    smooth, half = base * base + SMOOTHED**2, 0.5 * (exponent - 1.0)
    if isinstance(smooth, Slot) and not isinstance(half, Slot):
        return base * Slot(smooth.rows, smooth.rows.add(POWER, smooth.index, c=half))
    # The derivative by the exponent needs the logarithm.
    return base * np.exp(half * np.log(smooth))


def _product(base: Any, count: int) -> Any:
    if count == 0:
        return 1.0
    half = _product(base, count // 2) if count > 1 else None
    return base if half is None else half * half * base if count % 2 else half * half


# Functions that switch depend on the branch; they are not called if the branch is given.
FUNCTIONS: Functions = {
    "sign": np.sign,
    "abs": lambda u: np.sign(u) * u,
    "max": lambda a, b: 0.5 * (a + b) + 0.5 * np.sign(a - b) * (a - b),
    "min": lambda a, b: 0.5 * (a + b) - 0.5 * np.sign(a - b) * (a - b),
    "sin": np.sin,
    "cos": np.cos,
    "tan": lambda u: np.sin(u) / np.cos(u),
    "tanh": np.tanh,
    "exp": np.exp,
    "sqrt": lambda u: _power(u, 0.5),
    "log": lambda u: 0.5 * np.log(u * u + SMOOTHED**2),
    "power": _power,
}
