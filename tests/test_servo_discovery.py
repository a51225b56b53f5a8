"""The friction law of a joint by `discover`: forces whose formulas hold coefficients of other forces."""

import numpy as np
import pytest
from command_line import run

import sysid_trib as st
from benchmarks import servo
from sysid_trib.discovery.engine.trials import Settings
from sysid_trib.discovery.motion_fits import (
    Budget,
    MotionFits,
    MotionModel,
    decimated_run,
)
from sysid_trib.motion_fit.least_squares import Fit
from sysid_trib.motion_fit.parameters import PER_RUN
from sysid_trib.motion_fit.problem import FitProblem, WhitenedRecord
from sysid_trib.results.effects import added_effects, credible_set, steps_taken
from sysid_trib.results.judged import verdict_of

START = ("gravity", "motor", "back_emf", "lambda", "zeta")


def runs_of(law: str, seed: int = 0):
    """Six of the simulated runs: two gains, three motions."""
    runs = servo.rig_runs(servo.RIG_LAWS[law], seed)
    return [runs[at] for at in (0, 1, 3, 4, 5, 7)]


@pytest.fixture(scope="module")
def load():
    forces = servo.library()
    start = forces.select(START)
    return st.discover(runs_of("with the load"), start, forces, constraints={"gravity": 1.0})


def test_the_load_is_named_although_the_start_model_is_far_from_the_records(load):
    assert added_effects(load) == ["load_friction"]
    assert load.attrs["search_outcome"] == "explained"
    assert verdict_of(load) == "explained"
    (step,) = steps_taken(load)
    assert abs(step.coefficient.item() - 0.2) < 4.0 * step.standard_error.item()
    assert step.standard_error.item() < 2e-3
    assert [*credible_set(step)] == ["load_friction"]
    before, after = load["holdout"].rms.values
    assert before > 20.0 * servo.RIG_NOISE
    assert after < 1.2 * servo.RIG_NOISE
    # The formula holds coefficients by name, which are those of the final model.
    assert "motor" in step.formula.item()
    motor = load["after"].coefficient.sel(force="motor").item()
    assert motor == pytest.approx(servo.RIG["motor"], rel=5e-3)


def test_a_complete_joint_is_given_no_further_force():
    forces = servo.library()
    tree = st.discover(
        runs_of("Coulomb and viscous"), forces.select(START), forces, constraints={"gravity": 1.0}
    )
    assert added_effects(tree) == []
    assert tree.attrs["search_outcome"] == "nothing missing"


@pytest.mark.slow
@pytest.mark.parametrize("law", ["with Stribeck", "directional", "with the load, and Stribeck"])
def test_the_law_of_a_simulated_rig_is_named(law):
    forces = servo.library()
    tree = st.discover(runs_of(law), forces.select(START), forces, constraints={"gravity": 1.0})
    assert {*added_effects(tree)} == {*servo.RIG_LAWS[law]}
    assert tree.attrs["search_outcome"] == "explained"


@pytest.mark.slow
def test_a_model_that_stopped_at_a_worse_minimum_is_fitted_again_from_a_larger_one():
    """Without it the search drops an effect that is not needed, and arrives at a fit 50 times worse."""
    forces, law = servo.library(), servo.RIG_LAWS["with the load, and Stribeck"]
    tree = st.discover(servo.rig_runs(law, 1), forces.select(START), forces, constraints={"gravity": 1.0})
    assert {*added_effects(tree)} == {*law}
    assert tree.attrs["search_outcome"] == "explained"


def test_the_time_limit_ends_a_search_by_motions():
    forces = servo.library()
    tree = st.discover(
        runs_of("with the load")[:2],
        forces.select(START),
        forces,
        constraints={"gravity": 1.0},
        time_limit=1e-3,
    )
    assert tree.attrs["out_of_time"] == "0.001 s"
    assert tree.attrs["search_outcome"] == "unknown effect"
    assert not bool(tree["converged"])


def test_a_search_by_motions_ends_at_a_number_of_computed_samples(monkeypatch):
    """By default, too, it ends: the limit does not depend on the speed of the computer."""
    runs, forces = runs_of("with the load")[:2], servo.library()
    samples = 30 * sum(run.sizes["time"] for run in runs)
    monkeypatch.setattr("sysid_trib.discovery.discover.MOST_COMPUTED", samples)
    tree = st.discover(runs, forces.select(START), forces, constraints={"gravity": 1.0})
    assert tree.attrs["out_of_time"] == ""
    assert not bool(tree["converged"])
    assert tree.attrs["search_outcome"] == "unknown effect"
    assert "ended after as many fits as its settings allow" in str(st.show(tree))


