"""Optimisers of our own in plain `pysindy.SINDy`: the same least squares, with errors and whitening."""

import numpy as np
import pysindy
import pytest
import statsmodels.api
from helpers import SIX
from scipy.linalg import cholesky_banded, toeplitz
from sklearn.base import clone

from sysid_trib import load_library
from sysid_trib.likelihood.optimizers import SignificanceSelection, WhitenedLeastSquares
from sysid_trib.likelihood.pysindy_features import ForceFeatures

NOISE = 1e-4


def noisy(seed=0, colour=0.0, count=600):
    """States of a swing, theta'' + theta of the six forces with noise, and the noise's covariance factor."""
    tau = np.linspace(0.0, 120.0, count)
    a = 0.3 * np.exp(-0.01 * tau)
    states = np.column_stack((a * np.cos(tau), -a * np.sin(tau)))
    columns = np.asarray(ForceFeatures(load_library()).fit_transform(states))
    covariance = toeplitz([1.0 + colour**2, colour, *np.zeros(count - 2)])
    band = np.vstack([np.full(count, 1.0 + colour**2), np.append(np.full(count - 1, colour), 0.0)])
    factor = cholesky_banded(band, lower=True)
    white = np.random.default_rng(seed).standard_normal(count)
    target = -columns @ list(SIX.values()) + NOISE * np.linalg.cholesky(covariance) @ white
    return states, columns, target, factor, covariance


def sindy(optimizer):
    return pysindy.SINDy(optimizer=optimizer, feature_library=ForceFeatures(load_library()))


def test_in_sindy_it_is_least_squares_with_errors():
    states, columns, target, _, _ = noisy()
    model = sindy(WhitenedLeastSquares()).fit(states, t=0.01, x_dot=target[:, None])
    expected = statsmodels.api.OLS(target, columns).fit()
    np.testing.assert_allclose(model.coefficients()[0], expected.params, rtol=1e-8)
    np.testing.assert_allclose(model.optimizer.covariance_[0], expected.cov_params(), rtol=1e-6)
    assert model.optimizer.noise_[0] == pytest.approx(NOISE, rel=0.15)
    assert model.score(states, t=0.01, x_dot=target[:, None]) > 0.99


def test_correlated_rows_are_whitened():
    states, columns, target, factor, covariance = noisy(colour=0.9)
    optimizer = WhitenedLeastSquares(covariance_factor=factor)
    model = sindy(optimizer).fit(states, t=0.01, x_dot=target[:, None])
    expected = statsmodels.api.GLS(target, columns, covariance).fit()
    np.testing.assert_allclose(model.coefficients()[0], expected.params, rtol=1e-6)
    np.testing.assert_allclose(optimizer.covariance_[0], expected.cov_params(), rtol=1e-5)


def test_correlation_that_is_not_known_is_allowed_for_in_the_errors():
    _, columns, target, _, _ = noisy(colour=0.9)
    optimizer = WhitenedLeastSquares(correlation_lags=24).fit(columns, target)
    expected = statsmodels.api.OLS(target, columns).fit(
        cov_type="HAC", cov_kwds={"maxlags": 24, "use_correction": False}
    )
    assert optimizer.lags_ == [24]
    np.testing.assert_allclose(optimizer.covariance_[0], expected.cov_params(), rtol=1e-6)
    assert WhitenedLeastSquares(correlation_lags=24).fit(columns, noisy(3)[2]).lags_ == [0]


def test_weights_rows_that_are_not_numbers_and_several_targets():
    _, columns, target, _, _ = noisy()
    weights = np.linspace(0.5, 2.0, len(target))
    both = np.column_stack([target, 2.0 * target])
    found = WhitenedLeastSquares().fit(columns, both, sample_weight=weights)
    expected = statsmodels.api.WLS(target, columns, weights).fit()
    np.testing.assert_allclose(found.coef_, [expected.params, 2.0 * expected.params], rtol=1e-8)
    holed = target.copy()
    holed[5] = np.nan
    without = WhitenedLeastSquares().fit(np.delete(columns, 5, axis=0), np.delete(target, 5))
    np.testing.assert_allclose(WhitenedLeastSquares().fit(columns, holed).coef_, without.coef_, rtol=1e-10)


@pytest.mark.slow
def test_significance_selects_in_sindy():
    states, _, target, _, _ = noisy(count=4000)
    without = list(SIX).index("alpha")
    model = sindy(SignificanceSelection(level=0.01)).fit(states, t=0.01, x_dot=target[:, None])
    kept = model.coefficients()[0] != 0.0
    assert SIX["alpha"] == 0.0
    assert not kept[without]
    assert kept[list(SIX).index("zeta")]
    every = sindy(SignificanceSelection(level=1.0 - 1e-12)).fit(states, t=0.01, x_dot=target[:, None])
    assert np.sum(every.coefficients()[0] != 0.0) >= np.sum(kept)


@pytest.mark.parametrize(
    "optimizer",
    [WhitenedLeastSquares(np.ones((2, 3)), 24), SignificanceSelection(0.05, removed_columns=2)],
    ids=lambda optimizer: type(optimizer).__name__,
)
def test_they_clone(optimizer):
    copy = clone(optimizer)
    assert copy is not optimizer
    for name, value in optimizer.get_params().items():
        np.testing.assert_array_equal(copy.get_params()[name], value)
