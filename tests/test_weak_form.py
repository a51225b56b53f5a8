"""The weak form: exact integrals, motions it annihilates, white rows."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
from helpers import NOISE, SIX, W, decay, paper_run
from scipy.interpolate import BSpline

from sysid_trib import load_library
from sysid_trib.forces.constraints import Constraints
from sysid_trib.likelihood.linearisation import derivatives_along, linearised
from sysid_trib.likelihood.optimizers import constraint_map
from sysid_trib.likelihood.problem import begin
from sysid_trib.likelihood.refined_columns import simulated
from sysid_trib.likelihood.rows import weak_rows
from sysid_trib.likelihood.weak_form import SAMPLES_PER_ROW, build_weak_form, noise_operator, whiten, whitener
from sysid_trib.records.smoothing import (
    KNOTS_PER_PERIOD,
    SAMPLES_PER_KNOT,
    SPLINE_DEGREE,
    knot_intervals,
    knot_sequence,
    smooth,
)

EVEN = np.linspace(0.0, 60.0, 1001)
# Relative to the integral of the absolute value; at the ends the test functions do not end smoothly.
INSIDE, AT_ENDS, UNEVEN = 3e-8, 1e-4, 1e-3
JITTERED = EVEN + np.random.default_rng(0).uniform(-0.01, 0.01, EVEN.size) * EVEN[1]


def assert_annihilated(operator, motion, inside=INSIDE, at_ends=AT_ENDS):
    left = operator @ motion / (np.abs(operator) @ np.ones(motion.size))
    np.testing.assert_allclose(left[4:-4], 0.0, atol=inside)
    np.testing.assert_allclose(left, 0.0, atol=at_ends)


@pytest.mark.parametrize("tau", [EVEN, EVEN[:200] + 3.0], ids=["long", "short"])
def test_integrals_of_smooth_functions_are_exact(tau):
    form, knots = build_weak_form(tau), knot_sequence(tau, knot_intervals(tau, SAMPLES_PER_ROW))
    for row, spline in ((0, 2), (1, 3), (form.rows // 2, form.rows // 2 + 2), (form.rows - 1, form.rows + 1)):
        psi = BSpline.basis_element(knots[spline : spline + SPLINE_DEGREE + 2], extrapolate=False)
        low, high = knots[spline], knots[spline + SPLINE_DEGREE + 1]
        for order, matrix in enumerate((form.value, form.slope, form.curvature)):

            def integrand(t, psi=psi, order=order):
                return np.nan_to_num(psi.derivative(order)(t) if order else psi(t)) * np.cos(1.1 * t + 0.3)

            inner = np.unique(knots[(knots >= low) & (knots <= high)])
            exact = sum(
                scipy.integrate.fixed_quad(integrand, a, b, n=12)[0] for a, b in itertools.pairwise(inner)
            )
            found = (matrix @ np.cos(1.1 * tau + 0.3))[row]
            accuracy = INSIDE if row == form.rows // 2 else AT_ENDS
            assert found == pytest.approx(exact, abs=accuracy * np.abs(matrix[[row]]).sum())


def test_test_functions_vanish_with_their_slope_at_both_ends():
    """Integrated twice by parts, nothing is left at the ends."""
    form = build_weak_form(EVEN)
    motion = np.exp(0.02 * EVEN) * np.cos(EVEN)
    slope = 0.02 * motion - np.exp(0.02 * EVEN) * np.sin(EVEN)
    curvature = 0.04 * slope - (1.0 + 0.02**2) * motion
    by_value = form.value @ curvature
    for by_parts in (-(form.slope @ slope), form.curvature @ motion):
        np.testing.assert_allclose(by_parts, by_value, atol=1e-5 * np.abs(by_value).max())


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


def test_whitened_rows_have_the_unit_matrix_as_covariance():
    form = build_weak_form(EVEN)
    operator = noise_operator(form, 1.0 + 0.1 * np.cos(EVEN), 0.02 * np.ones(EVEN.size))
    white = whiten(whitener(operator), operator.toarray())
    np.testing.assert_allclose(white @ white.T, np.eye(form.rows), atol=1e-8)


def test_smoothing_finds_motion_derivatives_and_noise():
    tau = np.linspace(0.0, 60.0, 2501)
    motion = 0.3 * np.exp(-0.02 * tau) * np.cos(tau)
    x, v, a, noise = smooth(tau, decay(tau, motion, seed=1).angle.values)
    assert noise == pytest.approx(NOISE, rel=0.06)
    assert np.sqrt(np.mean((x - motion) ** 2)) < 0.4 * NOISE
    assert np.sqrt(np.mean((v - np.gradient(motion, tau, edge_order=2)) ** 2)) < 2e-3
    assert np.sqrt(np.mean((a[50:-50] + motion[50:-50]) ** 2)) < 2e-2


def test_whitened_residual_of_a_true_model_is_white():
    run = paper_run()
    library = run.model.library
    free = constraint_map(Constraints(), library, {})
    (begun,) = begin([run.decay(2)], library, free, reference_frequency=W, shapes={})
    true = replace(
        begun, coefficients=np.array(list(SIX.values())), frequency=W, offset=0.0, start=(0.3, 0.0)
    )
    moving, _ = simulated(true, np.ones(6, bool), None)
    rows = weak_rows(moving, linearised(moving))
    coefficients = moving.coefficients
    residual = whiten(rows.factor, rows.target - rows.columns @ (rows.scale * coefficients)) / NOISE
    assert moving.problem.noise == pytest.approx(NOISE, rel=0.06)
    count = len(residual)
    assert np.sum(residual**2) == pytest.approx(count, abs=4.0 * np.sqrt(2.0 * count))
    for lag in range(1, 6):
        assert abs(np.mean(residual[lag:] * residual[:-lag])) < 4.0 / np.sqrt(count)


def test_too_few_samples_between_knots_make_wider_test_functions():
    coarse = np.linspace(0.0, 60.0, 150)
    intervals = len(np.unique(knot_sequence(coarse))) - 1
    assert intervals == round(149 / SAMPLES_PER_KNOT) < 60.0 / (2.0 * np.pi) * KNOTS_PER_PERIOD


def test_twenty_samples_a_period_have_rows_that_resolve_the_third_harmonic():
    periods = 20
    form = build_weak_form(np.arange(20 * periods) * 2.0 * np.pi / 20)
    assert form.rows / periods == pytest.approx(KNOTS_PER_PERIOD, rel=0.02)


@pytest.mark.parametrize("symbol", ["power_damping", "log_friction"])
def test_what_rises_steeply_at_a_reversal_damps_the_noise_as_a_jump_does(symbol):
    """No spike that the test functions cannot see, and the whole rise in the mean."""
    steep = load_library("candidate_effects")[symbol]
    ((name, shape),) = steep.shape.items()
    shapes = {f"{symbol}.{name}": shape.low}
    x, v = 0.2 * np.cos(EVEN), -0.2 * np.sin(EVEN)
    small = 1e-4
    damping = derivatives_along([(steep, small)], shapes, EVEN, x, v)[1] / small
    fastest = float(steep.value(0.0, 0.2, 0.0, shapes=shapes))
    assert damping.max() < 3.0 * fastest / 0.2
    at = np.flatnonzero((0.5 * np.pi < EVEN) & (1.5 * np.pi > EVEN))
    rise = np.trapezoid(damping[at], v[at])
    assert rise == pytest.approx(2.0 * fastest, rel=0.2)
