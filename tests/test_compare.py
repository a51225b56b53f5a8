"""Every method side by side on one record, or on several runs."""

import json
import re
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
import xarray as xr
from command_line import run
from helpers import FIVE, NOISE, Run, W, library_of_formulas, paper_run, sentences_of
from scipy.stats import chi2

from sysid_trib import Model, compare, identify, load_library, plots
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.methods import Averaging, Direct, LogarithmicDecrement
from sysid_trib.printing.comparison import comparison_blocks
from sysid_trib.records.smoothing import sensor_noise
from sysid_trib.results.judged import column_power, comparison_of
from sysid_trib.smooth_laws.method import law_methods
from sysid_trib.validation.compare import every_method
from sysid_trib.validation.holdout import split

FORCES = load_library()
RUN = paper_run(FIVE, sampling_rate=50.0)
FULL = ["trajectory", "direct", "averaging", "averaging (analytic signal)"]
DECREMENTS = ["Wu decrement", "Feeny-Liang decrement", "energy decay", "logarithmic decrement"]


@cache
def paper():
    """Every method on the paper's run, with the labels in the order of the progress reports."""
    told = []
    tree = compare(RUN.decay(7), FORCES, every_method(), tell=lambda text, done=None: told.append(text))
    return tree, told


def table():
    return comparison_of(paper()[0])


def of(found, method):
    """Return the row of a method."""
    return found.sel(model=method)


def test_true_models_predict_to_the_noise():
    found = table()
    rest = split(RUN.decay(7))[1].sizes["time"]
    # The start and the zero are fitted there.
    low, high = np.sqrt(chi2.ppf([1e-4, 1.0 - 1e-4], rest - 3) / rest) * NOISE
    for label in FULL:
        assert low < of(found, label).holdout_rms.item() < high
        assert of(found, label).reason.item() == ""
    assert found.attrs["best"] in FULL


def test_a_biased_method_is_worse():
    found = table()
    for label in ("averaging (printed rule)", "direct (strong form)", *DECREMENTS):
        one = of(found, label)
        assert one.holdout_over_noise.item() > 2.0
        assert one.holdout_p_value.item() < 0.01
    assert "first-order bias" in of(found, "averaging (printed rule)").bias.item()
    assert "smoothed" in of(found, "direct (strong form)").bias.item()
    assert abs(of(found, "logarithmic decrement").z.sel(force="zeta").item()) > 10.0


def test_forces_of_one_signature_are_one_to_averaging():
    library = library_of_formulas(zeta="2*v", delta="v*abs(v)", positional="x**2*sign(v)", even="x**2")
    record = Run(Model(library, {"zeta": 0.0097, "delta": 0.037}, W), paper_run().time).decay(0)
    found = compare(record, library, [Averaging(), Direct(), LogarithmicDecrement()])["comparison"].ds
    assert found.cannot_tell_apart.values.tolist() == ["delta = positional", "", ""]
    averaging = of(found, "averaging")
    assert averaging.reason.item().startswith("does not apply: Force even has no signature")
    assert averaging.neglects.item() == "even"
    assert np.all(np.isnan(averaging.coefficient))
    assert np.isnan(averaging.time_taken)
    blind = "delta, positional (absorbed by zeta); even"
    assert of(found, "logarithmic decrement").neglects.item() == blind
    assert found.attrs["averaging_cannot_see"] == "even"


@dataclass(frozen=True)
class Wild:
    """A method whose identified model diverges, or that raises an error."""

    broken: bool = False

    def identify(self, decay, library):
        if self.broken:
            raise np.linalg.LinAlgError("singular")
        found = Direct().identify(decay, library)
        return found.assign(coefficient=-1e3 * abs(found.coefficient))


def test_a_model_that_runs_away_and_a_method_that_breaks():
    record = RUN.decay(7)
    found = comparison_of(compare(record, FORCES, [Wild(), Wild(broken=True), Direct()]))
    assert found.model.values.tolist() == ["wild", "wild (broken)", "direct"]
    assert of(found, "wild").reason.item() == "its model diverges"
    assert of(found, "wild (broken)").reason.item() == "failed: LinAlgError, singular"
    assert np.isnan(of(found, "wild").residual_rms.item())


