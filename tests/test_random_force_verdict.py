"""Is a random force one: its dependence on angle, speed, amplitude and time, and what is said of it."""

import time as clock

import numpy as np
import pytest
import xarray as xr
from helpers import correlated_noise, sentences_of

import sysid_trib as st
from sysid_trib import plots
from sysid_trib.commands.checks import parse_random_force
from sysid_trib.errors import UsageError
from sysid_trib.likelihood.random_force import RandomForce
from sysid_trib.methods.scope import with_random_force
from sysid_trib.motion_fit.tracked import FollowedRuns
from sysid_trib.printing.comparison import comparison_blocks
from sysid_trib.printing.identification import identification_blocks
from sysid_trib.printing.json_results import identification_json
from sysid_trib.printing.verdict import verdict_sentence
from sysid_trib.validation.verdict import verdict_on_record

W, NOISE = 8.87, 2e-4
FORCES = st.load_library("contact_forces").select(["zeta", "delta", "epsilon"])
TRUTH = {"zeta": 5e-5, "delta": 2e-3, "epsilon": -0.1}
MODEL = st.Model(FORCES, TRUTH, W)
TIME = np.arange(500) * 2.0 * np.pi / W / 25


def density_of(wander):
    """Density that lets the angle wander by so many noise levels at the end."""
    return RandomForce.density_of(2.0 * (wander * NOISE) ** 2 / (W * TIME[-1]), W)


def measured(model, density=0.0, seed=0, time=TIME):
    angle = st.simulate(model, time, 0.3, random_force=density, seed=seed).angle
    return xr.Dataset({"angle": angle + NOISE * np.random.default_rng(seed).standard_normal(len(time))})


def identified(decay, forces=FORCES, random_force="estimated"):
    start = st.Model(forces, {s: TRUTH.get(s, 0.0) for s in forces.symbols}, W)
    return st.identify(decay, forces, st.methods.Trajectory(random_force=random_force, start=start))


@pytest.fixture(scope="module")
def pushed():
    decay = measured(MODEL, density_of(5.0), 3)
    return decay, identified(decay)


@pytest.mark.slow
def test_a_random_force_alone_depends_on_nothing():
    values = []
    for seed in range(4):
        decay = measured(MODEL, density_of(5.0), seed)
        values.append(st.validation.random_force_dependence(decay, identified(decay)))
    tested = xr.concat(values, "seed")
    assert (tested.p_value > 0.01).all()
    assert 0.2 < tested.dependence_p_value.mean() < 0.8
    assert 0.5 < (tested.chi_square / tested.degrees_of_freedom).mean() < 1.7


@pytest.mark.slow
@pytest.mark.parametrize(
    ("symbol", "coefficient", "on"),
    [
        ("lambda", 1e-3, "speed"),
        ("gravity", 0.5, "angle"),
        ("even_spring", 5e-2, "angle"),
        ("damping_drift", 2e-3, "time"),
    ],
)
def test_a_force_that_is_left_out_shows_on_what_it_depends(symbol, coefficient, on):
    whole = {f.symbol: f for name in ("contact_forces", "candidate_effects") for f in st.load_library(name)}
    kept = FORCES.select(["zeta", "delta"])
    library = st.forces.ForceLibrary("whole", (*kept, whole[symbol]))
    decay = measured(st.Model(library, {"zeta": 5e-3, "delta": 2e-3, symbol: coefficient}, W))
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
    decay = xr.Dataset(
        {"angle": ("time", angle + NOISE * np.random.default_rng(1).standard_normal(1500))}, {"time": time}
    )
    tested = st.validation.random_force_dependence(decay, identified(decay, FORCES.select(["zeta"])))
    assert tested.dependence_p_value.sel(aspect="size", on="amplitude") < 1e-4
    assert tested.p_value < 1e-3


@pytest.mark.slow
def test_a_coefficient_that_was_held_wrong_is_no_random_force():
    decay = measured(MODEL.with_coefficients({"zeta": 5e-3}))
    method = st.methods.Trajectory(random_force="estimated", constraints={"epsilon": -0.05}, start=MODEL)
    tested = st.validation.random_force_dependence(decay, st.identify(decay, FORCES, method))
    assert tested.dependence_p_value.sel(aspect="force", on="angle") < 1e-6


