"""The parts of the discrepancy workflow: responses, noise without a model, scores, twins, the search."""

from dataclasses import replace

import numpy as np
import pytest
from helpers import (
    FIVE,
    NOISE,
    W,
    correlated_noise,
    decay,
    library_of_formulas,
    paper_run,
    rms,
    rms_range,
    share_range,
)

from sysid_trib import ForceLibrary, Model, cramer_rao_bound, load_library
from sysid_trib.discrepancy import candidate_fits
from sysid_trib.discrepancy.baseline import fit, fit_records
from sysid_trib.discrepancy.candidate_sensitivities import (
    ReferenceMotion,
    TrialCandidate,
    moved_by,
    trials_of,
)
from sysid_trib.discrepancy.competing_models import tie_class
from sysid_trib.discrepancy.decimation import decimated
from sysid_trib.discrepancy.frequency_parameters import has_frequency_parameter, is_frequency, is_resonance
from sysid_trib.discrepancy.homogeneity_test import homogeneity
from sysid_trib.discrepancy.omnibus_test import omnibus
from sysid_trib.discrepancy.score_tests import scores
from sysid_trib.discrepancy.stepwise_search import first_baseline, search, verdict_of
from sysid_trib.errors import SimulationError
from sysid_trib.forces.formulas import parse
from sysid_trib.noise.autoregression import fractional_difference, whitened
from sysid_trib.noise.residual_noise import NoiseModel, estimate_noise, modulated_harmonics
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.trajectory_fit.parameters import Parameters
from sysid_trib.trajectory_fit.problem import FitProblem
from sysid_trib.trajectory_fit.sensitivities import tangent

CONTACT, EFFECTS = load_library(), load_library("candidate_effects")
RUN = paper_run(FIVE)
BASE = CONTACT.select(FIVE)
TRUTH = np.array([*FIVE.values(), W, 0.3, 0.0, 0.0])
# Narrower than a cell of the motion, or singular there: no derivative to hold them against.
SINGULAR = {"stribeck", "stribeck_exponential"}


def course(coefficients=FIVE):
    model = Model(CONTACT, coefficients, W)
    return ReferenceMotion(model, (0.3, 0.0), RUN.time, tangent(model, RUN.time, 0.3, 0.0))


def with_effect(symbol, coefficient, shapes=None):
    """The paper's run with one effect more."""
    library = ForceLibrary("with an effect", (*BASE.forces, EFFECTS[symbol]))
    model = Model(library, FIVE | {symbol: coefficient}, W, shapes or {})
    return trajectory(model, RUN.time, 0.3, 0.0).angle


@pytest.mark.parametrize("solid", [-2.3e-5, 3e-4])
def test_responses_are_derivatives_of_the_motion(solid):
    base = FIVE | {"lambda": solid}
    trials = [TrialCandidate(f, {f"{f.symbol}.{k}": v for k, v in f.shape_values().items()}) for f in EFFECTS]
    moved = moved_by(course(base), trials)
    for at, trial in enumerate(trials):
        symbol = trial.force.symbol
        if symbol in SINGULAR or moved.reasons[at]:
            continue
        found = moved.angle[:, at]
        step = 1e-6 / max(rms(found).item(), 1e-12)
        library = ForceLibrary("with one", (*CONTACT.forces, trial.force))
        ends = [
            trajectory(Model(library, base | {symbol: s * step}, W, trial.shapes), RUN.time, 0.3, 0.0).angle
            for s in (1.0, -1.0)
        ]
        true = (ends[0] - ends[1]) / (2.0 * step)
        # The net effect of a friction that changes sides is a difference of large parts.
        limit = 0.05 if symbol == "tilted_friction" else 0.01
        assert np.linalg.norm(found - true) < limit * np.linalg.norm(true), symbol


