"""Parts of a file: a motion, numbers drawn for it, rows of cells, and the right reading."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Item = TypeVar("Item")
DEG = 180.0 / np.pi
GRAVITY = 9.81


@dataclass(frozen=True)
class Right:
    """Right reading of a file.

    Attributes
    ----------
    quantity, unit : str
        Of the signal, as it is to be read; nothing where the file is to be refused.
    period, zeta, amplitude : float
        s, rate of decay over the frequency, first amplitude in rad or in `unit`; nan: not judged.
    decays : int
    words : tuple of str
        One of them must be in the sentence that refuses it; beside a quantity: where it is refused.
    names : tuple of str
        All of them must be in the sentence that asks for a column.
    options : dict
        Of `Reading`, where the file alone cannot tell.
    """

    quantity: str = ""
    unit: str = ""
    period: float = np.nan
    zeta: float = np.nan
    amplitude: float = np.nan
    decays: int = 1
    words: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    options: dict[str, object] = field(default_factory=dict)


class Draw:
    """Numbers and choices of one file."""

    def __init__(self, seed: Sequence[int]) -> None:
        self.rng = np.random.default_rng(seed)

    def pick(self, *items: Item) -> Item:
        """One of the items."""
        return items[int(self.rng.integers(len(items)))]

    def within(self, low: float, high: float) -> float:
        """A number between two, to three digits."""
        return float(f"{self.rng.uniform(low, high):.3g}")

    def noise(self, size: int | tuple[int, ...], of: float) -> Array:
        """White noise."""
        return self.rng.normal(0.0, of, size)


@dataclass(frozen=True)
class Swing:
    """A viscous decay from rest at `release`, sampled at `time`: x in rad, v in rad/s, a in rad/s^2."""

    time: Array
    x: Array
    v: Array
    a: Array
    period: float
    zeta: float
    start: float
    rate: float
    release: float = 0.0

    def right(self, quantity: str, unit: str, scale: float = 1.0, **more: object) -> Right:
        """Return the right reading of its file; `scale`: its unit of an angle of 1 rad."""
        return Right(quantity, unit, self.period, self.zeta, self.start * scale, **more)  # type: ignore[arg-type]

    def as_unit(self, unit: str, scale: float) -> Right:
        """Return the right reading of its file, with the quantity by the unit."""
        if unit in ("mm", "cm", "V"):
            return self.right("displacement", unit, scale)
        return self.right("angle", "rad" if unit == "rad" else "deg")


def swing(
    draw: Draw,
    *,
    period: tuple[float, float] = (0.5, 2.2),
    start: tuple[float, float] = (0.2, 0.6),
    zeta: tuple[float, float] = (0.004, 0.012),
    samples: tuple[float, float] = (30.0, 120.0),
    release: float = 0.0,
    falls: float = 12.0,
    clock: float | None = None,
) -> Swing:
    """A decay whose numbers are drawn; `samples` a period; its amplitude falls by about `falls`."""
    length, ratio, angle = draw.within(*period), draw.within(*zeta), draw.within(*start)
    rate = clock or float(f"{draw.within(*samples) / length:.2g}")
    w = 2.0 * np.pi / length
    duration = release + min(np.log(falls) / (ratio * w), 90.0 * length)
    time = np.arange(int(duration * rate)) / rate
    x, v, a = decay_at(time - release, w, ratio, angle)
    return Swing(time, x, v, a, length, ratio, angle, rate, release)


def decay_at(tau: Array, w: float, zeta: float, start: float) -> tuple[Array, Array, Array]:
    """Angle, rate and acceleration of a viscous decay that is held until 0; `2 pi / w` is its period."""
    stiff = w / np.sqrt(1.0 - zeta**2)
    past = np.maximum(tau, 0.0)
    fall = start * np.exp(-zeta * stiff * past)
    x = fall * (np.cos(w * past) + zeta * stiff / w * np.sin(w * past))
    v = -fall * stiff**2 / w * np.sin(w * past)
    a = np.where(tau > 0.0, -(stiff**2) * x - 2.0 * zeta * stiff * v, 0.0)
    return x, v, a


def cells(formats: Sequence[str], columns: Sequence[Sequence[object] | Array]) -> list[list[str]]:
    """Rows of texts: one format a column."""
    return [[f % v for f, v in zip(formats, row, strict=True)] for row in zip(*columns, strict=True)]


def text_of(
    rows: list[list[str]],
    head: str = "",
    *,
    sep: str = ",",
    comma: bool = False,
    tail: str = "",
    encoding: str = "utf-8",
    end: str = "\n",
) -> bytes:
    """A text file; `comma`: as the sign of decimals."""
    body = [sep.join(cell.replace(".", ",") if comma else cell for cell in row) for row in rows]
    lines = [*head.splitlines(), *body, *tail.splitlines()]
    return "".join(line + end for line in lines).encode(encoding)
