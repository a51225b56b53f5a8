"""Parameters of a trajectory fit: one vector by names, and fits with fixed, bounded and tied parameters."""

import numpy as np
import pytest
from helpers import FIVE, NOISE, SIX, W, paper_run

from sysid_trib import Model, load_library
from sysid_trib.errors import UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.motion_fit.parameters import Parameters
from sysid_trib.motion_fit.problem import FitProblem, WhitenedRecord
from sysid_trib.validation.homogeneity import run_agreement

FORCES = load_library()
EFFECTS = load_library("candidate_effects")
TIE = {"nu": "-2.356*delta"}


@pytest.fixture(scope="module")
def record():
    return paper_run(SIX).decay(0)


@pytest.fixture(scope="module")
def plain(record):
    return Trajectory(W).identify(record, FORCES)


def test_a_fixed_coefficient_comes_back_exactly_and_conditions_the_others(record, plain):
    value = plain.coefficient.sel(force="nu").item()
    found = Trajectory(W, constraints={"nu": value}).identify(record, FORCES)
    assert found.coefficient.sel(force="nu").item() == value
    assert found.standard_error.sel(force="nu").item() == 0.0
    assert found.constraint.sel(force="nu").item() == "fixed"
    errors = plain.standard_error.values
    np.testing.assert_allclose(found.coefficient / errors, plain.coefficient / errors, atol=1e-4)
    others = [s for s in plain.force.values.tolist() if s != "nu"]
    # The covariance of the others, given that one: the Schur complement.
    c, at = plain.covariance, {"force": "nu"}
    given = c.sel(force=others, other_force=others).values - np.outer(
        c.sel(**at, other_force=others), c.sel(**at, other_force=others)
    ) / float(c.sel(**at, other_force="nu"))
    np.testing.assert_allclose(
        found.covariance.sel(force=others, other_force=others), given, rtol=2e-2, atol=1e-12 * given.max()
    )


def test_a_tie_is_a_reparametrised_library(record):
    found = Trajectory(W, constraints=TIE).identify(record, FORCES)
    value, error = (found[k].sel(force=["delta", "nu"]).values for k in ("coefficient", "standard_error"))
    assert value[1] == -2.356 * value[0]
    assert error[1] == pytest.approx(2.356 * error[0])
    assert found.constraint.sel(force="nu").item() == "nu=-2.356*delta"
    formula = f"{FORCES['delta'].formula.text} - 2.356*({FORCES['nu'].formula.text})"
    others = [s for s in FORCES.symbols if s not in ("nu", "delta")]
    entries = [{"symbol": s, "formula": FORCES[s].formula.text} for s in others]
    both = parse_library({"force": [*entries, {"symbol": "both", "formula": formula}]}, "test")
    same = Trajectory(W).identify(record, both)
    for symbol, name in [*zip(others, others, strict=True), ("delta", "both")]:
        expected, scale = (same[k].sel(force=name).item() for k in ("coefficient", "standard_error"))
        assert found.coefficient.sel(force=symbol).item() == pytest.approx(expected, abs=1e-4 * scale)
        assert found.standard_error.sel(force=symbol).item() == pytest.approx(scale, rel=1e-4)
    assert found.noise.item() == pytest.approx(same.noise.item(), rel=1e-9)


def test_a_tie_need_not_be_linear(record):
    found = Trajectory(W, constraints={"alpha": "-abs(nu)**1.5"}).identify(record, FORCES)
    nu, alpha = (found.sel(force=s) for s in ("nu", "alpha"))
    assert alpha.coefficient.item() == -(abs(nu.coefficient.item()) ** 1.5)
    slope = 1.5 * abs(nu.coefficient.item()) ** 0.5
    assert alpha.standard_error.item() == pytest.approx(slope * nu.standard_error.item())


def test_a_bound_that_stops_a_coefficient_holds_it(record):
    found = Trajectory(W, constraints={"zeta": (0.01, np.inf)}).identify(record, FORCES)
    zeta = found.sel(force="zeta")
    assert (zeta.coefficient.item(), zeta.standard_error.item()) == (0.01, 0.0)
    assert zeta.constraint.item() == "at its bound"
    same = Trajectory(W, constraints={"zeta": 0.01}).identify(record, FORCES)
    np.testing.assert_allclose(found.coefficient, same.coefficient, rtol=1e-6)


@pytest.mark.parametrize("method", [Direct, Averaging])
def test_runs_are_compared_by_what_is_free(method):
    runs = [paper_run(SIX, duration=12.0).decay(seed) for seed in range(2)]
    found = method(constraints={"lambda": 0.0, "zeta": (0.012, 1.0)}).identify(runs, FORCES)
    compared = run_agreement(runs, found)
    assert set(compared.quantity.values.tolist()) == {"delta", "nu", "epsilon", "asymptotic frequency"}
    assert np.all(np.isfinite(compared.p_value))


def test_a_bound_that_stops_nothing_changes_nothing(record, plain):
    found = Trajectory(W, constraints={"zeta": (0.0, 1.0)}).identify(record, FORCES)
    np.testing.assert_allclose(found.coefficient, plain.coefficient, rtol=1e-5)
    assert set(found.constraint.values.tolist()) == {""}
    assert "constraint" not in plain.coords


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"gamma": 1.0}, "gamma"),
        ({"nu": "gamma"}, "gamma"),
        ({"nu": "2*nu"}, "itself"),
        ({"zeta": (1.0, 0.0)}, "must rise"),
        ({"zeta": np.nan}, "finite"),
        ({"zeta": (0.0,)}, "give a number to hold it"),
        ({"dahl.s": (0.0, 1.0)}, "held"),
    ],
)
def test_what_cannot_be_constrained_is_refused(record, asked, said):
    library = parse_library(
        {"force": [{"symbol": s, "formula": FORCES[s].formula.text} for s in FIVE]}, "test"
    )
    if "dahl.s" in asked:
        library = EFFECTS.select(["dahl"])
    with pytest.raises(UsageError, match=said):
        Trajectory(constraints=asked).identify(record, library)


def test_a_motion_that_diverges_leads_back(record):
    """Half of the record that can be computed says where to go; a plateau does not."""
    library = FORCES.select(["zeta"])
    whole = WhitenedRecord(record.time.values, record.angle.values)
    problem = FitProblem(Parameters(library, W), (whole,))
    start = np.array([0.3, 0.0, 0.0])
    here = [
        float(np.linalg.norm(whole.residual(Model(library, {"zeta": c}, W), start)))
        for c in (-0.06, -0.055, -0.05)
    ]
    assert here[0] > here[1] > here[2]
    values = np.array([-0.05, *start])
    residuals = problem.residuals(values)
    slope = problem.white_sensitivity(values, residuals)[:, 0] @ problem.white(residuals)
    assert slope < 0.0
    assert np.isfinite(slope)


@pytest.mark.slow
def test_a_fit_comes_back_from_a_start_that_diverges(record):
    """Nothing of this motion can be computed; with a plateau in its place there was no fit."""
    start = Model(FORCES, dict.fromkeys(SIX, 0.0) | {"epsilon": -30.0}, W)
    found = Trajectory(W, start=start).identify(record, FORCES)
    assert found.noise.item() == pytest.approx(NOISE, rel=0.05)
