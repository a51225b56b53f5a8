"""A randomly forced motion: its law, its likelihood, and fits to it."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from helpers import decay, density_that_wanders, rms, scores
from kicked_motion import kicked_motion, smooth_forces
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from statsmodels.tsa.statespace.kalman_smoother import SMOOTHER_ALL

import sysid_trib as st
from benchmarks.certified import DECAYS, noisy, seed_of
from benchmarks.certified_scores import FRESH
from sysid_trib.errors import DecayError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods import Averaging, Direct, EnergyDecay, FeenyLiang, Trajectory, WuDecrement
from sysid_trib.motion_fit.linearised import linearised_about
from sysid_trib.results.random_force import RandomForce, random_force_of
from sysid_trib.simulation.model import FREQUENCY
from sysid_trib.simulation.trajectory import trajectory

W, NOISE = 8.87, 2e-4
FORCES = {f.symbol: f for name in ("contact_forces", "candidate_effects") for f in st.load_library(name)}
TRUTH = {"lambda": 1e-3, "zeta": 5e-5, "delta": 2e-3, "epsilon": -0.1}
SMOOTH = {symbol: value for symbol, value in TRUTH.items() if symbol != "lambda"}
FOUR = {"zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}


def library_with(*symbols):
    return ForceLibrary("of a test", tuple(FORCES[symbol] for symbol in symbols))


def record(truth, per_period, *, periods=16, wander=0.0, filter_=(1.0,), seed=0):
    """A record from 0.3 rad, its library, and the density that pushes it."""
    library = library_with(*truth)
    time = np.arange(periods * per_period) * 2.0 * np.pi / W / per_period
    density = density_that_wanders(wander, NOISE, time, W)
    angle = st.simulate(st.Model(library, truth, W), time, 0.3, random_force=density, seed=seed).angle
    white = np.random.default_rng(100 + seed).standard_normal(len(time) + 500)
    return xr.Dataset({"angle": angle + NOISE * lfilter([1.0], filter_, white)[500:]}), library, density


def linear_record(samples=60):
    """Rows of a viscous decay, linear about its exact motion."""
    model, time = st.Model(library_with("zeta"), {"zeta": 0.02}, W), np.arange(samples) * 0.05
    motion = trajectory(model, time, 0.3, 0.0)
    path = np.stack([motion.position, motion.rate / W], axis=1)
    angle = decay(time, path[:, 0], 1, 1e-3).angle.values
    return linearised_about(model, (time, angle), path, np.array([0.3, 0.0, 0.0]), ("zeta", FREQUENCY))


@pytest.mark.parametrize(("ratio", "correlation"), [(50.0, 0.0), (0.3, 0.8)])
def test_the_filter_is_the_dense_gaussian_likelihood(ratio, correlation):
    linear = linear_record()
    free = linear.rows(0.0)
    linear = replace(linear, sensor_filter=np.array([1.0, -correlation][: 1 + bool(correlation)]))
    samples, size = linear.path.shape
    kicks = np.zeros((samples, size, size * (samples - 1)))
    for k, covariance in enumerate(ratio * linear.steps.diffusion):
        kicks[k + 1, :, size * k : size * (k + 1)] = np.linalg.cholesky(covariance)
    wander = np.einsum("na,nac->nc", linear.observed, linear.recursion(np.zeros((samples, size)), kicks))
    total = wander @ wander.T + toeplitz(correlation ** np.arange(samples)) / (1.0 - correlation**2)
    rows = linear.rows(ratio)
    assert rows.log_determinant == pytest.approx(np.linalg.slogdet(total)[1], abs=1e-6)
    assert rows.target @ rows.target == pytest.approx(
        free.target @ np.linalg.solve(total, free.target), rel=1e-6
    )
    assert rows.design.T @ rows.design == pytest.approx(
        free.design.T @ np.linalg.solve(total, free.design), rel=1e-6, abs=1e-9
    )


@pytest.mark.parametrize("filter_", [[1.0], [1.0, -0.5, 0.2]], ids=["white", "coloured"])
def test_the_smoothed_motion_is_that_of_statsmodels(filter_):
    linear = replace(linear_record(), sensor_filter=np.array(filter_))
    deviation = np.array([2e-3, 0.01, 1e-3, 0.02, 1e-3])
    # Smoother of statsmodels, given the record, the covariance added in each step, and the first state.
    model = linear.statsmodels(0.3, smoothed=True)
    model.smoother_output = SMOOTHER_ALL
    further = len(filter_) - 1
    record = linear.record - linear.observed_parameters @ deviation
    added = np.pad(linear.steps.end - linear.path[1:] + linear.by_column @ deviation, ((0, 1), (0, further)))
    model.bind(np.ascontiguousarray(record[None]))
    model["state_intercept"] = added.T
    start = np.pad(linear.start @ deviation, (0, further))
    model.initialize_known(start, model.initialization.stationary_cov)
    change = model.smooth().smoothed_state[:2].T
    assert linear.smoothed_motion(0.3, deviation) == pytest.approx(linear.path + change, abs=1e-12)
    assert np.abs(change).max() > 1e-4


@pytest.mark.parametrize(
    ("method", "truth", "per_period", "periods"),
    [
        (Direct, TRUTH, 20, 16),
        (Direct, SMOOTH, 60, 16),
        (Trajectory, TRUTH | {"zeta": 1e-4}, 25, 20),
        pytest.param(Trajectory, SMOOTH | {"zeta": 1e-4}, 25, 20, marks=pytest.mark.in_full),
        pytest.param(Averaging, {"zeta": 2e-3, "delta": 2e-2}, 60, 20, marks=pytest.mark.slow),
    ],
)
def test_a_fit_separates_the_two_noises(method, truth, per_period, periods):
    z, ratios = [], []
    for seed in range(4):
        run, library, density = record(truth, per_period, periods=periods, wander=5.0, seed=seed)
        result = st.identify(run, library, method(random_force="estimated"))
        z.append(scores(result, truth))
        ratios.append(random_force_of(result).density / density)
        assert random_force_of(result).p_value < 1e-3
        assert result.noise.item() == pytest.approx(NOISE, rel=0.15)
    assert 0.4 < np.sqrt(np.mean(np.square(z))) < 1.7
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.3)
    if method is not Direct:
        # By white noise alone the same record contradicts itself by far; Direct's rows know of its colour.
        plain = method(random_force="off").identify(run, library)
        assert (plain.standard_error < 0.8 * result.standard_error).all()


@pytest.mark.in_full
@pytest.mark.parametrize("method", [FeenyLiang, EnergyDecay, WuDecrement], ids=lambda m: m.__name__)
def test_decrements_have_errors_of_a_motion_that_is_pushed(method):
    truth, z = {"lambda": 1e-3, "zeta": 2e-3}, []
    for seed in range(4):
        run, library, density = record(truth, 60, periods=10, wander=5.0 * 0.5**0.5, seed=seed)
        result = method(random_force="estimated").identify(run, library)
        assert 0.2 < random_force_of(result).density / density < 5.0
        z.append(scores(result, truth))
    assert 0.3 < np.sqrt(np.mean(np.square(z))) < 1.8


@pytest.mark.in_full
@pytest.mark.parametrize("filter_", [[1.0], [1.0, -0.8]], ids=["white", "coloured"])
def test_no_random_force_is_found_where_there_is_none(filter_):
    z, found = [], []
    for seed in range(4):
        run, library, _ = record(TRUTH, 60, filter_=filter_, seed=seed)
        result = st.identify(run, library, Direct(random_force="estimated"))
        z.append(scores(result, TRUTH))
        found.append(bool(random_force_of(result).p_value < 0.01))
    assert np.sqrt(np.mean(np.square(z))) < 1.7
    assert not any(found)


def test_averaging_without_a_random_force_gives_the_result_of_off():
    truth, absent = {"zeta": 2e-3, "delta": 2e-2}, 0
    for seed in range(4):
        run, library, _ = record(truth, 60, periods=20, seed=seed)
        methods = (Averaging(random_force=option) for option in ("off", "estimated"))
        plain, auto = (method.identify(run, library) for method in methods)
        if force := random_force_of(auto):
            assert force.p_value > 0.01
            assert np.abs((auto.coefficient - plain.coefficient) / plain.standard_error).max() < 0.5
        else:
            absent += 1
            xr.testing.assert_identical(auto.drop_attrs(deep=False), plain.drop_attrs(deep=False))
    assert absent


def test_a_frequency_that_the_wander_hides_is_asked_for():
    # The swing loses 4 % of its amplitude, and wanders by twenty noise levels.
    run, library, _ = record(FOUR, 60, periods=20, wander=20.0, seed=18)
    with pytest.raises(DecayError, match=r"give it \(reference_frequency=\)"):
        Averaging(random_force="estimated").identify(run, library)
    result = Averaging(random_force="estimated", reference_frequency=W).identify(run, library)
    assert np.abs(scores(result, FOUR)).max() < 3.0


@pytest.mark.slow
def test_trajectory_takes_no_coloured_noise_for_a_random_force():
    run, library, _ = record(TRUTH, 40, filter_=(1.0, -0.8), seed=5)
    result = st.identify(run, library, Trajectory(random_force="estimated"))
    # Taken for white, it has p-values below 1e-30.
    assert not random_force_of(result).p_value < 1e-3
    assert np.max(np.abs(scores(result, TRUTH))) < 3.0


def test_of_runs_that_are_pushed_each_has_a_friction_of_its_own():
    truths = [{"zeta": zeta, "delta": 2e-3} for zeta in (2e-3, 6e-3)]
    (one, library, density), (other, *_) = (record(truth, 20, wander=3.0) for truth in truths)
    result = Trajectory(random_force=density, own=("zeta",)).identify([one, other], library)
    assert np.abs(scores(result, {"zeta_1": 2e-3, "zeta_2": 6e-3, "delta": 2e-3})).max() < 3.5


@pytest.mark.parametrize("free", [False, True])
def test_the_bound_with_a_random_force_continues_that_without(free):
    truth = {"lambda": 1e-3, "zeta": 1e-4, "epsilon": -0.1}
    model, time = st.Model(library_with(*truth), truth, W), np.arange(600) * 0.02

    def errors(**pushed):
        bound = st.validation.cramer_rao_bound(model, time, 0.3, 0.0, 2e-4, free=free, **pushed)
        return np.append(bound.standard_error, bound.reference_frequency_standard_error if free else [])

    weak, some, strong = (errors(random_force=density) for density in (1e-16, 1e-6, 1e-4))
    assert weak == pytest.approx(errors(), rel=1e-3)
    assert np.all((weak < some) & (some < strong))


@pytest.mark.in_full
def test_gravity_of_a_measured_pendulum_is_one(data_folder):
    table = np.loadtxt(data_folder / "single_pendulum" / "free_swing.csv", delimiter=",", skiprows=1)
    time, angle = table[(table[:, 0] >= 15.0) & (table[:, 0] <= 75.0)][::10].T
    library = library_with("lambda", "zeta", "delta", "gravity")
    result = Trajectory(random_force="estimated").identify(decay(time, angle - np.pi), library)
    assert result.standard_error.sel(force="gravity").item() < 1e-3
    assert abs(scores(result, {"gravity": 1.0})[0]) < 3.0
    assert np.abs(result.autocorrelation.values).max() < 0.08


def test_at_few_samples_no_error_is_smaller_than_the_bound():
    run, library, density = record(FOUR, 20, wander=1.0)
    result = st.identify(run, library, Direct(random_force=density))
    bound = st.validation.cramer_rao_bound(
        st.Model(library, FOUR, W), run.time.values, 0.3, 0.0, NOISE, free=True, random_force=density
    ).standard_error
    # A tenth for the noise that the record shows; with some cells averaged and others not, nu had 0.77.
    assert ((result.standard_error > 0.9 * bound) & (result.standard_error < 1.3 * bound)).all()


@pytest.mark.in_full
def test_direct_settles_on_records_that_friction_stops():
    truth = FOUR | {"lambda": 1e-3}
    library, time = library_with(*truth), np.arange(400) * 2.0 * np.pi / W / 20
    stop = st.simulate(st.Model(library, truth, W), time, 0.06).stop_time.item()
    density = density_that_wanders(20.0, NOISE, time, W)
    motions, _ = kicked_motion(time, W, smooth_forces(truth), 1e-3, density, range(6), start=(0.06, 0.0))
    z, settled = [], []
    for seed, motion in enumerate(motions):
        run = decay(time, motion, seed, NOISE).sel(time=slice(0.0, stop))
        result = st.identify(run, library, Direct(random_force="estimated"))
        settled.append(bool(result.refined))
        z.append(scores(result, truth))
    # With the sign of the smoothed speed one in six did.
    assert sum(settled) >= 5
    assert np.sqrt(np.mean(np.square(z))) < 1.5


PER_TAU = 1e-6
DENSITY = RandomForce.density_of(PER_TAU, W)


def test_the_variance_of_a_free_oscillator_grows_as_the_theory_says():
    tau = np.linspace(0.0, 12.0, 25)
    motions = kicked_motion(tau / W, W, smooth_forces({}), 0.0, DENSITY, range(2000), kicks_per_period=40)
    free = 0.3 * np.cos(tau), -0.3 * np.sin(tau)
    swing = np.sin(tau) * np.cos(tau)
    for motion, mean, grown in zip(motions, free, (tau - swing, tau + swing), strict=True):
        variance = 0.5 * PER_TAU * grown[1:]
        # Of 2,000 motions a mean square is known to 3 %.
        assert np.mean((motion - mean)[:, 1:] ** 2, axis=0) == pytest.approx(variance, rel=0.15)
        assert np.abs(np.mean(motion - mean, axis=0)[1:] / np.sqrt(variance)).max() < 4.0 / np.sqrt(2000)


@pytest.mark.parametrize("friction", [0.0, 1e-3])
def test_pushed_motions_of_the_package_have_the_same_law(friction):
    coefficients = FOUR | {"alpha": 1e-3, "lambda": friction}
    time = np.arange(161) * 2.0 * np.pi / W / 40
    theirs, _ = kicked_motion(time, W, smooth_forces(coefficients), friction, DENSITY, range(400))
    model = st.Model(st.load_library(), coefficients, W)
    ours = np.array([st.simulate(model, time, 0.3, random_force=DENSITY, seed=s).angle for s in range(60)])
    free = st.simulate(model, time, 0.3).angle.values
    for at in (80, 120, 160):
        errors = [motions[:, at] - free[at] for motions in (ours, theirs)]
        # Of 60 an RMS is known to 9 %.
        assert 0.7 < rms(errors[0]) / rms(errors[1]) < 1.35
        assert abs(np.mean(errors[0]) - np.mean(errors[1])) < 4.0 * np.std(errors[0]) / np.sqrt(60)


@pytest.mark.parametrize("realisation", [14, 16])
def test_small_noise_gives_no_false_random_force(realisation):
    """Dry friction is 100 noise levels here: a wrong sign in few samples at the ends looks like a push."""
    certified = next(decay for decay in DECAYS if decay.name == "three_frictions")
    motion = st.simulate(certified.model, certified.time, certified.angle, certified.rate).angle.values
    seed = seed_of(certified, 1e-5) + FRESH * realisation
    swing = certified.time, noisy(certified, motion, 1e-5, seed)
    found = st.identify(swing, certified.model.library, Direct())
    truth = st.datasets.truth("certified/three_frictions_1e-5").sel(quantity=found.force.values)
    assert "random_force_density" not in found
    assert rms((found.coefficient.values - truth.value.values) / truth.bound.values) < 2.0