def test_a_fit_ends_within_its_evaluations_if_the_budget_is_spent():
    runs, forces = runs_of("with the load")[:2], servo.library()
    samples, start = sum(run.sizes["time"] for run in runs), forces.select(START)
    candidates = forces.select([symbol for symbol in forces.symbols if symbol not in START])
    fits = MotionFits(
        runs, start, candidates, {"gravity": 1.0}, None, Settings(), Budget(np.inf, 6 * samples)
    )
    first = fits.first()
    assert fits.of(["load_friction"], first) is None
    # The last evaluation may exceed the budget; no other one is begun.
    assert -samples < fits.budget.samples <= 0
    assert fits.failed == []
    assert fits.best_nearby(first) is first


class LinearParameters:
    """Two common parameters, and the start of each of six runs."""

    common = ("first", "second")
    names = (*common, *(f"{name} of run {run}" for run in range(6) for name in PER_RUN))
    free = np.array([at for at, name in enumerate(names) if not name.startswith("offset")])


def test_the_squares_of_what_is_left_out_are_those_of_fits_without_it():
    """Of a linear model exactly: the start is each run's own, and is fitted to what is left out."""
    random, time = np.random.default_rng(3), np.arange(30.0)
    design, target = random.standard_normal((6, len(time), 2)), random.standard_normal((6, len(time)))
    own = np.stack([np.exp(-time / 5.0), time * np.exp(-time / 5.0)], axis=1)
    table = np.zeros((6, len(time), 14))
    for at in range(6):
        table[at, :, :2], table[at, :, 2 + 2 * at : 4 + 2 * at] = design[at], own
    whole, measured = table.reshape(-1, 14), target.ravel()
    values = np.linalg.lstsq(whole, measured, rcond=None)[0]
    problem = FitProblem(LinearParameters(), (WhitenedRecord(time, time),) * 6, [], None)
    model = MotionModel((), Fit(problem, values, whole @ values - measured, whole), 1, 0.01)
    for at, squares in enumerate(model.left_out_squares):
        others = np.arange(6) != at
        common = np.linalg.lstsq(table[others].reshape(-1, 14), target[others].ravel(), rcond=None)[0][:2]
        rest = target[at] - design[at] @ common
        rest = rest - own @ np.linalg.lstsq(own, rest, rcond=None)[0]
        assert squares == pytest.approx(rest @ rest, rel=1e-6)


def test_a_run_of_many_samples_is_thinned_and_says_so():
    (run_of_many,) = [servo.rig_runs({}, 0, step=0.001)[0]]
    fewer = decimated_run(run_of_many, servo.RIG_FREQUENCY, 60)
    assert fewer.attrs["decimated"] == "6000 samples to 1500, by single samples"
    few = servo.rig_runs({}, 0)[0]
    assert decimated_run(few, servo.RIG_FREQUENCY, 60) is few


def test_a_random_force_takes_no_part_in_the_choice(load):
    (step,) = steps_taken(load)
    assert step.random_force_before.item() == step.random_force_after.item() == 0.0


def test_the_command_names_the_load_and_prints_no_omnibus_test(load, tmp_path):
    names = []
    for at, record in enumerate(runs_of("with the load")):
        table = np.column_stack([record.time, record.angle, record.goal, record.kp, record.on])
        names.append(str(tmp_path / f"run_{at}.csv"))
        header = "time (s),position (rad),goal position (rad),kp,torque on"
        np.savetxt(names[-1], table, delimiter=",", header=header, comments="", fmt="%.6f")
    library = tmp_path / "servo.toml"
    library.write_text(servo.library_text(servo.DUTY_RATIO), encoding="utf-8")
    how = ["--angle", "position (rad)", "--input", "goal=goal position,on=torque on", "--between", "linear"]
    how += ["--constant", "kp=kp", "--library", str(library), "--forces", ",".join(START)]
    ending = run("discover", *names, *how, "--candidates", str(library))
    assert ending.status == 0, ending.err
    assert ending.out.startswith("Explained: with load_friction the residual is ")
    assert "omnibus" not in ending.out
    # In the run in which the torque is switched off, the switch is held, the goal linear.
    assert "; goal linear; on, kp held between samples" in ending.out
