"""Constraints on a direct identification: fixed, bounded and tied coefficients."""

import numpy as np
import pytest
from helpers import FIVE, SIX, W, library_of_formulas, names, paper_run, values

from sysid_trib.errors import UsageError
from sysid_trib.forces import ForceLibrary
from sysid_trib.methods import Direct

RUN = paper_run()
LIBRARY = RUN.model.library
PAIR = SIX["nu"] / SIX["delta"]


@pytest.mark.parametrize("frequency", [W, None], ids=["given", "fitted"])
def test_a_force_fixed_at_zero_is_a_force_left_out(frequency):
    record = RUN.decay(2)
    fixed = Direct(frequency, constraints={"lambda": 0.0}).identify(record, LIBRARY)
    rest = [s for s in fixed.force.values.tolist() if s != "lambda"]
    without = Direct(frequency).identify(record, LIBRARY.select(rest))
    np.testing.assert_allclose(values(fixed, rest), values(without, rest), rtol=1e-6)
    np.testing.assert_allclose(fixed.standard_error.sel(force=rest), without.standard_error, rtol=1e-3)
    held = fixed.sel(force="lambda")
    assert (held.coefficient.item(), held.standard_error.item()) == (0.0, 0.0)
    assert held.constraint.item() == "fixed"
    assert set(fixed.constraint.sel(force=rest).values) == {""}


@pytest.mark.parametrize("frequency", [W, None], ids=["given", "fitted"])
def test_a_fixed_value_comes_back_exactly_and_others_are_as_if_it_were_known(frequency):
    """A force that is known is the same as one whose columns are moved to the other side."""
    record, truth = RUN.decay(2), FIVE["epsilon"]
    fixed = Direct(frequency, constraints={"epsilon": truth}).identify(record, LIBRARY)
    assert fixed.coefficient.sel(force="epsilon").item() == truth
    assert fixed.standard_error.sel(force="epsilon").item() == 0.0
    free = Direct(frequency).identify(record, LIBRARY)
    # What is known of one coefficient is passed on by the covariance of the unconstrained fit.
    symbols = free.force.values.tolist()
    variance = free.covariance.sel(force="epsilon", other_force="epsilon").item()
    gain = free.covariance.sel(other_force="epsilon").values / variance
    expected = free.coefficient + gain * (truth - free.coefficient.sel(force="epsilon").item())
    other = [s for s in symbols if s != "epsilon"]
    differences = (fixed.coefficient - expected) / free.standard_error
    np.testing.assert_allclose(differences.sel(force=other), 0.0, atol=0.02)
    rest = free.covariance.values - variance * np.outer(gain, gain)
    errors = np.sqrt(np.diag(rest)[[symbols.index(s) for s in other]])
    np.testing.assert_allclose(fixed.standard_error.sel(force=other), errors, rtol=0.02)


@pytest.mark.parametrize("frequency", [None], ids=["fitted"])
def test_a_tie_is_a_library_with_both_forces_in_one(frequency):
    record = RUN.decay(3)
    tied = Direct(frequency, constraints={"nu": f"{PAIR!r}*delta"}).identify(record, LIBRARY)
    delta, nu = values(tied, ["delta", "nu"])
    assert nu == pytest.approx(PAIR * delta, rel=1e-12)
    error, given = tied.standard_error.sel(force=["nu", "delta"]).values
    assert error == pytest.approx(abs(PAIR) * given, rel=1e-9)
    assert tied.constraint.sel(force="nu").item() == f"nu={PAIR!r}*delta"
    if frequency is None:
        # The two forces scale differently with the frequency: no one formula holds both.
        return
    both = library_of_formulas(both=f"v*abs(v) + ({PAIR!r})*x*abs(x)")
    rest = [s for s in LIBRARY.symbols if s not in ("delta", "nu")]
    merged = ForceLibrary("merged", (*LIBRARY.select(rest).forces, *both.forces))
    expected = Direct(frequency).identify(record, merged)
    np.testing.assert_allclose([*values(tied, rest), delta], values(expected, [*rest, "both"]), rtol=1e-6)
    np.testing.assert_allclose(
        tied.standard_error.sel(force=[*rest, "delta"]), expected.standard_error, rtol=1e-3
    )


