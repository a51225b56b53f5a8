"""Averaging (Le Bot et al. 2019, Sec. 2.3): the paper's rule with its faults, and what removes them."""

from functools import cache

import numpy as np
import pytest
from helpers import (
    FIVE,
    SIX,
    Run,
    W,
    decay,
    library_of_formulas,
    over_seeds,
    paper_run,
    rms,
    rms_range,
    values,
)

from sysid_trib import Model, load_library
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.methods import Averaging
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


def test_alpha_varies_with_the_others_as_over_seeds():
    run, exact, found = paper_run(FIVE), paper_run(FIVE).angle, []
    for seed in range(SEEDS):
        result = Averaging(correct=False).identify(decay(run.time, exact, seed), FORCES)
        found.append(with_contactless_frequency(result, 8.87))
    drawn = np.corrcoef(np.array([r.coefficient.values for r in found]).T)
    error = found[0].standard_error.values
    told = found[0].covariance.values / np.outer(error, error)
    alpha = list(FORCES.symbols).index("alpha")
    for other in ("nu", "epsilon"):
        at = list(FORCES.symbols).index(other)
        # Fisher's z has a standard deviation of 1/sqrt(n - 3).
        gap = np.arctanh(drawn[alpha, at]) - np.arctanh(told[alpha, at])
        assert abs(gap) < 4.0 / np.sqrt(SEEDS - 3)


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


def test_weights_pay():
    decay = paper_run(FIVE).decay(0)
    plain = Averaging(weighted=False).identify(decay, FORCES)
    assert np.all(plain.standard_error.values > 1.5 * np.array(noisy_standard_errors()))


def test_errors_shrink_with_the_noise():
    # Averaging to first order leaves more than this noise, but so does the simulation it is held against.
    quiet = Averaging().identify(paper_run(FIVE).decay(0, noise=1e-6), FORCES)
    ratio = quiet.standard_error.values / np.array(noisy_standard_errors())
    assert np.all((ratio > 0.009) & (ratio < 0.03))
    assert np.all(np.abs(values(quiet, FIVE) - list(FIVE.values())) < 5.0 * quiet.standard_error.values)


def test_a_force_with_both_signatures_is_one_unknown():
    library = library_of_formulas(zeta="2*v", tilted="x*abs(x) + v*abs(v)")
    run = Run(Model(library, {"zeta": 0.005, "tilted": 0.05}, W), paper_run().time)
    result = Averaging().identify(run.decay(), library)
    np.testing.assert_allclose(result.coefficient.values, [0.005, 0.05], rtol=2e-3)
    assert result.reference_frequency.item() == pytest.approx(W, rel=1e-5)


def test_constraints_are_linear_maps_of_the_columns():
    record = paper_run(SIX).decay(0)
    plain = Averaging(reference_frequency=W).identify(record, FORCES)
    value = plain.coefficient.sel(force="zeta").item()
    found = Averaging(reference_frequency=W, constraints={"zeta": value}).identify(record, FORCES)
    assert found.coefficient.sel(force="zeta").item() == value
    assert found.standard_error.sel(force="zeta").item() == 0.0
    others = found.force != "zeta"
    gaps = (found.coefficient - plain.coefficient) / plain.standard_error
    assert float(np.abs(gaps).max()) < 0.01
    assert np.all((found.standard_error < plain.standard_error * (1.0 + 1e-6))[others])


def test_a_tie_agrees_with_a_library_of_the_tied_forces():
    record = paper_run(SIX).decay(0)
    found = Averaging(constraints={"nu": "-2.356*delta"}).identify(record, FORCES)
    value, error = (found[k].sel(force=["delta", "nu"]).values for k in ("coefficient", "standard_error"))
    assert value[1] == pytest.approx(-2.356 * value[0], rel=1e-12)
    assert error[1] == pytest.approx(2.356 * error[0])
    assert found.constraint.sel(force="nu").item() == "nu=-2.356*delta"
    others = {s: FORCES[s].formula.text for s in FORCES.symbols if s not in ("nu", "delta", "alpha")}
    both = f"{FORCES['delta'].formula.text} - 2.356*({FORCES['nu'].formula.text})"
    same = Averaging().identify(record, library_of_formulas(**others, both=both))
    for symbol, name in [*((s, s) for s in others), ("delta", "both")]:
        expected, scale = (same[k].sel(force=name).item() for k in ("coefficient", "standard_error"))
        assert found.coefficient.sel(force=symbol).item() == pytest.approx(expected, abs=1e-3 * scale)
        assert found.standard_error.sel(force=symbol).item() == pytest.approx(scale, rel=1e-3)


def test_a_bound_that_stops_a_coefficient_holds_it():
    record = paper_run(SIX).decay(0)
    found = Averaging(reference_frequency=W, constraints={"zeta": (0.01, np.inf)}).identify(record, FORCES)
    zeta = found.sel(force="zeta")
    assert (zeta.coefficient.item(), zeta.standard_error.item()) == (0.01, 0.0)
    assert zeta.constraint.item() == "at its bound"
