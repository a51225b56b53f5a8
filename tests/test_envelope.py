"""Half-sines give the envelope, its rate and the frequency, with standard errors that are true."""

import helpers
import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings, strategies as st
from scipy.integrate import solve_ivp
from scipy.stats import binom

from sysid_trib.errors import DecayError
from sysid_trib.records import equilibrium
from sysid_trib.records.free_decay import free_decay
from sysid_trib.records.half_sines import _scatter_ratio, envelope, instant_derivatives
from sysid_trib.records.read import read_record

OMEGA = 9.91
LAMBDA, ZETA, DELTA, NU, EPSILON = -2.3e-5, 0.0097, 0.037, -0.40, 0.30


def decay_of(time, angle):
    return xr.Dataset(
        {"angle": ("time", angle, {"units": "rad"})}, coords={"time": time}, attrs={"source": "run.csv"}
    )


def damped(time, zeta=0.01, amplitude=0.3, phase=0.0):
    return amplitude * np.exp(-zeta * OMEGA * time) * np.cos(OMEGA * time + phase)


@pytest.fixture(scope="module")
def paper_run():
    """The paper's PDMS/glass run without noise: 25 s at 100 Hz, restarted at zeros of theta and theta'."""
    time, found = np.arange(2501) / 100.0, np.empty(2501)
    start, state = 0.0, np.array([0.3, 0.0])
    crossing, turning = (lambda t, y: y[0]), (lambda t, y: y[1])
    crossing.terminal = turning.terminal = True
    while start < 25.0:
        ahead = state + 1e-6 * np.array([state[1], -(OMEGA**2) * state[0]])
        side, way = np.sign(ahead)

        def motion(t, y, side=side, way=way):
            x, v = y[0], y[1] / OMEGA
            force = LAMBDA * way + 2 * ZETA * v + DELTA * v * v * way + NU * x * x * side + EPSILON * x**3
            return [y[1], -(OMEGA**2) * (x + force)]

        settings_ = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}
        first = solve_ivp(motion, (start, start + 1e-3), state, dense_output=True, **settings_)
        rest = solve_ivp(
            motion,
            (start + 1e-3, 26.0),
            first.y[:, -1],
            events=[crossing, turning],
            dense_output=True,
            **settings_,
        )
        part = (time >= start) & (time < rest.t[-1])
        early = part & (time < start + 1e-3)
        found[part] = rest.sol(np.maximum(time[part], start + 1e-3))[0]
        if early.any():
            found[early] = first.sol(time[early])[0]
        start, state = rest.t[-1], rest.y[:, -1].copy()
        state[np.argmin(np.abs(state * [OMEGA, 1.0]))] = 0.0
    return time, found


def dissipative(result, w):
    a, rate = result["amplitude"].to_numpy(), result["amplitude_rate"].to_numpy()
    columns = np.stack([np.full(a.size, -2 / np.pi), -a, -4 * a**2 / (3 * np.pi)], axis=1) * w
    return np.linalg.lstsq(columns, rate)[0]


def test_the_papers_run_by_the_papers_rule_and_with_fitted_frequency(paper_run):
    result = envelope(free_decay(decay_of(*paper_run)))
    a, w = result["amplitude"].to_numpy(), result["frequency"].to_numpy()
    assert result.sizes == {"half_period": 77, "instant": 75}
    columns = np.stack([4 * a / (3 * np.pi), 3 * a**2 / 8], axis=1)
    last = np.linalg.lstsq(w[-1] * columns, w - w[-1])[0]
    assert w[-1] == pytest.approx(9.875, abs=5e-4)
    assert last.round(2).tolist() == [-0.25, -0.31]
    fitted = np.linalg.lstsq(np.column_stack([columns, np.ones(a.size)]), w)[0]
    assert fitted[2] == pytest.approx(9.9098, abs=1e-4)
    assert fitted[:2] / fitted[2] == pytest.approx([-0.402, 0.280], abs=1e-3)
    assert dissipative(result, fitted[2]) == pytest.approx([-2.37e-5, 0.00976, 0.0377], rel=0.01)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(
    phase=st.floats(-np.pi, np.pi),
    zeta=st.floats(0.001, 0.05),
    rate=st.sampled_from([60.0, 100.0, 1000.0]),
    periods=st.floats(5.0, 40.0),
)
def test_viscous_decay(phase, zeta, rate, periods):
    time = np.arange(0.0, periods * 2 * np.pi / OMEGA, 1 / rate)
    result = envelope(decay_of(time, damped(time, zeta, phase=phase)))
    # The fit depends a little on where the samples fall; a decrement and a frequency must not.
    np.testing.assert_allclose(result["frequency"], OMEGA, rtol=2e-4)
    decrement = -result["amplitude_rate"] / result["amplitude"] / OMEGA
    np.testing.assert_allclose(decrement, np.tanh(np.pi * zeta) / np.pi, rtol=0.02)
    true = 0.3 * np.exp(-zeta * OMEGA * result["extremum_time"])
    np.testing.assert_allclose(result["extremum"], true, rtol=0.01)