@pytest.mark.slow
def test_a_density_by_hand_that_the_record_contradicts(pushed):
    decay, result = pushed
    assert st.validation.random_force_dependence(decay, result).density_p_value > 0.5
    wrong = identified(decay, random_force=30.0 * density_of(5.0))
    tested = st.validation.random_force_dependence(decay, wrong)
    assert tested.density_p_value < 1e-4
    assert 0.3 < tested.likely_density / density_of(5.0) < 3.0


def test_without_a_random_force_there_is_nothing_to_test(pushed):
    with pytest.raises(UsageError, match="estimated"):
        st.validation.random_force_dependence(pushed[0], identified(pushed[0], random_force="off"))


@pytest.mark.slow
def test_a_long_record_takes_seconds():
    time = np.arange(100_000) * 2.0 * np.pi / W / 100
    model = st.Model(FORCES.select(["zeta", "delta"]), {"zeta": 1e-5, "delta": 1e-4}, W)
    decay = measured(model, time=time)
    result = st.identify(decay, model.library, st.methods.Direct(refine=False))
    result["random_force_density"] = 1e-7
    result["random_force_standard_error"] = result["random_force_p_value"] = 0.0
    start = clock.process_time()
    tested = st.validation.random_force_dependence(decay, result)
    assert clock.process_time() - start < 10.0
    assert tested.attrs["every"] == 5


@pytest.fixture(scope="module")
def checked(pushed):
    return st.cross_check(pushed[0], identified(pushed[0], random_force="off"), pushed[1], draws=1)


@pytest.mark.slow
def test_a_cross_check_says_that_a_random_force_explains(checked):
    assert checked["comparison"].attrs["verdict_on_record"] == "explained with a random force"
    assert {"random_force", "innovations", "prediction_bands"} <= set(checked.children)
    assert "neither angle" in verdict_sentence(checked)
    sentences = " ".join(sentences_of(identification_blocks(checked)))
    assert "property of the experiment" in sentences
    assert "to 5 % of its amplitude" in sentences
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
    decay = measured(damped)
    library = damped.library.select(["zeta"])
    tree = st.cross_check(decay, identified(decay, library, "off"), identified(decay, library), draws=1)
    assert tree["comparison"].attrs["verdict_on_record"] == "approximate"
    assert "is approximate" in verdict_sentence(tree)
    told = " ".join(sentences_of(identification_blocks(tree)))
    assert "sign of something missing: it depends on the" in told
    assert "What is left, taken for a random force, has a density of " in told
    assert "agree within their errors" not in told


@pytest.mark.slow
def test_without_a_random_force_the_verdict_is_that_of_the_residual(pushed):
    free = measured(MODEL)
    for decay, verdict in ((free, "explained"), (pushed[0], "approximate")):
        tree = st.cross_check(decay, *[identified(decay, random_force="off")] * 2, draws=1)
        data = identification_json(tree)
        assert (data["verdict"], data["random_force"], data["innovations"]) == (verdict, None, None)
        assert "random_force" not in tree.children


@pytest.mark.slow
def test_a_random_force_is_named_where_methods_are_compared():
    decay = measured(MODEL, density_of(20.0), 3)
    methods = {"direct": st.methods.Direct(random_force="estimated")}
    tree = st.compare(decay, FORCES, methods)
    text = " ".join(sentences_of(comparison_blocks(tree)))
    assert "These forces without a random force do not explain it." in text
    assert "allow: direct" in text
    assert "effective values" not in text
    methods = {"direct": st.methods.Direct(random_force="off")}
    tree = st.compare(decay, FORCES, methods)
    assert "effective values" in " ".join(sentences_of(comparison_blocks(tree)))


