"""Variation between runs: exact cases, statistics over seeds, published numbers, refusals."""

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from helpers import FIVE, paper_run
from statsmodels.stats.meta_analysis import combine_effects

import sysid_trib as st
from sysid_trib.errors import UsageError
from sysid_trib.validation.random_effects import RandomEffects, precision


def runs_of(values, errors, names=("lambda",)):
    """Values of runs in the form of `run_agreement`."""
    dims = ("run", "quantity")
    values, errors = (np.reshape(array, (-1, len(names))) for array in (values, errors))
    return xr.Dataset({"value": (dims, values), "standard_error": (dims, errors)}, {"quantity": list(names)})


def test_the_spread_is_that_of_paule_and_mandel():
    random = np.random.default_rng(1)
    values, errors = random.normal(3.0, 1.0, 12), random.uniform(0.2, 0.6, 12)
    known = combine_effects(values, errors**2, method_re="iterated")
    told = st.campaigns.between_runs(runs_of(values, errors))
    np.testing.assert_allclose(told.between_run.item() ** 2, known.tau2, rtol=1e-4)
    np.testing.assert_allclose(told.effect.item(), known.mean_effect_re, rtol=1e-6)
    assert told.between_run_lower < told.between_run < told.between_run_upper


@pytest.mark.in_full
@pytest.mark.parametrize("tau", [2.0])
def test_intervals_of_the_scatter_cover_in_95_of_100_cases(tau):
    random, hold, records = np.random.default_rng(2), 0, 400
    for _ in range(records):
        errors = np.exp(random.normal(0.0, 0.5, 8))
        values = 3.0 + np.hypot(errors, tau) * random.standard_normal(8)
        lower, upper = RandomEffects(values, errors, np.ones((8, 1))).tau_interval
        hold += lower <= tau <= upper
    # Three binomial errors.
    assert abs(hold / records - 0.95) < 0.033


def test_intervals_of_laboratories_cover_in_95_of_100_cases():
    random, hold, records = np.random.default_rng(4), np.zeros(3), 400
    truths = (1.0, 1.0, 2**0.5)
    # Different numbers of results.
    group = np.repeat(np.arange(8), [2, 3, 5, 2, 3, 5, 2, 4])
    for _ in range(records):
        values = random.standard_normal(8)[group] + random.standard_normal(len(group))
        found = precision(values, group)
        hold += [low <= truth <= high for (_, low, high), truth in zip(found, truths, strict=True)]
    assert np.all(np.abs(hold / records - 0.95) < 0.035)


def test_two_laboratories_have_the_standard_numbers():
    # Two laboratories, means 1 and 3, deviations 0.1: by hand after ISO 5725-2, 7.4.
    found = precision(np.array([0.9, 1.1, 2.9, 3.1]), np.array(list("aabb")))
    within, between = 0.02, 2.0 - 0.02 / 2
    measured = [interval[0] ** 2 for interval in found]
    np.testing.assert_allclose(measured, [within, between, within + between], rtol=1e-12)


def test_only_quantities_that_vary_with_a_condition_are_named():
    random = np.random.default_rng(5)
    load, material = np.repeat([1.0, 2.0, 4.0], 4), np.tile(["glass", "steel"], 6)
    columns = np.column_stack(
        [
            0.5 * load + 0.05 * random.standard_normal(12),
            np.where(material == "steel", 2.0, 1.0) + 0.05 * random.standard_normal(12),
            3.0 + 0.05 * random.standard_normal(12),
            7.0 + random.standard_normal(12),
        ]
    )
    names = ("lambda", "zeta", "delta", "nu")
    told = st.campaigns.between_runs(
        runs_of(columns, np.full((12, 4), 0.05), names), {"load": load, "material": material}
    )
    assert told.verdict.values.tolist() == ["varies with load", "varies with material", "common", "scatters"]
    slope = told.sel(quantity="lambda", term="load")
    assert abs(slope.effect - 0.5) < 3.0 * slope.effect_standard_error
    jump = told.sel(quantity="zeta", term="material=steel")
    assert abs(jump.effect - 1.0) < 3.0 * jump.effect_standard_error
    # The mean is that of all runs, for any conditions, because equally many runs were made with each.
    np.testing.assert_allclose(told.sel(term="mean").effect, columns.mean(axis=0), rtol=1e-6)


def test_a_unit_changes_nothing():
    random = np.random.default_rng(6)
    values, errors = random.normal(3.0, 1.0, 9), random.uniform(0.2, 0.6, 9)
    load, unit = {"load": np.arange(9.0)}, 1e-9
    first = st.campaigns.between_runs(runs_of(values, errors), load)
    second = st.campaigns.between_runs(runs_of(unit * values, unit * errors), load)
    for name in ("between_run", "between_run_upper", "shrunken", "effect_standard_error"):
        np.testing.assert_allclose(second[name], unit * first[name], rtol=1e-6)


@pytest.mark.slow
def test_identifications_are_compared_at_one_frequency_and_a_worn_run_scatters():
    library = st.load_library("contact_forces").select(FIVE)
    identified = [st.identify(paper_run().decay(seed), library, st.methods.Direct()) for seed in range(4)]
    told = st.campaigns.between_runs(identified)
    assert set(told.verdict.values.tolist()) == {"common"}
    assert told.unit.values.tolist() == ["1"] * 5 + ["rad/s"]
    assert told.sizes == {"run": 4, "quantity": 6, "term": 1, "condition": 0}
    worn = identified[3].copy(deep=True)
    worn["coefficient"] += xr.where(worn.force == "lambda", 20.0 * worn.standard_error, 0.0)
    verdicts = st.campaigns.between_runs([*identified[:3], worn]).verdict.to_series()
    assert (verdicts["lambda"], verdicts["zeta"]) == ("scatters", "common")


@pytest.mark.parametrize(
    ("conditions", "laboratories", "sentence"),
    [
        ({"load": [1.0, 2.0]}, None, "2 rows for 4 runs"),
        ({"load": [1.0, 1.0, 1.0, 1.0]}, None, "the same in all runs"),
        ({"load": [1.0, None, 2.0, 3.0]}, None, "no value for run 2"),
        (
            {"load": [1.0, 2.0, 3.0, 4.0], "wear": [2.0, 4.0, 6.0, 8.0]},
            None,
            "'wear' is confounded with 'load'",
        ),
        ({"load": [1.0, 2.0, 3.0, 4.0]}, "place", "no column 'place'"),
        ({"place": list("abcd")}, "place", "one of which has several runs"),
        (pd.DataFrame({"place": list("aaaa")}), "place", "at least two laboratories"),
    ],
)
def test_conditions_that_say_nothing_are_refused(conditions, laboratories, sentence):
    runs = runs_of([1.0, 1.1, 0.9, 1.0], np.full(4, 0.1))
    with pytest.raises(UsageError, match=sentence):
        st.campaigns.between_runs(runs, conditions, laboratories=laboratories)


def test_invalid_sets_of_runs_are_refused():
    with pytest.raises(UsageError, match="needs at least two runs"):
        st.campaigns.between_runs(runs_of([1.0], [0.1]))
    with pytest.raises(UsageError, match="needs identifications"):
        st.campaigns.between_runs([xr.Dataset()])
    with pytest.raises(UsageError, match="no free coefficient in common"):
        st.campaigns.between_runs([])
