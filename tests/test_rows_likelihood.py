"""Likelihood of rows with two noises against dense Gaussian densities, for any runs and columns."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from sysid_trib.discovery.columns_beside import each_beside, projected
from sysid_trib.likelihood.likelihood import DEVIANCE_SETTLED, likeliest_near, likelihood
from sysid_trib.likelihood.row_noise import covariance_band
from sysid_trib.likelihood.run_products import RowNoise, products_of
from sysid_trib.likelihood.settings import DEFAULTS
from sysid_trib.likelihood.variance_ratio import ratio_span
from sysid_trib.likelihood.weak_form import build_weak_form, noise_operator

FORM = build_weak_form(np.arange(90) * 0.25)
OPERATOR = noise_operator(FORM, np.ones(90), np.full(90, 0.02))
BAND = covariance_band(OPERATOR @ OPERATOR.T)
SENSOR = (OPERATOR @ OPERATOR.T).toarray()
LEVEL = 0.7
NOISE = RowNoise(BAND, BAND, FORM, LEVEL)
# A spline between the ratios that are tried is off by so much of the deviance.
SPLINE = 0.5


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
    return table, products_of(NOISE, table)


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
    return replace(
        run,
        products=run.products[g : g + 1],
        log_determinant=run.log_determinant[g : g + 1],
        ratios=run.ratios[g : g + 1],
    )


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


@given(seed=seeds, count=columns, wander=st.sampled_from([0.0, 0.1, 1.0, 10.0]))
@settings(max_examples=15)
def test_the_most_likely_ratio_is_the_dense_one(seed, count, wander):
    table, run = drawn(seed, count, ratio=wander)
    found = likelihood([run], range(1, 1 + count))
    low, high = ratio_span(float(FORM.tau[-1]), 0.25)
    fine = np.append(0.0, np.geomspace(low, high, 120))
    every = np.array([profiled(table, ratio)[0] for ratio in fine])
    assert found.deviance == pytest.approx(every.min(), abs=SPLINE)
    assert found.gains[0] == pytest.approx(every[0] - every.min(), abs=SPLINE)
    deviance, b, covariance, variance = profiled(table, found.ratios[0])
    assert deviance < every.min() + SPLINE
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)) / scale, 1.0, atol=0.1)
    np.testing.assert_allclose((found.coefficients - b) / scale, 0.0, atol=0.1)
    assert found.variances[0] == pytest.approx(variance, rel=0.1)


@given(seed=seeds, count=columns, wander=st.sampled_from([0.0, 0.1, 1.0, 10.0, 1e5]))
@settings(max_examples=15)
@pytest.mark.parametrize("near", [0.0, 1e-3, 1.0, 1e3])
def test_near_the_likeliest_ratio_the_likelihood_is_the_dense_one(near, seed, count, wander):
    """From any guess, exactly: a spline between ratios that are far from each other is off by `SPLINE`."""
    table, whole = drawn(seed, count, ratio=wander)
    names = range(1, 1 + count)
    (run,), found = likeliest_near([partial(products_of, NOISE, table, DEFAULTS)], [near], names)
    assert found.deviance < likelihood([whole], names).deviance + SPLINE
    deviance, b, covariance, variance = profiled(table, found.ratios[0])
    assert found.deviance == pytest.approx(deviance, abs=0.02)
    np.testing.assert_allclose((found.coefficients - b) / np.sqrt(np.diag(covariance)), 0.0, atol=0.02)
    assert found.variances[0] == pytest.approx(variance, rel=1e-3)
    assert run.is_close(float(found.ratios[0]))
    # Candidates are screened beside it, with the ratios that are tried all over.
    assert found.ratios[0] <= whole.ratios[-1]
    for beside in (0.9 * found.ratios[0], min(1.1 * found.ratios[0], whole.ratios[-1])):
        assert profiled(table, beside)[0] > deviance - 0.05


def test_a_ratio_is_found_within_its_error():
    z = []
    for seed in range(40):
        found = likelihood([drawn(seed, 2, ratio=1.0)[1]], [1, 2])
        if np.isfinite(found.ratio_errors[0]):
            z.append(np.log(found.ratios[0]) / found.ratio_errors[0])
    assert len(z) > 30
    assert abs(np.median(z)) < 0.6
    assert np.sqrt(np.mean(np.square(z))) < 1.6


@given(seed=seeds, count=columns, runs=st.integers(2, 3))
@settings(max_examples=15)
def test_of_several_runs_no_nearby_point_is_likelier(seed, count, runs):
    """Coefficients and variances of all runs at once, though one run is solved after the other."""
    tables, products = zip(
        *(drawn(seed + 7 * at, count, ratio=float(at), scale=3.0**at) for at in range(runs)), strict=True
    )
    # Columns of one size in all runs, so that each has a part in the coefficients.
    found = likelihood(products, range(1, 1 + count))
    rng = np.random.default_rng(seed)
    ratios = [p.ratios[np.argmin(np.abs(p.ratios - r))] for p, r in zip(products, found.ratios, strict=True)]
    held = [
        at_one_ratio(p, int(np.argmin(np.abs(p.ratios - r)))) for p, r in zip(products, ratios, strict=True)
    ]
    here = likelihood(held, range(1, 1 + count))
    errors = np.linalg.cholesky(here.covariance)

    def deviance(b, variances):
        parts = zip(tables, variances, ratios, strict=True)
        return sum(dense_deviance(table, b, variance, ratio) for table, variance, ratio in parts)

    best = deviance(here.coefficients, here.variances)
    assert best - sum(run.degrees_of_freedom for run in held) == pytest.approx(here.deviance, abs=1e-2)
    for size in (0.03, 0.3, 1.0):
        b = here.coefficients + size * errors @ rng.standard_normal(count)
        variances = here.variances * np.exp(0.2 * size * rng.standard_normal(runs))
        assert deviance(b, variances) > best - 2.0 * DEVIANCE_SETTLED


@given(seed=seeds, count=st.integers(2, 5))
@settings(max_examples=15)
def test_each_beside_is_the_likelihood_with_one_column_more(seed, count):
    products = [drawn(seed, count + 1, ratio=seed % 3)[1]]
    base, more = list(range(1, count)), [count, count + 1]
    together = each_beside(products, base, more, likelihood(products, base))
    for at, column in enumerate(more):
        whole = likelihood(products, [*base, column])
        error = np.sqrt(whole.covariance[-1, -1])
        # The spline is evaluated in larger steps.
        assert together.deviance[at] == pytest.approx(whole.deviance, abs=0.02)
        # Between two ratios that are tried, by a spline of the products and by the two.
        assert together.errors[at] == pytest.approx(error, rel=0.1)
        assert abs(together.coefficients[at] - whole.coefficients[-1]) < 0.2 * error


@given(seed=seeds, count=st.integers(2, 5), runs=st.integers(2, 3))
@settings(max_examples=15)
def test_each_beside_of_several_runs_is_not_likelier_than_the_most_likely(seed, count, runs):
    products = [drawn(seed + 7 * at, count + 1, ratio=float(at))[1] for at in range(runs)]
    base, more = list(range(1, count)), [count, count + 1]
    together = each_beside(products, base, more, likelihood(products, base))
    for at, column in enumerate(more):
        assert together.deviance[at] > likelihood(products, [*base, column]).deviance - SPLINE


@pytest.mark.parametrize("size", [0.0, 1e-220, 1e-90, 1e90])
def test_a_column_of_any_size_can_be_fitted(size):
    table, _ = drawn(3, 3)
    table[:, 2] *= size
    run = products_of(NOISE, table)
    found, without = (likelihood([run], columns) for columns in ([1, 2, 3], [1, 3]))
    assert found.deviance < without.deviance + 1e-6
    beside = each_beside([run], [1, 3], [2], without)
    assert beside.deviance[0] == pytest.approx(found.deviance, abs=0.02)


@given(seed=seeds, count=st.integers(2, 4))
@settings(max_examples=10)
def test_what_is_outside_of_columns_is_what_least_squares_leaves(seed, count):
    table, run = drawn(seed, count)
    one = at_one_ratio(run, 3)
    about = likelihood([one], range(1, 1 + count))
    part, products = projected([one], about, range(1, count), [0, count])
    white = np.linalg.solve(np.linalg.cholesky(SENSOR + run.ratios[3] * FORCE), table)
    white = white / np.sqrt(about.variances[0])
    inside, others = white[:, 1:count], white[:, [0, count]]
    outside = others - inside @ np.linalg.lstsq(inside, others, rcond=None)[0]
    np.testing.assert_allclose(
        part, np.linalg.norm(outside, axis=0) / np.linalg.norm(others, axis=0), rtol=1e-4
    )
    assert products == pytest.approx(outside.T @ outside, rel=1e-4, abs=1e-4 * np.abs(products).max())


@given(seed=seeds, factor=st.floats(1e-6, 1e6))
@settings(max_examples=10)
def test_units_of_columns_do_not_matter(seed, factor):
    table, run = drawn(seed, 3)
    table = table * [1.0, factor, 1.0, 1.0]
    scaled = products_of(NOISE, table)
    here, there = likelihood([run], [1, 2, 3]), likelihood([scaled], [1, 2, 3])
    assert there.deviance == pytest.approx(here.deviance, abs=1e-5)
    assert there.coefficients[0] * factor == pytest.approx(here.coefficients[0], rel=1e-5)
