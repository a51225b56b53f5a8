"""Averaging and decrements of a motion that is pushed at random: the walk of half periods, and the fits."""

import numpy as np
import pytest
import scipy.sparse as sp
import xarray as xr
from helpers import library_of_formulas

import sysid_trib as st
from sysid_trib.cycles.kick_response import KICKS, SPAN, kick_response
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.likelihood.random_force import RandomForce, random_force_of
from sysid_trib.methods import Averaging, EnergyDecay, FeenyLiang, FrequencyShift, WuDecrement
from sysid_trib.methods.half_period_noise import HalfPeriodEquations
from sysid_trib.records.half_sines import envelope

W, NOISE, PERIODS, PER_PERIOD = 8.87, 2e-4, 20, 60
TIME = np.arange(PERIODS * PER_PERIOD) * 2.0 * np.pi / W / PER_PERIOD
LIBRARY = library_of_formulas(zeta="2*v", delta="v*abs(v)")
TRUTH = {"zeta": 2e-3, "delta": 2e-2}
# Five noise levels of wander at the end.
DENSITY = RandomForce.density_of(2.0 * (5.0 * NOISE) ** 2 / (W * TIME[-1]), W)
CURVES = ("half-sines", "analytic-signal")


def decay(density, seed, truth=TRUTH):
    model = st.Model(LIBRARY, truth, W)
    angle = st.simulate(model, TIME, angle=0.3, random_force=density, seed=seed).angle
    return xr.Dataset({"angle": angle + NOISE * np.random.default_rng(seed).standard_normal(len(TIME))})


@pytest.mark.parametrize("curve", CURVES)
def test_amplitude_and_phase_walk_by_half_of_what_v_grows(curve):
    lasting, passing = kick_response(curve)
    # A unit of white acceleration in each half period: half of it in amplitude, half in phase, none in both.
    walk = np.pi / KICKS * lasting.T @ lasting
    np.testing.assert_allclose(walk, np.pi / 2.0 * np.eye(2), atol=1e-12)
    # A curve takes part in a kick within its own half period and its neighbours'.
    size = np.abs(passing).max(axis=(0, 2))
    assert size[SPAN - 1 : SPAN + 1].min() > 10.0 * size[[0, -1]].max()


def rotating(kicks):
    """A steady swing after kicks of v, (sample,): four steps a sample."""
    tau = np.arange(4 * len(TIME)) * W * TIME[1] / 4.0
    turned = np.cumsum(1j * kicks * np.exp(1j * tau))
    return (0.3 * np.cos(tau) + (turned * np.exp(-1j * tau)).real)[::4]


@pytest.mark.parametrize("curve", CURVES)
def test_the_walk_of_half_periods_is_that_of_simulated_kicks(curve):
    random, per_tau, steps = np.random.default_rng(0), 1e-9, []
    for _ in range(40):
        kicks = np.sqrt(per_tau * W * TIME[1] / 4.0) * random.standard_normal(4 * len(TIME))
        measured = envelope(xr.Dataset({"angle": ("time", rotating(kicks))}, {"time": TIME}), curve)
        amplitude, phase = np.diff(measured.extremum), 0.3 * W * (np.diff(measured.extremum_time) - np.pi / W)
        steps.append(np.stack([amplitude, phase])[:, 8:28])
    count = measured.sizes["half_period"]
    difference = sp.diags_array([-1.0, 1.0], offsets=[0, 1], shape=(count - 1, count))
    slopes = sp.csr_matrix(sp.block_diag([difference, 0.3 * W * difference]))
    number = np.tile(np.arange(count - 1), 2)
    equations = HalfPeriodEquations(np.zeros((len(number), 0)), np.zeros(len(number)), slopes, number)
    matrix = equations.kicks(measured.assign_attrs(curve=curve))
    expected = RandomForce.density_of(per_tau, W) * (matrix @ matrix.T).toarray()
    for kind, lag in np.ndindex(2, 3):
        values, at = np.array(steps)[:, kind], kind * (count - 1) + 15
        drawn = np.mean(values[:, : 20 - lag] * values[:, lag:])
        # Of 800 products the mean is known to some 5 % of the variance.
        assert abs(drawn - expected[at, at + lag]) < 0.15 * expected[at, at]


def test_an_equation_is_off_by_the_kicks_between_its_half_periods():
    slopes = sp.csr_matrix([[-0.9, 0.0, 1.0, 0.0, 0.0, 0.0]])
    later = HalfPeriodEquations(np.ones((1, 1)), np.ones(1), slopes, np.array([0])).by_later_steps()
    # A step before the first half period is none to it, one after it is in all that come later.
    np.testing.assert_allclose(later.toarray(), [[0.0, 1.0, 1.0, 0.0, 0.0, 0.0]])


