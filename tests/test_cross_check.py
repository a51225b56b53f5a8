"""Two identifications of one decay compared with each other."""

from functools import cache

import numpy as np
import pytest
from helpers import FIVE, decay, paper_run

from sysid_trib import load_library
from sysid_trib.errors import UsageError
from sysid_trib.methods import Averaging, Direct, Trajectory
from sysid_trib.results.references import stated_covariance
from sysid_trib.validation.cross_check import cross_check
from sysid_trib.validation.identify import identify
from sysid_trib.validation.influence import covariances_of_difference
from sysid_trib.validation.residuals import FollowedRuns

FORCES = load_library()


def checked(record, library=FORCES, averaging=None):
    pair = [identify(record, library, method) for method in (averaging or Averaging(), Direct())]
    return cross_check(record, *pair)


@cache
def paper_check():
    return checked(paper_run(FIVE).decay(7))


def test_both_models_are_true_and_the_methods_agree():
    compared, judged = paper_check()["agreement"], paper_check()["judged"]
    assert (compared.attrs["verdict"], judged.attrs["verdict"]) == ("agree", "explained")
    assert compared.p_value.item() > 0.01
    assert np.all(np.abs(compared.z.values) < 4.0)
    np.testing.assert_allclose(judged.residual_over_noise.values, 1.0, rtol=0.1)
    assert np.all(np.isnan(judged.departure_time.values))
    assert judged.verdict.values.tolist() == ["explained", "explained"]
    assert compared.attrs["errors"] == "influence"
    np.testing.assert_allclose(compared.difference / compared.standard_error, compared.z, rtol=1e-12)


def test_the_difference_is_taken_at_one_reference_frequency():
    tree = paper_check()
    averaging, direct = tree["averaging"], tree["direct"]
    # The second's.
    ratio = averaging.reference_frequency.item() / direct.reference_frequency.item()
    moved = averaging.coefficient.values * ratio ** np.array([2.0, 1.0, 0.0, 2.0, 2.0])
    expected = moved - direct.coefficient.values
    np.testing.assert_allclose(tree["agreement"].difference.values[:-1], expected, rtol=1e-6, atol=1e-12)


def simulated_pairs(seeds):
    """Run both methods on records of one model: differences, their stated errors, and p-values."""
    run, exact, found = paper_run(FIVE), paper_run(FIVE).angle, []
    for seed in seeds:
        compared = checked(decay(run.time, exact, 100 + seed))["agreement"]
        found.append((compared.difference.values, compared.standard_error.values, compared.p_value.item()))
    differences, errors, p_values = zip(*found, strict=True)
    return np.array(differences), np.array(errors), np.array(p_values)


@pytest.mark.in_full
def test_errors_of_the_difference_are_those_of_simulated_records():
    differences, errors, p_values = simulated_pairs(range(60))
    # Of 60 records a scatter is known to 9 %.
    ratio = differences.std(axis=0, ddof=1) / errors.mean(axis=0)
    assert np.all((ratio > 0.75) & (ratio < 1.25))
    assert np.mean(p_values < 0.01) < 0.05
    assert np.mean(p_values < 0.5) > 0.2


@pytest.mark.slow
def test_a_missing_force_shows():
    tree = checked(paper_run(FIVE).decay(7), FORCES.select(["lambda", "zeta", "delta", "epsilon"]))
    judged = tree["judged"]
    # The methods may agree on a wrong model: that it is wrong shows in its residual.
    assert judged.attrs["verdict"] == "approximate"
    assert np.all(judged.p_value.values < 1e-3)
    assert np.all(judged.residual_over_noise.values > 3.0)
    assert np.all(judged.departure_time.values < 25.0)


def test_methods_with_a_bias_left_in_are_not_compared():
    compared = checked(paper_run(FIVE).decay(7), averaging=Averaging(correct=False))["agreement"]
    assert abs(compared.difference.sel(quantity="epsilon").item()) > 0.01
    assert compared.attrs["verdict"] == "unknown"


def test_covariances_add_where_an_influence_is_not_known():
    record = paper_run(FIVE).decay(7)
    pair = [identify(record, FORCES, method) for method in (Averaging(curve="analytic-signal"), Direct())]
    compared = cross_check(record, *pair)["agreement"]
    assert compared.attrs["errors"] == "stated"
    both = np.hypot(*(result.standard_error.values for result in pair))
    np.testing.assert_allclose(compared.standard_error.values[:-1], both, rtol=1e-9)


def test_a_tie_and_a_held_coefficient_have_an_influence():
    record, known = paper_run(FIVE).decay(7), {"lambda": -2.3e-5, "nu": "-1.3333*epsilon"}
    pair = [identify(record, FORCES, m(constraints=known)) for m in (Averaging, Direct)]
    compared = cross_check(record, *pair)["agreement"]
    assert compared.attrs["errors"] == "influence"
    # A tied coefficient and the one that it depends on differ by the same number of errors.
    z = compared.z.to_series()
    assert z.drop("asymptotic frequency").abs().max() < 4.0


@pytest.mark.parametrize("kind", [Direct, Trajectory])
def test_the_influence_of_a_fit_of_the_motion_has_its_stated_error(kind):
    record = paper_run(FIVE).decay(7)
    result = kind(random_force="off").identify(record, FORCES.select(FIVE))
    pair = [FollowedRuns({0: record}, result)] * 2
    found = covariances_of_difference(pair, pair[0], list(FIVE))
    stated = stated_covariance(result, list(FIVE))
    np.testing.assert_allclose(np.sqrt(np.diag(found.second) / np.diag(stated)), 1.0, atol=0.15)
    assert np.all(np.abs(found.difference) <= 1e-12 * np.abs(found.first))


@pytest.mark.parametrize(("library", "method"), [(3, Direct()), (FORCES, Direct), (FORCES, 3)])
def test_an_invalid_library_or_method_is_refused(library, method):
    with pytest.raises(UsageError, match="identify needs"):
        identify(paper_run(FIVE).decay(0), library, method)