def test_a_missing_force_is_reported():
    """Errors then include a model error, both in tables and in figures."""
    library = FORCES.select(["lambda", "zeta", "epsilon"])
    tree = compare(RUN.decay(7), library, [Direct(), Averaging()])
    table = comparison_of(tree)
    assert table.residual_over_noise.values.min() > 3.0
    assert "a force is missing or has a different form" in " ".join(sentences_of(comparison_blocks(tree)))
    best = of(table, table.attrs["best"])
    for label in table.model.values.tolist():
        row, result = of(table, label), tree[label].to_dataset()
        assert (result.standard_error > result.error_of_noise).any()
        if label != table.attrs["best"]:
            both = np.hypot(row.standard_error, best.standard_error)
            np.testing.assert_allclose(row.z, (row.coefficient - best.coefficient) / both)
    figure = plots.comparison(tree)
    names = [text.get_text() for text in figure.axes[0].get_yticklabels()]
    drawn = next(ax for ax in figure.axes if ax.get_xlabel().startswith(r"$\lambda$")).containers
    power = 10.0 ** column_power(table.sel(force="lambda"))
    assert len(drawn) > 0
    for bar in drawn:
        row, ends = round(float(bar.lines[0].get_ydata()[0])), bar.lines[2][0].get_segments()[0][:, 0]
        error = of(table, names[row]).standard_error.sel(force="lambda").item()
        assert np.ptp(ends) / 2.0 * power == pytest.approx(error)


@pytest.mark.slow
def test_a_good_prediction_by_coincidence_is_reported():
    methods = {name: every_method()[name] for name in ("averaging", "averaging (printed rule)", "direct")}
    tree = compare(RUN.decay(7), FORCES.select(["lambda", "zeta"]), methods)
    told = " ".join(sentences_of(comparison_blocks(tree)))
    assert "Averaging (printed rule) predicts the held-out part best" in told
    assert "a coincidence" in told
    # Its frequency may be far off: coefficients refer to that of the model that misses the record least.
    least = re.search("times that of (.+?): its good prediction", told)[1]
    assert f"rad/s (w of {least})" in told


def test_a_difference_from_a_best_method_that_neglects_a_force_is_its_own():
    tree = paper()[0].copy(deep=True)
    tree["comparison"].attrs["best"] = "logarithmic decrement"
    tree["comparison"].z[:] = 9.0
    told = " ".join(sentences_of(comparison_blocks(tree)))
    assert "The probable cause: logarithmic decrement neglects forces" in told
    assert "do not have the form of what acts" not in told


def test_alpha_from_the_frequency_without_contact():
    found = compare(RUN.decay(7), FORCES, [Direct()], contactless=(8.87, 0.02))["comparison"].ds
    one = of(found, "direct")
    alpha = (one.asymptotic_frequency.item() / 8.87) ** 2 - 1.0
    assert one.coefficient.sel(force="alpha").item() == pytest.approx(alpha, rel=1e-12)
    assert found.attrs["exchangeable_with_the_frequency"] == ""


@pytest.mark.parametrize(
    ("record", "library", "methods", "reason"),
    [
        ([], FORCES, [Direct()], "No run is given"),
        ("run.csv", FORCES, [Direct()], "not the name of a file; read it"),
        (None, "contact_force", [Direct()], "Did you mean 'contact_forces'"),
        (None, FORCES, [Direct], "a method such as"),
        (None, FORCES, [], "at least one"),
    ],
)
def test_the_reason_why_methods_cannot_be_compared_is_stated(record, library, methods, reason):
    given = RUN.decay(0) if record is None else record
    with pytest.raises(UsageError, match=reason):
        compare(given, library, methods)


def test_a_record_that_no_method_can_use():
    with pytest.raises(DecayError, match=r"No method can identify this record\. direct: does not apply"):
        compare(RUN.decay(0), FORCES.select(["alpha"]), [Direct()])


def test_command_json():
    def refused(text):
        raise AssertionError(f"{text} is not JSON")

    ending = run("compare", "--json", "--window", ":9", "--forces", "zeta,delta,nu,epsilon")
    found = json.loads(ending.out, parse_constant=refused)
    assert set(found["methods"]) == {*every_method(), *law_methods()}
    direct, linear = found["methods"]["direct"], found["methods"]["linear decrement"]
    assert set(direct["coefficients"]) == {"zeta", "delta", "nu", "epsilon"}
    assert direct["coefficients"]["zeta"]["value"] == pytest.approx(FIVE["zeta"], rel=0.05)
    assert linear["coefficients"]["zeta"]["value"] is linear["holdout_rms"] is None
    assert linear["reason"].startswith("does not apply")
    assert found["best"] in found["methods"]
    assert found["common_frequency"] == pytest.approx(W, rel=1e-3)


