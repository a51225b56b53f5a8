"""Forces in plain `pysindy.SINDy`: features, optimisers with errors, and which forces are kept."""

from dataclasses import replace

import numpy as np
import pysindy
import pytest
import statsmodels.api
from helpers import (
    EIGHT_MORE,
    FIVE,
    SIX,
    W,
    decay,
    library_of_formulas,
    names,
    paper_run,
    share_range,
    values,
)
from scipy.linalg import cholesky_banded, toeplitz

from sysid_trib import load_library
from sysid_trib.errors import DecayError, LibraryError
from sysid_trib.forces import ForceLibrary
from sysid_trib.likelihood.pysindy_features import ForceFeatures, WhitenedLeastSquares
from sysid_trib.methods import Direct
from sysid_trib.results.schema import model_of

# The paper's PDMS sphere on glass, with an additional linear elastic force.
PAPER = {"lambda": -0.000023, "zeta": 0.0097, "delta": 0.037, "alpha": 0.05, "nu": -0.40, "epsilon": 0.30}


def states(cycles=30.0, phase=0.0):
    tau = np.arange(0.0, cycles * 2 * np.pi, 0.1)
    a = 0.3 * np.exp(-0.01 * tau)
    return np.column_stack((a * np.cos(tau + phase), -a * np.sin(tau + phase)))


def target(x, coefficients=PAPER):
    """Theta'' + theta, exact: minus the force."""
    return -sum(c * load_library()[k].value(x[:, 0], x[:, 1]) for k, c in coefficients.items())[:, None]


def sindy(optimizer=None):
    plain = pysindy.STLSQ(threshold=0, alpha=0)
    return pysindy.SINDy(feature_library=ForceFeatures(load_library()), optimizer=optimizer or plain)


def test_sindy_identifies_equation_1_from_exact_derivatives():
    x = states()
    model = sindy().fit(x, t=0.01, x_dot=target(x))
    np.testing.assert_allclose(model.coefficients()[0], [-c for c in PAPER.values()], rtol=0, atol=1e-10)


def test_sindy_prints_a_readable_equation(capsys):
    x = states()
    model = sindy().fit(x, t=0.01, x_dot=target(x))
    model.print(lhs=["theta'' + theta"], precision=6)
    assert capsys.readouterr().out.strip() == (
        "theta'' + theta =  0.000023 sgn(theta') + -0.009700 2 theta' + -0.037000 theta' |theta'|"
        " + -0.050000 theta +  0.400000 theta |theta| + -0.300000 theta^3"
    )
    assert model.equations()[0].endswith("-0.300 theta^3")


def test_inputs_are_those_of_pysindy():
    """`u=` has a column for each input; its derivative by tau is that of a spline."""
    truth = {"gain": 0.05, "base_spring": 0.3, "base_damping": 0.01, "zeta": 0.02, "epsilon": 0.3}
    forces = [*load_library("inputs").select(list(truth)[:3]), *load_library().select(list(truth)[3:])]
    library = replace(load_library("inputs"), forces=tuple(forces))
    x, w, step = states(), 9.9, 0.01
    angle, rate, time = x[:, 0], x[:, 1], step * np.arange(len(x))
    given = np.column_stack([np.sin(3.0 * time), 0.1 * np.cos(7.3 * time)])
    shaken = -0.73 * np.sin(7.3 * time) / w
    exact = np.column_stack([*-given.T, 2.0 * (rate - shaken), 2.0 * rate, angle**3])
    features = ForceFeatures(library, sampling_time=step, reference_frequency=w)
    model = pysindy.SINDy(feature_library=features, optimizer=pysindy.STLSQ(threshold=0, alpha=0))
    model.fit(x, t=step, x_dot=exact @ np.array(list(truth.values()))[:, None], u=given)
    np.testing.assert_allclose(features.transform(np.column_stack([x, given])), exact, rtol=0, atol=1e-6)
    np.testing.assert_allclose(model.coefficients()[0], list(truth.values()), rtol=1e-5)
    assert model.get_feature_names()[:2] == ["(-u)", "(-base)"]
    with pytest.raises(DecayError, match="a column each of the inputs u, base"):
        features.fit(x)
    with pytest.raises(LibraryError, match="give ForceFeatures a positive sampling_time"):
        ForceFeatures(library).fit(np.column_stack([x, given]))


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