def test_what_is_not_finite_has_a_reason():
    wild, tame = library_of_formulas(wild="x", tame="x**7")
    # A library with such a formula is not read; where it is finite at first, it may not stay so.
    wild = replace(wild, formula=parse("exp(30*t)*x", frozenset("xvt"), frozenset(), "test"))
    moved = moved_by(course(), [TrialCandidate(force, {}) for force in (wild, tame)])
    assert "not finite" in moved.reasons[0]
    assert moved.reasons[1] == ""
    assert np.all(moved.angle[:, 0] == 0.0)


def test_a_frequency_is_known_by_its_formula():
    assert is_frequency(EFFECTS["ambient"], "W")
    assert not is_frequency(EFFECTS["ambient"], "p")
    assert not is_frequency(EFFECTS["stribeck"], "s")
    grid = {p.shapes["ambient.W"] for p in trials_of(EFFECTS.select(["ambient"]), [3.0, 11.0])}
    assert grid == {3.0, 11.0}
    resonances = [(f.symbol, name) for f in EFFECTS for name in f.shape if is_resonance(f, name)]
    assert resonances == [("resonator", "k")]
    grid = {p.shapes["resonator.k"] for p in trials_of(EFFECTS.select(["resonator"]), [11.0], 10.0)}
    assert 1.1 in grid
    assert len(grid) > 1


@pytest.mark.parametrize(("correlation", "order"), [(0.0, 0), (0.6, 1)])
def test_noise_is_found_without_a_model(correlation, order):
    levels, orders = [], []
    for seed in range(12):
        added = correlated_noise(len(RUN.time), seed, correlation)
        run = decay(RUN.time, RUN.angle + added)
        # A wrong model leaves an oscillation a thousand times the noise.
        wrong = 0.1 * RUN.angle * np.cos(0.2 * RUN.time)
        found = estimate_noise(added + wrong, modulated_harmonics(run))
        levels.append(found.innovation / (NOISE * np.sqrt(1.0 - correlation**2)))
        orders.append(len(found.filter_) - 1)
    assert np.mean(levels) == pytest.approx(1.0, abs=0.02)
    assert np.median(orders) == order


def pink_noise(count, seed):
    """Noise of unit standard deviation whose spectrum falls as 1/f."""
    spectrum = np.fft.rfft(np.random.default_rng(seed).standard_normal(2 * count))
    spectrum[1:] /= np.sqrt(np.arange(1, len(spectrum)))
    values = np.fft.irfft(spectrum)[:count]
    return (values - values.mean()) / values.std()


@pytest.mark.parametrize("filter_", [[1.0], [1.0, -0.8], fractional_difference(0.5, 2000), [1.0, -1.0]])
def test_drawn_noise_is_whitened_by_its_filter(filter_):
    drawn = NoiseModel(0.01, np.asarray(filter_)).draws(2000, 20)
    assert drawn.shape == (20, 2000)
    assert abs(drawn.mean()) < 1e-12
    # The first samples of a long filter have no past; its end would see the beginning again.
    white = whitened(drawn.T, np.asarray(filter_))[500:]
    low, high = rms_range(white.size)
    assert low < rms(white.ravel()) / 0.01 < high
    neighbours = np.mean(white[1:] * white[:-1]) / np.mean(white**2)
    assert abs(neighbours) < 5.0 / np.sqrt(white.size)


def test_noise_that_rises_to_low_frequencies_is_whitened_there_too():
    """Slow effects live below the swing's frequency, where an autoregression of short memory sees little."""
    basis, low = modulated_harmonics(RUN.decay(0)), []
    for seed in range(12):
        added = NOISE * pink_noise(len(RUN.time), seed)
        found = estimate_noise(added, basis)
        white = whitened(added, found.filter_) / found.innovation
        power = np.abs(np.fft.rfft(white)) ** 2 / len(white)
        # The swing has some forty periods: lines far below it, and the mean of all.
        low.append(np.mean(power[1:12]))
        assert np.mean(power[12:]) == pytest.approx(1.0, abs=0.1)
    # 132 lines of an exponential distribution; without the power law they have 3 to 8.
    assert np.mean(low) == pytest.approx(1.0, abs=0.4)


