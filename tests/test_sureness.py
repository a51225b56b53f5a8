"""Uncertainty of coefficients: profile likelihoods, and other defensible fits."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import run as command
from helpers import FIVE, library_of_formulas, paper_run
from scipy.stats import norm

from sysid_trib import Model, identify, load, simulate
from sysid_trib.cycles.smooth_curve import simultaneous_factor
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces import ForceLibrary
from sysid_trib.methods import Direct
from sysid_trib.printing import Layer
from sysid_trib.printing.sureness import sureness_blocks
from sysid_trib.questions.profiles import free_likelihood
from sysid_trib.validation import curve_bands, log_likelihood, profile, sensitivity

RUN = paper_run(FIVE, duration=10.0)
LIBRARY = RUN.model.library


@pytest.fixture(scope="module")
def decay():
    return RUN.decay(1)


@pytest.fixture(scope="module")
def result(decay):
    return identify(decay, LIBRARY, Direct())


def test_a_profile_of_a_linear_parameter_is_the_parabola_of_its_error(decay, result):
    found = profile(decay, result, ["epsilon"]).isel(parameter=0)
    known = np.isfinite(found.value)
    parabola = ((found.value - found.estimate) / found.standard_error) ** 2
    assert found.deviance[known].values == pytest.approx(parabola[known].values, rel=0.05, abs=0.05)
    assert not found.asymmetric.item()
    assert found.low.item() == pytest.approx(
        found.estimate.item() - 1.96 * found.standard_error.item(), rel=0.01
    )


def test_held_parameters_and_other_names_are_refused(decay, result):
    held = identify(decay, LIBRARY, Direct(), constraints={"lambda": 0.0})
    for one, name in ((held, "lambda"), (result, "gravity"), (result, "dahl.s")):
        with pytest.raises(UsageError, match=r"is fixed|is not a parameter"):
            profile(decay, one, [name])


def test_a_random_force_has_no_profile_of_the_free_motion(decay):
    pushed = identify(decay, LIBRARY, Direct(random_force=1e-4))
    with pytest.raises(DecayError, match="--random-force off"):
        profile(decay, pushed, ["zeta"])


def test_a_profile_ends_at_a_bound_and_comes_in_the_unit_of_the_record(decay):
    millimetres = decay.assign(angle=(1e3 * decay.angle).assign_attrs(units="mm"))
    ends = []
    for record, unit in ((decay, 1.0), (millimetres, 1e-3)):
        free = profile(record, identify(record, LIBRARY, Direct()), ["delta"]).isel(parameter=0)
        ends.append([free.low.item() / unit, free.high.item() / unit])
    assert ends[1] == pytest.approx(ends[0], rel=1e-6)
    bounded = identify(decay, LIBRARY, Direct(), constraints={"delta": (0.0368, None)})
    found = profile(decay, bounded, ["delta"]).isel(parameter=0)
    # The exact bound, without rounding errors.
    assert found.low.item() == 0.0368
    assert found.asymmetric.item()


def test_a_run_that_is_not_there_is_refused(decay, result):
    with pytest.raises(UsageError, match="no run 5"):
        curve_bands(decay, result, run=5)


def test_the_log_likelihood_is_highest_at_the_estimate_and_nothing_beyond_a_bound(decay):
    bounded = identify(decay, LIBRARY, Direct(), constraints={"delta": (0.0, None)})
    likelihood = log_likelihood(decay, bounded)
    assert likelihood.names[:5] == tuple(bounded.force.values)
    assert likelihood(likelihood.estimate) == 0.0
    for step in np.sqrt(np.diag(likelihood.covariance)) * np.eye(len(likelihood.names)):
        assert likelihood(likelihood.estimate + step) < 0.0
    beyond = likelihood.estimate.copy()
    beyond[likelihood.names.index("delta")] = -1e-6
    assert likelihood(beyond) == -np.inf
    with pytest.raises(UsageError, match="parameters"):
        likelihood(beyond[1:])


def test_a_motion_that_stops_has_the_likelihood_of_its_own_fit():
    # From a rough start the fit ends in the minimum of another number of swings, which is worse by 66.
    model = Model(LIBRARY.select(["lambda", "zeta"]), {"lambda": 8e-3, "zeta": 0.005}, 9.91)
    decay = simulate(model, np.arange(0.0, 10.0, 0.01), 0.3)[["angle"]]
    decay["angle"] = decay.angle + 1e-3 * np.random.default_rng([2, 5]).standard_normal(decay.time.size)
    likelihood = free_likelihood(decay, identify(decay, model.library, Direct(random_force="off")))
    truth = np.array([8e-3, 0.005, 9.91, 0.3, 0.0, 0.0])
    assert 0.0 < likelihood.deviance(truth) < 20.0


@pytest.mark.parametrize("points", [1, 20])
def test_a_band_of_independent_points_holds_all_of_them(points):
    draws = np.random.default_rng(0).standard_normal((20_000, points))
    expected = norm.isf(0.5 * (1.0 - 0.95 ** (1.0 / points)))
    assert simultaneous_factor(draws) == pytest.approx(expected, rel=0.02)
    assert simultaneous_factor(np.repeat(draws[:, :1], 5, axis=1)) == pytest.approx(1.96, rel=0.02)


@pytest.mark.slow
def test_bands_hold_whole_curves(decay, result):
    found = curve_bands(decay, result)
    for name in ("angle", "envelope", "frequency", "damping_ratio"):
        assert 1.9 < found.attrs[f"factor_{name}"] < 4.5
        half = found[f"{name}_high"] - found[name]
        assert half.values == pytest.approx(
            found.attrs[f"factor_{name}"] * found[f"{name}_standard_error"].values
        )
    assert np.all((found.angle_low <= RUN.angle) & (found.angle_high >= RUN.angle))


@pytest.mark.slow
def test_emcee_draws_the_posterior_from_the_log_likelihood(decay, result):
    emcee = pytest.importorskip("emcee")
    likelihood = log_likelihood(decay, result)
    start = np.random.default_rng(1).multivariate_normal(likelihood.estimate, likelihood.covariance, size=32)
    sampler = emcee.EnsembleSampler(32, len(likelihood.names), likelihood)
    # With the state of the global generator, the draws of each run would differ.
    sampler.random_state = np.random.RandomState(1).get_state()
    sampler.run_mcmc(start, 400)
    draws = sampler.get_chain(discard=100, flat=True)
    expected = np.sqrt(np.diag(likelihood.covariance))
    assert draws.std(axis=0) == pytest.approx(expected, rel=0.15)
    assert np.abs((draws.mean(axis=0) - likelihood.estimate) / expected).max() < 0.3


@pytest.mark.slow
def test_constraints_of_the_result_are_those_of_the_profile(decay):
    tied = identify(decay, LIBRARY, Direct(), constraints={"nu": "-10.8*delta"})
    found = profile(decay, tied, ["delta"]).isel(parameter=0)
    free = profile(decay, identify(decay, LIBRARY, Direct()), ["delta"]).isel(parameter=0)
    assert found.standard_error.item() < 0.9 * free.standard_error.item()
    with pytest.raises(UsageError, match="tied"):
        profile(decay, tied, ["nu"])
    # All are fixed at the estimate of one, which improves no other parameter.
    assert found.deviance.min().item() >= 0.0


@pytest.mark.slow
def test_every_fit_is_of_the_same_forces_at_one_reference(decay, result):
    found = sensitivity(decay, result)
    assert set(found.kind.values) == {"window", "start", "sampling", "noise", "method"}
    assert np.isfinite(found.coefficient).all()
    assert not any(found.reason.values)
    # The same method on the same samples is the result itself.
    assert found.coefficient.sel(fit="random force off").values == pytest.approx(result.coefficient.values)
    assert np.all((found.low <= result.coefficient) & (result.coefficient <= found.high))
    assert np.nanmax(np.abs(found.change)) < 5.0


@pytest.mark.slow
def test_the_reason_of_a_failed_fit_is_stated(decay, result):
    drift = (*LIBRARY, library_of_formulas(drift="t").forces[0])
    library = ForceLibrary("with a drift", (*drift[:-1], replace(drift[-1], kind="sensor")))
    found = sensitivity(decay, identify(decay, library, Direct()))
    failed = found.isel(fit=[bool(reason) for reason in found.reason.values])
    assert failed.fit.values.tolist() == ["averaging"]
    assert np.isnan(failed.coefficient).all()


@pytest.mark.slow
def test_the_command_prints_both_and_keeps_them(tmp_path, decay):
    decay.to_dataframe().to_csv(tmp_path / "a.csv")
    asked = ("identify", str(tmp_path / "a.csv"), "--profile", "epsilon", "--sensitivity")
    ending = command(*asked, "--json", "-o", str(tmp_path / "a.nc"), "--plot", str(tmp_path / "figures"))
    assert ending.status == 0, ending.err
    data = json.loads(ending.out)
    low, high = (data["profile"]["epsilon"][end] for end in ("low", "high"))
    assert low < FIVE["epsilon"] < high
    assert data["sensitivity"]["fits"]["averaging"]["kind"] == "method"
    assert {path.stem for path in (tmp_path / "figures").glob("*.pdf")} >= {"profile", "sensitivity"}
    asked_for = sureness_blocks(load(tmp_path / "a.nc"))
    assert [block.title for block in asked_for if Layer.QUIET in block.layers] == ["Profiles", "Sensitivity"]
    page = tmp_path / "a.html"
    assert command("report", str(tmp_path / "a.nc"), "-o", str(page)).status == 0
    assert "by the profile likelihood" in page.read_text()
