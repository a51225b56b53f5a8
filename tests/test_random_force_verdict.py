"""Is a random force physical: its dependence on angle, speed, amplitude and time, and the text on it."""

import helpers
import numpy as np
import pytest
import xarray as xr
from helpers import correlated_noise, density_that_wanders, measured, sentences_of

import sysid_trib as st
from sysid_trib.errors import UsageError
from sysid_trib.printing.identification import identification_blocks, identification_json
from sysid_trib.printing.verdict import verdict_sentence
from sysid_trib.validation import verdict as decisions
from sysid_trib.validation.residuals import fitted_motion

W, NOISE = 8.87, 2e-4
FORCES = st.load_library("contact_forces").select(["zeta", "delta", "epsilon"])
TRUTH = {"zeta": 5e-5, "delta": 2e-3, "epsilon": -0.1}
MODEL = st.Model(FORCES, TRUTH, W)
TIME = np.arange(500) * 2.0 * np.pi / W / 25


def pushed_record(model, wander=0.0, seed=0, time=TIME):
    density = density_that_wanders(wander, NOISE, time, W)
    return measured(model, time, noise=NOISE, seed=seed, random_force=density)


def identified(decay, forces=FORCES, random_force="estimated"):
    start = st.Model(forces, {s: TRUTH.get(s, 0.0) for s in forces.symbols}, W)
    return st.identify(decay, forces, st.methods.Trajectory(random_force=random_force, start=start))


@pytest.fixture(scope="module")
def pushed():
    decay = pushed_record(MODEL, 5.0, 3)
    return decay, identified(decay)


def amplitude_p_value(decay, forces):
    """Return the p-value of a dependence on the amplitude, for the fit without a random force."""
    result = st.identify(decay, forces, st.methods.Direct(random_force="off"))
    motion = fitted_motion(decay, result)
    free = xr.Dataset({"angle": ("time", motion.x)}, {"time": decay.time})
    return st.methods.Averaging().amplitude_p_value([decay], [free], forces)


def test_averages_distinguish_a_missing_force_from_a_random_one():
    time = np.arange(1200) * 2.0 * np.pi / W / 30
    drag = st.Model(FORCES, {"zeta": 2e-3, "delta": 0.02, "epsilon": -0.1}, W)
    # Whatever its size, a random force does not depend on the amplitude.
    for wander in (0.0, 20.0):
        assert amplitude_p_value(pushed_record(drag, wander, 1, time), FORCES) > 1e-3
    assert amplitude_p_value(pushed_record(drag, 0.0, 1, time), FORCES.select(["zeta", "epsilon"])) < 1e-6


def test_dependence_on_amplitude_is_not_taken_for_a_random_force(monkeypatch):
    time = np.arange(1200) * 2.0 * np.pi / W / 30
    drag = st.Model(FORCES, {"zeta": 2e-3, "delta": 0.02, "epsilon": -0.1}, W)
    decay = pushed_record(drag, 0.0, 1, time)

    def looked_for(*_):
        raise AssertionError

    monkeypatch.setattr(decisions, "_stochastic", looked_for)
    result = st.identify(decay, FORCES.select(["zeta", "epsilon"]), st.methods.Direct())
    assert "random_force_density" not in result


@pytest.mark.in_full
def test_a_random_force_alone_depends_on_nothing():
    values = []
    for seed in range(4):
        decay = pushed_record(MODEL, 5.0, seed)
        values.append(st.validation.random_force_dependence(decay, identified(decay)))
    tested = xr.concat(values, "seed")
    assert (tested.p_value > 0.01).all()
    assert 0.2 < tested.dependence_p_value.mean() < 0.8
    assert 0.5 < (tested.chi_square / tested.degrees_of_freedom).mean() < 1.7


@pytest.mark.slow
@pytest.mark.parametrize(
    ("symbol", "coefficient", "on"), [("lambda", 1e-3, "speed"), ("damping_drift", 2e-3, "time")]
)
def test_the_dependences_of_a_missing_force_are_found(symbol, coefficient, on):
    whole = {f.symbol: f for name in ("contact_forces", "candidate_effects") for f in st.load_library(name)}
    kept = FORCES.select(["zeta", "delta"])
    library = st.forces.ForceLibrary("whole", (*kept, whole[symbol]))
    decay = pushed_record(st.Model(library, {"zeta": 5e-3, "delta": 2e-3, symbol: coefficient}, W))
    result = identified(decay, kept)
    tested = st.validation.random_force_dependence(decay, result)
    assert tested.p_value < 1e-6
    assert tested.dependence_p_value.sel(aspect="force", on=on) < 1e-4


