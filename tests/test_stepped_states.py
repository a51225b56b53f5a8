"""States by linear steps from sample to sample, many columns at once, against exact ones."""

import itertools
import pickle

import numpy as np
import pytest
from candidates import force
from scipy.interpolate import CubicSpline

from sysid_trib import load_library
from sysid_trib.forces.formulas import parse
from sysid_trib.simulation import stepped_states
from sysid_trib.simulation.internal_states import (
    LARGER,
    GivenMotion,
    roots_of,
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


@pytest.mark.parametrize(
    ("text", "derivative"),
    [
        ("v - 3*abs(v)*abs(z)*z", lambda v, z: -6.0 * np.abs(v * z)),
        ("max(z, v) + min(z, v)*z", lambda v, z: np.where(z > v, 1.0 + v, 2.0 * z)),
        ("sign(z)*exp(-z**2)", lambda v, z: -2.0 * np.abs(z) * np.exp(-(z**2))),
        ("sign(v)", lambda v, z: 0.0 * z),
    ],
)
def test_derivatives_are_those_of_the_branch(text, derivative):
    v, z = np.random.default_rng(3).normal(size=(2, 50))
    formula = parse(text, frozenset("vz"), frozenset(), text)
    value, slope = formula.with_derivative({"v": v, "z": z}, "z")
    np.testing.assert_allclose(slope, derivative(v, z), rtol=1e-13)
    np.testing.assert_allclose(value, formula.evaluate({"v": v, "z": z}), rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "order"),
    [
        ("(v - abs(v)*z/(1 + 2*exp(-v**2)))/3", 1.0),
        ("-(z + v)*2", 1.0),
        ("sin(v)/v", 0.0),
        ("z*(v - z)", 2.0),
        ("v - 3*abs(v)*abs(z)*z", np.inf),
        ("v/(1 + z)", np.inf),
        ("z**2", np.inf),
        ("max(z, v)", np.inf),
    ],
)
def test_the_order_in_a_variable_is_as_written(text, order):
    assert parse(text, frozenset("vz"), frozenset(), text).order_in("z") == order


def test_two_forces_of_one_symbol_have_values_of_their_own_along_a_motion():
    """A notebook may define a force anew."""
    slow, fast = (force("z", state={"z": f"v - z/{s}"}) for s in (1, 0.1))
    values = [values_along(MOTION, effect, [{}])[:, 0] for effect in (slow, fast)]
    assert np.linalg.norm(values[1]) < 0.3 * np.linalg.norm(values[0])


def test_a_formula_goes_to_another_process_after_it_was_evaluated():
    formula = parse("sign(v)*exp(-abs(v))", frozenset("v"), frozenset(), "")
    here = formula.evaluate({"v": 0.3})
    assert pickle.loads(pickle.dumps(formula)).evaluate({"v": 0.3}) == here


@pytest.mark.parametrize("step", [0.01, 0.3, 2.0])
def test_zeros_are_those_of_every_cubic(step):
    """Of a swing, and of noise that crosses zero twice between samples."""
    tau = np.arange(400) * step
    noise = np.random.default_rng(3).standard_normal(400)
    for values in (np.cos(tau + 0.3), noise):
        spline = CubicSpline(tau, values)
        zeros = spline.roots(extrapolate=False)
        np.testing.assert_allclose(roots_of(spline), zeros, rtol=0, atol=1e-9 * step)


def test_a_reversal_at_a_sample_counts_once():
    tau = np.arange(0.0, 20.0, np.pi / 8.0)
    values = np.round(np.sin(tau), 12)
    np.testing.assert_allclose(GivenMotion(tau, -np.cos(tau), values, tau).reversals, np.pi * np.arange(1, 7))


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


@pytest.mark.parametrize("k", [0.1, 1.0, 3.0])
def test_even_steps_are_those_of_any_steps(k, monkeypatch):
    shapes = [{"resonator.k": k, "resonator.d": 0.01}]
    even = values_along(GivenMotion(TAU, X, V, TAU), EFFECTS["resonator"], shapes)
    monkeypatch.setattr(stepped_states, "SAME_STEP", -1.0)
    one_by_one = values_along(GivenMotion(TAU, X, V, TAU), EFFECTS["resonator"], shapes)
    np.testing.assert_allclose(even, one_by_one, rtol=0.0, atol=1e-9 * np.abs(even).max())


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