@pytest.mark.slow
def test_each_run_is_judged(pushed):
    runs = [measured(MODEL, density_of(5.0), seed) for seed in (3, 4)]
    results = [identified(runs, random_force=option) for option in ("off", "estimated")]
    tree = st.cross_check(runs, *results, draws=1)
    assert tree["random_force"].p_value.dims == ("run",)
    assert {"innovations_1", "innovations_2", "prediction_bands_2"} <= set(tree.children)
    assert tree["comparison"].attrs["verdict_on_record"] == "explained with a random force"


def test_methods_take_the_option_that_they_can():
    direct, decrement = st.methods.Direct(), st.methods.WindowedERA()
    assert with_random_force(direct, "auto").random_force == "auto"
    assert with_random_force(decrement, "auto") is decrement
    strong = st.methods.Direct(form="strong")
    assert with_random_force(strong, 1e-4) is strong
    with pytest.raises(UsageError, match="random_force"):
        with_random_force(decrement, -1.0)


@pytest.mark.parametrize("text", ["much", "-1", "nan", "1e30", ""])
def test_the_command_line_refuses_what_is_no_density(text):
    with pytest.raises(UsageError, match="auto, estimated, off, or a density"):
        parse_random_force(text)
    assert parse_random_force(" 1e-4") == 1e-4
    assert (parse_random_force("auto"), parse_random_force("off")) == ("auto", "off")


def test_figures_show_the_numbers(checked):
    followed, bands = (checked[name].to_dataset() for name in ("innovations", "prediction_bands"))
    over_time, over_lag, force = plots.innovations(followed).axes
    assert over_time.lines[0].get_ydata() == pytest.approx(1e3 * followed.innovation.values)
    assert (over_time.get_xlabel(), over_time.get_ylabel()) == ("time (s)", "innovation (mrad)")
    assert over_lag.get_xlabel() == "lag (samples)"
    assert over_lag.lines[0].get_ydata() == pytest.approx(followed.autocorrelation.values)
    assert set(force.lines[0].get_ydata()) <= set(followed.random_force.values)
    assert force.get_ylabel() == "random force (rad/s²)"
    predicted = plots.prediction_bands(bands)
    drawn = predicted.lines[0].get_ydata()
    assert drawn == pytest.approx(1e3 * (bands.measured - bands.predicted).values[0], nan_ok=True)
    assert predicted.get_ylabel().endswith("(mrad)")


@pytest.mark.slow
def test_noise_that_is_larger_than_the_sensors_hides_no_force():
    whole = {f.symbol: f for f in st.load_library("candidate_effects")}
    library = st.forces.ForceLibrary("whole", (*FORCES, whole["structural_damping"]))
    time = np.arange(1200) * 2.0 * np.pi / W / 60
    truth = {"zeta": 5e-3, "delta": 2e-3, "epsilon": -0.1, "structural_damping": 0.09}
    decay = measured(st.Model(library, truth, W), time=time)
    result = st.identify(decay, FORCES, st.methods.Direct(random_force="off"))
    # As a method that takes the force for coloured noise states it.
    result = result.assign(noise=result.noise * 5.0, random_force_density=0.0)
    result = result.assign(random_force_standard_error=1e-6, random_force_p_value=1.0)
    assert verdict_on_record("yes", 0.1, FollowedRuns({0: decay}, result), {}) == "not explained"
    free = measured(MODEL, time=time)
    plain = st.identify(free, FORCES, st.methods.Direct(random_force="off"))
    assert verdict_on_record("yes", 0.1, FollowedRuns({0: free}, plain), {}) == "explained"


def coloured(model, seed, density=0.0, time=TIME):
    angle = st.simulate(model, time, 0.3, random_force=density, seed=seed).angle
    return xr.Dataset({"angle": angle + correlated_noise(len(time), seed, 0.8, NOISE)})


def direct_verdict(decay):
    result = st.identify(decay, FORCES, st.methods.Direct(random_force="estimated"))
    return st.cross_check(decay, result, result, draws=1)["comparison"].attrs["verdict_on_record"]


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
    density = RandomForce.density_of(2.0 * (wander * NOISE) ** 2 / (W * time[-1]), W)
    assert direct_verdict(coloured(model, 2, density, time)) == verdict
