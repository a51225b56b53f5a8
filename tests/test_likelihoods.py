"""Likelihoods of rows against dense Gaussian densities, and the operator that makes the rows."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from sysid_trib.discovery.engine.likelihood import likelihood
from sysid_trib.discovery.engine.run_products import RunProducts, products_of, tried_ratios
from sysid_trib.discovery.engine.trials import DEFAULTS
from sysid_trib.likelihood.sensor_noise import covariance_band
from sysid_trib.likelihood.weak_form import build_weak_form, noise_operator

FORM = build_weak_form(np.arange(90) * 0.25)
OPERATOR = noise_operator(FORM, np.ones(90), np.full(90, 0.02))
BAND = covariance_band(OPERATOR)
SENSOR = (OPERATOR @ OPERATOR.T).toarray()
LEVEL = 0.7
RATIOS = tried_ratios(FORM.tau, DEFAULTS.ratio_step, None)


def dense(band):
    """A covariance from its diagonals."""
    below = sum(np.diag(row[: band.shape[1] - k], -k) for k, row in enumerate(band))
    return below + np.tril(below, -1).T


FORCE = dense(FORM.gram)
seeds = st.integers(0, 10_000)
columns = st.integers(1, 4)


def drawn(seed, count, *, ratio=0.0, scale=1.0):
    """A table of a target with both noises beside random columns, and its products."""
    rng = np.random.default_rng(seed)
    table = rng.standard_normal((FORM.rows, 1 + count)) @ np.triu(rng.standard_normal((1 + count,) * 2))
    table[:, 1:] *= 10.0 ** rng.uniform(-4.0, 4.0, count)
    noise = np.linalg.cholesky(SENSOR + ratio * FORCE) @ rng.standard_normal(FORM.rows)
    table[:, 0] = scale * noise + table[:, 1:] @ (rng.standard_normal(count) / np.std(table[:, 1:], axis=0))
    products, of_noise = products_of(BAND, FORM.gram, table, RATIOS)
    return table, RunProducts(
        products, of_noise - of_noise[0], RATIOS, len(table), LEVEL, DEFAULTS.level_rows
    )


def dense_deviance(table, b, variance, ratio):
    """Minus twice a Gaussian density, and that of the level, over white noise of the sensor of unit size."""
    covariance = variance * (SENSOR + ratio * FORCE)
    rest = table[:, 0] - table[:, 1:] @ b
    squares = rest @ np.linalg.solve(covariance, rest)
    determinant = np.linalg.slogdet(covariance)[1] - np.linalg.slogdet(SENSOR)[1]
    return squares + determinant + DEFAULTS.level_rows * (LEVEL**2 / variance + np.log(variance))


def profiled(table, ratio):
    """Least dense deviance at a ratio: (deviance, coefficients, covariance, variance)."""
    root = np.linalg.cholesky(SENSOR + ratio * FORCE)
    white = np.linalg.solve(root, table)
    b = np.linalg.lstsq(white[:, 1:], white[:, 0], rcond=None)[0]
    rest = white[:, 0] - white[:, 1:] @ b
    count = len(rest) + DEFAULTS.level_rows
    variance = (rest @ rest + DEFAULTS.level_rows * LEVEL**2) / count
    covariance = variance * np.linalg.inv(white[:, 1:].T @ white[:, 1:])
    return dense_deviance(table, b, variance, ratio) - count, b, covariance, variance


def at_one_ratio(run, g):
    of_each = {name: getattr(run, name)[g : g + 1] for name in ("products", "log_determinant", "ratios")}
    return replace(run, **of_each)


@given(seed=seeds, count=columns, part=st.floats(0.0, 1.0))
@settings(max_examples=20)
def test_at_a_ratio_it_is_a_dense_gaussian_density(seed, count, part):
    table, run = drawn(seed, count)
    g = round(part * (len(run.ratios) - 1))
    found = likelihood([at_one_ratio(run, g)], range(1, 1 + count))
    deviance, b, covariance, variance = profiled(table, run.ratios[g])
    scale = np.sqrt(np.diag(covariance))
    assert found.deviance == pytest.approx(deviance, abs=1e-5)
    np.testing.assert_allclose(found.coefficients / scale, b / scale, atol=1e-4)
    np.testing.assert_allclose(found.covariance / np.outer(scale, scale), covariance / np.outer(scale, scale))
    assert found.variances[0] == pytest.approx(variance)


EVEN = np.linspace(0.0, 60.0, 1001)
# Relative to the integral of the absolute value; at the ends the test functions do not end smoothly.
INSIDE, AT_ENDS, UNEVEN = 3e-8, 1e-4, 1e-3
JITTERED = EVEN + np.random.default_rng(0).uniform(-0.01, 0.01, EVEN.size) * EVEN[1]


def assert_annihilated(operator, motion, inside=INSIDE, at_ends=AT_ENDS):
    left = operator @ motion / (np.abs(operator) @ np.ones(motion.size))
    np.testing.assert_allclose(left[4:-4], 0.0, atol=inside)
    np.testing.assert_allclose(left, 0.0, atol=at_ends)


@pytest.mark.parametrize("tau", [EVEN, JITTERED], ids=["even", "jittered"])
def test_harmonic_motion_is_annihilated(tau):
    form = build_weak_form(tau)
    operator = noise_operator(form, np.ones(tau.size), np.zeros(tau.size))
    for motion in (np.cos(tau), np.sin(tau + 0.7)):
        assert_annihilated(operator, motion, *((INSIDE, AT_ENDS) if tau is EVEN else (UNEVEN, UNEVEN)))


def test_damped_motion_with_a_stiffness_that_varies_is_annihilated():
    # theta = exp(-c tau/2) cos(tau): theta'' + c theta' + (1 + c^2/4) theta = 0.
    c = 0.05
    form = build_weak_form(EVEN)
    motion = np.exp(-c * EVEN / 2) * np.cos(EVEN)
    operator = noise_operator(form, np.full(EVEN.size, 1 + c**2 / 4), np.full(EVEN.size, c))
    assert_annihilated(operator, motion)
