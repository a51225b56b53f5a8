"""Averaging (Le Bot et al. 2019, Sec. 2.3): the paper's rule, what mends it, and a random force."""

from functools import cache

import numpy as np
import pytest
import xarray as xr
from helpers import (
    FIVE,
    SIX,
    Run,
    W,
    library_of_formulas,
    over_seeds,
    paper_run,
    rms,
    rms_range,
    values,
)

import sysid_trib as st
from sysid_trib import Model, load_library
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.likelihood.random_force import RandomForce, random_force_of
from sysid_trib.methods import Averaging, EnergyDecay, FeenyLiang, FrequencyShift, WuDecrement
from sysid_trib.motion_fit.cramer_rao import cramer_rao_bound
from sysid_trib.results.references import with_contactless_frequency

FORCES = load_library()
SEEDS = 20


@cache
def noisy_standard_errors() -> tuple[float, ...]:
    """The errors that the coefficients have at a noise of 1e-4 rad."""
    return tuple(Averaging().identify(paper_run(FIVE).decay(0), FORCES).standard_error.values)


def test_the_papers_rule_loses_the_sign_of_epsilon():
    result = Averaging(frequency="last", correct=False).identify(paper_run(FIVE).decay(), FORCES)
    nu, epsilon = values(result, {"nu": 0, "epsilon": 0})
    assert (round(nu, 2), round(epsilon, 2)) == (-0.25, -0.31)
    assert result.asymptotic_frequency.item() == pytest.approx(9.875, abs=1e-3)


def test_a_fitted_frequency_keeps_it_but_for_the_first_order_bias():
    result = Averaging(correct=False, weighted=False).identify(paper_run(FIVE).decay(), FORCES)
    nu, epsilon = values(result, {"nu": 0, "epsilon": 0})
    assert (round(nu, 3), round(epsilon, 3)) == (-0.402, 0.280)
    assert result.asymptotic_frequency.item() == pytest.approx(9.9098, abs=1e-4)
    assert result.attrs["first_order_bias_removed"] == "no"


@pytest.mark.parametrize("strength", [0.0, 5e-4])
def test_correction_removes_the_bias(strength):
    truth = FIVE | {"lambda": FIVE["lambda"] + strength}
    run = paper_run(truth, duration=25.0 if strength == 0.0 else 16.0)
    result = Averaging().identify(run.decay(), FORCES)
    assert result.attrs["first_order_bias_removed"] == "yes"
    gap = values(result, truth) - list(truth.values())
    assert np.all(np.abs(gap) < 0.5 * np.array(noisy_standard_errors()))
    plain = Averaging(correct=False).identify(run.decay(), FORCES)
    np.testing.assert_allclose(
        values(plain, truth) - result.first_order_bias.values, values(result, truth), rtol=1e-9
    )


@pytest.mark.parametrize("case", ["fitted", "given"])
@pytest.mark.in_full
def test_standard_errors_tell_the_scatter(case):
    run = paper_run(FIVE if case == "fitted" else SIX)
    method = Averaging(reference_frequency=None if case == "fitted" else W)
    errors, reported = over_seeds(run, lambda d: method.identify(d, FORCES), SEEDS)
    low, high = rms_range(SEEDS)
    pulls = rms(errors / reported)
    assert np.all((pulls > low) & (pulls < high))
    bound = cramer_rao_bound(run.model, run.time, run.start, 0.0, 1e-4, free=case == "fitted")
    assert np.all(rms(errors) / bound.standard_error.values < 1.25 * high)


def test_alpha_is_an_unknown_where_the_frequency_is_given():
    truth = SIX | {"alpha": 0.1}
    result = Averaging(reference_frequency=W).identify(paper_run(truth).decay(), FORCES)
    # Measured against the error at noise 1e-4: the correction stops at a thousandth of the record's own.
    np.testing.assert_allclose(values(result, FIVE), list(FIVE.values()), rtol=2e-2, atol=2e-7)
    assert result.coefficient.sel(force="alpha").item() == pytest.approx(0.1, abs=2e-5)
    assert result.reference_frequency_standard_error.item() == 0.0


