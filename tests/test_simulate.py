import itertools
import time as clock
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy_motion import motion_and_stop, reference_motion

from sysid_trib import Model, load_library
from sysid_trib.errors import SimulationError
from sysid_trib.simulation.simulate import simulate
from sysid_trib.simulation.trajectory import trajectory

SIX = load_library("contact_forces")
W = 9.91
PAPER = {"lambda": -2.3e-5, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
TIME = np.linspace(0.0, 25.0, 2501)
ODD = load_library(Path(__file__).with_name("odd.toml"))


def six(**coefficients):
    renamed = {"lambda" if k == "lam" else k: c for k, c in coefficients.items()}
    return Model(SIX, renamed, W)


def odd(**coefficients):
    return Model(ODD, coefficients, W)


def energy(x, v, c):
    return (
        v**2 / 2
        + (1 + c.get("alpha", 0.0)) * x**2 / 2
        + c.get("nu", 0.0) * np.abs(x) ** 3 / 3
        + c.get("epsilon", 0.0) * x**4 / 4
    )


FIGURES = [
    {"lambda": 0.03},
    *({"delta": d} for d in (0.9, 0.05, 0.1, 0.3, 0.8)),
    {"zeta": 0.05},
    *({"zeta": 0.05, "nu": nu} for nu in (-0.5, -0.2, 0.2, 0.9)),
    *({"zeta": 0.05, "epsilon": e} for e in (-0.9, -0.1, 0.5, 1.5)),
]


@pytest.mark.parametrize("friction", [-2.3e-5, 1e-3])
def test_the_papers_run_is_exact(friction):
    coefficients = PAPER | {"lambda": friction}
    found = simulate(Model(SIX, coefficients, W), TIME)
    np.testing.assert_allclose(found.angle, reference_motion(coefficients, W, TIME), rtol=0, atol=1e-10)


@pytest.mark.parametrize("coefficients", FIGURES, ids=str)
def test_each_force_alone_is_exact(coefficients):
    found = simulate(Model(SIX, coefficients, W), TIME, 1.0)
    expected = reference_motion(coefficients, W, TIME, (1.0, 0.0))
    np.testing.assert_allclose(found.angle, expected, rtol=0, atol=1e-10)


def test_strong_friction_stops_the_papers_run_at_16_s():
    strong = PAPER | {"lambda": 1e-3}
    found = trajectory(six(**strong), TIME)
    assert found.stop_time == pytest.approx(16.1, abs=0.05)
    assert found.stop_time == pytest.approx(motion_and_stop(strong, W, TIME)[1], abs=1e-9)


def test_dry_friction_takes_2_lambda_each_half_period_and_stops_in_the_stick_band():
    model = six(lam=0.03)
    found = trajectory(model, TIME, 1.0)
    half_periods = np.diff(np.concatenate([[0.0], found.reversals, [found.stop_time]]))
    np.testing.assert_allclose(half_periods, np.pi / W, rtol=1e-10)
    turned = trajectory(model, np.concatenate([[0.0], found.reversals]), 1.0).angle
    np.testing.assert_allclose(np.abs(turned), 1.0 - 0.06 * np.arange(len(turned)), rtol=0, atol=1e-12)
    assert abs(found.angle[-1]) <= 0.03
    after = found.stop_time < TIME
    assert np.all(found.angle[after] == found.angle[-1])
    assert np.all(found.rate[after] == 0.0)


@pytest.mark.parametrize(
    "c", [{"alpha": 0.2, "nu": -0.4, "epsilon": 0.3}, {"nu": 0.9}, {"epsilon": -0.5}], ids=str
)
def test_conservative_forces_keep_the_energy_over_1000_periods(c):
    found = trajectory(Model(SIX, c, W), np.linspace(0, 2000 * np.pi / W, 10_001), 0.8, 1.0)
    kept = energy(found.angle, found.rate / W, c)
    np.testing.assert_allclose(kept, kept[0], rtol=1e-10)


@pytest.mark.parametrize(("alpha", "zeta"), [(0.2, 0.0), (-0.3, 0.05), (0.0, 0.3)])
def test_linear_forces_give_the_closed_solution(alpha, zeta):
    w = W * np.sqrt(1 + alpha - zeta**2)
    expected = np.exp(-zeta * W * TIME) * (np.cos(w * TIME) + zeta * W / w * np.sin(w * TIME)) * 0.5
    found = simulate(six(alpha=alpha, zeta=zeta), TIME, 0.5)
    np.testing.assert_allclose(found.angle, expected, rtol=0, atol=1e-10)


def test_dry_friction_does_not_change_the_frequency():
    alpha = 0.2
    found = trajectory(six(lam=0.01, alpha=alpha), TIME, 0.5)
    np.testing.assert_allclose(np.diff(found.reversals), np.pi / (W * np.sqrt(1 + alpha)), rtol=1e-9)


def test_negative_dry_friction_has_a_limit_cycle():
    model = six(lam=-2e-3, zeta=0.02)
    ends = [np.max(trajectory(model, np.linspace(0, 60, 3001), a).angle[-500:]) for a in (0.01, 0.3)]
    np.testing.assert_allclose(ends, 2 * 2e-3 / (np.pi * 0.02), rtol=0.01)
    assert ends[0] == pytest.approx(ends[1], rel=1e-3)


@pytest.mark.parametrize(
    ("coefficients", "more"),
    [
        ({"stribeck": 0.02, "dry": 0.01}, lambda x, v, sv, sx, t: 0.02 * sv * np.exp(-np.abs(v) / 0.03)),
        ({"detent": 0.1, "dry": 0.01}, lambda x, v, sv, sx, t: 0.1 * sx),
        ({"broken": 0.05}, lambda x, v, sv, sx, t: 0.05 * sv * np.abs(v) ** 1.5),
        ({"logarithm": 0.01}, lambda x, v, sv, sx, t: 0.01 * v * np.log(np.abs(v) + 0.01)),
        ({"ambient": 0.1, "dry": 0.05}, lambda x, v, sv, sx, t: 0.1 * np.sin(4.0 * t)),
        ({"wear": 0.01, "dry": 0.01}, lambda x, v, sv, sx, t: 0.01 * t * v),
    ],
)
def test_the_engine_agrees_with_scipy(coefficients, more):
    dry = {"lambda": coefficients.get("dry", 0.0)}
    found, (angle, stop) = (
        trajectory(odd(**coefficients), TIME[:501]),
        motion_and_stop(dry, W, TIME[:501], more=more),
    )
    np.testing.assert_allclose(found.angle, angle, rtol=0, atol=1e-8)
    np.testing.assert_allclose(found.stop_time, stop, rtol=0, atol=1e-6)


def half_periods(model, start):
    """Positions at release and at every reversal."""
    found = trajectory(model, TIME[:1001], start)
    return found, trajectory(model, np.concatenate([[0.0], found.reversals]), start).angle


def test_a_jenkins_element_dissipates_the_energy_of_sliding():
    k, s = 0.1, 0.03
    found, turned = half_periods(Model(ODD, {"jenkins": k}, W, {"jenkins.s": s}), 0.5)
    # The first half period starts unstrained: the spring is loaded over s, unlike over 2 s later.
    a, b = turned[1:-1], turned[2:]
    slides = np.abs(b - a) > 2.2 * s
    lost = (a**2 - b**2)[slides] / 2
    np.testing.assert_allclose(lost, (k * s * (np.abs(b - a) - 2 * s))[slides], rtol=0, atol=1e-11)
    assert slides.sum() > 5
    assert set(found.hidden) == {"jenkins.xr", "jenkins.zr"}


def test_a_masing_element_follows_its_branches():
    c = 0.3
    _, turned = half_periods(odd(masing=c), 0.5)
    h = -turned[0] * abs(turned[0])
    for a, b in itertools.pairwise(turned):
        work = h * (b - a) - abs(b - a) ** 3 / 6
        assert (a**2 - b**2) / 2 == pytest.approx(c * work, abs=1e-11)
        h -= (b - a) * abs(b - a) / 2


def test_a_dahl_element_dissipates_the_energy_of_its_state():
    c, s = 0.1, 0.03
    _, turned = half_periods(odd(dahl=c), 0.5)
    z = 0.0
    for a, b in itertools.pairwise(turned):
        way, path = np.sign(b - a), abs(b - a)
        work = path + s * (way * z - 1.0) * (1.0 - np.exp(-path / s))
        assert (a**2 - b**2) / 2 == pytest.approx(c * work, abs=1e-11)
        z = way + (z - way) * np.exp(-path / s)


def test_a_disturbed_oscillator_sticks_and_moves_again():
    found = trajectory(odd(ambient=0.1, dry=0.05), TIME)
    stuck = np.mean(found.rate == 0.0)
    assert 0.2 < stuck < 0.9
    assert np.isnan(found.stop_time)
    assert len(found.reversals) > 10


def test_time_scales_with_the_frequency():
    slow = trajectory(Model(SIX, PAPER, 2.0), TIME * W / 2.0, 0.3, 0.4)
    fast = trajectory(Model(SIX, PAPER, W), TIME, 0.3, 0.4 * W / 2.0)
    np.testing.assert_allclose(slow.angle, fast.angle, rtol=0, atol=1e-12)
    np.testing.assert_allclose(slow.rate / 2.0, fast.rate / W, rtol=0, atol=1e-12)


strengths = st.fixed_dictionaries(
    {
        "lambda": st.floats(0.0, 0.02),
        "zeta": st.floats(0.0, 0.1),
        "delta": st.floats(0.0, 0.5),
        "alpha": st.floats(-0.3, 0.5),
        "nu": st.floats(-0.3, 0.5),
        "epsilon": st.floats(-0.3, 0.5),
    }
)
starts = st.tuples(st.floats(-0.8, 0.8), st.floats(-3.0, 3.0))


@settings(max_examples=30)
@given(coefficients=strengths, start=starts)
def test_energy_never_grows_and_both_sides_are_symmetric(coefficients, start):
    model = Model(SIX, coefficients, W)
    found = trajectory(model, TIME[:1001], *start)
    assert np.all(np.diff(energy(found.angle, found.rate / W, coefficients)) <= 1e-13)
    mirrored = trajectory(model, TIME[:1001], -start[0], -start[1])
    np.testing.assert_allclose(mirrored.angle, -found.angle, rtol=0, atol=1e-11)


@settings(max_examples=20)
@given(coefficients=strengths, start=starts)
def test_conservative_motions_run_backwards(coefficients, start):
    model = Model(SIX, {k: coefficients[k] for k in ("alpha", "nu", "epsilon")}, W)
    there = trajectory(model, TIME[:501], *start)
    back = trajectory(model, TIME[:501], there.angle[-1], -there.rate[-1])
    np.testing.assert_allclose(back.angle[::-1], there.angle, rtol=0, atol=1e-10)


def test_uneven_times_give_the_same_motion():
    some = np.sort(np.random.default_rng(1).choice(TIME, 300, replace=False))
    some = np.concatenate([[0.0], some[some > 0.0]])
    model = six(**PAPER | {"lambda": 1e-3})
    expected = trajectory(model, TIME).angle[np.searchsorted(TIME, some)]
    np.testing.assert_allclose(trajectory(model, some).angle, expected, rtol=0, atol=1e-12)


def test_time_counts_from_the_first_sample():
    model = odd(wear=0.01, dry=0.01, clock=1e-3)
    early, late = trajectory(model, TIME), trajectory(model, TIME + 100.0)
    np.testing.assert_allclose(late.angle, early.angle, rtol=0, atol=1e-9)
    assert late.stop_time == pytest.approx(early.stop_time + 100.0, abs=1e-9)
    np.testing.assert_allclose(late.reversals, early.reversals + 100.0, rtol=0, atol=1e-9)


@pytest.mark.parametrize("start", [(0.0, 1.0), (0.3, 0.0), (0.0, -2.0), (-0.2, 0.5)])
def test_starts_on_a_switching_surface_are_exact(start):
    found = simulate(Model(SIX, PAPER, W), TIME[:301], *start)
    expected = reference_motion(PAPER, W, TIME[:301], start)
    np.testing.assert_allclose(found.angle, expected, rtol=0, atol=1e-10)


def test_rest_in_the_stick_band_is_a_stop_at_once():
    found = simulate(six(lam=0.03, zeta=0.01), TIME + 5.0, 0.02)
    assert found.stop_time == 5.0
    assert np.all(found.angle == 0.02)
    assert np.all(found.rate == 0.0)
    assert simulate(six(zeta=0.01), TIME, 0.0).stop_time == 0.0


def test_sensor_terms_change_the_measured_angle_alone():
    plain, measured = trajectory(odd(dry=0.01), TIME), trajectory(odd(dry=0.01, offset=0.1, clock=1e-3), TIME)
    np.testing.assert_array_equal(measured.rate, plain.rate)
    np.testing.assert_array_equal(measured.position, plain.angle)
    expected = plain.angle + 0.1 + 1e-3 * TIME * plain.rate / W
    np.testing.assert_allclose(measured.angle, expected, rtol=0, atol=1e-15)


def test_the_dataset_describes_its_contents():
    found = simulate(odd(dahl=0.1), TIME, 0.2)
    assert set(found.data_vars) == {"angle", "rate", "stop_time", "dahl.z"}
    assert (found.angle.units, found.rate.units, found.stop_time.units) == ("rad", "rad/s", "s")
    assert found.time.units == "s"
    assert all("long_name" in variable.attrs for variable in found.variables.values())
    assert "dahl.z" not in simulate(odd(dahl=0.0, dry=0.01), TIME, 0.2)


@pytest.mark.parametrize(
    ("coefficients", "message"),
    [
        ({"viscous": -0.2}, "diverges: .* exceeds 1000 rad"),
        ({"cubic": -20.0}, "diverges: .* exceeds 1000 rad"),
        ({"wear": -1.0}, "diverges"),
        pytest.param({"pole": 9.0}, "diverges|not finite|too steep|too many steps", marks=pytest.mark.slow),
        ({"zeros": 0.1}, "not finite"),
    ],
)
def test_motions_without_a_future_are_refused_in_one_line(coefficients, message, capfd):
    began = clock.process_time()
    with pytest.raises(SimulationError, match=message) as caught:
        simulate(odd(**coefficients), TIME)
    assert "\n" not in str(caught.value)
    assert clock.process_time() - began < 30
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("time", [[], [0.0, 1.0, 1.0], [1.0, 0.0], [0.0, np.nan], [[0.0, 1.0]]], ids=str)
def test_times_must_increase(time):
    with pytest.raises(SimulationError, match="increase"):
        simulate(odd(dry=0.1), time)