def test_a_bound_that_is_not_reached_changes_nothing():
    record = RUN.decay(1)
    free = Direct(W).identify(record, LIBRARY)
    bounded = Direct(W, constraints={"zeta": (0.0, 1.0)}).identify(record, LIBRARY)
    np.testing.assert_array_equal(bounded.coefficient, free.coefficient)
    np.testing.assert_array_equal(bounded.standard_error, free.standard_error)
    assert set(bounded.constraint.values) == {""}


@pytest.mark.parametrize("frequency", [None], ids=["fitted"])
def test_a_coefficient_at_its_bound_is_held_there(frequency):
    record, low = RUN.decay(1), 1.05 * SIX["zeta"]
    bounded = Direct(frequency, constraints={"zeta": (low, np.inf)}).identify(record, LIBRARY)
    fixed = Direct(frequency, constraints={"zeta": low}).identify(record, LIBRARY)
    assert bounded.coefficient.sel(force="zeta").item() == low
    assert bounded.standard_error.sel(force="zeta").item() == 0.0
    assert bounded.constraint.sel(force="zeta").item() == "at its bound"
    np.testing.assert_allclose(bounded.coefficient, fixed.coefficient, rtol=1e-6)
    np.testing.assert_allclose(bounded.standard_error, fixed.standard_error, rtol=1e-3)


def test_constraints_hold_for_several_runs_and_in_strong_form():
    runs = [RUN.decay(1), RUN.decay(2)]
    constraints = {"lambda": 0.0, "nu": f"{PAIR!r}*delta"}
    for found in (
        Direct(constraints=constraints).identify(runs, LIBRARY),
        Direct(W, form="strong", constraints=constraints).identify(runs[0], LIBRARY),
    ):
        dry, delta, nu = values(found, ["lambda", "delta", "nu"])
        assert dry == 0.0
        assert nu == pytest.approx(PAIR * delta, rel=1e-12)


def test_selection_is_among_the_free_coefficients():
    method = Direct(W, significance=0.01, constraints={"lambda": SIX["lambda"], "nu": f"{PAIR!r}*delta"})
    found = method.identify(RUN.decay(4), LIBRARY)
    assert names(found.force.values, found.active.values) == {"lambda", "zeta", "delta", "nu", "epsilon"}
    alone = Direct(W, significance=0.01, constraints={"zeta": "100*alpha"}).identify(RUN.decay(4), LIBRARY)
    assert alone.active.sel(force="zeta").item() == alone.active.sel(force="alpha").item()


def test_forces_that_are_the_same_may_be_told_apart_by_a_fixed_value():
    library = library_of_formulas(zeta="2*v", viscous="v", delta="v*abs(v)", nu="x*abs(x)", epsilon="x**3")
    found = Direct(constraints={"viscous": 0.005}).identify(RUN.decay(0), library)
    alone = Direct().identify(RUN.decay(0), library.select(["zeta", "delta", "nu", "epsilon"]))
    assert found.coefficient.sel(force="zeta").item() == pytest.approx(
        alone.coefficient.sel(force="zeta").item() - 0.0025, rel=1e-4
    )


@pytest.mark.parametrize(
    ("constraints", "sentence"),
    [
        ({"nu": "delta**2"}, "not linear in the coefficients"),
        ({"gamma": 1.0}, "No parameter 'gamma'"),
        (dict.fromkeys(SIX, 0.0), "leave at least one free"),
    ],
)
def test_what_it_cannot_do_is_refused(constraints, sentence):
    with pytest.raises(UsageError, match=sentence):
        Direct(W, constraints=constraints).identify(RUN.decay(0), LIBRARY)


def test_shapes_are_held_and_may_be_fixed():
    from test_direct import run_with

    run, method = run_with("stribeck")
    fixed = Direct(W, constraints={"stribeck.s": 0.05}).identify(run.decay(0), run.model.library)
    given = method.identify(run.decay(0), run.model.library)
    np.testing.assert_array_equal(fixed.coefficient, given.coefficient)
    assert fixed.shape.sel(shape_parameter="stribeck.s").item() == 0.05
    with pytest.raises(UsageError, match=r"stribeck.s is bounded"):
        Direct(W, constraints={"stribeck.s": (0.0, 1.0)}).identify(run.decay(0), run.model.library)
