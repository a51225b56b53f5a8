"""How probable models are: Laplace's evidence, credible sets, and what forces remember of a given motion."""

import numpy as np
import pytest
from discovery import (
    EFFECTS,
    EVERY,
    TIME,
    credible_set,
    library,
    model_of,
    rows_about,
    searched,
    start_model,
    with_effect,
)
from helpers import FIVE, W
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import quad

from sysid_trib.discovery.fits import _at_end, credible, evidence, probabilities
from sysid_trib.likelihood.likelihood import likelihood
from sysid_trib.likelihood.run_rows import nuisances
from sysid_trib.likelihood.settings import DEFAULTS
from sysid_trib.likelihood.trials import TrialEffect, from_unit, to_unit, trials_of
from sysid_trib.simulation.internal_states import values_along
from sysid_trib.simulation.simulate import trajectory

PATH = rows_about(model_of(FIVE), TIME[:320]).path
WITH_A_PAST = [force.symbol for force in EFFECTS if not force.memoryless]


@given(arrays(float, st.integers(1, 30), elements=st.floats(-50.0, 50.0)))
def test_a_credible_set_is_the_smallest_that_is_probable_enough(costs):
    each = probabilities(costs)
    inside = credible(each, DEFAULTS.credible)
    assert each.sum() == pytest.approx(1.0)
    assert each[inside].sum() >= DEFAULTS.credible - 1e-12
    # Without its least probable member it is not.
    assert each[inside].sum() - each[inside].min() < DEFAULTS.credible
    assert each[inside].min() >= each[~inside].max(initial=0.0)


@given(arrays(float, st.integers(1, 30), elements=st.floats(-50.0, 50.0)), st.floats(-1e3, 1e3))
def test_probabilities_are_odds(costs, constant):
    each = probabilities(costs)
    np.testing.assert_allclose(each, probabilities(costs + constant), rtol=1e-9, atol=1e-300)
    odds = np.exp(-0.5 * (costs - costs.min()))
    np.testing.assert_allclose(each / each.max(), odds, rtol=1e-9)


def deviance_along(model, symbol, parts):
    """Least deviance for values of a shape, in parts of its range, along the path of a model."""
    (rows,) = model.rows
    at = [trial.force.symbol for trial in model.trials].index(symbol)
    force = model.trials[at].force
    (name,) = force.shape
    found = []
    for part in parts:
        trials = list(model.trials)
        trials[at] = TrialEffect(force, {f"{symbol}.{name}": float(from_unit(force.shape[name], part))})
        columns = np.column_stack([rows.columns(trials), nuisances(rows, 0, 1, model.frequency_free)])
        found.append(likelihood([rows.products(columns)], range(1, 1 + columns.shape[1])).deviance)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("symbol", "coefficient", "shape"),
    [("power_damping", 0.1, 1.4), ("power_damping", 0.02, 1.4), ("dahl", 4e-3, 0.06)],
)
def test_shapes_that_must_be_set_cost_the_part_of_their_range_that_fits(symbol, coefficient, shape):
    """Laplace's factor against an integral of the likelihood over the range, all else the same."""
    base = {"zeta": 5e-3, "epsilon": 0.2}
    (name,) = EVERY[symbol].shape
    run = with_effect({symbol: coefficient}, seed=2, base=base, shapes={f"{symbol}.{name}": shape})
    model = start_model([run], library(*base, symbol))
    rows = model.rows[0].path.form.rows
    half_line = 2.0 * np.log(2.0) * EVERY[symbol].passive
    cost = evidence(model, (symbol,)) - model.deviance - np.log(rows) + half_line
    trial = next(trial for trial in model.trials if trial.force.symbol == symbol)
    middle = to_unit(trial.force.shape[name], trial.shapes[f"{symbol}.{name}"])
    error = np.sqrt(model.likelihood.covariance[-1, -1])
    parts = np.unique(np.clip(middle + error * np.linspace(-6.0, 6.0, 61), 0.0, 1.0))
    rise = deviance_along(model, symbol, parts)
    mean = np.trapezoid(np.exp(-0.5 * (rise - rise.min())), parts)
    assert cost == pytest.approx(-2.0 * np.log(mean), abs=0.3)


