"""Hidden effects by hand: nothing of the project's formulas is used, so that an error there is seen here.

An effect gives its force `push(x, v, s, c, t, z)`: x angle, v = x'/w, s and c the branches of sign(v) and
sign(x), t in seconds, z its states. What depends on the past without a differential equation is kept
at reversals: `begin` at the start, `reverse` at every v = 0.
"""

import math
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

Shapes = dict[str, float]


@dataclass
class Effect:
    """A force (or sensor error) of unit coefficient without memory."""

    push: Callable
    states: int = 0
    flow: Callable | None = None
    origin: Callable = lambda x: []
    kinks: tuple[float, ...] = ()
    # Steps a sample where the force is singular at v = 0 or narrow.
    parts: int = 1

    def begin(self, x: float) -> None:
        """Remember the start."""

    def reverse(self, x: float) -> None:
        """Remember a reversal."""


@dataclass
class Remembering(Effect):
    """`after(x, s, a, h)`, with angle and force at the last reversal; `virgin(x)`, the force at the start."""

    push: Callable = field(init=False)
    after: Callable = field(kw_only=True)
    virgin: Callable = field(kw_only=True)

    def __post_init__(self) -> None:
        self.a = self.h = 0.0
        self.push = lambda x, v, s, c, t, z: self.after(x, s, self.a, self.h)

    def begin(self, x: float) -> None:
        self.a, self.h = x, self.virgin(x)

    def reverse(self, x: float) -> None:
        # Before the reversal x approached `a` from the old one: the sign follows from where it lies.
        h = self.after(x, math.copysign(1.0, x - self.a), self.a, self.h) if x != self.a else self.h
        self.a, self.h = x, h


def stops(h: Callable, both: bool) -> Callable[[Shapes], Effect]:
    return lambda p: Effect(
        lambda x, v, s, c, t, z: h(x, p["g"]), kinks=(-p["g"], p["g"]) if both else (p["g"],)
    )


def maxwell(p: Shapes) -> Effect:
    return Effect(
        lambda x, v, s, c, t, z: z[0],
        states=1,
        flow=lambda x, v, s, z: [v - z[0] / p["s"]],
        origin=lambda x: [0.0],
        parts=max(1, round(0.3 / p["s"])),
    )


def resonator(p: Shapes) -> Effect:
    return Effect(
        lambda x, v, s, c, t, z: z[0],
        states=2,
        flow=lambda x, v, s, z: [z[1], -x - p["k"] ** 2 * z[0] - 2.0 * p["d"] * z[1]],
        origin=lambda x: [0.0, 0.0],
        parts=max(1, round(p["k"])),
    )


def lugre(p: Shapes) -> Effect:
    def flow(x, v, s, z):
        return [(v - s * v * z[0] / (1.0 + p["r"] * math.exp(-((v / p["u"]) ** 2)))) / p["s"]]

    return Effect(
        lambda x, v, s, c, t, z: z[0],
        states=1,
        flow=flow,
        origin=lambda x: [math.copysign(1.0 - math.exp(-abs(x) / p["s"]), x)],
        parts=max(1, round(0.1 / p["s"])),
    )


def bouc_wen_2(p: Shapes) -> Effect:
    b = p["b"]
    return Effect(
        lambda x, v, s, c, t, z: z[0],
        states=1,
        flow=lambda x, v, s, z: [v - b * s * v * abs(z[0]) * z[0]],
        origin=lambda x: [math.tanh(math.sqrt(b) * x) / math.sqrt(b)],
        parts=max(1, round(0.1 * math.sqrt(b))),
    )


def jenkins(p: Shapes) -> Effect:
    s0 = p["s"]
    return Remembering(
        after=lambda x, s, a, h: max(-s0, min(s0, h + x - a)), virgin=lambda x: max(-s0, min(s0, x)), parts=2
    )


