"""Friction laws that are made passive."""

import json

import numpy as np
import pytest

import sysid_trib as st
from sysid_trib.errors import DecayError
from sysid_trib.printing.laws import laws_blocks
from sysid_trib.results.law_curves import PASSIVE
from sysid_trib.smooth_laws.bands import laws_of
from sysid_trib.smooth_laws.passive import made_passive

W, NOISE, LARGEST = 9.0, 3e-4, {"x": 0.3, "v": 2.7}
FRICTION = st.load_library().select(["lambda", "zeta", "delta"])


def identified(coefficients, **constraints):
    """Friction by Direct, of a record whose friction feeds energy in at low speed."""
    model = st.Model(FRICTION, coefficients, W)
    motion = st.simulate(model, np.arange(0.0, 15.0, 0.02), angle=0.3)[["angle"]]
    motion["angle"] += NOISE * np.random.default_rng(0).standard_normal(motion.sizes["time"])
    method = st.methods.Direct(random_force="off", constraints=constraints)
    return method.identify(st.free_decay(motion), FRICTION)


ACTIVE = {"lambda": 0.0, "zeta": -0.004, "delta": 0.08}


def friction_of(result):
    return laws_of(result, LARGEST)[0]


def test_friction_dissipates_at_every_speed_and_active_constraints_are_stated():
    result = identified(ACTIVE)
    assert friction_of(result).values.min() < 0.0
    passive = made_passive(result, LARGEST)
    law = friction_of(passive)
    assert law.values.min() >= -1e-9 * law.values.max()
    acting = json.loads(passive.attrs[PASSIVE])
    assert 0 < len(acting) < 10
    # Ranges in which the law is negative, as fractions of the largest speed.
    assert max(acting) < 0.45


def test_it_is_the_nearest_of_all_passive_laws():
    result = identified(ACTIVE)
    passive = made_passive(result, LARGEST)
    inverse = np.linalg.inv(result.covariance.values)

    def distance(coefficients):
        off = coefficients - result.coefficient.values
        return off @ inverse @ off

    nearest = distance(passive.coefficient.values)
    draw = np.random.default_rng(1)
    scale = result.standard_error.values
    for _ in range(300):
        other = passive.assign(coefficient=passive.coefficient + 3.0 * scale * draw.standard_normal(3))
        if friction_of(other).values.min() >= 0.0:
            assert distance(other.coefficient.values) > 0.98 * nearest


def test_a_passive_law_is_unchanged():
    result = identified({"lambda": 3e-4, "zeta": 0.01, "delta": 0.03})
    passive = made_passive(result, LARGEST)
    assert json.loads(passive.attrs[PASSIVE]) == []
    np.testing.assert_array_equal(passive.coefficient, result.coefficient)


def test_held_forces_that_feed_energy_in_are_refused():
    result = identified(ACTIVE, **{"lambda": -0.01})
    with pytest.raises(DecayError, match="Held forces feed energy in"):
        made_passive(result, LARGEST)


@pytest.mark.slow
def test_laws_say_where_passivity_acts():
    motion = st.simulate(st.Model(FRICTION, ACTIVE, W), np.arange(0.0, 12.0, 0.03), angle=0.3)[["angle"]]
    motion["angle"] += NOISE * np.random.default_rng(0).standard_normal(motion.sizes["time"])
    tree = st.laws(st.free_decay(motion), passive=True)
    result = st.best(tree)
    assert result.friction.values.min() >= -1e-9 * result.friction.values.max()
    assert tree["judged"].attrs[PASSIVE] == result.attrs[PASSIVE]
    tree["judged"].attrs[PASSIVE] = json.dumps([1e-6, 0.025, 0.05, 0.4])
    speed = result.speed.values
    assert (
        "The passivity constraint is active next to zero speed and at "
        f"{speed[0]:.3g} to {speed[1]:.3g} and {speed[15]:.3g} rad/s"
    ) in said_of(tree)


def said_of(tree):
    return " ".join(text for block in laws_blocks(tree) for text in block.sentences)


@pytest.mark.parametrize(
    ("noise", "cause"),
    [(3e-4, "does not determine whether friction feeds"), (1e-5, "is an error of the sensor within")],
)
def test_a_jump_made_passive_is_stated_at_zero_speed_with_its_size(noise, cause):
    # Too few half periods for a curve, so that the laws are those of the named forces.
    truth = st.Model(FRICTION, {"lambda": -2.5e-4, "zeta": 0.04, "delta": 0.04}, W)
    motion = st.simulate(truth, np.arange(0.0, 2.0, 0.01), angle=0.3)[["angle"]]
    motion["angle"] += noise * np.random.default_rng(0).standard_normal(motion.sizes["time"])
    decay = st.free_decay(motion)
    held = {"nu": 0.0, "epsilon": 0.0}
    free, passive = (st.laws(decay, constraints=held, passive=asked) for asked in (False, True))
    assert json.loads(passive["judged"].attrs[PASSIVE]) == pytest.approx([1e-6])
    # Without the constraint, friction is positive at all speeds shown, and negative only in its jump.
    before = st.best(free).sel(force="lambda")
    assert np.all(st.best(free).friction.values > 0.0)
    errors = -before.coefficient.item() / before.standard_error.item()
    said = said_of(passive)
    assert "active next to zero speed: without it" in said
    assert f"negative, by up to {errors:.2g} standard errors" in said
    assert cause in said