def test_contactless_frequency_gives_alpha_and_its_error():
    result = Averaging().identify(paper_run(FIVE).decay(1), FORCES)
    omega0, error = 8.87, 0.02
    found = with_contactless_frequency(result, omega0, error)
    assert found.force.values.tolist() == list(FORCES.symbols)
    alpha = found.sel(force="alpha")
    limit = result.asymptotic_frequency.item()
    assert alpha.coefficient.item() == pytest.approx((limit / omega0) ** 2 - 1.0, rel=1e-12)
    assert alpha.refers_to.item() == omega0
    assert found.sel(force="nu").refers_to.item() == result.reference_frequency.item()
    np.testing.assert_array_equal(values(found, FIVE), values(result, FIVE))
    random = np.random.default_rng(0)
    limits = limit + result.asymptotic_frequency_standard_error.item() * random.standard_normal(40_000)
    drawn = (limits / (omega0 + error * random.standard_normal(40_000))) ** 2 - 1.0
    assert alpha.standard_error.item() == pytest.approx(np.std(drawn), rel=0.02)
    np.testing.assert_allclose(found.covariance.values, found.covariance.values.T, rtol=1e-9)
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), found.standard_error, rtol=1e-9)


def test_contactless_frequency_needs_a_force_of_formula_x():
    other = library_of_formulas(zeta="2*v", delta="v*abs(v)")
    result = Averaging(correct=False).identify(paper_run(FIVE).decay(1), other)
    with pytest.raises(UsageError, match="no force of formula x"):
        with_contactless_frequency(result, 8.87)


def test_forces_of_one_signature_are_refused_by_name():
    library = library_of_formulas(zeta="2*v", delta="v*abs(v)", positional="x**2*sign(v)")
    with pytest.raises(DecayError, match="cannot tell apart delta and positional"):
        Averaging().identify(paper_run(FIVE).decay(0), library)


def test_a_force_without_signature_is_refused_by_name():
    library = library_of_formulas(zeta="2*v", even="x**2")
    with pytest.raises(DecayError, match="even has no signature"):
        Averaging().identify(paper_run(FIVE).decay(0), library)


def test_too_few_half_periods_are_refused():
    run = paper_run(FIVE)
    short = Run(run.model, run.time[:140])
    with pytest.raises(DecayError, match="cannot decide 5 forces"):
        Averaging().identify(short.decay(0), FORCES)


def test_unknown_rule_is_refused():
    with pytest.raises(UsageError, match="neither 'fit' nor 'last'"):
        Averaging(frequency="first")


def test_a_force_with_both_signatures_is_one_unknown():
    library = library_of_formulas(zeta="2*v", tilted="x*abs(x) + v*abs(v)")
    run = Run(Model(library, {"zeta": 0.005, "tilted": 0.05}, W), paper_run().time)
    result = Averaging().identify(run.decay(), library)
    np.testing.assert_allclose(result.coefficient.values, [0.005, 0.05], rtol=2e-3)
    assert result.reference_frequency.item() == pytest.approx(W, rel=1e-5)


NOISE = 2e-4
TIME = np.arange(1200) * 2.0 * np.pi / W / 60
LIBRARY = library_of_formulas(zeta="2*v", delta="v*abs(v)")
TRUTH = {"zeta": 2e-3, "delta": 2e-2}
# Five noise levels of wander at the end.
DENSITY = RandomForce.density_of(2.0 * (5.0 * NOISE) ** 2 / (W * TIME[-1]), W)


def pushed_decay(density, seed, truth=TRUTH):
    model = st.Model(LIBRARY, truth, W)
    angle = st.simulate(model, TIME, angle=0.3, random_force=density, seed=seed).angle
    return xr.Dataset({"angle": angle + NOISE * np.random.default_rng(seed).standard_normal(len(TIME))})


@pytest.mark.slow
def test_averaging_tells_the_two_noises_apart():
    scores, ratios = [], []
    for seed in range(4):
        record = pushed_decay(DENSITY, seed)
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
            Averaging(random_force=option).identify(pushed_decay(0.0, seed), LIBRARY)
            for option in ("off", "estimated")
        )
        if force := random_force_of(auto):
            assert force.p_value > 0.01
            assert np.abs((auto.coefficient - plain.coefficient) / plain.standard_error).max() < 0.5
        else:
            absent += 1
            xr.testing.assert_identical(auto.drop_attrs(deep=False), plain.drop_attrs(deep=False))
    assert absent


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