@settings(max_examples=10, deadline=None, derandomize=True)
@given(scale=st.floats(1e-3, 1e3), shift=st.floats(-100, 100), flip=st.sampled_from([1.0, -1.0]))
def test_scaling_time_shift_and_parity(scale, shift, flip):
    time = np.arange(0.0, 12.0, 0.01)
    angle = damped(time) + 1e-4 * np.random.default_rng(0).standard_normal(time.size)
    first, second = envelope(decay_of(time, angle)), envelope(decay_of(time + shift, flip * scale * angle))
    np.testing.assert_allclose(second["amplitude"], scale * first["amplitude"], rtol=1e-8)
    np.testing.assert_allclose(
        second["amplitude_standard_error"], scale * first["amplitude_standard_error"], rtol=1e-5
    )
    np.testing.assert_allclose(second["instant_time"], first["instant_time"] + shift, atol=1e-8)
    np.testing.assert_array_equal(second["sign"], flip * first["sign"])


@pytest.mark.parametrize(("rate", "noise"), [(100.0, 1e-4), (1000.0, 1e-3)])
def test_standard_errors_are_true(rate, noise):
    time = np.arange(0.0, 18.0, 1 / rate)
    clean = damped(time, 0.012, phase=1.0)
    reference = envelope(decay_of(time, clean))
    generator = np.random.default_rng(11)
    squares = {name: [] for name in ("extremum", "extremum_time", "amplitude", "amplitude_rate", "frequency")}
    levels = []
    for _ in range(60):
        result = envelope(decay_of(time, clean + noise * generator.standard_normal(time.size)))
        levels.append(result["white_noise"].item())
        for name, into in squares.items():
            into.append(
                (((result[name] - reference[name]) / result[f"{name}_standard_error"]) ** 2).to_numpy()
            )
    assert np.mean(levels) == pytest.approx(noise, rel=0.02)
    for name, values in squares.items():
        assert np.sqrt(np.mean(values)) == pytest.approx(1.0, abs=0.15), name


def test_errors_grow_where_the_extrema_scatter():
    time = np.arange(0.0, 20.0, 0.01)
    slow = np.interp(time, np.arange(0, 21, 0.3), np.random.default_rng(2).standard_normal(70) * 3e-3)
    quiet = envelope(decay_of(time, damped(time, 0.003)))
    waves = envelope(decay_of(time, damped(time, 0.003) + slow))
    assert waves.attrs["scatter_of_extrema"] > 10
    error = np.abs(waves["amplitude"] - quiet["amplitude"]) / waves["amplitude_standard_error"]
    assert 0.4 < np.sqrt(np.mean(error**2)) < 2.0