@pytest.mark.slow
def test_a_size_that_follows_the_amplitude_is_seen():
    time = np.arange(1500) * 2.0 * np.pi / W / 25
    model = st.Model(FORCES, {"zeta": 1e-2}, W)
    pushed = st.simulate(model, time[:501], 0.3, random_force=2e-4, seed=4)
    # From a third of the record on nothing pushes it.
    last = pushed.isel(time=500)
    rest = st.simulate(model, time[500:], last.angle.item(), last.rate.item()).angle
    angle = np.concatenate([pushed.angle.values[:500], rest.values])
    decay = helpers.decay(time, angle, 1, NOISE)
    tested = st.validation.random_force_dependence(decay, identified(decay, FORCES.select(["zeta"])))
    assert tested.dependence_p_value.sel(aspect="size", on="amplitude") < 1e-4
    assert tested.p_value < 1e-3


def test_without_a_random_force_there_is_nothing_to_test(pushed):
    with pytest.raises(UsageError, match="estimated"):
        st.validation.random_force_dependence(pushed[0], identified(pushed[0], random_force="off"))


@pytest.fixture(scope="module")
def checked(pushed):
    return st.cross_check(pushed[0], identified(pushed[0], random_force="off"), pushed[1])


@pytest.mark.slow
def test_a_cross_check_says_that_a_random_force_explains(checked):
    assert checked["judged"].attrs["verdict"] == "explained with a random force"
    assert {"random_force", "innovations", "prediction_bands"} <= set(checked.children)
    assert "neither angle" in verdict_sentence(checked)
    sentences = " ".join(sentences_of(identification_blocks(checked)))
    assert "property of the experiment" in sentences
    assert "within 5 % of its amplitude" in sentences
    data = identification_json(checked)
    assert data["verdict"] == "explained with a random force"
    assert set(data["random_force"]) >= {"density", "standard_error", "relative"}
    relative = (
        np.sqrt(data["random_force"]["density"]) / float(checked["trajectory_2"].reference_frequency) ** 2
    )
    assert data["random_force"]["relative"] == pytest.approx(relative, rel=1e-3)
    assert len(data["innovations"]["autocorrelation"]) == 20
    assert data["innovations"]["rms"] == pytest.approx(NOISE, rel=0.5)


@pytest.mark.slow
def test_a_cross_check_says_that_a_force_is_missing():
    damped = st.Model(FORCES.select(["zeta", "delta"]), {"zeta": 5e-3, "delta": 5e-2}, W)
    decay = pushed_record(damped)
    library = damped.library.select(["zeta"])
    tree = st.cross_check(decay, identified(decay, library, "off"), identified(decay, library))
    assert tree["judged"].attrs["verdict"] == "approximate"
    assert "is approximate" in verdict_sentence(tree)
    told = " ".join(sentences_of(identification_blocks(tree)))
    assert "stands for a missing force: it depends on the" in told
    assert "As a random force, the residual has a density of " in told
    assert "agree within their errors" not in told


@pytest.mark.slow
def test_without_a_random_force_the_verdict_is_that_of_the_residual(pushed):
    free = pushed_record(MODEL)
    for decay, verdict in ((free, "explained"), (pushed[0], "approximate")):
        tree = st.cross_check(decay, *[identified(decay, random_force="off")] * 2)
        data = identification_json(tree)
        assert (data["verdict"], data["random_force"], data["innovations"]) == (verdict, None, None)
        assert "random_force" not in tree.children


def coloured(model, seed, density=0.0, time=TIME):
    angle = st.simulate(model, time, 0.3, random_force=density, seed=seed).angle
    return xr.Dataset({"angle": angle + correlated_noise(len(time), seed, 0.8, NOISE)})


def direct_verdict(decay):
    result = st.identify(decay, FORCES, st.methods.Direct(random_force="estimated"))
    return st.cross_check(decay, result, result)["judged"].attrs["verdict"]


@pytest.mark.parametrize(
    ("wander", "symbol", "coefficient", "verdict"),
    [
        (0.0, None, 0.0, "explained"),
        (5.0, None, 0.0, "explained with a random force"),
        (0.0, "cubic_damping", 0.5, "approximate"),
        (0.0, "three_halves_damping", 0.05, "approximate"),
    ],
)
def test_the_verdict_in_coloured_noise(wander, symbol, coefficient, verdict):
    time = np.arange(1200) * 2.0 * np.pi / W / 60
    further = [] if symbol is None else [st.load_library("candidate_effects")[symbol]]
    library = st.forces.ForceLibrary("whole", (*FORCES, *further))
    model = st.Model(library, TRUTH | {force.symbol: coefficient for force in further}, W)
    density = density_that_wanders(wander, NOISE, time, W)
    assert direct_verdict(coloured(model, 2, density, time)) == verdict
