"""The search: what is hidden is named, what is not there is not, and the evidence decides."""

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
from helpers import FIVE, NOISE, W, decay, library_of_formulas, paper_run, rms, rms_range, share_range
from kicked_motion import kicked_motion, smooth_forces

from sysid_trib import discover
from sysid_trib.discovery.discover import verdict_of
from sysid_trib.discovery.exchange import exchange_effects, rivals_of
from sysid_trib.discovery.fits import Fits
from sysid_trib.discovery.omnibus_test import corrected
from sysid_trib.discovery.screen import independent_tests, screen
from sysid_trib.discovery.unseen import better_by, predicted
from sysid_trib.errors import UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.formulas import parse
from sysid_trib.forces.library import parse_library
from sysid_trib.likelihood.run_rows import decimated
from sysid_trib.likelihood.settings import DEFAULTS, Settings
from sysid_trib.likelihood.trials import (
    TrialEffect,
    has_frequency_parameter,
    is_frequency,
    is_resonance,
    trials_of,
)
from sysid_trib.printing.discovery_tables import formula_text
from sysid_trib.printing.discovery_verdict import verdict_sentences
from sysid_trib.printing.layout import value_with_error
from sysid_trib.results.discoveries import shapes_of
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.validation.holdout import split, up_to_held_out

RUN = paper_run(FIVE)
# What imitates each other least, and quickly follows a path.
FEW = EFFECTS.select(["cubic_damping", "inertia", "even_spring", "stiffness_drift", "bias", "sensor_curve"])


def verdict(found):
    return verdict_of(found)


def test_a_frequency_is_known_by_its_formula():
    assert is_frequency(EFFECTS["ambient"], "W")
    assert not is_frequency(EFFECTS["ambient"], "p")
    assert not is_frequency(EFFECTS["stribeck"], "s")
    grid = {p.shapes["ambient.W"] for p in trials_of(EFFECTS.select(["ambient"]), [3.0, 11.0], W)}
    assert grid == {3.0, 11.0}
    resonances = [(f.symbol, name) for f in EFFECTS for name in f.shape if is_resonance(f, name)]
    assert resonances == [("resonator", "k")]
    grid = {p.shapes["resonator.k"] for p in trials_of(EFFECTS.select(["resonator"]), [11.0], 10.0)}
    assert 1.1 in grid
    assert len(grid) > 1


@pytest.mark.parametrize("tests", [1, 5, 40])
def test_independent_tests_are_counted(tests):
    """Of each five that are the same one counts."""
    correlation = np.kron(np.eye(tests), np.ones((5, 5)))
    assert independent_tests(correlation) == pytest.approx(tests, rel=0.35, abs=0.5)


def test_candidates_and_the_omnibus_test_share_the_level():
    """So that a record with nothing hidden is blamed no more often than the level says."""
    found = screen(start_model([with_effect({}, seed=4)]), [EVERY["bias"]])
    assert found.tests == pytest.approx(2.0)
    assert corrected(0.01 / 8.0) == pytest.approx(0.01)


@pytest.mark.in_full
def test_the_omnibus_test_keeps_its_level_on_short_records():
    """Thirty columns beside ninety rows explain more of noise than a chi-square."""
    time = np.arange(267) / 50.0
    before, p_values = exact(model_of({"zeta": 0.01}), time), []
    for seed in range(40):
        model = start_model([decay(time, before, seed)], library("zeta"))
        p_values.append(screen(model, [EVERY["quintic"]]).omnibus.p_value)
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
        generic.append(screening.omnibus.p_value)
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
    assert verdict(found) == "explained"
    assert symbol in credible_set(found, found.effects[0])
    assert found.models[0].deviance > found.models[-1].deviance + 20.0
    if found.effects == (symbol,):
        assert abs(deviations(found.models[-1], {symbol: coefficient})[0]) < 4.0


def test_nothing_is_missing_from_the_truth():
    found = searched([with_effect({}, seed=5)])
    assert found.effects == ()
    assert verdict(found) == "nothing missing"
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
        assert verdict(found) == "nothing missing"
        assert found.models[0].likelihood.gains[0] > 20.0


def test_the_right_name_makes_the_random_force_vanish():
    found = searched([with_effect({"cubic_damping": 0.2}, seed=4)], FEW)
    assert found.effects == ("cubic_damping",)
    gains = [model.likelihood.gains[0] for model in found.models]
    assert gains[0] > 20.0
    assert gains[1] < 6.0


def test_an_effect_that_no_candidate_mimics_is_unknown():
    few = EFFECTS.select(["van_der_pol", "quintic", "stiffness_drift"])
    found = searched([with_effect({"even_spring": 1e-2}, seed=6)], few)
    assert verdict(found) == "unknown effect"


