"""Errors beside a random force whose size is not known exactly, and columns of a motion near rest."""

import numpy as np
import pytest
import xarray as xr
from kicked_motion import kicked_motion, smooth_forces
from scipy.linalg import expm
from scipy.special import erf

import sysid_trib as st
from sysid_trib.likelihood.pysindy_features import ForceFeatures
from sysid_trib.likelihood.random_force import RandomForce
from sysid_trib.likelihood.ratio_posterior import average_over_ratios, probability_of_none
from sysid_trib.likelihood.variance_ratio import VarianceRatio, WhiteRows, smoothed_rate_error, variance_ratio

W, NOISE = 8.87, 2e-4
FORCES = st.load_library("contact_forces")


SAMPLES = 100
# A random walk in its principal axes.
WALK, AXES = np.linalg.eigh(np.minimum.outer(np.arange(SAMPLES), np.arange(SAMPLES)) + 1.0)


def pushed_line(kick, seed):
    """Rows of a line through a random walk in noise, by the ratio of its steps to the noise."""
    random = np.random.default_rng(seed)
    record = random.standard_normal(SAMPLES) + np.cumsum(kick * random.standard_normal(SAMPLES))
    line = np.column_stack([np.ones(SAMPLES), np.linspace(-1.0, 1.0, SAMPLES)])
    design, target = AXES.T @ line, AXES.T @ record

    def rows(ratio):
        root = np.sqrt(1.0 + ratio * WALK)
        return WhiteRows(target / root, design / root[:, None], 2.0 * float(np.log(root).sum()))

    def solved(ratio):
        values, covariance = rows(ratio.ratio).solution()
        return values, ratio.variance * covariance

    estimate = variance_ratio(rows, 1e-6, 1e2)
    average = average_over_ratios(rows, estimate, SAMPLES, solved)
    return estimate, solved, average


def test_a_random_walk_that_is_there_by_chance_moves_the_estimate_little():
    errors = []
    for seed in range(40):
        estimate, solved, average = pushed_line(0.0, seed)
        none, best = solved(VarianceRatio(0.0, 1.0, np.nan, np.nan, 0.0))[0], solved(estimate)[0]
        errors.append((none[1], best[1], (best + average.shift)[1]))
    none, best, averaged = np.sqrt(np.mean(np.square(errors), axis=0))
    assert best > 1.1 * none
    assert averaged < 1.03 * none


def test_errors_of_the_averaged_estimate_hold_beside_a_random_walk_that_hardly_shows():
    scores = []
    for seed in range(60):
        estimate, solved, average = pushed_line(0.15, seed)
        values, covariance = solved(estimate)
        errors = np.sqrt(np.diag(covariance + average.covariance))
        scores.append((values + average.shift)[1] / errors[1])
    assert 0.75 < np.sqrt(np.mean(np.square(scores))) < 1.25


def test_no_random_force_is_as_probable_as_one_where_the_gain_is_its_price():
    assert probability_of_none(np.log(1200.0), 1200) == pytest.approx(0.5)
    assert probability_of_none(60.0, 1200) < 1e-10
    assert probability_of_none(0.0, 1200) > 0.97


@pytest.mark.parametrize("ratio", [1e-3, 1.0, 50.0])
def test_error_of_the_smoothed_speed_is_that_of_the_smoother(ratio):
    step, samples, middle = 0.02, 3000, 1500
    transition = expm(step * np.array([[0.0, 1.0], [-1.0, 0.0]]))
    kicks = ratio * NOISE**2 * np.array([[step**3 / 3.0, step**2 / 2.0], [step**2 / 2.0, step]])
    # Information of the record before and after a sample, each by a Kalman filter.
    covariances = []
    for forward in (transition, np.linalg.inv(transition)):
        covariance = np.eye(2)
        for _ in range(min(middle, samples - middle)):
            gain = covariance[:, 0] / (covariance[0, 0] + NOISE**2)
            covariance = covariance - np.outer(gain, covariance[0])
            covariance = forward @ covariance @ forward.T + kicks
        covariances.append(covariance)
    seen = np.diag([NOISE**-2, 0.0])
    smoothed = np.linalg.inv(sum(np.linalg.inv(covariance) for covariance in covariances) + seen)
    estimate = VarianceRatio(ratio, NOISE**2, np.nan, np.nan, 0.0)
    assert smoothed_rate_error(estimate, step) == pytest.approx(np.sqrt(smoothed[1, 1]), rel=0.05)


def test_sign_of_a_speed_that_is_not_known_exactly_is_its_mean():
    features = ForceFeatures(FORCES.select(["lambda"]), reference_frequency=W)
    time, speed, error = np.arange(50) * 0.01, np.linspace(-5e-4, 5e-4, 50), 2e-4
    mean = features.cell_averages(time, np.zeros(50), speed, np.zeros(50), rate_error=error)[:, 0]
    assert mean == pytest.approx(erf(speed / (error * np.sqrt(2.0))), abs=0.06)


@pytest.mark.slow
def test_direct_settles_on_records_that_friction_stops():
    truth = {"lambda": 1e-3, "zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}
    library, time = FORCES.select(truth), np.arange(400) * 2.0 * np.pi / W / 20
    stop = st.simulate(st.Model(library, truth, W), time, 0.06).stop_time.item()
    density = RandomForce.density_of(2.0 * (20.0 * NOISE) ** 2 / (W * time[-1]), W)
    friction, forces = truth["lambda"], smooth_forces(truth)
    motions = kicked_motion(time, W, forces, friction, density, range(6), start=(0.06, 0.0))[0]
    scores, settled = [], []
    for seed, motion in enumerate(motions):
        angle = motion + NOISE * np.random.default_rng(seed).standard_normal(len(time))
        decay = xr.Dataset({"angle": ("time", angle)}, {"time": time}).sel(time=slice(0.0, stop))
        result = st.identify(decay, library, st.methods.Direct(random_force="estimated"))
        settled.append(result.attrs["refined"] == "True")
        scores.append((result.coefficient.values - list(truth.values())) / result.standard_error.values)
    # With the sign of the smoothed speed one in six did.
    assert sum(settled) >= 5
    assert np.sqrt(np.mean(np.square(scores))) < 1.5