def test_a_line_of_vibration_is_no_noise():
    quiet = correlated_noise(len(RUN.time), 1, 0.0)
    line = 3.0 * NOISE * np.sin(5.7 * RUN.time)
    basis = modulated_harmonics(RUN.decay(1))
    assert estimate_noise(quiet + line, basis).standard_deviation == pytest.approx(
        estimate_noise(quiet, basis).standard_deviation, rel=0.03
    )


def true_baseline(seed):
    problem = FitProblem(Parameters(BASE), fit_records([RUN.decay(seed)]))
    return fit(problem, TRUTH, [NoiseModel(NOISE, np.ones(1))])


def test_errors_of_a_baseline_are_the_bound():
    found = true_baseline(1)
    bound = cramer_rao_bound(RUN.model, RUN.time, 0.3, 0.0, NOISE, free=True)
    mine = np.sqrt(np.diag(found.covariance))[: len(FIVE)]
    # The zero of the sensor is one unknown more.
    assert mine == pytest.approx(bound.standard_error.values, rel=0.02)


def test_runs_that_agree_differ_by_chance_alone():
    """What runs of their own explain of noise is a chi-square of as many degrees of freedom."""
    total, freedom = 0.0, 0
    for seed in range(8):
        problem = FitProblem(Parameters(BASE, runs=2), fit_records([RUN.decay(seed), RUN.decay(100 + seed)]))
        found = fit(problem, np.append(TRUTH, TRUTH[-3:]), [NoiseModel(NOISE, np.ones(1))] * 2)
        told = homogeneity([found], level=0.01)
        assert told.degrees_of_freedom.item() == len(FIVE) + 1
        total, freedom = total + told.chi_square.item(), freedom + told.degrees_of_freedom.item()
    low, high = rms_range(freedom)
    assert low**2 < total / freedom < high**2


@pytest.mark.slow
def test_scores_of_noise_are_noise():
    """Scores are standard normal, and the least p-value of all is below 0.05 in a twentieth of records."""
    seeds, z, least, generic = 20, [], [], []
    # A frequency is taken from the record's own spectrum: its score is the largest of many.
    candidates = EFFECTS.select(f.symbol for f in EFFECTS if not has_frequency_parameter(f))
    about = [course()]
    for seed in range(seeds):
        found = true_baseline(seed)
        scored = scores(found, candidates, about)
        good = np.array([not reason for reason in scored.reasons])
        z.append(scored.z[good])
        least.append(scored.p_values.min())
        generic.append(omnibus(found, about).p_value)
    low, high = rms_range(seeds)
    each = rms(np.array([values[: min(map(len, z))] for values in z]))
    assert np.all((each > low) & (each < high))
    allowed = share_range(seeds, 0.05)[1]
    assert np.mean(np.array(least) < 0.05) <= allowed
    assert np.mean(np.array(generic) < 0.05) <= allowed


@pytest.mark.parametrize(
    ("symbol", "coefficient"),
    [
        ("inertia", 0.34),
        pytest.param("van_der_pol", 0.13, marks=pytest.mark.slow),
        pytest.param("partial_slip", 0.12, marks=pytest.mark.slow),
        pytest.param("tilted_friction", 2.4e-3, marks=pytest.mark.slow),
    ],
)
def test_a_hidden_effect_is_named(symbol, coefficient):
    run = decay(RUN.time, with_effect(symbol, coefficient), seed=3)
    found = search([run], first_baseline([run], BASE, None), EFFECTS)
    assert verdict_of(found) == "explained"
    assert symbol in tie_class(found.final, found.added[0], found.ties[found.added[0]])
    at = found.final.problem.parameters.index(found.added[0])
    if found.added == (symbol,):
        error = float(np.sqrt(found.final.covariance[at, at]))
        assert abs(found.final.values[at] - coefficient) < 4.0 * error


def test_nothing_is_missing_from_the_truth():
    run = RUN.decay(5)
    found = search([run], first_baseline([run], BASE, None), EFFECTS)
    assert found.added == ()
    assert verdict_of(found) == "nothing missing"