def test_several_runs_name_together():
    runs = [with_effect({"cubic_damping": 0.1}, seed=seed, start=a) for seed, a in enumerate((0.3, 0.2))]
    found = searched(runs, FEW)
    assert found.effects == ("cubic_damping",)
    assert abs(deviations(found.models[-1], {"cubic_damping": 0.1})[0]) < 4.0
    assert verdict(found) == "explained"


def with_two(seed=8):
    return with_effect({"cubic_damping": 0.2, "even_spring": 1e-2}, seed=seed)


def test_two_missing_effects_are_both_named():
    found = searched([with_two()], FEW)
    assert set(found.effects) == {"cubic_damping", "even_spring"}
    assert verdict(found) == "explained"
    # In the order of what each explains; each model is likelier than the one before.
    deviance = [model.deviance for model in found.models]
    assert deviance[0] - deviance[1] > deviance[1] - deviance[2] > 0.0


@pytest.mark.slow
def test_the_papers_own_elastic_forces_are_both_named():
    """Without its two elastic forces, a third that mimics both is no answer."""
    candidates = replace(EFFECTS, forces=(*CONTACT.select(["alpha", "nu", "epsilon"]), *EFFECTS))
    found = searched([RUN.decay(7)], candidates, CONTACT.select(["lambda", "zeta", "delta"]))
    assert len(found.effects) == 2
    assert credible_set(found, "nu") == {"nu"}
    other = next(symbol for symbol in found.effects if symbol != "nu")
    # Gravity and a magnet are cubic, too, at this amplitude.
    assert "epsilon" in credible_set(found, other)


@pytest.mark.in_full
def test_effects_that_imitate_one_of_no_library_are_not_believed():
    """Quintic and detent forces together imitate the missing x*abs(x)."""
    few = EFFECTS.select(["quintic", "detent", "magnet", "cubic_damping"])
    found = searched([RUN.decay(2)], few, CONTACT.select(["lambda", "zeta", "delta"]))
    assert verdict(found) == "unknown effect"


def wrong_model(run, *symbols, forces=BASE):
    """The start model with effects whether they are there or not: (model, fits)."""
    fits = Fits(start_model([run], forces))
    trials = [TrialEffect(EVERY[symbol], {}) for symbol in symbols]
    return fits.of(fits.start, (), trials), fits


def test_two_wrong_effects_are_exchanged_for_the_right_pair():
    effects = ("inertia", "bias")
    model, fits = wrong_model(with_two(), *effects)
    for _ in range(4):
        current = screen(model, [force for force in FEW if force.symbol not in effects])
        step = exchange_effects(current, effects, fits)
        if step is None:
            break
        effects, model = step.effects, step.model
    assert set(effects) == {"cubic_damping", "even_spring"}
    assert step is None


def test_a_resonance_beside_the_line_of_the_swing_is_looked_for():
    """It makes no line of its own, and an ambient vibration gains a third of what it does."""
    run = with_effect(
        {"resonator": 8e-3}, seed=2, base={"zeta": 4e-3}, shapes={"resonator.k": 0.93, "resonator.d": 0.02}
    )
    screened = screen(start_model([run], library("zeta")), EFFECTS.forces)
    first, second = screened.best()[:2]
    assert screened.trials[first].force.symbol == "resonator"
    assert screened.gains[first] > 2.0 * screened.gains[second]


def test_chance_is_in_the_place_of_a_weak_effect_and_not_of_a_strong_one():
    """A random force takes the blame for what is weak."""
    costs = []
    for coefficient in (4e-3, 2e-2):
        run = with_effect({"cubic_damping": coefficient}, seed=1)
        model, fits = wrong_model(run, "cubic_damping")
        current = screen(model, [EVERY["bias"]])
        rivals = rivals_of(current, ("cubic_damping",), "cubic_damping", fits)
        # Far from every credible set it is not fitted at all.
        costs.append(rivals.get("", np.inf))
    assert costs[0] < costs[1]


def test_names_that_were_not_compared_explain_nothing():
    """Both are right, and nothing is left; but what else may stand in their place was not fitted."""
    tree = discover(with_two(), BASE, FEW, settings=Settings(most_fits=3))
    assert set(tree["steps"].symbol.values) == {"cubic_damping", "even_spring"}
    assert tree.attrs["verdict"] == "unknown effect"
    headline, ended, *_ = verdict_sentences(tree)
    assert headline.endswith(
        "0.947 times the noise, but not all that may stand in their place were compared."
    )
    assert "after as many fits as its settings allow" in ended


