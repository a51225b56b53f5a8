"""Rows that do not resolve a stiffness: the determinant of their noise, and what a model gains by it."""

import numpy as np
import pytest
from discovery import EVERY, library, start_model
from helpers import NOISE, W, decay
from kicked_motion import kicked_motion, smooth_forces

from sysid_trib.discovery.screen import screen
from sysid_trib.likelihood.model_fit import fit_model
from sysid_trib.likelihood.resolution import unresolved
from sysid_trib.likelihood.weak_form import build_weak_form, noise_operator

PERIODS, PER_PERIOD, PARTS = 20, 100, 15
POINTS = np.linspace(0.0, 2.0 * np.pi * PERIODS, PERIODS * PER_PERIOD * PARTS + 1)
STIFFNESSES = {
    "constant": np.full(POINTS.size, 0.8),
    "smooth": 1.0 + 0.2 * np.cos(2.0 * POINTS),
    "jumps": 1.0 + 0.3 * np.sign(np.cos(2.0 * POINTS) - 0.5),
    "narrow": 1.0 + 0.6 * (np.abs(np.cos(POINTS)) < 0.1),
}


def lost(name, knots):
    """What so many test functions a period do not resolve."""
    form = build_weak_form(POINTS[::PARTS], PERIODS * knots)
    damping = np.full(POINTS.size, 0.01)
    hat = 1.0 - np.abs(np.arange(1 - PARTS, PARTS)) / PARTS

    def at_samples(values):
        weights = np.convolve(np.ones(POINTS.size), hat, "same")
        return (np.convolve(values, hat, "same") / weights)[::PARTS]

    stiffness = STIFFNESSES[name]
    operator = noise_operator(form, at_samples(stiffness), at_samples(damping))
    return unresolved(form, POINTS, stiffness, damping, operator)


@pytest.mark.parametrize("name", ["constant", "smooth"])
def test_what_is_smooth_is_resolved(name):
    assert lost(name, 12) == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("name", ["jumps", "narrow"])
def test_finer_test_functions_resolve_more(name):
    """The determinant tends to that of the equation itself, that of the Gram matrix of free motions."""
    coarse, finer, fine = (lost(name, knots) for knots in (12, 24, 48))
    assert coarse > 3.0
    assert coarse > 1.8 * finer > 3.2 * fine
    assert fine < 1.0


@pytest.mark.slow
def test_beside_a_random_force_a_kinked_force_gains_no_more_than_the_smooth_one_that_acts():
    """Rows that resolve its stiffness badly see the random force badly: that is no gain of the model."""
    base = {"zeta": 6e-4, "nu": -0.54, "epsilon": -0.57}
    time = np.arange(2500) * 2.0 * np.pi / 23.2 / W
    density = (4.0 * NOISE * 2.0 * W) ** 2 / time[-1]

    def force(x, v):
        return smooth_forces(base)(x, v) - 14.0 * x**5

    (angle, _), _ = kicked_motion(time, W, force, 0.0, density, [3, 4])
    start = start_model([decay(time, angle, 0)], library(*base))
    gains = {}
    for symbol in ("quintic", "freeplay"):
        screened = screen(start, [EVERY[symbol]])
        model = fit_model(
            [rows.path for rows in start.rows],
            [*start.trials, screened.trials[screened.best()[0]]],
            frequency_free=True,
            first=np.array([*start.coefficients, 0.0, start.stiffness]),
        )
        assert model.settled
        assert model.likelihood.ratios[0] > 0.0
        gains[symbol] = start.deviance - model.deviance
    assert gains["quintic"] > 300.0
    # It has a shape parameter more.
    assert gains["freeplay"] < gains["quintic"] + 10.0


def test_what_drives_beyond_all_bounds_has_no_free_motions():
    form = build_weak_form(POINTS[::PARTS], PERIODS * 12)
    samples = np.zeros(len(form.tau))
    operator = noise_operator(form, samples + 1.0, samples)
    driven = np.full(POINTS.size, -2.0 / (POINTS[1] - POINTS[0]))
    assert unresolved(form, POINTS, STIFFNESSES["jumps"], driven, operator) == 0.0
