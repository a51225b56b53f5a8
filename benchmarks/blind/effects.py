"""Hidden effects by hand: nothing of the project's formulas is used, so that an error there is seen here.

An effect gives its force `push(x, v, s, c, t, z)`: x angle, v = x'/w, s and c the branches of sign(v) and
sign(x), t in seconds, z its states. What depends on the past without a differential equation is kept
at reversals: `begin` at the start, `reverse` at every v = 0.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

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


def plain(h: Callable, **more) -> Callable[[Shapes], Effect]:
    return lambda p: Effect(lambda x, v, s, c, t, z: h(x, v, s, c, t, p), **more)


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
        after=lambda x, s, a, h: max(-s0, min(s0, h + x - a)),
        virgin=lambda x: max(-s0, min(s0, x)),
        parts=2,
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


# Symbol: family, maker. The families and symbols are the libraries'; the formulas are the table's.
FORCES: dict[str, tuple[str, Callable[[Shapes], Effect]]] = {
    "lambda": ("friction", plain(lambda x, v, s, c, t, p: s)),
    "zeta": ("friction", plain(lambda x, v, s, c, t, p: 2.0 * v)),
    "delta": ("friction", plain(lambda x, v, s, c, t, p: s * v * v)),
    "nu": ("elasticity", plain(lambda x, v, s, c, t, p: c * x * x)),
    "epsilon": ("elasticity", plain(lambda x, v, s, c, t, p: x * x * x)),
    "cubic_damping": ("damping", plain(lambda x, v, s, c, t, p: v * v * v)),
    "van_der_pol": ("damping", plain(lambda x, v, s, c, t, p: x * x * v)),
    "angle_damping": ("damping", plain(lambda x, v, s, c, t, p: c * x * v)),
    "angle_drag": ("damping", plain(lambda x, v, s, c, t, p: c * x * s * v * v)),
    "three_halves_damping": ("damping", plain(lambda x, v, s, c, t, p: s * abs(v) ** 1.5, parts=2)),
    "power_damping": ("damping", plain(lambda x, v, s, c, t, p: s * abs(v) ** p["p"], parts=3)),
    "angle_friction": ("friction", plain(lambda x, v, s, c, t, p: x * x * s)),
    "structural_damping": ("friction", plain(lambda x, v, s, c, t, p: c * x * s)),
    "stribeck": ("friction", plain(lambda x, v, s, c, t, p: s * math.exp(-((v / p["s"]) ** 2)), parts=2)),
    "stribeck_exponential": (
        "friction",
        plain(lambda x, v, s, c, t, p: s * math.exp(-abs(v) / p["s"]), parts=2),
    ),
    "log_friction": ("friction", plain(lambda x, v, s, c, t, p: s * math.log1p(abs(v) / p["s"]), parts=3)),
    "maxwell": ("hysteresis", maxwell),
    "resonator": ("hysteresis", resonator),
    "jenkins": ("hysteresis", jenkins),
    "iwan": ("hysteresis", iwan),
    "dahl": ("hysteresis", relaxing(lambda p: p["s"], lambda p: 1.0)),
    "lugre": ("hysteresis", lugre),
    "bouc_wen": ("hysteresis", relaxing(lambda p: 1.0 / p["b"], lambda p: 1.0 / p["b"])),
    "bouc_wen_2": ("hysteresis", bouc_wen_2),
    "partial_slip": ("hysteresis", masing(lambda p: 2.0)),
    "masing": ("hysteresis", masing(lambda p: p["m"])),
    "detent": ("elasticity", plain(lambda x, v, s, c, t, p: c)),
    "quintic": ("elasticity", plain(lambda x, v, s, c, t, p: x**5)),
    "gravity": ("elasticity", plain(lambda x, v, s, c, t, p: math.sin(x) - x)),
    "magnet": ("elasticity", plain(lambda x, v, s, c, t, p: 0.5 * math.sin(2.0 * x) - x)),
    "inertia": ("elasticity", plain(lambda x, v, s, c, t, p: x * v * v)),
    "speed_detent": ("elasticity", plain(lambda x, v, s, c, t, p: c * v * v)),
    "speed_stiffness": ("elasticity", plain(lambda x, v, s, c, t, p: s * v * x)),
    "freeplay": ("elasticity", stops(lambda x, g: x - g if x > g else x + g if x < -g else 0.0, True)),
    "wall": ("elasticity", stops(lambda x, g: x - g if x > g else 0.0, False)),
    "bias": ("even", plain(lambda x, v, s, c, t, p: 1.0)),
    "even_spring": ("even", plain(lambda x, v, s, c, t, p: x * x)),
    "bilinear": ("even", plain(lambda x, v, s, c, t, p: c * x)),
    "even_drag": ("even", plain(lambda x, v, s, c, t, p: v * v)),
    "even_speed": ("even", plain(lambda x, v, s, c, t, p: s * v)),
    "tilted_damping": ("even", plain(lambda x, v, s, c, t, p: x * v)),
    "tilted_friction": ("even", plain(lambda x, v, s, c, t, p: x * s)),
    "stiffness_drift": ("drift", plain(lambda x, v, s, c, t, p: t * x)),
    "damping_drift": ("drift", plain(lambda x, v, s, c, t, p: t * v)),
    "friction_drift": ("drift", plain(lambda x, v, s, c, t, p: t * s)),
    "ageing": ("drift", plain(lambda x, v, s, c, t, p: math.log1p(t) * s)),
    "equilibrium_drift": ("drift", plain(lambda x, v, s, c, t, p: t)),
    "ambient": ("ambient", plain(lambda x, v, s, c, t, p: math.sin(p["W"] * t + p["p"]))),
}

# Errors of the sensor and the clock: what is added to the true angle, in arrays.
SENSORS: dict[str, Callable] = {
    "sensor_drift": lambda x, v, t: t,
    "sensor_curve": lambda x, v, t: x * x,
    "sensor_cubic": lambda x, v, t: x**3,
    "shutter": lambda x, v, t: -x * v,
    "clock_drift": lambda x, v, t: t * t * v,
}

# Of no library: a bump of friction at one angle or one speed, a root, a washboard, something that happens
# at one moment.
STRANGERS: dict[str, tuple[str, Callable[[Shapes], Effect]]] = {
    "friction_bump": (
        "strange",
        plain(lambda x, v, s, c, t, p: s * math.exp(-(((abs(x) - p["a"]) / p["d"]) ** 2)), parts=2),
    ),
    "speed_bump": (
        "strange",
        plain(lambda x, v, s, c, t, p: s * math.exp(-(((abs(v) - p["a"]) / p["d"]) ** 2)), parts=2),
    ),
    "root": ("strange", plain(lambda x, v, s, c, t, p: c * abs(x) ** 0.3, parts=3)),
    "washboard": ("strange", plain(lambda x, v, s, c, t, p: math.sin(p["k"] * x), parts=2)),
    "braking": ("strange", plain(lambda x, v, s, c, t, p: v * math.exp(-(((t - p["a"]) / p["d"]) ** 2)))),
    "jump": ("strange", plain(lambda x, v, s, c, t, p: x * (0.5 + 0.5 * math.tanh((t - p["a"]) / p["d"])))),
}
EVERYTHING = FORCES | STRANGERS


def make(symbol: str, shapes: Shapes) -> Effect:
    return EVERYTHING[symbol][1](shapes)


def family(symbol: str) -> str:
    return "sensor" if symbol in SENSORS else EVERYTHING[symbol][0]


def names(truth: str) -> set[str]:
    """The truth's symbols: Bouc-Wen hysteresis with n = 1 is Dahl's, its coefficient over b."""
    return {"dahl", "bouc_wen"} if truth in ("dahl", "bouc_wen") else {truth}
