"""The search: hidden effects are named, absent effects are not, and the evidence decides."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from discovery import (
    BASE,
    CONTACT,
    EFFECTS,
    EVERY,
    TIME,
    active,
    coefficients_of,
    credible_set,
    deviations,
    exact,
    library,
    model_of,
    searched,
    start_model,
    with_effect,
)
from helpers import FIVE, NOISE, W, decay, rms, rms_range, share_range
from kicked_motion import kicked_motion, smooth_forces

from sysid_trib import discover
from sysid_trib.discovery.engine.shape_parameters import has_frequency_parameter
from sysid_trib.discovery.engine.trials import DEFAULTS, Settings
from sysid_trib.discovery.omnibus_test import independent_tests
from sysid_trib.discovery.parts import outcome_of
from sysid_trib.discovery.screen import screen
from sysid_trib.errors import UsageError
from sysid_trib.printing.discovery_tables import formula_text
from sysid_trib.printing.discovery_verdict import verdict_sentences
from sysid_trib.printing.layout import value_with_error
from sysid_trib.results.effects import shapes_of
from sysid_trib.validation.holdout import split

# Effects that differ most from each other, and whose paths are quickly computed.
FEW = EFFECTS.select(["cubic_damping", "inertia", "even_spring", "stiffness_drift", "bias", "sensor_curve"])


@pytest.mark.in_full
def test_the_omnibus_test_keeps_its_level_on_short_records():
    """Thirty columns explain more of the noise in ninety rows than a chi-square distribution predicts."""
    time = np.arange(267) / 50.0
    before, p_values = exact(model_of({"zeta": 0.01}), time), []
    for seed in range(40):
        model = start_model([decay(time, before, seed)], library("zeta"))
        p_values.append(screen(model, [EVERY["quintic"]]).omnibus_p_value)
    assert np.mean(np.array(p_values) < 0.05) <= share_range(40, 0.05)[1]


@pytest.mark.in_full
def test_gains_of_noise_are_noise():
    """Scores are standard normal, and the least p-value of all is below 0.05 in a twentieth of records."""
    seeds, z, least, generic = 20, [], [], []
    # A frequency is taken from the record's own spectrum: its score is the largest of many. Where physics
    # forbids a sign there is no score.
    tried = [f for f in EFFECTS if not has_frequency_parameter(f) and not f.passive]
    before = exact(model_of(FIVE))
    for seed in range(seeds):
        screening = screen(start_model([decay(TIME, before, seed)]), tried)
        trials = zip(screening.trials, screening.reasons, screening.z, strict=True)
        z.append({(t.force.symbol, *t.shapes.values()): value for t, reason, value in trials if not reason})
        least.append(screening.p_values.min())
        generic.append(screening.omnibus_p_value)
    low, high = rms_range(seeds)
    # Grids of shapes are finer where a record tells more values apart.
    common = set.intersection(*map(set, z))
    each = rms(np.array([[scores[trial] for trial in sorted(common)] for scores in z]))
    assert np.all((each > low) & (each < high))
    allowed = share_range(seeds, 0.05)[1]
    assert np.mean(np.array(least) < 0.05) <= allowed
    assert np.mean(np.array(generic) < 0.05) <= allowed


@pytest.mark.parametrize(
    ("symbol", "coefficient"),
    [
        ("inertia", 0.5),
        ("sensor_curve", 0.01),
        ("stiffness_drift", -1e-4),
        pytest.param("partial_slip", 0.12, marks=pytest.mark.slow),
        pytest.param("tilted_friction", 2.4e-3, marks=pytest.mark.slow),
    ],
)
def test_a_hidden_effect_is_named(symbol, coefficient):
    found = searched([with_effect({symbol: coefficient}, seed=4)])
    assert found.converged
    assert outcome_of(found) == "explained"
    assert symbol in credible_set(found, found.effects[0])
    assert found.models[0].deviance > found.models[-1].deviance + 20.0
    if found.effects == (symbol,):
        assert abs(deviations(found.models[-1], {symbol: coefficient})[0]) < 4.0


def test_nothing_is_missing_from_the_truth():
    found = searched([with_effect({}, seed=5)])
    assert found.effects == ()
    assert outcome_of(found) == "nothing missing"
    assert found.converged


@pytest.mark.slow
def test_a_random_force_is_no_effect():
    """Wander of ten noise levels: forces that imitate it must win against it."""
    smooth = {symbol: value for symbol, value in FIVE.items() if symbol != "lambda"}
    density = (10.0 * NOISE * 2.0 * W) ** 2 / TIME[-1]
    motions, _ = kicked_motion(TIME, W, smooth_forces(smooth), 0.0, density, range(2))
    for seed, x in enumerate(motions):
        found = searched([decay(TIME, x, seed)], forces=library(*smooth))
        assert found.effects == ()
        assert outcome_of(found) == "nothing missing"
        assert found.models[0].likelihood.gains[0] > 20.0


def test_an_effect_that_no_candidate_mimics_is_unknown():
    few = EFFECTS.select(["van_der_pol", "quintic", "stiffness_drift"])
    found = searched([with_effect({"even_spring": 1e-2}, seed=6)], few)
    assert outcome_of(found) == "unknown effect"


def with_two(seed=8):
    return with_effect({"cubic_damping": 0.2, "even_spring": 1e-2}, seed=seed)


def test_two_missing_effects_are_both_named():
    found = searched([with_two()], FEW)
    assert set(found.effects) == {"cubic_damping", "even_spring"}
    assert outcome_of(found) == "explained"
    # In the order of explained deviance; each model is more likely than the previous one.
    deviance = [model.deviance for model in found.models]
    assert deviance[0] - deviance[1] > deviance[1] - deviance[2] > 0.0


def test_names_that_were_not_compared_explain_nothing():
    """Both names are right and the residual is noise, but their competitors were not fitted."""
    tree = discover(with_two(), BASE, FEW, settings=Settings(most_fits=3))
    assert set(tree["steps"].symbol.values) == {"cubic_damping", "even_spring"}
    assert tree.attrs["search_outcome"] == "unknown effect"
    headline, ended, *_ = verdict_sentences(tree)
    assert headline.endswith("0.98 times the noise, but not all alternatives to these effects were compared.")
    assert "after as many fits as its settings allow" in ended


def test_a_search_ends_at_its_time_limit():
    run = with_two()
    tree = discover(run, BASE, FEW, time_limit=1e-3)
    assert tree.attrs["out_of_time"] == "0.001 s"
    assert not tree["converged"]
    assert tree.attrs["search_outcome"] == "unknown effect"
    assert tree["steps"].attrs["count"] == 0
    told = " ".join(verdict_sentences(tree))
    assert "ended at its time limit of 0.001 s" in told
    with pytest.raises(UsageError, match="time limit of 0 s"):
        discover(run, BASE, FEW, time_limit=0.0)


def test_shape_parameters_are_stated_with_their_errors():
    """The record determines no error of a shape parameter at an end of its range."""
    shapes = {"power_damping.p": 1.7}
    run = with_effect({"power_damping": 0.02}, seed=2, base={"zeta": 4e-3}, shapes=shapes)
    tree = discover(run, library("zeta"), EFFECTS.select(["power_damping"]))
    step = tree["steps"].to_dataset().isel(step=0)
    (error,) = shapes_of(step, "power_damping", "shape_standard_error").values()
    (value,) = shapes_of(step, "power_damping").values()
    assert abs(value - 1.7) < 4.0 * error
    assert value_with_error(value, error) in formula_text(step)


def test_settings_are_few_documented_and_stored():
    page = (Path(__file__).parents[1] / "docs" / "discovery.md").read_text()
    assert "<!-- generated: settings -->" in page
    assert len(Settings.table()) <= 25
    given = Settings(tolerance=0.2)
    tree = discover(with_effect({}, seed=1), BASE, FEW, max_effects=0, settings=given)
    assert json.loads(tree.attrs["settings"]) == asdict(replace(given, max_effects=0))


def test_a_force_that_only_takes_energy_never_drives():
    few = EFFECTS.select(["structural_damping", "bias"])
    run = with_effect({"structural_damping": -5e-3}, seed=3)
    held, free = searched([run], few), searched([run], active(few))
    assert held.effects == ()
    assert outcome_of(held) == "unknown effect"
    assert free.effects == ("structural_damping",)
    taking = searched([with_effect({"structural_damping": 5e-3}, seed=3)], few)
    assert taking.effects == ("structural_damping",)
    assert coefficients_of(taking.models[-1])["structural_damping"] > 0.0


@pytest.mark.slow
def test_discover_is_blind_to_the_last_third_unless_asked():
    run = with_effect({"even_spring": 1e-2}, seed=4)
    blind, again = (discover(run, BASE, FEW, refit=refit) for refit in (False, True))
    assert blind["record"].sizes["time"] == split(run)[0].sizes["time"]
    assert again["record"].sizes["time"] == run.sizes["time"]
    for tree in (blind, again):
        assert tree.attrs["search_outcome"] == "explained"
        assert tree["converged"]
        assert tree["steps"].symbol.values.tolist() == ["even_spring"]
        assert tree["steps"].prediction_z.item() > -DEFAULTS.refuted
        assert not tree["steps"].worsens_holdout.item()
        assert tree["steps"].gain.item() > 50.0
        assert np.diff(tree["holdout"].log_score.values) > 0.0
    # More samples, smaller errors.
    errors = [tree["steps"].standard_error.item() for tree in (blind, again)]
    assert errors[1] < errors[0]


KNOWN = {"lambda": 1e-3, "zeta": 9.7e-3, "delta": 0.037, "epsilon": 0.3}
LEVEL = 0.01
# As strong as some tenth of the friction, or of the cubic force.
MISSING = {
    **dict.fromkeys(("cubic_damping", "angle_damping", "angle_drag", "van_der_pol", "even_drag"), 0.02),
    **dict.fromkeys(("structural_damping", "even_spring", "bilinear", "quintic"), 0.02),
    "friction_drift": 2e-5,
    "damping_drift": 2e-4,
    "stiffness_drift": 1e-4,
}


@pytest.mark.in_full
def test_increased_errors_of_an_incomplete_model_cover_better():
    """With errors by the noise alone, about half of the 95 % intervals cover."""
    library, inside = BASE.select(KNOWN), []
    for seed, (symbol, coefficient) in enumerate(MISSING.items()):
        model = start_model([with_effect({symbol: coefficient}, seed=seed, base=KNOWN)], library)
        factor = screen(model, [EVERY["bias"]]).widening
        errors = np.sqrt(np.diag(model.covariance_with_frequency()))[:-1]
        off = np.abs(model.coefficients - list(KNOWN.values())) / errors
        inside.append([off < 1.96, off < 1.96 * factor])
    plain, widened = np.mean(inside, axis=(0, 2))
    assert plain < 0.7
    assert widened > 0.8


SLOW_TIME = np.arange(600) / 20.0


def flicker_noise(count: int, seed: int):
    """1/f noise of unit size."""
    white = np.random.default_rng(seed).standard_normal(4 * count)
    frequency = np.fft.rfftfreq(4 * count)
    frequency[0] = np.inf
    noise = np.fft.irfft(np.fft.rfft(white) / np.sqrt(frequency))[:count]
    return noise / np.std(noise)


# Of these what is slow was named as an ambient vibration, where its colour without any name is as likely.
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.in_full) for seed in (5, 6, 10))])
def test_slow_noise_is_not_named(seed):
    angle = exact(model_of({"zeta": 4e-3}), SLOW_TIME) + 2e-3 * flicker_noise(len(SLOW_TIME), seed)
    found = discover(decay(SLOW_TIME, angle, seed), CONTACT.select(["zeta"]), EFFECTS)
    assert found.attrs["search_outcome"] == "nothing missing"


def test_rounding_does_not_decide_how_many_tests_are_independent():
    """With similar candidates a tiny perturbation changes little."""
    random = np.random.default_rng(3)
    columns = random.standard_normal((60, 20)) @ random.standard_normal((20, 150))
    columns = np.column_stack([columns, columns + 1e-9 * random.standard_normal(columns.shape)])
    correlation = np.corrcoef(columns.T)
    noise = 1e-13 * random.standard_normal(correlation.shape)
    order = random.permutation(len(correlation))
    tests = independent_tests(correlation)
    assert independent_tests(correlation + noise + noise.T) == pytest.approx(tests, rel=1e-4)
    assert independent_tests(correlation[np.ix_(order, order)]) == pytest.approx(tests, rel=0.6)
