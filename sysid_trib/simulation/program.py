"""The equations of a motion as a straight-line program, one row an operation, that the engine runs.

A formula becomes rows by being evaluated once on `Slot`s, which note what is done to them. Slots are
numbered: the states `y`, tau, what is given over time, the parameters `p` up to the memory, then a row each.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sysid_trib.forces.formulas import Functions, divided

# Operations. PARTNER is the second of two rows that need each other: cos beside sin.
# LINEAR is a + c d b with d that does not change: most of an equation of motion.
ADD, SUB, LINEAR, MUL, SCALE, DIV, NEG, CONST, SIGN, SIN, PARTNER, EXP, LOG, POWER, TANH = range(15)
Integers = NDArray[np.int64]
# Below this distance from a surface (rad), what is infinite there is smoothed.
SMOOTHED = 1e-9
# What is given over time is a polynomial in tau between knots, of so many numbers at most.
FORCING_NUMBERS = 8


class Instructions(NamedTuple):
    """Listing of operations, and where to find what in them.

    Attributes
    ----------
    code : (slot, 4) array of int
        Operation and operands a, b, d of each slot; those of the inputs are not read.
    c : (slot,) array of float
        Number of a constant, exponent of a power.
    rows : (row,) array of int
        Slots that change along a motion, in their order.
    inputs, main : int
        Number of input slots; first slot that only the memory needs.
    states, channels, memory : int
        How many there are; channels are what is given over time.
    rates, surfaces, signs, replaced : array of int
        Slots of the states' rates, of the switching surfaces and their signs, of the memory's next values.
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
        Number of inputs that change along a motion, and of those that stay.
    """

    def __init__(self, changing: int, parameters: int) -> None:
        self.inputs = changing + parameters
        # Operation, operands a, b and d, number c of each.
        self.rows: list[tuple[int, int, int, int, float]] = [(0, 0, 0, 0, 0.0)] * self.inputs
        self.still = [False] * changing + [True] * parameters
        self._known: dict[tuple[int, int, int, int, float], int] = {}

    def add(self, op: int, a: int = 0, b: int = 0, c: float = 0.0, d: int = 0) -> int:
        """The slot of an operation, which is done once however often it is asked for."""
        row = (op, a, b, d, c)
        if row not in self._known:
            self.rows.append(row)
            still = op in (CONST, SIGN) or (self.still[a] and (op > DIV or self.still[b]))
            self.still.append(still)
            self._known[row] = len(self.rows) - 1
        return self._known[row]

    def pair(self, op: int, a: int, partner: Callable[[int], tuple[int, int, int]]) -> tuple[int, int]:
        """Two rows of which the first reads the second."""
        first = self.add(op, a, -1)
        if self.rows[first][2] < 0:
            self.rows[first] = (op, a, self.add(*partner(first)), 0, 0.0)
        return first, self.rows[first][2]

    def sum(self, a: int, b: int, way: float) -> int:
        """The slot of a + way b."""
        op, factor, of, *_ = self.rows[b]
        if op == SCALE:
            return self.add(LINEAR, a, of, way, factor)
        return self.add(ADD if way > 0.0 else SUB, a, b)

    def scaled(self, factor: int, a: int) -> int:
        """The slot of a times a factor that does not change."""
        op, first, of, *_ = self.rows[a]
        if op == SCALE and not self.still[a]:
            return self.scaled(self.scaled(factor, first), of)
        return self.add(SCALE, factor, a)

    def slot(self, value: Any) -> int:
        """The slot of a value."""
        return value.index if isinstance(value, Slot) else self.add(CONST, c=float(value))

    def tidied(self, main: int, counts: tuple[int, int], outputs: tuple[list[int], ...]) -> Instructions:
        """The program without rows that nothing needs; `main` is the first that only the memory may need."""
        count = len(self.rows)
        used = [i < self.inputs or any(i in output for output in outputs) for i in range(count)]
        for i in range(count - 1, self.inputs - 1, -1):
            if used[i] and self.rows[i][0] != CONST:
                for operand in self.rows[i][1:4]:
                    used[operand] = True
                    # A partner stands behind its first row, and is needed with it.
                    if operand > i:
                        for inner in self.rows[operand][1:3]:
                            used[inner] = True
        place = np.cumsum(used) - 1
        kept = np.flatnonzero(used)
        table = np.array(self.rows, dtype=float)[kept]
        code = table[:, :4].astype(np.int64)
        code[:, 1:] = place[code[:, 1:]]
        changing = [place[i] for i in kept if self.inputs <= i < main and not self.still[i]]
        return Instructions(
            code,
            table[:, 4].copy(),
            np.array(changing, dtype=np.int64),
            self.inputs,
            int(sum(used[:main])),
            *counts,
            len(outputs[3]),
            *(place[np.array(output, dtype=np.int64)].astype(np.int64) for output in outputs),
        )


class Slot:
    """A value in a program; arithmetic with it adds rows.

    Parameters
    ----------
    rows : Listing
    index : int
    """

    __slots__ = ("index", "rows")
    # NumPy's numbers leave arithmetic with it to it.
    __array_ufunc__ = None

    def __init__(self, rows: Listing, index: int) -> None:
        self.rows, self.index = rows, index

    def _sum(self, a: Any, b: Any, way: float) -> "Slot":
        return Slot(self.rows, self.rows.sum(self.rows.slot(a), self.rows.slot(b), way))

    def _over(self, a: Any, b: Any) -> "Slot":
        return Slot(self.rows, self.rows.add(DIV, self.rows.slot(a), self.rows.slot(b)))

    def __add__(self, other: Any) -> "Slot":
        return self._sum(self, other, 1.0)

    def __radd__(self, other: Any) -> "Slot":
        return self._sum(other, self, 1.0)

    def __sub__(self, other: Any) -> "Slot":
        return self._sum(self, other, -1.0)

    def __rsub__(self, other: Any) -> "Slot":
        return self._sum(other, self, -1.0)

    def __neg__(self) -> "Slot":
        return Slot(self.rows, self.rows.add(NEG, self.index))

    def __mul__(self, other: Any) -> "Slot":
        first, second = (self.rows.slot(value) for value in (self, other))
        still = self.rows.still
        if still[second] and not still[first]:
            first, second = second, first
        index = self.rows.scaled(first, second) if still[first] else self.rows.add(MUL, first, second)
        return Slot(self.rows, index)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> "Slot":
        divisor = self.rows.slot(other)
        if self.rows.still[divisor] and not self.rows.still[self.index]:
            return self * self._over(1.0, other)
        return self._over(self, other)

    def __rtruediv__(self, other: Any) -> "Slot":
        return self._over(other, self)


def _unary(op: int, of_number: Callable[[float], float]) -> Callable[[Any], Any]:
    def function(u: Any) -> Any:
        return Slot(u.rows, u.rows.add(op, u.index)) if isinstance(u, Slot) else of_number(u)

    return function


def _circular(u: Any) -> tuple[Any, Any]:
    if not isinstance(u, Slot):
        return math.sin(u), math.cos(u)
    pair = u.rows.pair(SIN, u.index, lambda sine: (PARTNER, u.index, sine))
    return Slot(u.rows, pair[0]), Slot(u.rows, pair[1])


def _tangent(u: Any) -> Any:
    sine, cosine = _circular(u)
    return sine / cosine


def _tanh(u: Any) -> Any:
    if not isinstance(u, Slot):
        return math.tanh(u)
    rows = u.rows

    def slope(tanh: int) -> tuple[int, int, int]:
        op = SCALE if rows.still[tanh] else MUL
        return SUB, rows.slot(1.0), rows.add(op, tanh, tanh)

    return Slot(rows, rows.pair(TANH, u.index, slope)[0])


def _power(base: Any, exponent: Any) -> Any:
    """Whole powers as products; broken ones as b (b^2 + e^2)^((p-1)/2), analytic where b changes sign."""
    if isinstance(exponent, int | float) and float(exponent).is_integer():
        whole = _product(base, abs(int(exponent)))
        return whole if exponent >= 0 else divided(1.0, whole)
    smooth, half = base * base + SMOOTHED**2, 0.5 * (exponent - 1.0)
    if not isinstance(half, Slot):
        if not isinstance(smooth, Slot):
            return base * smooth**half
        return base * Slot(smooth.rows, smooth.rows.add(POWER, smooth.index, c=half))
    # The derivative by the exponent wants the logarithm.
    log = math.log(smooth) if not isinstance(smooth, Slot) else _unary(LOG, math.log)(smooth)
    return base * _unary(EXP, math.exp)(half * log)


def _product(base: Any, count: int) -> Any:
    if count == 0:
        return 1.0
    half = _product(base, count // 2) if count > 1 else None
    return base if half is None else half * half * base if count % 2 else half * half


FUNCTIONS: Functions = {
    "sin": lambda u: _circular(u)[0],
    "cos": lambda u: _circular(u)[1],
    "tan": _tangent,
    "tanh": _tanh,
    "exp": _unary(EXP, math.exp),
    "sqrt": lambda u: _power(u, 0.5),
    "log": lambda u: 0.5 * _unary(LOG, math.log)(u * u + SMOOTHED**2),
    "power": _power,
}


def live_functions(rows: Listing) -> Functions:
    """Functions whose branches follow their arguments."""

    def sign(u: Any) -> Any:
        return Slot(rows, rows.add(SIGN, rows.slot(u)))

    def larger(a: Any, b: Any) -> Any:
        return 0.5 * (a + b) + 0.5 * sign(a - b) * (a - b)

    def smaller(a: Any, b: Any) -> Any:
        return 0.5 * (a + b) - 0.5 * sign(a - b) * (a - b)

    return {**FUNCTIONS, "sign": sign, "abs": lambda u: sign(u) * u, "max": larger, "min": smaller}
