"""Direct identification beside a random force: at few samples, with dry friction, in coloured noise."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.linalg import toeplitz
from scipy.signal import lfilter

import sysid_trib as st
from sysid_trib.likelihood.colour import sensor_colour
from sysid_trib.likelihood.random_force import RandomForce, random_force_of
from sysid_trib.likelihood.row_noise import covariance_band, covariance_of_local_rows
from sysid_trib.likelihood.weak_form import build_weak_form, coloured, noise_operator
from sysid_trib.methods import Direct, Trajectory
from sysid_trib.motion_fit.linearised import Derivatives, linearised_about

W, NOISE = 8.87, 2e-4
TRUTH = {"lambda": 1e-3, "zeta": 5e-5, "delta": 2e-3, "epsilon": -0.1}


def autoregressive(samples, filter_, seed):
    white = np.random.default_rng(seed).standard_normal(samples + 500)
    return NOISE * lfilter([1.0], filter_, white)[500:]


def record(truth, per_period, *, wander=0.0, filter_=(1.0,), seed=0):
    library = st.load_library("contact_forces").select(truth)
    time = np.arange(16 * per_period) * 2.0 * np.pi / W / per_period
    density = RandomForce.density_of(2.0 * (wander * NOISE) ** 2 / (W * time[-1]), W)
    angle = st.simulate(st.Model(library, truth, W), time, 0.3, random_force=density, seed=seed).angle
    return xr.Dataset({"angle": angle + autoregressive(len(time), filter_, 100 + seed)}), library, density


@pytest.mark.parametrize("filter_", [[1.0], [1.0, -0.99]], ids=["white", "long"])
@pytest.mark.parametrize("samples", [60, 600])
@pytest.mark.parametrize("clock", ["two rates", "jittered"])
def test_the_covariance_of_local_rows_is_the_sparse_product(samples, filter_, clock):
    steps = np.full(samples, 0.1)
    if clock == "two rates":
        steps[: samples // 3] = 0.2
    if clock == "jittered":
        steps *= np.random.default_rng(1).uniform(0.8, 1.2, samples)
    form = build_weak_form(np.cumsum(steps))
    operator = coloured(noise_operator(form, np.ones(samples), np.full(samples, 0.01)), np.array(filter_))
    for band in (covariance_of_local_rows(operator), covariance_of_local_rows(operator, operator.copy())):
        product = covariance_band(operator @ operator.T)
        bands = min(len(band), len(product))
        assert band[:bands] == pytest.approx(product[:bands], abs=1e-12 * product.max())
        assert not band[bands:].any()
        assert not product[bands:].any()


@pytest.mark.parametrize("filter_", [[1.0], [1.0, -1.2, 0.5]], ids=str)
@pytest.mark.parametrize("per_period", [20, 100])
@pytest.mark.parametrize("pushed", [True, False])
def test_colour_of_noise_beside_a_random_force(filter_, per_period, pushed):
    # Response of the oscillator to kicks, besides the sensor's noise.
    step, samples = 2.0 * np.pi / per_period, 3000
    kicks = pushed * 1e-4 * np.sqrt(step) * np.random.default_rng(1).standard_normal(samples)
    swing = lfilter([0.0, np.sin(step)], [1.0, -2.0 * np.cos(step), 1.0], kicks)
    angle = swing + autoregressive(samples, filter_, 2)
    found = sensor_colour(angle, step * np.arange(samples), random_force=pushed)
    line = np.linspace(0.0, np.pi, 50)

    def response(taps):
        return np.abs(np.exp(-1j * np.multiply.outer(line, np.arange(len(taps)))) @ taps)

    assert found.innovation == pytest.approx(NOISE, rel=0.1)
    assert response(found.filter_) == pytest.approx(response(filter_), rel=0.35)


@pytest.mark.parametrize(
    ("truth", "per_period"), [(TRUTH, 20), ({s: c for s, c in TRUTH.items() if s != "lambda"}, 60)]
)
def test_coefficients_beside_a_random_force(truth, per_period):
    scores, ratios = [], []
    for seed in range(4):
        decay, library, density = record(truth, per_period, wander=5.0, seed=seed)
        result = st.identify(decay, library, Direct(random_force="estimated"))
        scores.append((result.coefficient - list(truth.values())) / result.standard_error)
        ratios.append(random_force_of(result).density / density)
        assert result.noise.item() == pytest.approx(NOISE, rel=0.15)
        assert random_force_of(result).p_value < 1e-3
    assert np.sqrt(np.mean(np.square(scores))) < 1.7
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize("filter_", [[1.0], [1.0, -0.8]], ids=["white", "coloured"])
def test_no_random_force_is_found_where_there_is_none(filter_):
    scores, told = [], 0
    for seed in range(4):
        decay, library, _ = record(TRUTH, 60, filter_=filter_, seed=seed)
        result = st.identify(decay, library, Direct(random_force="estimated"))
        scores.append((result.coefficient - list(TRUTH.values())) / result.standard_error)
        told += bool(random_force_of(result).p_value < 0.01)
    assert np.sqrt(np.mean(np.square(scores))) < 1.7
    assert told == 0


@pytest.mark.slow
def test_an_exact_record_has_exact_coefficients():
    library = st.load_library("contact_forces").select(TRUTH)
    time = np.arange(900) * 2.0 * np.pi / W / 45
    decay = st.simulate(st.Model(library, TRUTH, W), time, 0.3)[["angle"]]
    result = st.identify(decay, library, Direct(random_force="estimated"))
    assert result.coefficient.values == pytest.approx(np.array(list(TRUTH.values())), rel=1e-3)
    assert result.reference_frequency.item() == pytest.approx(W, rel=1e-5)


def test_runs_have_noises_of_their_own():
    quiet, library, _ = record(TRUTH, 40, seed=1)
    pushed, _, density = record(TRUTH, 40, wander=20.0, seed=2)
    result = st.identify([quiet, pushed], library, Direct(random_force="estimated"))
    found = [random_force_of(result, run).density / density for run in range(2)]
    assert found[0] < 0.02
    assert found[1] == pytest.approx(1.0, abs=0.5)
    scores = (result.coefficient - list(TRUTH.values())) / result.standard_error
    assert np.max(np.abs(scores)) < 3.5


def test_the_filter_of_coloured_noise_is_the_dense_likelihood():
    decay, library, _ = record({"zeta": 1e-3}, 20, wander=5.0, filter_=(1.0, -0.8), seed=3)
    decay = decay.isel(time=slice(0, 60))
    time, angle = decay.time.values, decay.angle.values
    path = np.stack([angle, np.gradient(angle, W * time)], axis=1)
    by = Derivatives(("zeta",), frequency=False)
    linear = linearised_about(
        st.Model(library, {"zeta": 1e-3}, W), time, angle, path, np.array([angle[0], 0.0, 0.0]), by
    )
    linear = replace(linear, sensor_filter=np.array([1.0, -0.8]))
    assert linear.rows(0.3).log_determinant == pytest.approx(_dense(linear, 0.3)[0], abs=1e-6)
    assert np.sum(linear.rows(0.3).target ** 2) == pytest.approx(_dense(linear, 0.3)[1], rel=1e-6)


def _dense(linear, ratio):
    """Logarithm of the determinant, and chi-square of the record, by matrices of all samples."""
    samples, size = linear.path.shape
    gain = np.zeros((samples, size))
    kicks = np.zeros((samples, size, size * (samples - 1)))
    for k, covariance in enumerate(ratio * linear.steps.diffusion):
        kicks[k + 1, :, size * k : size * (k + 1)] = np.linalg.cholesky(covariance)
    motion = np.einsum("na,nac->nc", linear.observed, linear.recursion(gain, kicks))
    sensor = toeplitz(0.8 ** np.arange(samples)) / (1.0 - 0.8**2)
    total = motion @ motion.T + sensor
    added = np.zeros((samples, size, 1))
    added[1:, :, 0] = linear.mismatch
    target = linear.record - (linear.observed[:, :, None] * linear.recursion(gain, added)).sum(axis=1)[:, 0]
    return np.linalg.slogdet(total)[1], target @ np.linalg.solve(total, target)


def test_innovations_of_coloured_noise_are_white():
    decay, library, _ = record(TRUTH, 30, wander=5.0, filter_=(1.0, -0.8), seed=4)
    result = st.identify(decay, library, Direct(random_force="estimated"))
    innovations = st.validation.innovations(decay, result)
    assert innovations.ljung_box_p_value.item() > 0.01
    # Of 480 samples: three errors.
    assert innovations.innovation_rms.item() == pytest.approx(NOISE, rel=0.1)
    assert innovations.innovation_rms.item() < 0.8 * result.noise.item()


@pytest.mark.slow
def test_trajectory_takes_no_coloured_noise_for_a_random_force():
    for seed in (5,):
        decay, library, _ = record(TRUTH, 40, filter_=(1.0, -0.8), seed=seed)
        result = st.identify(decay, library, Trajectory(random_force="estimated"))
        # Taken for white, it has p-values below 1e-30.
        assert not random_force_of(result).p_value < 1e-3
        scores = (result.coefficient - list(TRUTH.values())) / result.standard_error
        assert np.max(np.abs(scores)) < 3.0


def test_at_few_samples_no_error_is_smaller_than_the_bound():
    truth = {"zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}
    decay, library, density = record(truth, 20, wander=1.0)
    result = st.identify(decay, library, Direct(random_force=density))
    model = st.Model(library, truth, W)
    bound = st.validation.cramer_rao_bound(
        model, decay.time.values, 0.3, 0.0, NOISE, free=True, random_force=density
    ).standard_error
    # A tenth for the noise that the record shows; with some cells averaged and others not, nu had 0.77.
    assert (result.standard_error > 0.9 * bound).all()
    assert (result.standard_error < 1.3 * bound).all()