def test_a_search_ends_at_its_time_limit():
    run = with_two()
    tree = discover(run, BASE, FEW, time_limit=1e-3)
    assert tree.attrs["out_of_time"] == "0.001 s"
    assert tree.attrs["converged"] == "False"
    assert tree.attrs["verdict"] == "unknown effect"
    assert tree["steps"].attrs["count"] == 0
    told = " ".join(verdict_sentences(tree))
    assert "ended at its time limit of 0.001 s" in told
    with pytest.raises(UsageError, match="time limit of 0 s"):
        discover(run, BASE, FEW, time_limit=0.0)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"level": 2.0}, "level of 2 "),
        ({"level": -3.0}, "level of -3 "),
        ({"max_effects": -1}, "most -1 effects"),
    ],
)
def test_a_search_that_cannot_be_is_refused(given, told):
    with pytest.raises(UsageError, match=told):
        discover(with_effect({}, seed=1), BASE, FEW, **given)


def test_shapes_are_told_with_their_errors():
    """One at an end of its range has none that the record tells."""
    shapes = {"power_damping.p": 1.7}
    run = with_effect({"power_damping": 0.02}, seed=2, base={"zeta": 4e-3}, shapes=shapes)
    tree = discover(run, library("zeta"), EFFECTS.select(["power_damping"]))
    step = tree["steps"].to_dataset().isel(step=0)
    (error,) = shapes_of(step, "power_damping", "shape_standard_error").values()
    (value,) = shapes_of(step, "power_damping").values()
    assert abs(value - 1.7) < 4.0 * error
    assert value_with_error(value, error) in formula_text(step)
    step["shape_standard_error"] = 0.0 * step.shape_standard_error
    assert formula_text(step).endswith(f"p = {value:.3g} (end of its range)")
    step["shape_standard_error"] = np.nan * step.shape_standard_error
    assert formula_text(step).endswith(f"p = {value:.5g} ± ?")


def test_settings_are_few_documented_and_stored():
    page = (Path(__file__).parents[1] / "docs" / "discovery.md").read_text()
    for row in Settings.table():
        assert f"| `{row[0]}` | {' | '.join(row[1:])} |" in page
    assert len(Settings.table()) <= 25
    given = Settings(slack=0.2)
    tree = discover(with_effect({}, seed=1), BASE, FEW, max_effects=0, settings=given)
    assert json.loads(tree.attrs["settings"]) == asdict(replace(given, max_effects=0))


def test_a_force_that_only_takes_energy_never_drives():
    few = EFFECTS.select(["structural_damping", "bias"])
    run = with_effect({"structural_damping": -5e-3}, seed=3)
    held, free = searched([run], few), searched([run], active(few))
    assert held.effects == ()
    assert verdict(held) == "unknown effect"
    assert free.effects == ("structural_damping",)
    taking = searched([with_effect({"structural_damping": 5e-3}, seed=3)], few)
    assert taking.effects == ("structural_damping",)
    assert coefficients_of(taking.models[-1])["structural_damping"] > 0.0


def test_a_candidate_that_cannot_be_followed_has_a_reason():
    wild, tame = library_of_formulas(wild="sqrt(2.25 - x**2)*x", tame="x**7")
    run = with_effect({}, seed=1, base={"zeta": 0.01}, start=2.0)
    screening = screen(start_model([run], library("zeta")), [wild, tame])
    assert "not finite" in screening.reasons[0]
    assert screening.reasons[1] == ""
    assert screening.gains[0] == 0.0


def test_a_candidate_whose_squares_overflow_has_a_reason():
    tame = library_of_formulas(tame="x**7").forces[0]
    # What a library refuses may still come of a number that its check does not meet.
    wild = replace(tame, symbol="wild", formula=parse("1e99*1e99*x**3", frozenset("x"), frozenset(), "test"))
    screening = screen(start_model([with_effect({}, seed=1)], library("zeta")), [wild, tame])
    assert "not finite" in screening.reasons[0]
    assert (screening.reasons[1], screening.gains[0]) == ("", 0.0)


def learned(run, *symbols):
    """Models of the first two thirds without and with effects, and the rest."""
    first, rest = split(run)
    bare = start_model([first])
    return bare, start_model([first], library(*FIVE, *symbols)), rest


def test_the_time_of_a_drift_counts_from_the_records_start():
    run = with_effect({"damping_drift": 1e-3}, seed=2)
    bare, drifting, rest = learned(run, "damping_drift")
    beginnings = float(run.time[0]), float(rest.time[0])
    whole, late = (predicted(drifting, [rest], [None], [begin], [0], W) for begin in beginnings)
    without = predicted(bare, [rest], [None], [beginnings[0]], [0], W)
    assert better_by(whole, without) > 2.0
    assert better_by(whole, late) > 2.0


