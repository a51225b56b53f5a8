"""How sure coefficients are: profile likelihoods, and the same fit in every other defensible way."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import run as command
from helpers import FIVE, library_of_formulas, paper_run

from sysid_trib import identify
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces import ForceLibrary
from sysid_trib.methods import Direct
from sysid_trib.validation import profile, sensitivity

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
        with pytest.raises(UsageError, match=r"is held|is no parameter"):
            profile(decay, one, [name])


def test_a_random_force_has_no_profile_of_the_free_motion(decay):
    pushed = identify(decay, LIBRARY, Direct(random_force=1e-4))
    with pytest.raises(DecayError, match="--random-force off"):
        profile(decay, pushed, ["zeta"])


@pytest.mark.slow
def test_constraints_of_the_result_are_those_of_the_profile(decay):
    tied = identify(decay, LIBRARY, Direct(), constraints={"nu": "-10.8*delta"})
    found = profile(decay, tied, ["delta"]).isel(parameter=0)
    free = profile(decay, identify(decay, LIBRARY, Direct()), ["delta"]).isel(parameter=0)
    assert found.standard_error.item() < 0.9 * free.standard_error.item()
    # All held at the estimate of one: nothing else is known better by it.
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
def test_a_fit_that_fails_says_why(decay, result):
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
    page = tmp_path / "a.html"
    assert command("report", str(tmp_path / "a.nc"), "-o", str(page)).status == 0
    assert "by the profile likelihood" in page.read_text()
