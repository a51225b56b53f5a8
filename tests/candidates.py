"""Forces written as data for tests: candidates of the literature, with parts of their closed signatures."""

from typing import Any

from sysid_trib.forces.force import Force
from sysid_trib.forces.library import parse_library


def number(default: float, low: float, high: float) -> dict[str, float]:
    return {"default": default, "low": low, "high": high}


SLIP = "max(-s, min(s, zr + x - xr))"
SLIDE = "hr - (x - xr)*abs(x - xr)/2"
CANDIDATES: dict[str, dict[str, Any]] = {
    "cubic_damping": {"formula": "v**3"},
    "van_der_pol": {"formula": "x**2*v"},
    "power": {"formula": "abs(v)**p*sign(v)", "shape": {"p": number(0.5, 0.1, 3.0)}},
    "stribeck": {"formula": "exp(-(v/s)**2)*sign(v)", "shape": {"s": number(0.05, 1e-4, 1.0)}},
    "stribeck_exponential": {"formula": "exp(-abs(v)/s)*sign(v)", "shape": {"s": number(0.05, 1e-4, 1.0)}},
    "rate": {"formula": "log(1 + abs(v)/s)*sign(v)", "shape": {"s": number(0.01, 1e-4, 1.0)}},
    "regularised": {"formula": "tanh(v/0.001)"},
    "detent": {"formula": "sign(x)"},
    "magnet": {"formula": "sin(2*x)/2 - x"},
    "gravity": {"formula": "sin(x) - x"},
    "freeplay": {"formula": "max(0, abs(x) - g)*sign(x)", "shape": {"g": number(0.1, 1e-3, 1.0)}},
    "wall": {"formula": "max(0, x - g)", "shape": {"g": number(0.1, 1e-3, 1.0)}},
    "offset": {"formula": "1"},
    "even": {"formula": "x**2"},
    "even_friction": {"formula": "x*sign(v)"},
    "drift": {"formula": "t*v"},
    "ageing": {"formula": "log(1 + t)*sign(v)"},
    "ambient": {
        "formula": "sin(W*t + p)",
        "shape": {"W": number(5.0, 0.1, 50.0), "p": number(0.0, -4.0, 4.0)},
    },
    "maxwell": {"formula": "z", "state": {"z": "v - z/s"}, "shape": {"s": number(1.0, 0.01, 100.0)}},
    "dahl": {"formula": "z", "state": {"z": "(v - abs(v)*z)/s"}, "shape": {"s": number(0.01, 1e-4, 0.3)}},
    "bouc_wen": {"formula": "z", "state": {"z": "v - b*abs(v)*z"}, "shape": {"b": number(1.0, 1e-6, 1e3)}},
    "bouc_wen_2": {
        "formula": "z",
        "state": {"z": "v - b*abs(v)*abs(z)*z"},
        "shape": {"b": number(1.0, 1e-6, 1e4)},
    },
    "jenkins": {
        "formula": SLIP,
        "memory": {"xr": "x", "zr": SLIP},
        "start": {"xr": "x", "zr": "0"},
        "shape": {"s": number(0.02, 1e-4, 0.5)},
    },
    "masing": {"formula": SLIDE, "memory": {"xr": "x", "hr": SLIDE}, "start": {"xr": "x", "hr": "0"}},
    "scale": {"formula": "x**3", "kind": "sensor"},
}


def force(formula: str, symbol: str = "g", **parts: Any) -> Force:
    """A force from its formula."""
    return parse_library({"force": [{"symbol": symbol, "formula": formula, **parts}]}, "test").forces[0]


def candidate(symbol: str) -> Force:
    """A force of the table."""
    return force(symbol=symbol, **CANDIDATES[symbol])