def test_an_effect_that_no_candidate_mimics_is_unknown():
    run = decay(RUN.time, with_effect("even_spring", 5e-3), seed=6)
    few = EFFECTS.select(["van_der_pol", "quintic", "stiffness_drift"])
    found = search([run], first_baseline([run], BASE, None), few)
    assert verdict_of(found) == "unknown effect"


@pytest.mark.slow
def test_effects_that_imitate_one_of_no_library_are_not_believed():
    """Quintic and detent forces together imitate the missing x*abs(x)."""
    run = RUN.decay(2)
    start = first_baseline([run], CONTACT.select(["lambda", "zeta", "delta"]), None)
    found = search([run], start, EFFECTS.select(["quintic", "detent", "magnet", "cubic_damping"]))
    assert len(found.added) > 1
    assert verdict_of(found) == "unknown effect"


def test_a_candidate_without_a_fit_is_reported(monkeypatch):
    def refuse(problem, values, table):
        if "quintic" in problem.parameters.library.symbols:
            raise SimulationError("The motion diverges.")
        return unfailing(problem, values, table)

    unfailing = candidate_fits.chord
    monkeypatch.setattr(candidate_fits, "chord", refuse)
    run = decay(RUN.time, with_effect("quintic", 0.3), seed=3)
    few = EFFECTS.select(["quintic", "cubic_damping"])
    found = search([run], first_baseline([run], BASE, None), few)
    assert found.failed == ("quintic",)
    assert verdict_of(found) == "unknown effect"


@pytest.mark.slow
def test_two_missing_effects_are_both_named():
    """The paper's own: without its two elastic forces, a third that mimics both is no answer."""
    run = RUN.decay(7)
    start = CONTACT.select(["lambda", "zeta", "delta"])
    candidates = replace(EFFECTS, forces=(*CONTACT.select(["alpha", "nu", "epsilon"]), *EFFECTS))
    found = search([run], first_baseline([run], start, None), candidates)
    assert len(found.added) == 2
    assert tie_class(found.final, "nu", found.ties["nu"]).keys() == {"nu"}
    other = next(symbol for symbol in found.added if symbol != "nu")
    # Gravity and a magnet are cubic, too, at this amplitude.
    assert "epsilon" in tie_class(found.final, other, found.ties[other])


@pytest.mark.slow
def test_two_effects_that_one_flexible_force_mimics_are_both_named():
    library = ForceLibrary("with two", (*BASE.forces, *EFFECTS.select(["cubic_damping", "tilted_friction"])))
    model = Model(library, FIVE | {"cubic_damping": 0.08, "tilted_friction": 4e-3}, W)
    run = decay(RUN.time, trajectory(model, RUN.time, 0.3, 0.0).angle, seed=8)
    found = search([run], first_baseline([run], BASE, None), EFFECTS)
    assert set(found.added) == {"cubic_damping", "tilted_friction"}


def test_thinning_keeps_the_motion_and_white_noise():
    fine = paper_run(FIVE, sampling_rate=1000.0)
    exact = decimated(decay(fine.time, fine.angle))
    assert exact.sizes["time"] == pytest.approx(25.0 * W / (2.0 * np.pi) * 60.0, rel=0.1)
    whole = decay(fine.time, fine.angle).assign(equilibrium=0.1)
    assert decimated(whole).equilibrium.item() == 0.1
    assert "time" not in decimated(whole).equilibrium.dims
    at = np.searchsorted(fine.time, exact.time.values - 1e-9)
    assert np.max(np.abs(exact.angle.values - fine.angle[at])) < 3e-7
    gap = decimated(fine.decay(1)).angle.values - exact.angle.values
    each = fine.time.size / exact.sizes["time"]
    assert rms(gap).item() == pytest.approx(NOISE * np.sqrt(9.0 / 4.0 / each), rel=0.1)
    assert abs(np.corrcoef(gap[1:], gap[:-1])[0, 1]) < 4.0 / np.sqrt(len(gap))


def test_a_record_with_few_samples_a_period_is_not_decimated():
    run = RUN.decay(1)
    assert decimated(run) is run