@pytest.mark.slow
def test_averaging_tells_the_two_noises_apart():
    scores, ratios = [], []
    for seed in range(8):
        record = decay(DENSITY, seed)
        result = Averaging(random_force="estimated").identify(record, LIBRARY)
        scores.append((result.coefficient - list(TRUTH.values())) / result.standard_error)
        force = random_force_of(result)
        assert force.p_value < 1e-4
        ratios.append(force.density / DENSITY)
    assert result.noise.item() == pytest.approx(NOISE, rel=0.1)
    assert 0.5 < np.sqrt(np.mean(np.square(scores))) < 1.5
    # Each is known to a quarter.
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.3)
    assert result.birge_ratio.item() == pytest.approx(1.0, abs=0.1)
    plain = Averaging().identify(record, LIBRARY)
    assert (plain.standard_error < 0.7 * result.standard_error).all()


def test_without_a_random_force_the_result_is_that_of_off():
    absent = 0
    for seed in range(4):
        plain, auto = (
            Averaging(random_force=option).identify(decay(0.0, seed), LIBRARY)
            for option in ("off", "estimated")
        )
        if force := random_force_of(auto):
            assert force.p_value > 0.01
            assert np.abs((auto.coefficient - plain.coefficient) / plain.standard_error).max() < 0.5
        else:
            absent += 1
            xr.testing.assert_identical(auto.drop_attrs(deep=False), plain.drop_attrs(deep=False))
    assert absent


def test_a_density_by_hand_is_held(tmp_path):
    record = decay(DENSITY, 3)
    held, off = (Averaging(random_force=option).identify(record, LIBRARY) for option in (DENSITY, "off"))
    assert random_force_of(held).density == DENSITY
    assert (held.standard_error > off.standard_error).all()
    st.save(held, tmp_path / "result.nc")
    assert st.load(tmp_path / "result.nc").to_dataset().identical(held)


def test_each_run_has_its_own():
    runs = [decay(0.0, 0), decay(DENSITY, 1)]
    result = Averaging(random_force="estimated").identify(runs, LIBRARY)
    quiet, pushed = (random_force_of(result, run).density for run in range(2))
    assert quiet < 0.1 * DENSITY < 0.3 * DENSITY < pushed


@pytest.mark.in_full
@pytest.mark.parametrize("method", [FeenyLiang, EnergyDecay, WuDecrement], ids=lambda m: m.__name__)
def test_decrements_have_errors_of_a_motion_that_is_pushed(method):
    truth = {"lambda": 1e-3, "zeta": 2e-3}
    library = library_of_formulas(**{"lambda": "sign(v)", "zeta": "2*v"})
    model, scores = st.Model(library, truth, W), []
    for seed in range(4):
        angle = st.simulate(model, TIME[:600], angle=0.3, random_force=DENSITY, seed=seed).angle
        record = xr.Dataset({"angle": angle + NOISE * np.random.default_rng(seed).standard_normal(600)})
        result = method(random_force="estimated").identify(record, library)
        assert 0.2 < random_force_of(result).density / DENSITY < 5.0
        scores.append((result.coefficient - list(truth.values())) / result.standard_error)
    assert 0.3 < np.sqrt(np.mean(np.square(scores))) < 1.8


def test_the_frequency_shift_has_it_too():
    library = library_of_formulas(zeta="2*v", epsilon="x**3")
    model = st.Model(library, {"zeta": 5e-3, "epsilon": 0.3}, W)
    angle = st.simulate(model, TIME, angle=0.3, random_force=DENSITY, seed=2).angle
    record = xr.Dataset({"angle": angle + NOISE * np.random.default_rng(2).standard_normal(len(TIME))})
    pushed, plain = (
        FrequencyShift(random_force=option).identify(record, library) for option in ("estimated", "off")
    )
    assert 0.3 < random_force_of(pushed).density / DENSITY < 3.0
    assert pushed.standard_error.item() > plain.standard_error.item()
    assert abs(pushed.coefficient.item() - 0.3) < 3.0 * pushed.standard_error.item()


def test_the_papers_rule_takes_no_random_force():
    with pytest.raises(UsageError, match="frequency='last' takes no random_force"):
        Averaging(frequency="last", random_force=1e-4)


@pytest.mark.parametrize("method", [Averaging, FeenyLiang, FrequencyShift], ids=lambda m: m.__name__)
def test_no_density_is_refused(method):
    with pytest.raises(UsageError, match="random_force"):
        method(random_force="maybe")


def test_a_frequency_that_the_wander_hides_is_asked_for():
    truth = {"zeta": 5e-5, "delta": 2e-3, "nu": 1e-2, "epsilon": -0.1}
    model = st.Model(st.load_library("contact_forces").select(truth), truth, W)
    # The swing loses 4 % of its amplitude, and wanders by twenty noise levels.
    angle = st.simulate(model, TIME, angle=0.3, random_force=16.0 * DENSITY, seed=18).angle
    record = xr.Dataset({"angle": angle + NOISE * np.random.default_rng(18).standard_normal(len(TIME))})
    with pytest.raises(DecayError, match=r"give it \(reference_frequency=\)"):
        Averaging(random_force="estimated").identify(record, model.library)
    result = Averaging(random_force="estimated", reference_frequency=W).identify(record, model.library)
    gaps = (result.coefficient - list(truth.values())) / result.standard_error
    assert np.abs(gaps).max() < 3.0
