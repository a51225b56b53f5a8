"""Two identifications of one decay held against each other."""

from functools import cache

import numpy as np
import pytest
from helpers import FIVE, decay, paper_run
from scipy.stats import chi2

from sysid_trib import load_library
from sysid_trib.errors import UsageError
from sysid_trib.methods import Averaging, Direct
from sysid_trib.validation.cross_check import cross_check
from sysid_trib.validation.identify import identify

pytestmark = pytest.mark.simulated_pairs

FORCES = load_library()


def checked(record, library=FORCES, averaging=None, **options):
    pair = [identify(record, library, method) for method in (averaging or Averaging(), Direct())]
    return cross_check(record, *pair, **options)


@cache
def paper_check():
    return checked(paper_run(FIVE).decay(7))


def test_both_models_are_true_and_the_methods_agree():
    compared = paper_check()["comparison"]
    assert (compared.attrs["verdict"], compared.attrs["explained"]) == ("agree", "yes")
    assert compared.p_value.item() > 0.01
    assert np.all(np.abs(compared.z.values) < 4.0)
    np.testing.assert_allclose(compared.residual_over_noise.values, 1.0, rtol=0.1)
    assert np.all(np.isnan(compared.departure_time.values))
    z = (compared.difference - compared.expected_difference) / compared.standard_error
    np.testing.assert_allclose(z, compared.z, rtol=1e-12)


def test_the_difference_is_taken_at_one_reference_frequency():
    tree = paper_check()
    averaging, direct = tree["averaging"], tree["direct"]
    # That of the model whose records are simulated, the second's.
    ratio = averaging.reference_frequency.item() / direct.reference_frequency.item()
    moved = averaging.coefficient.values * ratio ** np.array([2.0, 1.0, 0.0, 2.0, 2.0])
    expected = moved - direct.coefficient.values
    np.testing.assert_allclose(tree["comparison"].difference.values[:-1], expected, rtol=1e-6, atol=1e-12)


@pytest.mark.in_full
def test_p_values_are_those_of_chance():
    run, exact, p_values = paper_run(FIVE), paper_run(FIVE).angle, []
    for seed in range(8):
        record = decay(run.time, exact, 100 + seed)
        tree = checked(record, averaging=Averaging(correct=bool(seed % 2)), seed=seed, draws=12)
        p_values.append(tree["comparison"].p_value.item())
    # Fisher: minus twice the sum of the logarithms is chi-square distributed.
    assert chi2.ppf(1e-3, 16) < -2.0 * np.sum(np.log(p_values)) < chi2.ppf(1.0 - 1e-3, 16)


@pytest.mark.slow
def test_a_missing_force_shows():
    tree = checked(paper_run(FIVE).decay(7), FORCES.select(["lambda", "zeta", "delta", "epsilon"]))
    compared = tree["comparison"]
    # The methods may agree on a wrong model: that it is wrong shows in what it leaves.
    assert compared.attrs["explained"] == "no"
    assert np.all(compared.residual_over_noise.values > 3.0)
    assert np.all(compared.departure_time.values < 25.0)


@pytest.mark.slow
def test_first_order_bias_is_stated_where_it_is_not_removed():
    record = paper_run(FIVE).decay(7)
    compared = checked(record, averaging=Averaging(correct=False))["comparison"]
    expected = compared.expected_difference.sel(quantity="epsilon").item()
    assert expected == pytest.approx(0.2807 - 0.30, abs=2e-3)
    assert abs(compared.difference.sel(quantity="epsilon").item()) > 0.01
    assert compared.attrs["verdict"] == "agree"
    corrected = paper_check()["comparison"].expected_difference
    assert np.all(np.abs(corrected) < 0.05 * paper_check()["comparison"].standard_error)


@pytest.mark.parametrize(
    ("library", "method"), [("contact_forces", Direct()), (FORCES, Direct), (FORCES, "direct")]
)
def test_what_is_no_library_or_method_is_told(library, method):
    with pytest.raises(UsageError, match="identify wants"):
        identify(paper_run(FIVE).decay(0), library, method)