def iwan(p: Shapes) -> Effect:
    s0 = p["s"]

    def backbone(u: float) -> float:
        # Elements of slip length 0..s0, evenly: those below |u| slide, the others are elastic.
        r = min(abs(u), s0)
        return math.copysign(r - r * r / (2.0 * s0), u)

    return Remembering(
        after=lambda x, s, a, h: max(-s0 / 2, min(s0 / 2, h + 2.0 * backbone((x - a) / 2.0))), virgin=backbone
    )


def relaxing(length: Callable, height: Callable) -> Callable[[Shapes], Effect]:
    """dz/dx = (height - s z)/length, solved between reversals."""

    def make(p: Shapes) -> Effect:
        d, k = length(p), height(p)

        def after(x, s, a, h):
            return s * k + (h - s * k) * math.exp(-s * (x - a) / d)

        return Remembering(
            after=after,
            virgin=lambda x: math.copysign(k * (1.0 - math.exp(-abs(x) / d)), x),
            parts=max(1, round(0.05 / d)),
        )

    return make


def masing(power: Callable) -> Callable[[Shapes], Effect]:
    def make(p: Shapes) -> Effect:
        m = power(p)
        return Remembering(
            after=lambda x, s, a, h: h - 2.0 * math.copysign((abs(x - a) / 2.0) ** m, x - a),
            virgin=lambda x: -math.copysign(abs(x) ** m, x),
        )

    return make


# What has states, a memory or kinks.
MAKERS: dict[str, Callable[[Shapes], Effect]] = {
    "maxwell": maxwell,
    "resonator": resonator,
    "jenkins": jenkins,
    "iwan": iwan,
    "dahl": relaxing(lambda p: p["s"], lambda p: 1.0),
    "lugre": lugre,
    "bouc_wen": relaxing(lambda p: 1.0 / p["b"], lambda p: 1.0 / p["b"]),
    "bouc_wen_2": bouc_wen_2,
    "partial_slip": masing(lambda p: 2.0),
    "masing": masing(lambda p: p["m"]),
    "freeplay": stops(lambda x, g: x - g if x > g else x + g if x < -g else 0.0, True),
    "wall": stops(lambda x, g: x - g if x > g else 0.0, False),
}
TABLES = tomllib.loads(Path(__file__).with_name("effects.toml").read_text(encoding="utf-8"))


def made(
    symbol: str, family: str, formula: str = "", parts: int = 1
) -> tuple[str, Callable[[Shapes], Effect]]:
    """Family and maker of a row of the table."""
    if symbol in MAKERS:
        return family, MAKERS[symbol]
    force = eval(f"lambda x, v, s, c, t, p: {formula}", vars(math) | {"abs": abs})
    return family, lambda p: Effect(lambda x, v, s, c, t, z: force(x, v, s, c, t, p), parts=parts)


FORCES, STRANGERS = (
    {symbol: made(symbol, *row) for symbol, row in TABLES[kind].items()} for kind in ("forces", "strangers")
)
# Errors of the sensor and the clock: what is added to the true angle, in arrays.
SENSORS: dict[str, Callable] = {
    "sensor_drift": lambda x, v, t: t,
    "sensor_curve": lambda x, v, t: x * x,
    "sensor_cubic": lambda x, v, t: x**3,
    "shutter": lambda x, v, t: -x * v,
    "clock_drift": lambda x, v, t: t * t * v,
}

EVERYTHING = FORCES | STRANGERS


def make(symbol: str, shapes: Shapes) -> Effect:
    return EVERYTHING[symbol][1](shapes)


def family(symbol: str) -> str:
    return "sensor" if symbol in SENSORS else EVERYTHING[symbol][0]


def names(truth: str) -> set[str]:
    """The truth's symbols: Bouc-Wen hysteresis with n = 1 is Dahl's, its coefficient over b."""
    return {"dahl", "bouc_wen"} if truth in ("dahl", "bouc_wen") else {truth}
