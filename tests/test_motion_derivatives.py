"""Derivatives of motions against differences of fourth order, through switchings, sticking and memory."""

import numpy as np
import pytest
from test_simulate import ODD, SIX, TIME, W

from sysid_trib import Model
from sysid_trib.records.inputs import KnownInput
from sysid_trib.simulation.model import BY_ANGLE, BY_RATE, FREQUENCY
from sysid_trib.simulation.trajectory import trajectory

GRID = TIME[:801:2]
CASES = {
    "dry": {"dry": 0.003, "viscous": 0.01},
    "dahl": {"dahl": 0.05, "dry": 0.001},
    "jenkins": {"jenkins": 0.1, "viscous": 0.01},
    "masing": {"masing": 0.05, "dry": 0.01},
    "sticks and goes on": {"maxwell": 0.3, "dry": 0.02},
    "wall": {"wall": 5.0, "dry": 1e-3},
    "ambient": {"ambient": 0.1, "dry": 0.05},
    "stribeck": {"stribeck": 0.02, "dry": 0.01},
    "functions": {"logarithm": 0.01, "pole": 0.01, "cubic": 0.2},
    "sensor": {"wear": 0.01, "dry": 0.01, "clock": 1e-3, "offset": 0.1},
}
# A sample within the steps around a switching has no difference: this fraction of all must agree.
MOST = 0.97


def motion(model, values, inputs=()):
    coefficients = {name: values[name] for name in model.coefficients}
    shapes = {name: values[name] for name in model.library.shape_values() if name in values}
    moved = Model(model.library, coefficients, values[FREQUENCY], shapes, dict(inputs))
    return trajectory(moved, GRID, values[BY_ANGLE], values[BY_RATE])


def furthest_off(model, inputs=()):
    """Largest difference of a derivative, by its parameter, over the largest derivative."""
    library = model.library.select(model.coefficients)
    shapes = {**library.shape_values(), **model.shapes}
    values = {**model.coefficients, **shapes, FREQUENCY: W, BY_ANGLE: 0.3, BY_RATE: 0.4}
    at = Model(model.library, model.coefficients, W, shapes, dict(inputs))
    found = trajectory(at, GRID, 0.3, 0.4, by=[*values]).derivatives
    for column, (name, value) in enumerate(values.items()):
        step = 2e-6 * (value if "." in name else 1.0)

        def ahead(steps, name=name, value=value, step=step):
            return motion(at, {**values, name: value + steps * step}, inputs)

        near, far = (ahead(1), ahead(-1)), (ahead(2), ahead(-2))
        for quantity in ("angle", "rate", "acceleration"):
            one, two = (getattr(a, quantity) - getattr(b, quantity) for a, b in (near, far))
            difference = (8.0 * one - two) / (12.0 * step)
            off = np.quantile(np.abs(found[quantity][:, column] - difference), MOST)
            yield name, quantity, off / max(np.abs(difference).max(), 1e-12)


@pytest.mark.parametrize("case", CASES)
def test_derivatives_agree_with_differences(case):
    for name, quantity, off in furthest_off(Model(ODD, CASES[case], W)):
        assert off < 1e-7, (name, quantity)


def test_derivatives_of_a_driven_motion_agree_with_differences():
    push = 0.1 * W**2 * np.sin(7.0 * GRID)
    model = Model(SIX, {"lambda": 0.01, "zeta": 0.02, "nu": 0.3}, W)
    for name, quantity, off in furthest_off(model, {"input": KnownInput(GRID, push)}):
        assert off < 1e-7, (name, quantity)


def test_friction_that_never_held_has_the_derivative_of_its_closed_solution():
    # Under sign(v) alone x = a cos + (1 - cos) lambda in the first half period: dx/d(lambda) = 1 - cos.
    time = np.linspace(0.0, 0.9 * np.pi / W, 50)
    found = trajectory(Model(ODD, {"dry": 0.01}, W), time, 0.3, by=["dry", BY_ANGLE]).derivatives["angle"]
    np.testing.assert_allclose(
        found, np.stack([1.0 - np.cos(W * time), np.cos(W * time)], axis=1), atol=1e-12
    )
