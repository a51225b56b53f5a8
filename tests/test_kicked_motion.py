"""The generator of pushed motions against theory, and the package's own against the generator."""

import numpy as np
import pytest
from kicked_motion import kicked_motion, smooth_forces
from reference_motion import reference_motion

import sysid_trib as st
from sysid_trib.likelihood.random_force import RandomForce

W, PER_TAU = 8.87, 1e-6
DENSITY = RandomForce.density_of(PER_TAU, W)
SIX = {"lambda": 1e-3, "zeta": 5e-5, "delta": 2e-3, "alpha": 1e-3, "nu": 1e-2, "epsilon": -0.1}


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


@pytest.mark.slow
@pytest.mark.parametrize("start", [0.3, 0.03])
def test_without_kicks_it_is_the_exact_motion_with_its_stop(start):
    # The second stops after seven periods.
    time = np.arange(400) * 2.0 * np.pi / W / 40
    found, _ = kicked_motion(
        time, W, smooth_forces(SIX), SIX["lambda"], 0.0, [0], start=(start, 0.0), kicks_per_period=800
    )
    exact = st.simulate(st.Model(st.load_library(), SIX, W), time, start).angle.values
    assert found[0] == pytest.approx(exact, abs=3e-7)
    if start == 0.3:
        assert found[0] == pytest.approx(reference_motion(SIX, W, time), abs=3e-7)


def test_where_friction_holds_the_speed_has_the_law_of_fokker_and_planck():
    # dv = -lambda sign(v) dtau + kicks, without the spring's pull: density exp(-2 lambda |v| / per_tau).
    friction, density, time = 0.05, 1e2 * DENSITY, np.arange(40) * 0.05 / W
    _, v = kicked_motion(
        time, W, smooth_forces({}), friction, density, range(400), start=(0.0, 0.0), kicks_per_period=16_000
    )
    expected = (1e2 * PER_TAU) ** 2 / (2.0 * friction**2)
    assert 0.9 * expected < np.mean(v[:, 10:] ** 2) < 1.1 * expected


def test_a_seed_is_a_motion_whatever_the_others_are():
    time = np.arange(120) * 0.03
    three, _ = kicked_motion(time, W, smooth_forces(SIX), 1e-3, DENSITY, [4, 5, 6])
    one, _ = kicked_motion(time, W, smooth_forces(SIX), 1e-3, DENSITY, [5])
    assert (three[1] == one[0]).all()
    assert not np.allclose(three[0], three[1], atol=1e-6)


@pytest.mark.parametrize("friction", [0.0, 1e-3])
def test_pushed_motions_of_the_package_have_the_same_law(friction):
    coefficients = {**SIX, "lambda": friction}
    time, seeds = np.arange(161) * 2.0 * np.pi / W / 40, range(60)
    theirs, _ = kicked_motion(time, W, smooth_forces(coefficients), friction, DENSITY, range(400))
    model = st.Model(st.load_library(), coefficients, W)
    ours = np.array([st.simulate(model, time, 0.3, random_force=DENSITY, seed=s).angle for s in seeds])
    free = st.simulate(model, time, 0.3).angle.values
    for at in (80, 120, 160):
        errors = [motions[:, at] - free[at] for motions in (ours, theirs)]
        # Of 60 an RMS is known to 9 %.
        assert 0.7 < np.sqrt(np.mean(errors[0] ** 2) / np.mean(errors[1] ** 2)) < 1.35
        assert abs(np.mean(errors[0]) - np.mean(errors[1])) < 4.0 * np.std(errors[0]) / np.sqrt(60)