def test_an_effect_that_ends_is_refuted_by_what_follows():
    """Friction that grows for two thirds of the record and then is what it was on the mean."""
    ends, drift = round(2.0 / 3.0 * len(TIME)), 5e-4
    growing = model_of(FIVE | {"damping_drift": drift})
    steady = model_of(FIVE | {"zeta": FIVE["zeta"] + 0.25 * drift * TIME[ends]})
    before = trajectory(growing, TIME[: ends + 1], 0.3, 0.0)
    after = trajectory(steady, TIME[ends:], float(before.position[-1]), float(before.rate[-1]))
    run = decay(TIME, np.append(before.angle[:-1], after.angle), seed=1)
    bare, drifting, rest = learned(run, "damping_drift")
    assert bare.deviance - drifting.deviance > 30.0
    scores = [predicted(model, [rest], [None], [0.0], [0], W) for model in (bare, drifting)]
    assert better_by(scores[1], scores[0]) < -DEFAULTS.refuted


def test_what_rings_on_is_predicted_from_what_came_before():
    """Whoever begins anew at what is held out takes a resonator that rings for one at rest."""
    state = {"z": "u", "u": "-x - 3.61*z - 0.002*u"}
    (ring,) = parse_library({"force": [{"symbol": "ring", "formula": "z", "state": state}]}, "test")
    forces = ForceLibrary("of a test", (*library(*FIVE), ring))
    run = decay(TIME, exact(Model(forces, {**FIVE, "ring": 2e-3}, W)), seed=5)
    first, rest = split(run)
    bare, ringing = start_model([first]), start_model([first], forces)
    assert bare.deviance - ringing.deviance > 100.0
    before = [up_to_held_out(run)]
    without, whole = (predicted(model, [rest], before, [0.0], [0], W) for model in (bare, ringing))
    anew = predicted(ringing, [rest], [None], [0.0], [0], W)
    assert better_by(whole, without) > 2.0
    assert better_by(whole, anew) > 2.0
    assert whole.rms < 1.2 * NOISE < anew.rms


@pytest.mark.slow
def test_discover_is_blind_to_the_last_third_unless_asked():
    run = with_effect({"even_spring": 1e-2}, seed=4)
    blind, again = (discover(run, BASE, FEW, refit=refit) for refit in (False, True))
    assert blind["record"].sizes["time"] == split(run)[0].sizes["time"]
    assert again["record"].sizes["time"] == run.sizes["time"]
    for tree in (blind, again):
        assert tree.attrs["verdict"] == "explained"
        assert tree.attrs["converged"] == "True"
        assert tree["steps"].symbol.values.tolist() == ["even_spring"]
        assert tree["steps"].prediction_z.item() > -DEFAULTS.refuted
        assert not tree["steps"].worsens_holdout.item()
        assert tree["steps"].gain.item() > 50.0
        assert tree["steps"].random_force_after.item() <= tree["steps"].random_force_before.item()
        assert tree["steps"].chance_probability.item() == 0.0
        step = tree["steps"].to_dataset()
        assert step.whitened_residual_after.item() < step.whitened_residual_before.item()
        assert np.diff(tree["holdout"].log_score.values) > 0.0
    # More samples, smaller errors.
    errors = [tree["steps"].standard_error.item() for tree in (blind, again)]
    assert errors[1] < errors[0]


def test_thinning_keeps_the_motion_and_white_noise():
    fine = paper_run(FIVE, sampling_rate=1000.0)
    exact_few = decimated(decay(fine.time, fine.angle))
    assert exact_few.sizes["time"] == pytest.approx(25.0 * W / (2.0 * np.pi) * 60.0, rel=0.1)
    whole = decay(fine.time, fine.angle).assign(equilibrium=0.1)
    assert decimated(whole).equilibrium.item() == 0.1
    assert "time" not in decimated(whole).equilibrium.dims
    at = np.searchsorted(fine.time, exact_few.time.values - 1e-9)
    assert np.max(np.abs(exact_few.angle.values - fine.angle[at])) < 3e-7
    gap = decimated(fine.decay(1)).angle.values - exact_few.angle.values
    each = fine.time.size / exact_few.sizes["time"]
    assert rms(gap).item() == pytest.approx(NOISE * np.sqrt(9.0 / 4.0 / each), rel=0.1)
    assert abs(np.corrcoef(gap[1:], gap[:-1])[0, 1]) < 4.0 / np.sqrt(len(gap))


def test_a_record_with_few_samples_a_period_is_not_decimated():
    run = RUN.decay(1)
    assert decimated(run) is run
