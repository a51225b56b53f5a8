"""Several runs of one experiment at once, whether they agree, and the difference of two identifications."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from helpers import FIVE, Run, paper_run, rms, rms_range, values
from scipy.stats import kstest, norm

from sysid_trib import identify
from sysid_trib.errors import UsageError
from sysid_trib.methods import Averaging, Direct
from sysid_trib.validation import difference, run_agreement

LONG = paper_run(FIVE)
SHORT = replace(paper_run(FIVE, duration=15.0, sampling_rate=50.0), start=0.6)
LIBRARY = LONG.model.library
SEEDS = 15


def two_runs(seed: int) -> list[xr.Dataset]:
    """Return runs of different lengths, amplitudes, sampling rates and noises."""
    return [LONG.decay(seed), SHORT.decay(1000 + seed, 3e-4)]


def test_a_list_of_one_is_the_run_itself():
    decay, method = LONG.decay(3), Direct()
    assert identify([decay], LIBRARY, method).identical(identify(decay, LIBRARY, method))


def test_two_short_runs_separate_forces_that_one_cannot():
    """Nu and epsilon, inseparable at one amplitude, are separated by two: under two periods each."""
    weak = [replace(paper_run(FIVE, duration=4.0), start=start) for start in (0.1, 0.6)]
    decays = [run.decay(seed) for seed, run in enumerate(weak)]
    both = identify(decays, LIBRARY, Direct())
    alone = [identify(decay, LIBRARY, Direct()) for decay in decays]
    gain = np.min([r.standard_error.sel(force="nu") for r in alone]) / both.standard_error.sel(force="nu")
    assert gain > 1.5
    assert np.all(np.abs(values(both, FIVE) - list(FIVE.values())) < 4 * both.standard_error.values)


@pytest.mark.in_full
def test_runs_of_one_experiment_agree():
    p_values, each = [], []
    for seed in range(SEEDS):
        runs = two_runs(seed)
        found = run_agreement(runs, identify(runs, LIBRARY, Direct()))
        p_values.append(found.total_p_value.item())
        each.append(found.p_value.values)
    assert kstest(p_values, "uniform").pvalue > 1e-3
    assert min(p_values) > 1e-3
    assert kstest(np.array(each)[:, 0], "uniform").pvalue > 1e-3


def test_agreement_of_two_runs_is_that_of_normal_values():
    runs = two_runs(0)
    found = run_agreement(runs, identify(runs, LIBRARY, Direct()))
    z = found.value.diff("run").squeeze("run") / np.sqrt((found.standard_error**2).sum("run"))
    np.testing.assert_allclose(found.p_value, 2.0 * norm.sf(np.abs(z)), rtol=1e-6)
    assert found.total_degrees_of_freedom.item() == found.sizes["quantity"]


@pytest.mark.slow
def test_a_force_that_differs_is_named():
    worn = replace(SHORT, model=SHORT.model.with_coefficients(FIVE | {"lambda": 2e-4}))
    runs = [LONG.decay(1), worn.decay(2)]
    found = run_agreement(runs, identify(runs, LIBRARY, Direct()))
    assert found.attrs["verdict"] == "disagree"
    assert found.quantity.values[np.argmin(found.p_value.values)] == "lambda"
    assert found.value.sel(quantity="lambda", run=1).item() == pytest.approx(2e-4, abs=4e-5)


def test_a_run_that_determines_nothing_alone_is_reported():
    stub = LONG.decay(1).isel(time=slice(0, 150))
    runs = [LONG.decay(2), stub]
    found = run_agreement(runs, identify(runs, LIBRARY, Averaging()))
    assert found.attrs["verdict"] == "unknown"
    assert found.reason.values[0] == ""
    assert "amplitudes cannot determine" in found.reason.values[1]


@pytest.mark.in_full
def test_the_difference_is_the_force_of_the_contact():
    """A contact run minus a contactless one: friction, and the shift of the frequency."""
    free = Run(replace(LONG.model, coefficients={"zeta": 0.004}, reference_frequency=8.87), LONG.time)
    z, stiffness = [], []
    for seed in range(SEEDS):
        contact = identify(LONG.decay(seed), LIBRARY, Direct())
        air = identify(free.decay(500 + seed), LIBRARY.select(["zeta", "delta"]), Direct())
        found = difference(contact, air)
        # In units of the contact run's frequency: a torque 2 zeta w theta' is what it is.
        truth = xr.DataArray(list(FIVE.values()), {"force": list(FIVE)}, "force").copy()
        truth.loc["zeta"] -= 0.004 * 8.87 / 9.91
        z.append(((found.difference - truth) / found.standard_error).sel(force=list(FIVE)).values)
        # Viscous friction lowers the frequency, not the stiffness.
        alpha = (9.91 / 8.87) ** 2 - 1.0
        stiffness.append((found.stiffness_difference - alpha) / found.stiffness_difference_standard_error)
    low, high = rms_range(SEEDS)
    assert np.all((rms(z) > low) & (rms(z) < high))
    assert low < rms(np.array(stiffness)) < high
    assert found.second.sel(force="nu").item() == 0.0
    assert found.p_value.sel(force="nu").item() < 1e-6


@pytest.mark.parametrize("nothing", [[], [LONG.decay(1).drop_vars("angle")], ["run.csv"]])
def test_invalid_runs_are_refused(nothing):
    with pytest.raises(UsageError, match=r"No run is given|a Dataset with angle|read it"):
        identify(nothing, LIBRARY, Direct())


def test_the_papers_rule_takes_one_record():
    with pytest.raises(UsageError, match="a rule for one record"):
        identify(two_runs(0), LIBRARY, Averaging(frequency="last"))