def test_an_effect_costs_the_number_of_rows_and_a_half_line_is_half_of_it():
    base = {"zeta": 5e-3, "epsilon": 0.2}
    run = with_effect({"structural_damping": 1e-3, "even_spring": 1e-2}, seed=2, base=base)
    model = start_model([run], library(*base, "structural_damping", "even_spring"))
    each = [evidence(model, (symbol,)) - model.deviance for symbol in ("even_spring", "structural_damping")]
    assert each[0] == pytest.approx(np.log(model.rows[0].path.form.rows))
    assert each[0] - each[1] == pytest.approx(2.0 * np.log(2.0))
    both = evidence(model, ("even_spring", "structural_damping")) - model.deviance
    assert both == pytest.approx(sum(each))
    assert evidence(model, ()) == model.deviance


@pytest.mark.parametrize("symbol", WITH_A_PAST)
def test_what_a_force_remembers_of_a_motion_is_what_it_would_move(symbol):
    points, force = PATH.points, EVERY[symbol]
    default = {f"{symbol}.{name}": shape.default for name, shape in force.shape.items()}
    trials = trials_of([force], [], W) if len(force.shape) < 2 else [TrialEffect(force, default)]
    found = values_along(PATH.motion, force, [trial.shapes for trial in trials])
    names = (*force.state, *force.memory)
    followed = []
    for trial in trials:
        one = model_of(FIVE | {symbol: 1e-9}, trial.shapes)
        hidden = trajectory(one, points.time, 0.3, 0.0).hidden
        past = {name: hidden[f"{symbol}.{name}"] for name in names}
        followed.append(force.value(points.x, points.v, points.time, shapes=trial.shapes, hidden=past))
    exact = np.stack(followed, axis=1)
    # Slips of 1e-4 rad fall between two points; the rows hardly notice.
    for values, limit in ((found, 0.02), (points.integrals @ found, 5e-3)):
        true = exact if len(values) == len(exact) else points.integrals @ exact
        assert np.all(np.linalg.norm(values - true, axis=0) < limit * np.linalg.norm(true, axis=0))


def test_a_likely_rival_is_in_the_set():
    """At small amplitude gravity and a cubic force are one."""
    base = {"zeta": 3e-3}
    run = with_effect({"gravity": 1.0}, seed=0, base=base)
    found = searched([run], library("epsilon", "gravity", "nu", "cubic_damping"), library(*base))
    (name,) = found.effects
    assert credible_set(found, name) == {"epsilon", "gravity"}


def test_a_strong_effect_is_alone_in_its_set():
    base = {"zeta": 0.003, "nu": 0.14, "epsilon": 0.49}
    run = with_effect({"inertia": 2.2}, seed=0, base=base, start=0.26)
    found = searched([run], EFFECTS.select(["inertia", "sensor_cubic", "cubic_damping"]), library(*base))
    assert found.effects == ("inertia",)
    assert credible_set(found, "inertia") == {"inertia"}


@pytest.mark.slow
def test_two_effects_do_not_take_each_others_place_without_end():
    base = {"lambda": 1.7e-4, "zeta": 0.005, "nu": 0.22}
    run = with_effect({"dahl": 3e-4}, seed=0, base=base, shapes={"dahl.s": 0.042})
    found = searched([run], EFFECTS.select(["dahl", "lugre"]), library(*base))
    (name,) = found.effects
    assert "dahl" in credible_set(found, name)
    assert found.converged
    # One before the effect, one after it, and no more than one exchange.
    assert len(found.screenings) <= 3


@pytest.mark.parametrize(("outside", "error"), [(0.0, 0.1), (0.1, 0.05), (2.0, 0.3), (0.01, 30.0)])
def test_a_shape_at_an_end_of_its_range_costs_what_is_left_of_it(outside, error):
    likely = quad(lambda part: np.exp(-(part**2 + 2.0 * part * outside) / (2.0 * error**2)), 0.0, 1.0)[0]
    assert _at_end(outside, error) == pytest.approx(-2.0 * np.log(likely), abs=1e-6)


def test_a_shape_that_says_nothing_at_its_end_costs_nothing():
    assert _at_end(0.5, 0.0) == 0.0
    assert abs(_at_end(0.5, 1e6)) < 1e-9
