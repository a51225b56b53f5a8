"""Properties of every method of the list, and equal defaults in Python and in the command."""

from dataclasses import fields, is_dataclass
from inspect import signature

import numpy as np
import pytest
from command_line import run
from helpers import FIVE, OWN_MODELS, library_of_formulas, paper_run

import sysid_trib as st
from sysid_trib import load_library, methods
from sysid_trib.commands.options import CampaignOptions
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.methods import METHODS, Averaging, Direct, Trajectory, method_of
from sysid_trib.plots.compared import FAMILY_MARKS
from sysid_trib.validation.compare import every_method

EVERY = every_method()


def test_every_classical_method_has_a_model_of_its_own():
    assert set(METHODS) - set(OWN_MODELS) == {Trajectory, Direct, Averaging, methods.FrequencyShift}


@pytest.mark.parametrize("kind", METHODS, ids=lambda kind: kind.__name__)
def test_a_method_describes_itself(kind):
    method = kind()
    assert is_dataclass(kind)
    assert kind.__name__ in methods.__all__
    for text in (method.scope.label, method.scope.assumes, method.scope.observes, method.scope.identifies):
        assert text
    assert method.scope.family in FAMILY_MARKS
    assert "scope" not in {option.name for option in fields(kind)}


def test_every_method_and_variant_of_the_list_is_compared():
    labels = [
        label
        for scope in (kind().scope for kind in METHODS)
        for label in (scope.label, *(f"{scope.label} ({variant})" for variant in scope.variants))
    ]
    assert list(EVERY) == labels
    assert len(set(labels)) == len(labels)


def test_options_reach_the_methods_that_have_them():
    for method in every_method(9.8, {"dahl.s": 0.02}).values():
        names = {option.name for option in fields(method)}
        assert "reference_frequency" not in names or method.reference_frequency == 9.8
        assert "shapes" not in names or method.shapes == {"dahl.s": 0.02}


@pytest.mark.parametrize("label", [label for label, method in EVERY.items() if not method.scope.several_runs])
def test_a_method_of_one_record_refuses_several(label):
    run = paper_run(FIVE, duration=6.0).decay(0)
    with pytest.raises(UsageError, match="one record"):
        EVERY[label].identify([run, run], load_library())


def test_a_method_from_elsewhere_cannot_be_made_again():
    result = methods.Direct().identify(paper_run(FIVE).decay(0), load_library())
    assert method_of(result) == methods.Direct()
    with pytest.raises(UsageError, match="'elsewhere' is not an installed method"):
        method_of(result.assign_attrs(method="elsewhere"))


@pytest.mark.parametrize(
    ("kind", "options", "sentence"),
    [
        (Averaging, {"frequency": "first"}, "neither 'fit' nor 'last'"),
        (Averaging, {"frequency": "last", "random_force": 1e-4}, "frequency='last' takes no random_force"),
        (Direct, {"form": "medium"}, "neither 'weak' nor 'strong'"),
        (Direct, {"form": "strong", "random_force": 1e-4}, "form='weak'"),
        (Trajectory, {"noise": "pink"}, "coloured"),
        (Trajectory, {"noise": "coloured", "random_force": 1e-4}, "noise='white'"),
        (Direct, {"random_force": "maybe"}, "random_force"),
        (Trajectory, {"random_force": -1.0}, "random_force"),
        (methods.FeenyLiang, {"random_force": float("nan")}, "random_force"),
    ],
)
def test_options_that_cannot_be_are_refused(kind, options, sentence):
    with pytest.raises(UsageError, match=sentence):
        kind(**options)


SPEED = {"zeta": "2*v", "delta": "v*abs(v)"}


@pytest.mark.parametrize(
    ("method", "formulas", "sentence"),
    [
        (Averaging(), SPEED | {"positional": "x**2*sign(v)"}, "cannot separate delta and positional"),
        (Averaging(), {"zeta": "2*v", "even": "x**2"}, "even has no signature"),
        (Direct(9.91), SPEED | {"viscous": "v"}, "zeta and viscous are the same force"),
        (Trajectory(5.0), {"zeta": "2*v"}, "follows"),
        (methods.LogarithmicDecrement(), {"solid": "sign(v)"}, r"needs a force of formula 2\*v"),
        (methods.LinearDecrement(), {"viscous": "2*v"}, r"needs a force of formula sign\(v\)"),
        (methods.FeenyLiang(), {"viscous": "2*v"}, r"needs a force of formula sign\(v\)"),
        (methods.EnergyDecay(), {"solid": "sign(v)"}, r"needs a force of formula 2\*v"),
        (methods.QuadraticDecay(), {"viscous": "2*v"}, r"needs a force of formula v\*abs\(v\)"),
        (methods.WuDecrement(), {"solid": "sign(v)", "mixed": "abs(x)*v"}, "needs a power of the speed"),
        (methods.FrequencyShift(), {"viscous": "2*v", "linear": "x"}, "needs a nonlinear conservative force"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_forces_that_a_method_cannot_separate_are_refused_in_a_sentence(method, formulas, sentence):
    with pytest.raises(DecayError, match=sentence):
        method.identify(paper_run(FIVE, duration=10.0).decay(0), library_of_formulas(**formulas))


@pytest.mark.parametrize(
    ("method", "duration", "sentence"),
    [
        (Averaging(), 1.4, "cannot determine 5 forces"),
        (Direct(9.91), 0.3, "cannot determine 6 forces"),
        *(
            (kind(), 1.6, "give a longer record")
            for kind in (methods.FeenyLiang, methods.WuDecrement, methods.EnergyDecay)
        ),
        (methods.FrequencyShift(), 1.6, "give a longer record"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_a_short_record_is_refused(method, duration, sentence):
    with pytest.raises(DecayError, match=sentence):
        method.identify(paper_run(FIVE, duration=duration).decay(0), load_library())


@pytest.fixture(scope="module")
def example():
    return st.free_decay(st.records.paper_twin())


@pytest.mark.slow
def test_identify_returns_the_result_of_the_command(example, tmp_path):
    assert run("identify", "-o", tmp_path / "command.nc").status == 0
    by_command, here = st.load(tmp_path / "command.nc"), st.identify(example)
    # The command adds the consequences of the model for the page.
    assert set(here.children) == set(by_command.children) - {"consequences"}
    for group in ("averaging", "direct", "judged", "agreement"):
        for name, variable in here[group].data_vars.items():
            if variable.dtype.kind == "f":
                np.testing.assert_allclose(variable, by_command[group][name], rtol=1e-12, err_msg=name)
        assert here[group].attrs.get("verdict") == by_command[group].attrs.get("verdict")


def test_a_campaign_has_as_many_workers_and_as_much_memory():
    asked, here = CampaignOptions(), signature(st.campaign).parameters
    assert (here["workers"].default, here["memory"].default) == (asked.workers, asked.memory)
