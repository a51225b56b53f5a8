"""How probable candidates are in each other's place, and what forces remember of a given motion."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import FIVE, W, decay, paper_run
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import quad

from sysid_trib import ForceLibrary, Model, load_library
from sysid_trib.averaging.internal_states import GivenMotion, is_linear_in_state, values_along
from sysid_trib.discrepancy.baseline import fit
from sysid_trib.discrepancy.candidate_fits import likeliest, refit
from sysid_trib.discrepancy.candidate_sensitivities import TrialCandidate, trials_of
from sysid_trib.discrepancy.competing_models import tie_class
from sysid_trib.discrepancy.model_probabilities import CREDIBLE, credible, over_shapes, probabilities
from sysid_trib.discrepancy.replacement import alone
from sysid_trib.discrepancy.score_tests import scores
from sysid_trib.discrepancy.stepwise_search import first_baseline, search
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.trajectory_fit.sensitivities import responses, tangent

CONTACT, EFFECTS = load_library(), load_library("candidate_effects")
RUN = paper_run(FIVE)
WITH_A_PAST = [force.symbol for force in EFFECTS if not force.memoryless]
# States that are not linear, or two of them: these are simulated.
SIMULATED = {"bouc_wen_2", "resonator"}


@given(arrays(float, st.integers(1, 30), elements=st.floats(-50.0, 50.0)))
def test_a_credible_set_is_the_smallest_that_is_probable_enough(costs):
    each = probabilities(costs)
    inside = credible(each)
    assert each.sum() == pytest.approx(1.0)
    assert each[inside].sum() >= CREDIBLE - 1e-12
    # Without its least probable member it is not.
    assert each[inside].sum() - each[inside].min() < CREDIBLE
    assert each[inside].min() >= each[~inside].max(initial=0.0)


@pytest.mark.parametrize("width", [0.1, 0.5, 3.0])
def test_shapes_that_must_be_set_cost_the_part_of_their_range_that_fits(width):
    force = EFFECTS["dahl"]
    low, high = np.log(force.shape["s"].low), np.log(force.shape["s"].high)
    middle = 0.4 * low + 0.6 * high

    def left(scale):
        return 7.0 + ((scale - middle) / width) ** 2

    # A coarse grid, finer where it is narrow, as scores make it.
    scales = np.unique([*np.linspace(low, high, 13), *(middle + width * np.linspace(-3.0, 3.0, 7))])
    scales = scales[(scales >= low) & (scales <= high)]
    trials = [TrialCandidate(force, {"dahl.s": float(np.exp(scale))}) for scale in scales]
    least, price = over_shapes(trials, left(scales))
    mean = quad(lambda q: np.exp(-0.5 * (left(q) - 7.0)), low, high, points=[middle])[0] / (high - low)
    assert least == pytest.approx(7.0, abs=0.05)
    assert price == pytest.approx(-2.0 * np.log(mean), abs=0.1)


def given_motion(about):
    return GivenMotion(about.tau, about.x, about.v, about.time)


@pytest.mark.parametrize("symbol", WITH_A_PAST)
def test_what_a_force_remembers_of_a_motion_is_what_it_would_move(symbol):
    model = Model(CONTACT, FIVE, W)
    about, force = tangent(model, RUN.time, 0.3, 0.0), EFFECTS[symbol]
    assert is_linear_in_state(force) is (symbol not in SIMULATED)
    if symbol in SIMULATED:
        assert values_along(given_motion(about), force, [force.shape_values()]) is None
        return
    trials = trials_of(EFFECTS.select([symbol]))
    found = values_along(given_motion(about), force, [trial.shapes for trial in trials])
    library = ForceLibrary("with one", (*CONTACT.forces, force))
    names = (*force.state, *force.memory)
    followed = []
    for trial in trials:
        one = Model(library, {**FIVE, symbol: 1e-9}, W, dict(trial.shapes))
        hidden = trajectory(one, about.time, 0.3, 0.0).hidden
        past = {name: hidden[f"{symbol}.{name}"] for name in names}
        followed.append(force.value(about.x, about.v, about.time, shapes=trial.shapes, hidden=past))
    exact = np.stack(followed, axis=1)
    # Slips of 1e-4 rad fall between two points; the motion hardly notices.
    assert np.all(np.linalg.norm(found - exact, axis=0) < 0.02 * np.linalg.norm(exact, axis=0))
    moved, true = responses(about, found), responses(about, exact)
    assert np.all(np.linalg.norm(moved - true, axis=0) < 2e-3 * np.linalg.norm(true, axis=0))


def test_a_probe_that_is_not_finite_leaves_the_others_alone():
    about, force = tangent(Model(CONTACT, FIVE, W), RUN.time, 0.3, 0.0), EFFECTS["dahl"]
    shapes = [{"dahl.s": s} for s in (0.01, 0.0, 0.02)]
    first, wild, last = values_along(given_motion(about), force, shapes).T
    assert not np.all(np.isfinite(wild))
    np.testing.assert_array_equal([first, last], values_along(given_motion(about), force, shapes[::2]).T)


@pytest.mark.slow
def test_a_passive_part_never_drives():
    """A negative partial slip is no part of a contact; as an active force it would be named."""
    library = ForceLibrary("with an effect", (*CONTACT.select(FIVE).forces, EFFECTS["partial_slip"]))
    angle = trajectory(Model(library, FIVE | {"partial_slip": -0.03}, W), RUN.time, 0.3, 0.0).angle
    run, base = decay(RUN.time, angle, seed=3), CONTACT.select(FIVE)
    active = replace(EFFECTS, forces=tuple(replace(force, passive=False) for force in EFFECTS))
    free, held = (search([run], first_baseline([run], base, None), c) for c in (active, EFFECTS))
    named = {name for s in free.added for name in tie_class(free.final, s, free.ties[s])}
    assert "partial_slip" in named
    assert "partial_slip" not in held.added
    for symbol in held.added:
        value = held.final.values[held.final.problem.parameters.index(symbol)]
        assert value >= 0.0 or not EFFECTS[symbol].passive


def test_a_strong_effect_is_held_against_each_candidate_alone():
    truth = {"zeta": 0.003, "nu": 0.14, "epsilon": 0.49, "inertia": 2.2}
    base = CONTACT.select(["zeta", "nu", "epsilon"])
    library = ForceLibrary("with an effect", (*base.forces, EFFECTS["inertia"]))
    run = decay(RUN.time, trajectory(Model(library, truth, W), RUN.time, 0.26, 0.0).angle, seed=0)
    start = first_baseline([run], base, None)
    found = scores(start, EFFECTS.select(["inertia", "sensor_cubic"]), start.references)
    fits = {hint.force.symbol: refit(start, hint, np.inf) for hint in likeliest(found)}
    models = {name: fit(one.problem, one.values, start.noises) for name, one in fits.items()}
    _, _, instead = alone(models["sensor_cubic"], ("sensor_cubic",), start, found)
    assert instead == ("inertia",)
    assert alone(models["inertia"], ("inertia",), start, found) is None


def test_a_likely_twin_is_fitted_to_its_end():
    """A few steps with nearby sensitivities lead nowhere here: the truth would be no twin."""
    base = CONTACT.select(["zeta", "delta", "epsilon"])
    library = ForceLibrary("with an effect", (*base.forces, EFFECTS["bouc_wen"]))
    truth = {"zeta": 0.003, "delta": 0.011, "epsilon": 0.11, "bouc_wen": 0.0114}
    model = Model(library, truth, W, {"bouc_wen.b": 8.05})
    run = decay(RUN.time, trajectory(model, RUN.time, 0.3, 0.0).angle, seed=0)
    found = search([run], first_baseline([run], base, None), EFFECTS.select(["dahl", "bouc_wen"]))
    (name,) = found.added
    assert set(tie_class(found.final, name, found.ties[name])) == {"dahl", "bouc_wen"}


def test_two_effects_do_not_take_each_others_place_without_end():
    base = CONTACT.select(["lambda", "zeta", "nu"])
    library = ForceLibrary("with an effect", (*base.forces, EFFECTS["dahl"]))
    truth = {"lambda": 1.7e-4, "zeta": 0.005, "nu": 0.22, "dahl": 3e-4}
    model = Model(library, truth, W, {"dahl.s": 0.042})
    run = decay(RUN.time, trajectory(model, RUN.time, 0.3, 0.0).angle, seed=0)
    found = search([run], first_baseline([run], base, None), EFFECTS.select(["dahl", "lugre"]))
    (name,) = found.added
    assert set(tie_class(found.final, name, found.ties[name])) == {"dahl", "lugre"}
    # One before the effect, one after it, and no more than one exchange.
    assert len(found.selection_steps) <= 3
