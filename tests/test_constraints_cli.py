"""`--fix`, `--bound` and `--tie`: what comes back is exact, and what cannot be is refused in a sentence."""

import json

import pytest
from command_line import run

QUICK = ("--window", ":9")


@pytest.fixture(scope="module")
def tied():
    return run("identify", *QUICK, "--fix", "lambda=0", "--tie", "nu=-2.356*delta", "--json")


@pytest.mark.slow
def test_a_fixed_value_and_a_tie_come_back_exactly(tied):
    data = json.loads(tied.out)
    for method in data["methods"].values():
        found = method["coefficients"]
        assert found["lambda"]["value"] == found["lambda"]["standard_error"] == 0.0
        assert found["lambda"]["constraint"] == "fixed"
        assert found["nu"]["constraint"] == "nu=-2.356*delta"
        assert found["nu"]["value"] == pytest.approx(-2.356 * found["delta"]["value"], rel=1e-12)
        assert found["nu"]["standard_error"] == pytest.approx(2.356 * found["delta"]["standard_error"])
    # What is fixed or tied adds no difference of its own.
    assert set(data["cross_check"]["differences"]) == {"zeta", "delta", "epsilon", "asymptotic frequency"}
    assert data["cross_check"]["degrees_of_freedom"] == 4


@pytest.mark.slow
def test_it_is_told_in_the_table_and_in_a_sentence():
    told = " ".join(run("identify", *QUICK, "--fix", "lambda=0", "--bound", "zeta=0.02:").out.split())
    assert "0 (fixed)" in told
    assert "0.02 (bound)" in told
    assert "Constraints: lambda is fixed (0); zeta is at its bound (0.02)." in told


@pytest.mark.slow
def test_a_method_that_takes_no_constraint_keeps_its_row():
    ending = run("compare", *QUICK, "--fix", "lambda=0", "--tie", "zeta=delta**2", "--json")
    methods = json.loads(ending.out)["methods"]
    assert methods["trajectory"]["coefficients"]["lambda"]["value"] == 0.0
    assert "not linear" in methods["direct"]["reason"]
    assert methods["Wu decrement"]["reason"].endswith("takes no fixed, bounded or tied coefficients")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--fix", "lambda"], "--fix 'lambda' must be of the form lambda=0."),
        (["--fix", "lambda=x"], "--fix 'lambda=x': 'x' is not a number."),
        (["--fix", "lambda=0", "--fix", "lambda=1"], "--fix is given twice for lambda; choose one."),
        (["--fix", "gamma=0"], "No parameter 'gamma' can be constrained; there are lambda, zeta"),
        (["--fix", "alpha=0"], "No parameter 'alpha' can be constrained"),
        (["--bound", "zeta=1"], "--bound 'zeta=1' must be LOW:HIGH, of which one side may be empty."),
        (["--fix", "nu=1", "--tie", "nu=delta"], "Parameter nu is both tied and fixed; choose one."),
        (["--tie", "nu=2*nu"], "ties nu to itself; use other parameters."),
        (["--tie", "nu=delta", "--tie", "delta=nu"], "The ties of nu and delta go in a circle"),
        (["--tie", "nu=delta.__class__"], "holds 'delta.__class__', which is no parameter"),
        (
            ["--tie", "zeta=delta**2"],
            "is not linear in the coefficients, which only a trajectory fit can do.",
        ),
        (["--fix", "zeta=2", "--bound", "zeta=0:1"], "outside of its bounds 0:1."),
    ],
)
def test_what_cannot_be_asked_is_refused_in_a_sentence(options, said):
    ending = run("identify", *QUICK, *options)
    assert ending.status == 2
    assert said in ending.complaint