@pytest.mark.slow
@pytest.mark.parametrize("count", [15, 77])
def test_white_noise_is_no_scatter(count):
    """Errors are raised by chance in under 0.15 % of the records, for extrema as for their times."""
    generator, trials = np.random.default_rng(count), 20_000
    for decay_ratio in (1.0, 0.9, 0.6):
        raised = sum(
            _scatter_ratio(value, np.ones(count), decay_ratio) > 1.0
            for value in generator.standard_normal((trials // 3, count))
        )
        assert raised <= binom.ppf(1.0 - 1e-4, trials // 3, 0.0015)


@pytest.mark.parametrize("count", [15, 77])
def test_scatter_is_seen(count):
    values = 6.0 * np.random.default_rng(count).standard_normal((500, count))
    ratios = np.array([_scatter_ratio(value, np.ones(count), 0.95) for value in values])
    assert np.mean(ratios > 1.0) > 0.75
    assert np.median(ratios) == pytest.approx(6.0, rel=0.2)


@pytest.mark.parametrize("zeta", [0.003, 0.05])
@pytest.mark.parametrize("periods", [8, 12])
def test_clean_records_keep_their_errors(zeta, periods):
    time = np.arange(0.0, periods * 2 * np.pi / OMEGA, 0.01)
    generator = np.random.default_rng(periods)
    for _ in range(40):
        found = envelope(decay_of(time, damped(time, zeta) + 1e-4 * generator.standard_normal(time.size)))
        assert (found.attrs["scatter_of_extrema"], found.attrs["scatter_of_times"]) == (1.0, 1.0)


def test_chattering_and_coarse_crossings_make_no_half_periods():
    time = np.arange(0.0, 25.0, 1e-3)
    noisy = damped(time, 0.011) + 1e-3 * np.random.default_rng(4).standard_normal(time.size)
    coarse = 0.01 * np.round(damped(time, 0.011) / 0.01)
    for angle in (noisy, coarse):
        result = envelope(decay_of(time, angle))
        assert result.sizes["half_period"] in (77, 78)
        assert np.all(np.diff(result["extremum_time"]) > 0.9 * np.pi / OMEGA)
        assert np.all(np.diff(result["sign"]) != 0)
    assert result["white_noise"].item() == pytest.approx(0.01 / np.sqrt(12), rel=0.01)


def test_derivatives_are_those_of_the_instants():
    time = np.arange(0.0, 8.0, 0.01)
    result = envelope(decay_of(time, damped(time, 0.02)))
    b, t = result["extremum"].to_numpy(), result["extremum_time"].to_numpy()

    def instants(b, t):
        span = t[2:] - t[:-2]
        return (b[2:] + b[:-2]) / 2, (b[2:] - b[:-2]) / span, 2 * np.pi / span

    # Each instant is between two extrema.
    places = np.stack([np.eye(b.size)[:-2], np.eye(b.size)[2:]], axis=1)
    matrices = {name: (by[:, None] @ places)[:, 0] for name, by in instant_derivatives(result).items()}
    rows = {"amplitude_by_extremum": (0, 1, 0), "amplitude_rate_by_extremum": (1, 1, 0)}
    rows |= {"amplitude_rate_by_time": (1, 0, 1), "frequency_by_time": (2, 0, 1)}
    for name, (quantity, of_b, of_t) in rows.items():
        for column in range(b.size):
            step = 1e-6 * np.eye(b.size)[column]
            difference = instants(b + of_b * step, t + of_t * step)[quantity]
            difference = difference - instants(b - of_b * step, t - of_t * step)[quantity]
            np.testing.assert_allclose(matrices[name][:, column], difference / 2e-6, atol=1e-6)
    variance = result["extremum_standard_error"].to_numpy() ** 2
    covariance = matrices["amplitude_by_extremum"]
    covariance = covariance @ np.diag(variance) @ covariance.T
    np.testing.assert_allclose(np.diag(covariance), result["amplitude_standard_error"] ** 2)


def test_cut_half_periods_do_not_count():
    half = np.pi / OMEGA
    for lead in (0.3, 0.9):
        # The first zero crossing comes after `lead` of a half period.
        time = np.arange(0.0, 20 * half, 0.002)
        result = envelope(decay_of(time, damped(time, 0.005, phase=np.pi / 2 - np.pi * lead)))
        assert result["extremum_time"][0].item() / half == pytest.approx(lead + 0.5, abs=0.03)


def test_everything_has_units_and_survives_a_file(tmp_path):
    time = np.arange(0.0, 8.0, 0.01)
    result = envelope(decay_of(time, damped(time, 0.02)))
    for name, variable in result.variables.items():
        assert {"units", "long_name"} <= set(variable.attrs), name
        assert np.all(np.isfinite(variable)), name
    result.to_netcdf(tmp_path / "envelope.nc", engine="h5netcdf")
    xr.testing.assert_identical(xr.load_dataset(tmp_path / "envelope.nc", engine="h5netcdf"), result)


@pytest.mark.parametrize(
    ("angle", "reason"),
    [
        (np.zeros(500), "noise"),
        (np.random.default_rng(0).standard_normal(500), "noise"),
        (damped(np.arange(500) * 0.001), "half periods|noise"),
        (damped(np.arange(500) * 0.25), "two samples"),
    ],
)
def test_refused(angle, reason):
    step = 0.25 if reason == "two samples" else 0.001
    with pytest.raises(DecayError, match=reason):
        envelope(decay_of(np.arange(angle.size) * step, angle))


@pytest.mark.parametrize(
    ("file", "angle", "window", "count", "first", "last"),
    [
        ("single_pendulum/free_swing.csv", None, (15, 75), 145, (1.640, 6.741), (0.179, 7.997)),
        ("string_pendulum/run_1.txt", None, (None, None), 140, (0.68, 3.734), (0.185, 3.84)),
        ("roll_decay/model_test_21337.csv", "phi", (25, None), 52, (0.161, 2.4835), (0.0658, 2.4655)),
    ],
)
def test_measured(data_folder, file, angle, window, count, first, last):
    result = envelope(free_decay(read_record(data_folder / file, angle=angle), window=window))
    assert result.sizes["half_period"] == pytest.approx(count, abs=1)
    for index, (extremum, frequency) in ((0, first), (-1, last)):
        assert result["extremum"][index].item() == pytest.approx(extremum, rel=0.02)
        assert result["frequency"][index].item() == pytest.approx(frequency, rel=0.01)


def test_half_periods_are_found_once_for_the_same_numbers():
    decay = helpers.paper_run(helpers.FIVE, duration=6.0).decay(0)
    *_, first = equilibrium.with_half_periods(decay)
    assert equilibrium.with_half_periods(decay.copy(deep=True))[-1] is first
    # Numbers count, not the array that holds them.
    decay.angle.values *= -1.0
    assert equilibrium.with_half_periods(decay)[-1].sign[0] == -first.sign[0]
    for turn in range(equilibrium.KEPT_DECAYS + 3):
        equilibrium.with_half_periods(decay.assign_coords(time=decay.time + turn))
    assert equilibrium._whole_half_periods.cache_info().currsize == equilibrium.KEPT_DECAYS