def test_in_sindy_it_is_least_squares_with_errors():
    states, columns, target, _, _ = noisy()
    model = sindy(optimizer=WhitenedLeastSquares()).fit(states, t=0.01, x_dot=target[:, None])
    expected = statsmodels.api.OLS(target, columns).fit()
    np.testing.assert_allclose(model.coefficients()[0], expected.params, rtol=1e-8)
    np.testing.assert_allclose(model.optimizer.covariance_[0], expected.cov_params(), rtol=1e-6)
    assert model.optimizer.noise_[0] == pytest.approx(NOISE, rel=0.15)
    assert model.score(states, t=0.01, x_dot=target[:, None]) > 0.99


def test_correlated_rows_are_whitened():
    states, columns, target, factor, covariance = noisy(colour=0.9)
    optimizer = WhitenedLeastSquares(covariance_factor=factor)
    model = sindy(optimizer=optimizer).fit(states, t=0.01, x_dot=target[:, None])
    expected = statsmodels.api.GLS(target, columns, covariance).fit()
    np.testing.assert_allclose(model.coefficients()[0], expected.params, rtol=1e-6)
    np.testing.assert_allclose(optimizer.covariance_[0], expected.cov_params(), rtol=1e-5)


RUN = paper_run()
FOURTEEN = ForceLibrary("fourteen", (*RUN.model.library.forces, *library_of_formulas(**EIGHT_MORE).forces))
STRICT = Direct(W, significance=0.01)


@pytest.mark.in_full
def test_exactly_the_true_five_of_fourteen_are_kept():
    seeds, exact = 40, RUN.angle
    results = [STRICT.identify(decay(RUN.time, exact, seed), FOURTEEN) for seed in range(seeds)]
    kept = [names(FOURTEEN.symbols, result.active.values) for result in results]
    assert np.mean([found == set(FIVE) for found in kept]) >= share_range(seeds, 0.90, 0.05)[0]
    assert all(found >= set(FIVE) for found in kept)


def test_a_dropped_force_has_coefficient_zero_and_the_error_it_would_have_had():
    record = RUN.decay(4)
    result = STRICT.identify(record, RUN.model.library)
    alpha = result.sel(force="alpha")
    assert (alpha.active.item(), alpha.coefficient.item()) == (False, 0.0)
    assert "alpha" not in model_of(result).coefficients
    with_alpha = Direct(W).identify(record, RUN.model.library)
    assert alpha.standard_error.item() == pytest.approx(
        with_alpha.standard_error.sel(force="alpha").item(), rel=0.05
    )
    without = Direct(W).identify(record, RUN.model.library.select(FIVE))
    np.testing.assert_allclose(values(result, FIVE), values(without, FIVE), rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(result.standard_error.sel(force=list(FIVE)), without.standard_error, rtol=1e-3)


@pytest.mark.parametrize(
    "optimizer",
    [
        pysindy.STLSQ(threshold=3e-5, alpha=0.0),
        pysindy.SR3(reg_weight_lam=1e-9, relax_coeff_nu=1.0, regularizer="l0", max_iter=1000, tol=1e-12),
    ],
    ids=lambda optimizer: type(optimizer).__name__,
)
def test_a_sparsifying_optimiser_omits_small_coefficients_and_is_unchanged(optimizer):
    before = dict(optimizer.get_params())
    result = Direct(W, optimizer=optimizer).identify(RUN.decay(4), RUN.model.library)
    assert optimizer.get_params() == before
    assert not hasattr(optimizer, "coef_")
    kept = names(result.force.values, result.active.values)
    assert "alpha" not in kept
    assert kept >= {"zeta", "delta", "nu", "epsilon"}
    np.testing.assert_array_equal(result.coefficient.values[~result.active.values], 0.0)


def test_a_threshold_is_a_force_in_rad():
    """A force is dropped by its size along the motion, not by its coefficient."""
    sizes = {s: abs(c) * np.sqrt(np.mean(RUN.model.library[s].value(*motion()) ** 2)) for s, c in SIX.items()}
    middle = np.sqrt(sizes["zeta"] * sizes["epsilon"])
    low, high = sorted(("zeta", "epsilon"), key=sizes.get)
    result = Direct(W, optimizer=pysindy.STLSQ(threshold=middle, alpha=0.0)).identify(
        RUN.decay(4), RUN.model.library
    )
    kept = names(result.force.values, result.active.values)
    assert high in kept
    assert "lambda" not in kept
    assert low not in kept


def motion():
    from sysid_trib.simulation.trajectory import trajectory

    found = trajectory(RUN.model, RUN.time, RUN.start, 0.0)
    return found.position, found.rate / W
