"""States by linear steps from sample to sample, many columns at once, against exact ones."""

import itertools

import numpy as np
import pytest
from candidates import force

from sysid_trib import load_library
from sysid_trib.simulation.internal_states import (
    LARGER,
    GivenMotion,
    states_along,
    tangent_along,
    values_along,
)
from sysid_trib.simulation.stepped_states import is_linear, is_stepped

EFFECTS = load_library("candidate_effects")
HISTORIES = [effect.symbol for effect in EFFECTS if not effect.memoryless]
# A damped motion with its exact rate, as densely sampled as reference motions are.
TAU = np.arange(0.0, 60.0, 0.033)
SWING = 0.3 * np.exp(-0.01 * TAU)
X, V = SWING * np.cos(TAU), -SWING * (np.sin(TAU) + 0.01 * np.cos(TAU))
MOTION = GivenMotion(TAU, X, V, TAU)


def grid(effect):
    """Least, middle and largest values of the shape parameters, in all combinations."""
    columns = [
        np.geomspace(s.low, s.high, 3) if s.low > 0.0 else np.linspace(s.low, s.high, 3)
        for s in effect.shape.values()
    ]
    names = [f"{effect.symbol}.{k}" for k in effect.shape]
    return [dict(zip(names, map(float, row), strict=True)) for row in itertools.product(*columns)]


def collocated(effect, shapes):
    hidden = states_along(effect, TAU, X, V, shapes, time=TAU)
    return effect.value(X, V, TAU, shapes=shapes, hidden=hidden)


@pytest.mark.parametrize("symbol", HISTORIES)
def test_steps_follow_every_force_of_the_library(symbol):
    effect = EFFECTS[symbol]
    columns = grid(effect)
    values = values_along(MOTION, effect, columns)
    exact = np.stack([collocated(effect, shapes) for shapes in columns], axis=1)
    error = np.linalg.norm(values - exact, axis=0) / np.linalg.norm(exact, axis=0)
    # Slips of 1e-4 rad fall between two samples.
    assert error.max() < 0.02
    assert np.median(error) < 3e-3


@pytest.mark.parametrize(
    ("states", "worst"),
    [
        ({"z": "v - 300*abs(v)*abs(z)**3*z"}, 3e-4),
        ({"z": "v - tanh(z/0.01)"}, 1e-4),
        ({"z": "v - min(z, 0.05)"}, 1e-4),
        # Critical damping: two equal eigenvalues and one eigenvector.
        ({"z": "u", "u": "-x - z - 2*u"}, 3e-5),
        ({"z": "u", "u": "y", "y": "x - z - u - y"}, 3e-5),
        # Stiff beside slow.
        ({"z": "v - u", "u": "z/100 - 1000*u"}, 3e-5),
        ({"z": "u", "u": "-x"}, 1e-4),
    ],
    ids=lambda value: " ".join(value.values()) if isinstance(value, dict) else "",
)
def test_steps_follow_any_rate_of_one_state_and_constant_coefficients_of_several(states, worst):
    effect = force("z", state=states)
    (values,) = values_along(MOTION, effect, [{}]).T
    exact = collocated(effect, {})
    assert np.linalg.norm(values - exact) < worst * np.linalg.norm(exact)


@pytest.mark.parametrize("k", [0.0, 0.3, 1.0, 10.0])
def test_a_resonance_rings_with_its_own_frequency_and_damping(k):
    effect = force("z", state={"z": "u - 0.001*z", "u": f"-{k}**2*z - 0.001*u"}, start={"z": "1"})
    (values,) = values_along(MOTION, effect, [{}]).T
    # Radau's own steps take a quarter of the amplitude at k = 10 within this time.
    np.testing.assert_allclose(values, np.exp(-0.001 * TAU) * np.cos(k * TAU), atol=1e-3)


