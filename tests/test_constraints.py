"""Constraints: fixed, bounded and tied parameters are read, satisfied by every method, or refused."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from command_line import run
from helpers import FIVE, SIX, W, library_of_formulas, names, paper_run, values

from sysid_trib import Model, compare, free_decay, identify, load_library, simulate, system
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces import ForceLibrary
from sysid_trib.forces.constraints import Constraints
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.validation.identify import run_agreement

FORCES = load_library()
EFFECTS = load_library("candidate_effects")
METHODS = pytest.mark.parametrize("method", [Direct, Trajectory, Averaging], ids=lambda m: m.__name__)
QUICK = ("--window", ":9")


@pytest.fixture(scope="module")
def record():
    return paper_run(SIX).decay(0)


def test_a_fixed_value_stays_one_with_a_frequency_without_contact(record):
    found = identify(record, FORCES, Direct(), constraints={"delta": 0.01}, contactless=(9.0, 0.01))
    assert found.constraint.sel(force=["alpha", "delta"]).values.tolist() == ["", "fixed"]


@METHODS
def test_a_fixed_value_comes_back_exactly_and_conditions_the_others(record, method):
    """The covariance of the unconstrained fit gives the effect of a fixed coefficient on others."""
    truth, free = FIVE["epsilon"], method(reference_frequency=W).identify(record, FORCES)
    fixed = method(reference_frequency=W, constraints={"epsilon": truth}).identify(record, FORCES)
    held = fixed.sel(force="epsilon")
    assert (held.coefficient.item(), held.standard_error.item()) == (truth, 0.0)
    assert held.constraint.item() == "fixed"
    others = [s for s in free.force.values.tolist() if s != "epsilon"]
    assert set(fixed.constraint.sel(force=others).values) == {""}
    variance = free.covariance.sel(force="epsilon", other_force="epsilon").item()
    gain = free.covariance.sel(other_force="epsilon") / variance
    expected = free.coefficient + gain * (truth - free.coefficient.sel(force="epsilon").item())
    apart = (fixed.coefficient - expected) / free.standard_error
    np.testing.assert_allclose(apart.sel(force=others), 0.0, atol=0.02)
    errors = np.sqrt((free.standard_error**2 - variance * gain**2).sel(force=others))
    np.testing.assert_allclose(fixed.standard_error.sel(force=others), errors, rtol=0.02)


@pytest.mark.parametrize("frequency", [W, None], ids=["given", "fitted"])
def test_a_force_fixed_at_zero_is_a_force_left_out(record, frequency):
    fixed = Direct(frequency, constraints={"lambda": 0.0}).identify(record, FORCES)
    rest = [s for s in fixed.force.values.tolist() if s != "lambda"]
    without = Direct(frequency).identify(record, FORCES.select(rest))
    np.testing.assert_allclose(values(fixed, rest), values(without, rest), rtol=1e-6)
    np.testing.assert_allclose(fixed.standard_error.sel(force=rest), without.standard_error, rtol=1e-3)


@METHODS
def test_a_tie_is_a_library_with_both_forces_in_one(record, method):
    tied = method(reference_frequency=W, constraints={"nu": "-2.356*delta"}).identify(record, FORCES)
    value, error = (tied[k].sel(force=["delta", "nu"]).values for k in ("coefficient", "standard_error"))
    assert value[1] == pytest.approx(-2.356 * value[0], rel=1e-12)
    assert error[1] == pytest.approx(2.356 * error[0])
    assert tied.constraint.sel(force="nu").item() == "nu=-2.356*delta"
    rest = [s for s in FORCES.symbols if s not in ("delta", "nu")]
    both = library_of_formulas(both="v*abs(v) - 2.356*x*abs(x)")
    same = method(reference_frequency=W).identify(
        record, ForceLibrary("merged", (*FORCES.select(rest), *both))
    )
    for symbol, name in [*zip(rest, rest, strict=True), ("delta", "both")]:
        expected, scale = (same[k].sel(force=name).item() for k in ("coefficient", "standard_error"))
        assert tied.coefficient.sel(force=symbol).item() == pytest.approx(expected, abs=1e-3 * scale)
        assert tied.standard_error.sel(force=symbol).item() == pytest.approx(scale, rel=1e-3)


def test_a_tie_need_not_be_linear_in_a_fit_of_the_motion(record):
    found = Trajectory(W, constraints={"alpha": "-abs(nu)**1.5"}).identify(record, FORCES)
    nu, alpha = (found.sel(force=s) for s in ("nu", "alpha"))
    assert alpha.coefficient.item() == -(abs(nu.coefficient.item()) ** 1.5)
    slope = 1.5 * abs(nu.coefficient.item()) ** 0.5
    assert alpha.standard_error.item() == pytest.approx(slope * nu.standard_error.item())


@METHODS
def test_a_coefficient_at_its_bound_has_the_errors_of_the_free_fit(record, method):
    low = 1.05 * SIX["zeta"]
    bounded, fixed, free, wide = (
        method(reference_frequency=W, constraints=c).identify(record, FORCES)
        for c in ({"zeta": (low, np.inf)}, {"zeta": low}, {}, {"zeta": (0.0, 1.0)})
    )
    zeta = bounded.sel(force="zeta")
    assert zeta.coefficient.item() == low
    assert zeta.constraint.item() == "at its bound"
    np.testing.assert_allclose(bounded.coefficient, fixed.coefficient, rtol=1e-6)
    # A coefficient at its bound is not known: all errors are at least as large as if it were free.
    assert np.all(bounded.standard_error >= 0.95 * free.standard_error)
    np.testing.assert_allclose(wide.coefficient, free.coefficient, rtol=1e-5)
    assert set(wide.constraint.values) == {""}


def test_constraints_hold_for_several_runs_and_in_strong_form():
    runs = [paper_run(SIX, duration=12.0).decay(seed) for seed in range(2)]
    asked = {"lambda": 0.0, "nu": "-2.356*delta"}
    together = Direct(constraints=asked).identify(runs, FORCES)
    for found in (together, Direct(W, form="strong", constraints=asked).identify(runs[0], FORCES)):
        dry, delta, nu = values(found, ["lambda", "delta", "nu"])
        assert (dry, nu) == (0.0, pytest.approx(-2.356 * delta, rel=1e-12))
    compared = run_agreement(runs, together)
    assert set(compared.quantity.values.tolist()) == {"zeta", "delta", "epsilon", "asymptotic frequency"}


def test_selection_is_among_the_free_coefficients(record):
    method = Direct(W, significance=0.01, constraints={"lambda": SIX["lambda"], "nu": "-10.8*delta"})
    found = method.identify(record, FORCES)
    assert names(found.force.values, found.active.values) == {"lambda", "zeta", "delta", "nu", "epsilon"}
    alone = Direct(W, significance=0.01, constraints={"zeta": "100*alpha"}).identify(record, FORCES)
    assert alone.active.sel(force="zeta").item() == alone.active.sel(force="alpha").item()


def test_identical_forces_may_be_separated_by_a_fixed_value(record):
    library = library_of_formulas(zeta="2*v", viscous="v", delta="v*abs(v)", nu="x*abs(x)", epsilon="x**3")
    found = Direct(constraints={"viscous": 0.005}).identify(record, library)
    alone = Direct().identify(record, library.select(["zeta", "delta", "nu", "epsilon"]))
    expected = alone.coefficient.sel(force="zeta").item() - 0.0025
    assert found.coefficient.sel(force="zeta").item() == pytest.approx(expected, rel=1e-4)


def test_shapes_are_held_and_may_be_fixed():
    from test_direct import run_with

    run, method = run_with("stribeck")
    fixed = Direct(W, constraints={"stribeck.s": 0.05}).identify(run.decay(0), run.model.library)
    given = method.identify(run.decay(0), run.model.library)
    np.testing.assert_array_equal(fixed.coefficient, given.coefficient)
    assert fixed.shape.sel(shape_parameter="stribeck.s").item() == 0.05
    with pytest.raises(UsageError, match=r"stribeck.s is bounded"):
        Direct(W, constraints={"stribeck.s": (0.0, 1.0)}).identify(run.decay(0), run.model.library)


def test_constraints_on_a_displacement_are_in_its_unit():
    library = FORCES.select(["lambda", "zeta"])
    motion = simulate(Model(library, {"lambda": 1e-3, "zeta": 0.01}, 9.0), np.arange(0.0, 15.0, 0.02), 0.3)
    shown = 50.0 * motion.angle.values + 5e-3 * np.random.default_rng(0).standard_normal(motion.time.size)
    decay = free_decay(xr.Dataset({"angle": ("time", shown, {"units": "mm"})}, {"time": motion.time.values}))
    method, asked = Direct(random_force="off"), {"lambda": 0.04, "zeta": (0, None)}
    alone = identify(decay, library, method, constraints=asked)
    assert alone.coefficient.sel(force="lambda").item() == pytest.approx(0.04, rel=1e-12)
    assert json.loads(alone.attrs["options"])["constraints"]["zeta"] == [0.0, None]
    compared = compare(decay, library, [method], constraints=asked)["direct"]
    np.testing.assert_allclose(compared.coefficient, alone.coefficient, rtol=1e-9)


def test_ties_follow_each_other_and_hold_shapes():
    asked = Constraints({"lambda": 0.5, "nu": "2*delta + lambda", "delta": "3*zeta - 1"})
    free, matrix, constant = asked.linear_map(FORCES.select(["lambda", "zeta", "nu", "delta"]))
    assert free == ("zeta",)
    np.testing.assert_allclose(matrix[:, 0], [0.0, 1.0, 6.0, 3.0])
    np.testing.assert_allclose(constant, [0.5, 0.0, -1.5, -1.0])
    library = EFFECTS.select(["dahl", "cubic_damping"])
    _, held, _ = Constraints({"cubic_damping": "dahl.s*dahl"}).linear_map(library, {"dahl.s": 0.25})
    np.testing.assert_allclose(held[:, 0], [1.0, 0.25])
    with pytest.raises(UsageError, match=r"dahl\.s is tied"):
        Constraints({"dahl.s": "cubic_damping"}).linear_map(library)


@pytest.mark.parametrize(
    ("method", "asked", "said"),
    [
        (Direct, dict.fromkeys(SIX, 0.0), "leave at least one free"),
        (Trajectory, {"gamma": 1.0}, "gamma"),
        (Trajectory, {"zeta": (0.0,)}, "give a number, a pair"),
    ],
)
def test_constraints_that_a_method_does_not_support_are_refused(record, method, asked, said):
    with pytest.raises(UsageError, match=said):
        method(reference_frequency=W, constraints=asked).identify(record, FORCES)


@pytest.mark.slow
def test_a_method_that_takes_no_constraint_keeps_its_row():
    ending = run("compare", *QUICK, "--fix", "lambda=0", "--tie", "zeta=delta**2", "--json")
    methods = json.loads(ending.out)["methods"]
    assert methods["trajectory"]["coefficients"]["lambda"]["value"] == 0.0
    assert "not linear" in methods["direct"]["reason"]
    assert methods["Wu decrement"]["reason"].endswith("takes no fixed, bounded or tied coefficients")


def test_a_value_fixed_too_high_leaves_nothing_to_fit_and_is_reported(record):
    held = {"zeta": 0.05, "lambda": (0, None), "delta": (0, None)}
    with pytest.raises(DecayError, match="With the fixed values, delta, lambda would exceed the bounds"):
        Averaging(constraints=held).identify(record, FORCES.select(["lambda", "zeta", "delta"]))


OWN = """
title = "own"
[[force]]
symbol = "zeta"
name = "viscous friction"
formula = "2*v"
[[force]]
symbol = "gravity"
formula = "sin(x) - x"
coefficient = 0.9
"""


@pytest.fixture(scope="module")
def swing():
    offered = (*FORCES.select(["zeta"]), *EFFECTS.select(["gravity"]))
    model = Model(ForceLibrary("swing", offered), {"zeta": 5e-3, "gravity": 1.0}, W)
    angle = simulate(model, np.arange(0.0, 10.0, 0.02), 1.0, 0.0)
    angle["angle"] += 1e-3 * np.random.default_rng(0).standard_normal(angle.sizes["time"])
    return free_decay(angle)


@pytest.mark.parametrize("method", [Direct(random_force="off"), Trajectory(random_force="off")])
def test_a_coefficient_that_one_s_own_library_states_is_held(swing, method, tmp_path):
    """It is held as by `--system`; a constraint overrides it, and forces of the package are free."""
    (tmp_path / "own.toml").write_text(OWN)
    own = load_library(tmp_path / "own.toml")

    def gravity(library, how, **options):
        found = identify(swing, library, how, **options).sel(force="gravity")
        return found.coefficient.item(), found.standard_error.item()

    assert gravity(own, method) == (0.9, 0.0)
    assert gravity(own.select(["gravity", "zeta"]), method) == (0.9, 0.0)
    value, error = gravity(own, method, constraints={"gravity": (None, None)})
    assert abs(value - 1.0) < 4.0 * error
    assert gravity(own, replace(method, constraints={"gravity": 0.95})) == (0.95, 0.0)
    assert compare(swing, own, [method])["comparison"].coefficient.sel(force="gravity").item() == 0.9


def test_a_system_gives_its_forces_and_their_constraints_in_one_call(swing):
    library, constraints = system("pendulum")
    assert library.symbols == ("lambda", "zeta", "delta", "gravity")
    assert constraints["gravity"] == 1.0
    assert constraints["zeta"] == (0.0, np.inf)
    pendulum = system("pendulum", ["zeta"])
    assert pendulum.library.symbols == ("zeta", "gravity")
    assert pendulum.held == {"gravity": 1.0}
    method = Direct(random_force="off")
    found = identify(swing, pendulum.library, method, constraints=pendulum.constraints)
    assert found.coefficient.sel(force="gravity").item() == 1.0
    with pytest.raises(UsageError, match="no system 'pendlum'"):
        system("pendlum")
