"""Averaging (Le Bot et al. 2019, Sec. 2.3): the paper's rule, its corrections, and a random force."""

from functools import cache

import numpy as np
import pytest
from helpers import FIVE, SIX, Run, W, library_of_formulas, paper_run, values

from sysid_trib import Model, load_library
from sysid_trib.errors import UsageError
from sysid_trib.methods import Averaging
from sysid_trib.results.references import with_contactless_frequency

FORCES = load_library()


@cache
def noisy_standard_errors() -> tuple[float, ...]:
    """The errors that the coefficients have at a noise of 1e-4 rad."""
    return tuple(Averaging().identify(paper_run(FIVE).decay(0), FORCES).standard_error.values)


def test_the_papers_rule_loses_the_sign_of_epsilon():
    result = Averaging(frequency="last", correct=False).identify(paper_run(FIVE).decay(), FORCES)
    nu, epsilon = values(result, {"nu": 0, "epsilon": 0})
    assert (round(nu, 2), round(epsilon, 2)) == (-0.25, -0.31)
    assert result.asymptotic_frequency.item() == pytest.approx(9.875, abs=1e-3)


def test_a_fitted_frequency_keeps_it_but_for_the_first_order_bias():
    result = Averaging(correct=False, weighted=False).identify(paper_run(FIVE).decay(), FORCES)
    nu, epsilon = values(result, {"nu": 0, "epsilon": 0})
    assert (round(nu, 3), round(epsilon, 3)) == (-0.402, 0.280)
    assert result.asymptotic_frequency.item() == pytest.approx(9.9098, abs=1e-4)
    assert not result.first_order_bias_removed


@pytest.mark.parametrize("strength", [0.0, 5e-4])
def test_correction_removes_the_bias(strength):
    truth = FIVE | {"lambda": FIVE["lambda"] + strength}
    run = paper_run(truth, duration=25.0 if strength == 0.0 else 16.0)
    result = Averaging().identify(run.decay(), FORCES)
    assert result.first_order_bias_removed
    gap = values(result, truth) - list(truth.values())
    assert np.all(np.abs(gap) < 0.5 * np.array(noisy_standard_errors()))
    plain = Averaging(correct=False).identify(run.decay(), FORCES)
    np.testing.assert_allclose(
        values(plain, truth) - result.first_order_bias.values, values(result, truth), rtol=1e-9
    )


def test_alpha_is_an_unknown_where_the_frequency_is_given():
    truth = SIX | {"alpha": 0.1}
    result = Averaging(reference_frequency=W).identify(paper_run(truth).decay(), FORCES)
    # Measured against the error at noise 1e-4: the correction stops at a thousandth of the record's own.
    np.testing.assert_allclose(values(result, FIVE), list(FIVE.values()), rtol=2e-2, atol=2e-7)
    assert result.coefficient.sel(force="alpha").item() == pytest.approx(0.1, abs=2e-5)
    assert result.reference_frequency_standard_error.item() == 0.0


def test_contactless_frequency_gives_alpha_and_its_error():
    result = Averaging().identify(paper_run(FIVE).decay(1), FORCES)
    omega0, error = 8.87, 0.02
    found = with_contactless_frequency(result, omega0, error)
    assert found.force.values.tolist() == list(FORCES.symbols)
    alpha = found.sel(force="alpha")
    limit = result.asymptotic_frequency.item()
    assert alpha.coefficient.item() == pytest.approx((limit / omega0) ** 2 - 1.0, rel=1e-12)
    assert alpha.refers_to.item() == omega0
    assert found.sel(force="nu").refers_to.item() == result.reference_frequency.item()
    np.testing.assert_array_equal(values(found, FIVE), values(result, FIVE))
    random = np.random.default_rng(0)
    limits = limit + result.asymptotic_frequency_standard_error.item() * random.standard_normal(40_000)
    drawn = (limits / (omega0 + error * random.standard_normal(40_000))) ** 2 - 1.0
    assert alpha.standard_error.item() == pytest.approx(np.std(drawn), rel=0.02)
    np.testing.assert_allclose(found.covariance.values, found.covariance.values.T, rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), found.standard_error, rtol=1e-9)


def test_contactless_frequency_needs_a_force_of_formula_x():
    other = library_of_formulas(zeta="2*v", delta="v*abs(v)")
    result = Averaging(correct=False).identify(paper_run(FIVE).decay(1), other)
    with pytest.raises(UsageError, match="no force of formula x"):
        with_contactless_frequency(result, 8.87)


def test_a_force_with_both_signatures_is_one_unknown():
    library = library_of_formulas(zeta="2*v", tilted="x*abs(x) + v*abs(v)")
    run = Run(Model(library, {"zeta": 0.005, "tilted": 0.05}, W), paper_run().time)
    result = Averaging().identify(run.decay(), library)
    np.testing.assert_allclose(result.coefficient.values, [0.005, 0.05], rtol=2e-3)
    assert result.reference_frequency.item() == pytest.approx(W, rel=1e-5)