@pytest.mark.parametrize(
    ("symbol", "shape", "values"),
    [
        ("dahl", "s", (0.01, 0.0, 0.02)),
        ("bouc_wen_2", "b", (30.0, 0.0, 900.0)),
        ("resonator", "k", (0.5, np.inf, 3.0)),
        ("masing", "m", (1.5, np.nan, 2.0)),
    ],
)
def test_a_column_that_is_not_finite_does_not_touch_the_others(symbol, shape, values):
    effect = EFFECTS[symbol]
    defaults = {f"{symbol}.{k}": value for k, value in effect.shape_values().items()}
    columns = [defaults | {f"{symbol}.{shape}": value} for value in values]
    first, second, third = values_along(MOTION, effect, columns).T
    assert not np.all(np.isfinite(second))
    np.testing.assert_array_equal([first, third], values_along(MOTION, effect, columns[::2]).T)
    assert np.all(np.isfinite([first, third]))


@pytest.mark.parametrize("rate", ["1 + 9*z*z", "v - 0.1*sign(z)"])
def test_a_course_that_does_not_settle_is_no_number(rate):
    values = values_along(MOTION, force("z", state={"z": rate}), [{}])
    assert values.shape == (TAU.size, 1)
    assert np.all(np.isnan(values))


@pytest.mark.parametrize(
    "given",
    [
        {"state": {"z": "v - (z - x)"}, "memory": {"m": "z"}},
        {"state": {"z": "u", "u": "-x - z*z"}},
        {"state": {"z": "u", "u": "-x - abs(v)*z"}},
    ],
    ids=["memory of a state", "two states, not linear", "coefficients that vary"],
)
def test_what_steps_cannot_follow_is_said_beforehand(given):
    effect = force("z", **given)
    assert not is_stepped(effect)
    assert values_along(MOTION, effect, [{}]) is None


@pytest.mark.parametrize("symbol", ["masing", "jenkins", "dahl"])
def test_a_larger_motion_is_one_of_that_size(symbol):
    effect, factor = EFFECTS[symbol], 1.0 + LARGER
    shapes = [{f"{symbol}.{k}": shape.default for k, shape in effect.shape.items()}]
    drawn = GivenMotion(TAU, factor * X, factor * V, TAU)
    expected, found = (values_along(motion, effect, shapes) for motion in (drawn, MOTION.larger))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("k", [3.0, 5.43])
def test_a_ring_is_no_stiffness(k):
    """A resonance answers a swing by its transfer function; its ring would be k times as stiff."""
    of_x, of_v = tangent_along(MOTION, EFFECTS["resonator"], {"resonator.k": k, "resonator.d": 0.001})
    answer = -1.0 / (k**2 - 1.0 + 0.002j)
    middle = slice(200, -200)
    np.testing.assert_allclose(of_x[middle], answer.real, atol=0.15 * k * abs(answer))
    np.testing.assert_allclose(of_v[middle], answer.imag, atol=0.15 * k * abs(answer))


@pytest.mark.parametrize("symbol", ["resonator", "maxwell"])
def test_what_is_linear_grows_with_the_motion(symbol):
    """So that its tangent needs no larger motion."""
    effect, shapes = EFFECTS[symbol], grid(EFFECTS[symbol])[-1]
    assert is_linear(effect)
    here, larger = (values_along(along, effect, [shapes]) for along in (MOTION, MOTION.larger))
    np.testing.assert_allclose(
        larger, (1.0 + LARGER) * here, rtol=0.0, atol=1e-6 * LARGER * np.abs(here).max()
    )


@pytest.mark.parametrize(
    "given",
    [
        {"state": {"z": "v - z"}, "start": {"z": "1"}},
        {"state": {"z": "v - z + 1"}},
        {"state": {"z": "v - z**3"}},
        {"state": {"z": "v - t*z"}},
    ],
    ids=["rings by itself", "pushed", "cubic", "rate that drifts"],
)
def test_what_does_not_grow_in_proportion_is_not_linear(given):
    assert not is_linear(force("z", **given))
