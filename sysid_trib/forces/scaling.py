"""How coefficients and shape parameters change with the unit of the signal and the reference frequency."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from sysid_trib.forces.force import Force

FACTORS = (2.0, 0.125)
# Powers of the signal that shape parameters, and states and memory, may have.
SHAPE_POWERS = (0.0, 1.0, -1.0, -2.0)
HIDDEN_POWERS = (1.0, 0.0, 2.0)
# Powers of the reference frequency that these may have, and by how much those of rates, d/d(w t), are less.
REFERENCE_POWERS = (0.0, -1.0, 1.0, -2.0, 2.0)
OF_RATES = -1.0


@dataclass(frozen=True)
class Powers:
    """Powers of the signal's unit, or of the reference frequency, with which a force is written.

    Attributes
    ----------
    coefficient : float
    shapes : dict of str to float
        Power of each shape parameter.
    """

    coefficient: float
    shapes: dict[str, float]


@lru_cache(maxsize=1024)
def signal_powers(force: Force) -> Powers | None:
    """Powers of the signal's unit in a coefficient and its shape parameters; None if it has none.

    Parameters
    ----------
    force : Force
        The coefficient of a force of degree p in the signal, its states and shape parameters scaled along, is
        in unit^(1-p). `sin(x) - x` has no degree: it knows a radian. `tanh(v/s)` is of degree 0, with s of
        power 1. A degree that depends on a shape parameter, as that of abs(v)**p, is none.
    """
    of_signal = {channel.name: 1.0 for channel in force.channels if channel.kind}
    scaled = _powers(force, {"x": 1.0, "v": 1.0} | of_signal, SHAPE_POWERS, HIDDEN_POWERS, 0.0)
    return None if scaled is None else Powers(1.0 - scaled[0], scaled[1])


@lru_cache(maxsize=1024)
def reference_powers(force: Force) -> Powers | None:
    """Powers of the reference frequency w of a coefficient and its shape parameters; None if it has none.

    Parameters
    ----------
    force : Force
        -w^2 c f(x, v) with v = x'/w: of `v` the coefficient goes as 1/w, of `sin(x) - x` as 1/w^2. A natural
        frequency in units of w goes as 1/w, a relaxation time as w. None of abs(v)**p, as of `signal_powers`.
    """
    over_w = {channel.name: -float(channel.power) for channel in force.channels if channel.power}
    scaled = _powers(force, {"v": -1.0} | over_w, REFERENCE_POWERS, REFERENCE_POWERS, OF_RATES)
    if scaled is None:
        return None
    degree, shapes = scaled
    return Powers(-degree - (0.0 if force.kind == "sensor" else 2.0), shapes)


def _powers(
    force: Force,
    motion: Mapping[str, float],
    of_shapes: Sequence[float],
    of_hidden: Sequence[float],
    of_rates: float,
) -> tuple[float, dict[str, float]] | None:
    """Degree of a force, and powers of its shape parameters, as x and v scale with given powers."""
    hidden = (*force.state, *force.memory)
    for shape_powers in itertools.product(of_shapes, repeat=len(force.shape)):
        shapes = dict(zip(force.shape, shape_powers, strict=True))
        for hidden_powers in itertools.product(of_hidden, repeat=len(hidden)):
            powers = {**motion, **shapes, **dict(zip(hidden, hidden_powers, strict=True))}
            degrees = {_degree(force, powers, points, of_rates) for points in _points(force, shapes)}
            if None not in degrees and len(degrees) == 1:
                return float(degrees.pop() or 0.0), shapes
    return None


def _points(force: Force, shapes: dict[str, float]) -> list[dict[str, Any]]:
    """Test points with pure numbers at their default and at either end."""
    ends = ("default", "low", "high")
    pure = [{k: getattr(force.shape[k], end) for k, p in shapes.items() if p == 0.0} for end in ends]
    return [force.test_points | values for values in (pure if pure[0] else pure[:1])]


def _degree(force: Force, powers: dict[str, float], points: dict[str, Any], of_rates: float) -> float | None:
    """Degree of the force if states and memory keep their powers, else None."""
    rates = [(formula, powers[name] + of_rates) for name, formula in force.state.items()]
    values = [(f, powers[name]) for name, f in (*force.memory.items(), *force.start.items())]
    if any(f.degree_in(powers, points, FACTORS) not in (power, np.inf) for f, power in rates + values):
        return None
    degree = force.formula.degree_in(powers, points, FACTORS)
    return None if degree == np.inf else degree