def test_the_decay_is_left_as_it_was():
    record = RUN.decay(7)
    before = record.copy(deep=True)
    compare(record, FORCES, [LogarithmicDecrement()])
    xr.testing.assert_identical(record, before)


TOGETHER = [*FULL, "direct (strong form)"]
SHORT = replace(paper_run(FIVE, duration=15.0, sampling_rate=50.0), start=0.6)


@cache
def two_runs():
    """Return runs of different lengths, amplitudes, sampling rates and noises."""
    return [RUN.decay(7), SHORT.decay(8, 3e-4)]


@cache
def of_two_runs():
    return compare(two_runs(), FORCES, every_method())


@pytest.mark.slow
def test_several_runs_are_identified_together():
    tree = of_two_runs()
    found = comparison_of(tree)
    runs = {f"{name}_{at}" for name in ("record", "envelope") for at in (1, 2)}
    assert set(tree.children) == {*runs, "comparison", "judged", *TOGETHER}
    for label in TOGETHER:
        assert of(found, label).reason.item() == ""
    assert tree["direct"].to_dataset().equals(identify(two_runs(), FORCES, Direct()))
    for label in set(every_method()) - set(TOGETHER):
        one = of(found, label)
        assert one.reason.item() == "takes one record at a time"
        assert np.isnan(one.holdout_rms.item())
        assert np.all(np.isnan(one.coefficient.values))
    starts = [tree[f"record_{at}"].holdout_start.item() for at in (1, 2)]
    assert starts == pytest.approx([2.0 / 3.0 * 24.99, 2.0 / 3.0 * 14.98], abs=0.021)


def test_rms_are_over_the_runs_and_each_ones_noise():
    tree = of_two_runs()
    found = comparison_of(tree)
    noises = [sensor_noise(run) for run in two_runs()]
    assert found.run_noise.values.tolist() == noises == pytest.approx([1e-4, 3e-4], rel=0.1)
    for name in ("residual", "train", "holdout"):
        each = found[f"run_{name}_rms"]
        assert each.dims == ("model", "run")
        np.testing.assert_allclose(found[f"{name}_rms"], np.sqrt((each**2).mean("run", skipna=False)))
        ratio = np.sqrt(((each / noises) ** 2).mean("run", skipna=False))
        np.testing.assert_allclose(found[f"{name}_over_noise"], ratio)
    rest = sum(split(run)[1].sizes["time"] for run in two_runs())
    low, high = np.sqrt(chi2.ppf([1e-4, 1.0 - 1e-4], rest / 4) / (rest / 4))
    for label in FULL:
        assert low < of(found, label).holdout_over_noise.item() < high
    assert found.attrs["best"] in FULL
    assert of(found, "direct (strong form)").holdout_p_value.item() < 0.01


def test_runs_that_no_method_takes_together():
    with pytest.raises(DecayError, match=r"these runs together\. logarithmic decrement: takes one record"):
        compare(two_runs(), FORCES, [LogarithmicDecrement()])


def test_fixed_coefficients_have_no_error_and_others_that_of_identify():
    # Without delta the model misses the record: the errors allow for that.
    library, held = FORCES.select(["zeta", "nu", "epsilon"]), {"nu": -0.41}
    decay = RUN.decay(3)
    for kind in (Averaging, Direct):
        table = compare(decay, library, {"it": kind()}, constraints=held)["comparison"].to_dataset()
        alone = identify(decay, library, kind(), constraints=held)
        np.testing.assert_allclose(of(table, "it").standard_error, alone.standard_error, rtol=1e-3)
        nu = of(table, "it").sel(force="nu")
        assert (nu.coefficient.item(), nu.standard_error.item()) == (held["nu"], 0.0)


def test_fixed_coefficients_are_unchanged_at_the_reference_of_another_method():
    constraints = {"nu": -0.41}
    methods = {"averaging": Averaging(), "direct": Direct()}
    table = compare(RUN.decay(3), FORCES.select(["zeta", "nu", "epsilon"]), methods, constraints=constraints)
    assert set(table["comparison"].coefficient.sel(force="nu").values.tolist()) == {-0.41}
