"""Random oscillators, shape parameters and noise."""

from collections.abc import Callable

import numpy as np
from scipy.signal import lfilter

from .effects import Shapes
from .generator import Oscillator

# Noise over the first angle.
NOISE = 1e-3
# Effects that only take one sign: springs that pull back, contacts that lose energy.
ONE_SIGN = {
    "structural_damping", "maxwell", "resonator", "jenkins", "iwan", "dahl", "lugre", "bouc_wen",
    "bouc_wen_2", "partial_slip", "masing", "freeplay", "wall", "inertia", "ambient", "friction_bump",
    "speed_bump",
}  # fmt: skip


def oscillator(rng: np.random.Generator, start: float) -> Oscillator:
    """Two to five base forces of the order of the paper's, at least one of friction."""
    while True:
        every = {
            "lambda": rng.uniform(0.0002, 0.001) * start,
            "zeta": rng.uniform(0.002, 0.008),
            "delta": rng.uniform(0.01, 0.05),
            "nu": rng.choice([-1, 1]) * rng.uniform(0.1, 0.5),
            "epsilon": rng.choice([-1, 1]) * rng.uniform(0.1, 0.5),
        }
        chance = {"lambda": 0.5, "zeta": 0.8, "delta": 0.5, "nu": 0.5, "epsilon": 0.5}
        base = {k: float(q) for k, q in every.items() if rng.uniform() < chance[k]}
        if len(base) >= 2 and base.keys() & {"lambda", "zeta", "delta"}:
            return Oscillator(float(rng.uniform(5.0, 15.0)), base)


def shapes(rng: np.random.Generator, symbol: str, start: float, w: float, duration: float) -> Shapes:
    """Shape parameters within the reach of the motion."""
    u = rng.uniform
    table: dict[str, Callable[[], Shapes]] = {
        "power_damping": lambda: {"p": rng.choice([u(0.3, 0.7), u(2.3, 3.5)])},
        "stribeck": lambda: {"s": start * u(0.05, 0.3)},
        "stribeck_exponential": lambda: {"s": start * u(0.05, 0.3)},
        "log_friction": lambda: {"s": start * u(0.01, 0.1)},
        "maxwell": lambda: {"s": np.exp(u(-1.2, 1.2))},
        "resonator": lambda: {"k": rng.choice([u(0.8, 0.97), u(1.03, 1.25)]), "d": u(0.005, 0.03)},
        "jenkins": lambda: {"s": start * u(0.05, 0.3)},
        "iwan": lambda: {"s": start * u(0.3, 1.2)},
        "dahl": lambda: {"s": min(0.25, start * u(0.03, 0.2))},
        "lugre": lambda: {"s": start * u(0.03, 0.1), "r": u(0.5, 2.0), "u": start * u(0.1, 0.3)},
        "bouc_wen": lambda: {"b": 1.0 / (start * u(0.3, 2.0))},
        "bouc_wen_2": lambda: {"b": (start * u(0.5, 2.0)) ** -2},
        "masing": lambda: {"m": rng.choice([u(1.2, 1.8), u(2.3, 3.0)])},
        "freeplay": lambda: {"g": start * u(0.2, 0.6)},
        "wall": lambda: {"g": start * u(0.2, 0.6)},
        "ambient": lambda: {"W": w * rng.choice([u(0.3, 0.8), u(1.3, 2.5)]), "p": u(-3.0, 3.0)},
        "friction_bump": lambda: {"a": start * u(0.3, 0.6), "d": start * u(0.06, 0.12)},
        "speed_bump": lambda: {"a": start * u(0.3, 0.6), "d": start * u(0.06, 0.12)},
        "washboard": lambda: {"k": u(8.0, 16.0) / start},
        "braking": lambda: {"a": duration * u(0.3, 0.6), "d": duration * u(0.03, 0.08)},
        "jump": lambda: {"a": duration * u(0.3, 0.6), "d": duration * 0.01},
    }
    return {k: float(q) for k, q in table[symbol]().items()} if symbol in table else {}


def grid(symbol: str, start: float, w: float) -> list[Shapes]:
    """Shape parameters at which a candidate could stand in for an effect."""
    lengths = [start * q for q in (0.04, 0.12, 0.35, 1.0)]
    one: dict[str, tuple[str, list[float]]] = {
        "power_damping": ("p", [0.3, 0.6, 1.5, 2.5, 3.0, 3.5]),
        "stribeck": ("s", lengths),
        "stribeck_exponential": ("s", lengths),
        "log_friction": ("s", [q / 4.0 for q in lengths]),
        "maxwell": ("s", [0.3, 1.0, 3.0]),
        "jenkins": ("s", lengths),
        "iwan": ("s", lengths),
        "dahl": ("s", lengths),
        "bouc_wen": ("b", [1.0 / q for q in lengths]),
        "bouc_wen_2": ("b", [q**-2.0 for q in lengths[1:]]),
        "masing": ("m", [1.2, 1.5, 2.0, 2.5, 3.0]),
        "freeplay": ("g", lengths[1:3]),
        "wall": ("g", lengths[1:3]),
    }
    if symbol == "resonator":
        return [
            {"k": k, "d": d}
            for k, d in ((0.5, 0.1), (0.9, 0.05), (0.98, 0.02), (1.02, 0.02), (1.1, 0.05), (2.0, 0.1))
        ]
    if symbol == "lugre":
        return [{"s": 0.1 * start, "r": 1.0, "u": start * u} for u in (0.1, 0.4)]
    name, values = one.get(symbol, ("", []))
    return [{name: float(q)} for q in values] or [{}]


def whitener(rng: np.random.Generator, kind: str) -> np.ndarray:
    """Filter that whitens noise of this kind, [1, ...]; of 1/f and quantised noise it is that of white."""
    if kind == "ar1":
        return np.array([1.0, -rng.uniform(0.3, 0.9)])
    if kind == "ar2":
        # A resonance anywhere above the motion's own frequency.
        radius, angle = rng.uniform(0.5, 0.9), rng.uniform(0.4, 2.5)
        return np.array([1.0, -2.0 * radius * np.cos(angle), radius**2])
    return np.ones(1)


def innovation(weights: np.ndarray) -> float:
    """Standard deviation of the innovations of noise of unit standard deviation."""
    return float(1.0 / np.linalg.norm(lfilter([1.0], weights, np.eye(1, 3000)[0])))


def noise(rng: np.random.Generator, kind: str, weights: np.ndarray, count: int) -> np.ndarray:
    """Noise of unit standard deviation."""
    if kind == "pink":
        spectrum = np.fft.rfft(rng.standard_normal(2 * count))
        spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
        spectrum[0] = 0.0
        values = np.fft.irfft(spectrum)[:count]
        return values / values.std()
    values = lfilter([1.0], weights, rng.standard_normal(count + 500))[500:]
    return innovation(weights) * values
