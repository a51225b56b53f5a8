"""A motion that is pushed at random: exact steps, Kalman filter, likelihood, and what a fit makes of it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from scipy.special import erf

import sysid_trib as st
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.likelihood.random_force import RandomForce, check_random_force, random_force_of
from sysid_trib.likelihood.variance_ratio import WhiteRows, variance_ratio
from sysid_trib.motion_fit.kalman import likely_ratio, set_signal, statsmodels_model
from sysid_trib.motion_fit.linearised import Derivatives, linearised_about
from sysid_trib.motion_fit.steps import expected_steps
from sysid_trib.simulation.simulate import trajectory

W = 8.87
PENDULUM = Path(__file__).parents[2] / "shared" / "data" / "single_pendulum" / "free_swing.csv"
FORCES = {f.symbol: f for name in ("contact_forces", "candidate_effects") for f in st.load_library(name)}


def model_with(**coefficients):
    library = ForceLibrary("of a test", tuple(FORCES[symbol] for symbol in coefficients))
    return st.Model(library, coefficients, W)


def states_of(model, time, angle=0.3):
    motion = trajectory(model, time, angle, 0.0)
    return np.stack([motion.position, motion.rate / W, *motion.hidden.values()], axis=1)


@pytest.mark.parametrize(
    "coefficients",
    [
        {"lambda": 1e-3, "zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1},
        {"lambda": 5e-3, "zeta": 5e-5},
        {"zeta": 1e-4, "wall": 2e-3},
        {"zeta": 1e-4, "iwan": 2e-3},
        {"zeta": 1e-4, "ambient": 2e-3},
    ],
    ids=lambda coefficients: " ".join(coefficients),
)
def test_steps_end_where_the_motion_does(coefficients):
    # The second stops for good within the time.
    model, time = model_with(**coefficients), np.arange(1200) * 0.01
    states = states_of(model, time)
    steps = expected_steps(model, time, states, 0.0)
    # Where two branches of a formula touch, a step is exact to 3e-8.
    assert np.abs(steps.end - states[1:]).max() < 1e-7
    assert np.sort(np.abs(steps.end - states[1:]).max(axis=1))[-10] < 1e-9


@pytest.mark.parametrize("per_period", [16, 200])
def test_steps_do_not_turn_the_phase(per_period):
    # Of x = 0.3 cos(tau). Per radian a step of order five is wrong by 1e-10 to 3e-9, which long records sum.
    model, tau = model_with(zeta=0.0), np.arange(2000) * 2.0 * np.pi / per_period
    cosine, sine = np.cos(tau), np.sin(tau)
    error = expected_steps(model, tau / W, 0.3 * np.stack([cosine, -sine], axis=1), 0.0).end
    error = error - 0.3 * np.stack([cosine, -sine], axis=1)[1:]
    along = [-sine[1:], -cosine[1:]], [cosine[1:], -sine[1:]]
    phase, amplitude = (float(np.sum(error.T * np.array(way)) / (0.3 * tau[-1])) for way in along)
    assert abs(phase) < 1e-12
    assert abs(amplitude) < 1e-12


def test_a_long_gap_is_one_step():
    model = model_with(**{"lambda": 1e-3, "delta": 2e-3})
    time = np.array([0.0, 0.01, 7.3, 7.31])
    states = states_of(model, time)
    assert np.abs(expected_steps(model, time, states, 0.0).end - states[1:]).max() < 1e-10


@pytest.mark.parametrize("symbol", ["lambda", "jenkins"])
def test_derivatives_of_the_steps(symbol):
    model, time = model_with(**{"zeta": 1e-4, symbol: 2e-3}), 0.003 + np.arange(400) * 0.01
    # Away from v = 0 at a sample, where a difference would take both branches.
    states = states_of(model, time - time[0], 0.31)[1:]
    time = time[1:]
    names = ("zeta", symbol)
    steps = expected_steps(model, time, states, 0.0, names, frequency=True)
    for j in range(states.shape[1]):
        ends = [
            expected_steps(model, time, states + sign * 1e-6 * np.eye(states.shape[1])[j], 0.0).end
            for sign in (1, -1)
        ]
        difference = (ends[0] - ends[1]) / 2e-6
        worst = np.sort(np.abs(difference - steps.transition[:, :, j]).max(axis=1))
        assert worst[-3] < 1e-5
    for k, name in enumerate((*names, "w")):

        def changed(step, name=name):
            coefficients = {s: c + step * (s == name) for s, c in model.coefficients.items()}
            return st.Model(model.library, coefficients, W + step * (name == "w"))

        ends = [expected_steps(changed(step), time, states, 0.0).end for step in (1e-6, -1e-6)]
        difference = (ends[0] - ends[1]) / 2e-6
        assert np.sort(np.abs(difference - steps.sensitivity[:, :, k]).max(axis=1))[-3] < 1e-6


def test_diffusion_of_a_damped_oscillator():
    # Of dx = v, dv = -x - 2 z v + white: stationary variance 1/(4 z), and P = S - F S F'.
    damping = 0.1
    model, time = model_with(zeta=damping), np.array([0.0, 0.5, 3.0])
    steps = expected_steps(model, time, np.zeros((3, 2)) + 0.1, 0.0)
    stationary = np.eye(2) / (4.0 * damping)
    for transition, diffusion in zip(steps.transition, steps.diffusion, strict=True):
        assert diffusion == pytest.approx(stationary - transition @ stationary @ transition.T, abs=1e-6)


def linear_record(samples=60, seed=1):
    model, time = model_with(zeta=0.02), np.arange(samples) * 0.05
    path = states_of(model, time)
    angle = path[:, 0] + 1e-3 * np.random.default_rng(seed).standard_normal(samples)
    per_run = np.array([path[0, 0], W * path[0, 1], 0.0])
    return linearised_about(model, time, angle, path, per_run, Derivatives(("zeta",), True)), path


@pytest.mark.parametrize("ratio", [0.0, 50.0])
def test_filter_is_the_dense_gaussian_likelihood(ratio):
    linear, _ = linear_record()
    samples = len(linear.record)
    covariance = np.zeros((samples, 2, samples, 2))
    for k in range(samples - 1):
        # From the kick in step k to all later states.
        carried = {k + 1: np.eye(2)}
        for later in range(k + 2, samples):
            carried[later] = linear.steps.transition[later - 1] @ carried[later - 1]
        for i, a in carried.items():
            for j, b in carried.items():
                covariance[i, :, j] += ratio * a @ linear.steps.diffusion[k] @ b.T
    total = covariance[:, 0, :, 0] + np.eye(samples)
    rows = linear.rows(ratio)
    assert rows.log_determinant == pytest.approx(np.linalg.slogdet(total)[1], abs=1e-6)
    free = linear.rows(0.0)
    assert rows.target @ rows.target == pytest.approx(
        free.target @ np.linalg.solve(total, free.target), rel=1e-6
    )
    assert rows.design.T @ rows.design == pytest.approx(
        free.design.T @ np.linalg.solve(total, free.design), rel=1e-6, abs=1e-9
    )


def test_without_a_random_force_innovations_are_residuals():
    linear, path = linear_record()
    rows = linear.rows(0.0)
    assert rows.target == pytest.approx(linear.record, abs=1e-7)
    assert rows.log_determinant == 0.0
    assert path.shape == (60, 2)


@pytest.mark.parametrize("filter_", [[1.0], [1.0, -0.5, 0.2]], ids=["white", "coloured"])
@pytest.mark.parametrize("ratio", [0.3])
def test_the_smoothed_motion_is_that_of_statsmodels(ratio, filter_):
    linear, _ = linear_record()
    linear, deviation = (
        replace(linear, sensor_filter=np.array(filter_)),
        np.array([2e-3, 0.01, 1e-3, 0.02, 1e-3]),
    )
    steps = linear.steps
    model = statsmodels_model(
        linear.observed, steps.transition, ratio * steps.diffusion, linear.sensor_filter, smoother=True
    )
    set_signal(model, *linear.driven(deviation))
    change = model.smooth().smoothed_state[:2].T
    assert linear.smoothed_motion(ratio, deviation) == pytest.approx(linear.path + change, abs=1e-12)
    assert np.abs(change).max() > 1e-4


def test_restricted_likelihood_finds_a_ratio_and_its_absence():
    random, scale = np.random.default_rng(3), np.linspace(0.1, 3.0, 4000)

    def rows(ratio, kicks):
        size = np.sqrt(1.0 + ratio * scale**2)
        noise = random_part + kicks * scale * other_part
        return WhiteRows(noise / size, np.ones((4000, 1)) / size[:, None], float(np.sum(np.log(size**2))))

    random_part, other_part = random.standard_normal((2, 4000))
    there = variance_ratio(lambda ratio: rows(ratio, np.sqrt(0.5)), 1e-6, 1e4)
    absent = variance_ratio(lambda ratio: rows(ratio, 0.0), 1e-6, 1e4)
    assert abs(np.log(there.ratio * there.variance / 0.5)) < 3.0 * there.relative_error
    assert there.p_value < 1e-6 < 0.01 < absent.p_value


def test_a_body_that_friction_holds_is_not_pushed():
    linear, _ = linear_record()
    steps, held = linear.steps, np.zeros_like(linear.steps.diffusion)
    with pytest.raises(DecayError, match="holds the body"):
        likely_ratio(replace(linear, steps=replace(steps, diffusion=held)))
    held[:40] = steps.diffusion[:40]
    ratio = likely_ratio(replace(linear, steps=replace(steps, diffusion=held)))
    assert np.isfinite([ratio.ratio, ratio.variance]).all()


def test_the_wander_of_a_simulated_motion_is_that_of_the_theory():
    model, time = model_with(zeta=0.0), np.linspace(0.0, 10.0, 60)
    density = 2e-3
    free = st.simulate(model, time, angle=0.3).angle.values
    ends = [
        st.simulate(model, time, angle=0.3, random_force=density, seed=seed).angle.values[-1] - free[-1]
        for seed in range(60)
    ]
    expected = np.sqrt(RandomForce(density).per_tau(W) * W * 10.0 / 2.0)
    # Of 60 ends the RMS is known to 9 %.
    assert 0.7 < np.sqrt(np.mean(np.square(ends))) / expected < 1.3


@pytest.mark.parametrize("option", ["maybe", -1.0, float("nan")])
def test_no_density_is_refused(option):
    with pytest.raises(UsageError, match="random_force"):
        check_random_force(option)
    with pytest.raises(UsageError, match="random_force"):
        st.methods.Trajectory(random_force=option)


def test_coloured_noise_beside_a_random_force_is_refused():
    with pytest.raises(UsageError, match="noise='white'"):
        st.methods.Trajectory(random_force=1e-4, noise="coloured")


@pytest.mark.parametrize("friction", [pytest.param(0.0, marks=pytest.mark.in_full), 1e-3])
def test_a_fit_tells_the_two_noises_apart(friction):
    truth = {"zeta": 1e-4, "delta": 2e-3, "epsilon": -0.1} | ({"lambda": friction} if friction else {})
    model, time, noise = model_with(**truth), np.arange(500) * 2.0 * np.pi / W / 25, 2e-4
    # Five noise levels of wander at the end.
    density = RandomForce.density_of(2.0 * (5.0 * noise) ** 2 / (W * time[-1]), W)
    scores, ratios = [], []
    for seed in range(5):
        angle = st.simulate(model, time, angle=0.3, random_force=density, seed=seed).angle
        angle = angle + noise * np.random.default_rng(100 + seed).standard_normal(len(time))
        decay = xr.Dataset({"angle": angle})
        result = st.identify(decay, model.library, st.methods.Trajectory(random_force="estimated"))
        scores.append((result.coefficient - [truth[s] for s in result.force.values]) / result.standard_error)
        found = random_force_of(result)
        assert found.p_value < 1e-6
        ratios.append(found.density / density)
        assert np.abs(result.autocorrelation.values).max() < 0.2
        assert result.noise.item() == pytest.approx(noise, rel=0.15)
    assert np.sqrt(np.mean(np.square(scores))) < 1.5
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.2)
    # By output error the same records contradict themselves by far.
    plain = st.methods.Trajectory(random_force="off").identify(decay, model.library)
    assert (plain.standard_error < 0.5 * result.standard_error).all()


@pytest.mark.slow
def test_a_fit_settles_where_friction_holds_the_body_for_half_the_record():
    truth = {"lambda": 1e-3, "zeta": 5e-5}
    model, time, noise = model_with(**truth), np.arange(800) * 2.0 * np.pi / W / 40, 2e-4
    density = RandomForce.density_of(2.0 * (5.0 * noise) ** 2 / (W * time[-1]), W)
    angle = st.simulate(model, time, angle=0.03, random_force=density, seed=1).angle
    decay = xr.Dataset({"angle": angle + noise * np.random.default_rng(1).standard_normal(len(time))})
    result = st.identify(decay, model.library, st.methods.Trajectory(random_force="estimated"))
    assert result.noise.item() == pytest.approx(noise, rel=0.15)


@pytest.mark.parametrize("free", [False, True])
def test_the_bound_with_a_random_force_continues_that_without(free):
    truth = {"lambda": 1e-3, "zeta": 1e-4, "epsilon": -0.1}
    model, time = model_with(**truth), np.arange(600) * 0.02
    plain = st.validation.cramer_rao_bound(model, time, 0.3, 0.0, 2e-4, free=free)
    errors = [
        st.validation.cramer_rao_bound(model, time, 0.3, 0.0, 2e-4, free=free, random_force=density)
        for density in (1e-16, 1e-6, 1e-4)
    ]
    names = ["standard_error", *([] if not free else ["reference_frequency_standard_error"])]
    for name in names:
        assert errors[0][name].values == pytest.approx(plain[name].values, rel=1e-3)
        assert (errors[0][name].values < errors[1][name].values).all()
        assert (errors[1][name].values < errors[2][name].values).all()


def test_no_random_force_is_no_other_estimate():
    model, time = model_with(zeta=1e-4, delta=2e-3), np.arange(400) * 2.0 * np.pi / W / 20
    angle = st.simulate(model, time, angle=0.3).angle
    angle = angle + 2e-4 * np.random.default_rng(5).standard_normal(len(time))
    decay = xr.Dataset({"angle": angle})
    plain, auto = (
        st.identify(decay, model.library, st.methods.Trajectory(random_force=option))
        for option in ("off", "estimated")
    )
    assert np.abs((auto.coefficient - plain.coefficient) / plain.standard_error).max() < 0.5
    assert not random_force_of(auto) or random_force_of(auto).p_value > 0.01


def test_a_density_by_hand_is_held(tmp_path):
    model, time = model_with(zeta=1e-4, delta=2e-3), np.arange(400) * 2.0 * np.pi / W / 20
    angle = st.simulate(model, time, angle=0.3, random_force=1e-5, seed=4).angle
    decay = xr.Dataset({"angle": angle + 2e-4 * np.random.default_rng(5).standard_normal(len(time))})
    method = st.methods.Trajectory(random_force=1e-5, constraints={"zeta": (0.0, np.inf)})
    result = st.identify(decay, model.library, method)
    assert random_force_of(result).density == pytest.approx(1e-5, rel=1e-9)
    st.save(result, tmp_path / "result.nc")
    assert st.load(tmp_path / "result.nc").to_dataset().identical(result)


@pytest.mark.skipif(not PENDULUM.exists(), reason="the measured records are not here")
@pytest.mark.slow
def test_gravity_of_a_measured_pendulum_is_one():
    table = np.loadtxt(PENDULUM, delimiter=",", skiprows=1)
    window = (table[:, 0] >= 15.0) & (table[:, 0] <= 75.0)
    time, angle = table[window][::10].T
    decay = xr.Dataset({"angle": ("time", angle - np.pi)}, {"time": time})
    library = ForceLibrary("pendulum", tuple(FORCES[s] for s in ("lambda", "zeta", "delta", "gravity")))
    result = st.methods.Trajectory(random_force="estimated").identify(decay, library)
    gravity = result.sel(force="gravity")
    assert gravity.standard_error.item() < 1e-3
    assert abs(gravity.coefficient.item() - 1.0) < 3.0 * gravity.standard_error.item()
    assert np.abs(result.autocorrelation.values).max() < 0.08


@pytest.mark.in_full
def test_direct_tells_the_two_noises_apart():
    truth = {"zeta": 1e-4, "delta": 2e-3, "epsilon": -0.1}
    model, time, noise = model_with(**truth), np.arange(1000) * 2.0 * np.pi / W / 50, 2e-4
    density = RandomForce.density_of(2.0 * (5.0 * noise) ** 2 / (W * time[-1]), W)
    scores, ratios = [], []
    for seed in range(5):
        angle = st.simulate(model, time, angle=0.3, random_force=density, seed=seed).angle
        angle = angle + noise * np.random.default_rng(100 + seed).standard_normal(len(time))
        result = st.identify(
            xr.Dataset({"angle": angle}), model.library, st.methods.Direct(random_force="estimated")
        )
        scores.append((result.coefficient - [truth[s] for s in result.force.values]) / result.standard_error)
        ratios.append(random_force_of(result).density / density)
        assert result.noise.item() == pytest.approx(noise, rel=0.15)
    assert np.sqrt(np.mean(np.square(scores))) < 1.5
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.25)


def test_the_strong_form_takes_no_random_force():
    with pytest.raises(UsageError, match="form='weak'"):
        st.methods.Direct(form="strong", random_force=1e-4)


def test_expected_steps_have_the_mean_of_the_friction():
    # Within a short step x hardly moves: friction acts with lambda erf(v / (error sqrt 2)) on average.
    friction, error, h = 1e-2, 1e-3, 1e-3
    model, speeds = model_with(**{"lambda": friction}), 1e-3 * np.array([-2.0, -0.7, 0.0, 0.4, 1.2, 9.0])
    for v in speeds:
        states = np.array([[0.0, v], [0.0, v]])
        steps = expected_steps(model, np.array([0.0, h / W]), states, error)
        mean = (v - steps.end[0, 1]) / (friction * h)
        assert mean == pytest.approx(erf(v / (error * np.sqrt(2.0))), abs=0.09)
        # The derivative of friction that has its sign is zero: what is left is the law of the speeds.
        assert 0.0 < steps.transition[0, 1, 1] <= 1.0


def test_steps_of_a_speed_that_is_known_are_exact():
    model, time = model_with(**{"lambda": 1e-3, "delta": 2e-3}), np.arange(200) * 0.02
    states = states_of(model, time)
    exact, far = expected_steps(model, time, states, 0.0), np.abs(states[:, 1]) > 1e-3
    for error in (0.0, 1e-5):
        steps = expected_steps(model, time, states, error)
        same = slice(None) if error == 0.0 else far[:-1] & far[1:] & (states[:-1, 1] * states[1:, 1] > 0.0)
        assert np.array_equal(steps.end[same], exact.end[same])
        assert np.array_equal(steps.diffusion[same], exact.diffusion[same])
    assert not np.array_equal(steps.end, exact.end)


def test_the_filtered_motion_knows_no_later_sample():
    linear, _ = linear_record()
    later = linear.record.copy()
    later[40:] += 1.0
    both = [replace(linear, record=record) for record in (linear.record, later)]
    deviation = np.zeros(linear.start.shape[1])
    filtered, smoothed = (
        [getattr(model, name)(0.1, deviation) for model in both]
        for name in ("filtered_motion", "smoothed_motion")
    )
    assert np.array_equal(filtered[0][0][:40], filtered[1][0][:40])
    assert np.abs(filtered[0][0][40:] - filtered[1][0][40:]).min() > 0.0
    assert np.abs(smoothed[0][39] - smoothed[1][39]).max() > 1e-3
    # The last sample has no later one.
    assert filtered[0][0][-1] == pytest.approx(smoothed[0][-1], abs=1e-12)
