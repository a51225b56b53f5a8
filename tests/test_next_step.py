"""Verdicts lead on: what is said of a model that holds, or does not, and the command that follows."""

import dataclasses
import json
import re
import shlex
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from command_line import run, write_csv
from helpers import FIVE, W, decay, paper_run, sentences_of
from known_results import PAPER, known

import sysid_trib as st
from sysid_trib.commands.options import ConstraintOptions, DecayOptions, ModelOptions, SearchOptions
from sysid_trib.commands.terminal import command_after
from sysid_trib.physics.contact import speaks_of_slip
from sysid_trib.plots.motion_panels import motion_data
from sysid_trib.printing.identification import consequences, identification_blocks, identification_table
from sysid_trib.printing.json_results import identification_json
from sysid_trib.printing.next_step import SECOND_RECORD, NextStep, next_step
from sysid_trib.printing.physics import physics_sentences
from sysid_trib.printing.verdict import separation_sentences, verdict_sentence
from sysid_trib.records.smoothing import sensor_noise
from sysid_trib.results.significance import determines, significant, sufficient_forces
from sysid_trib.validation.findings import answer_of, holds
from sysid_trib.validation.verdict import breakdown, no_nearer_than_rest, record_noise, widening

FORCES = st.load_library()
RUN = paper_run(FIVE, sampling_rate=50.0)


def checked(record, library=FORCES, **options):
    methods = (st.methods.Averaging(**options), st.methods.Direct(**options))
    return st.cross_check(record, *(st.identify(record, library, method) for method in methods), draws=16)


@cache
def explained():
    return checked(RUN.decay(7))


@cache
def unexplained():
    return checked(RUN.decay(7), FORCES.select(["lambda", "zeta"]), random_force="off")


@cache
def undetermined():
    """Two periods of a motion below its noise's detail: no coefficient is known."""
    time = np.arange(0.0, 3.5, 0.02)
    return checked(decay(time, 0.01 * np.cos(W * time), 3, 1e-3), FORCES.select(["lambda", "zeta", "delta"]))


def with_motion(tree, model, angle):
    """The result with another motion of one of its models."""
    changed = tree.copy(deep=True)
    at = tree["record"].model.values.tolist().index(model)
    changed["record"].simulated_angle.values[at] = angle
    return changed


def words(table):
    return [[str(cell) for cell in column.cells] for column in table.columns]


# The next step.


def test_an_explained_record_leads_to_every_method():
    assert holds(explained())
    assert next_step(explained()).command == "compare"


def test_a_record_that_is_not_explained_leads_to_discover():
    assert not holds(unexplained())
    assert next_step(unexplained()).command == "discover"


@pytest.mark.slow
def test_a_search_starts_from_the_forces_that_were_given(tmp_path):
    time = np.arange(0.0, 12.0, 0.02)
    moved = st.simulate(st.Model(FORCES, {"lambda": 1e-3, "zeta": 0.01, "nu": -0.4}, W), time, 0.4, 0.0).angle
    path = write_csv(tmp_path / "swing.csv", time, moved.values)
    told = json.loads(run("identify", path, "--forces", "lambda,zeta", "--json").out)["next"]
    assert shlex.split(told, comments=True)[1:] == ["discover", str(path), "--forces", "lambda,zeta"]
    given = dataclasses.replace(ModelOptions(), forces="lambda,zeta")
    methods = {"direct": st.methods.Direct(), "averaging": st.methods.Averaging()}
    compared = st.compare(RUN.decay(7), FORCES.select(["lambda", "zeta"]), methods)
    assert command_after(next_step(compared), [given]) == "sysid-trib discover --forces lambda,zeta"


@pytest.mark.slow
def test_a_record_that_decides_nothing_leads_to_fewer_forces_and_then_to_a_longer_one():
    tree = undetermined()
    assert tree["comparison"].attrs["verdict_on_record"] == "undetermined"
    assert "does not decide" in verdict_sentence(tree)
    assert not determines(tree["direct"].to_dataset())
    following = next_step(tree)
    assert (following.command, dict(following.options)) == ("identify", {"forces": "zeta"})
    alone = tree.copy()
    alone["direct"] = xr.DataTree(tree["direct"].to_dataset().sel(force=["zeta"], other_force=["zeta"]))
    assert next_step(alone).records == (SECOND_RECORD,)


def test_forces_that_a_record_does_not_separate_are_told_with_the_fewest_that_suffice():
    tree = explained().copy(deep=True)
    result = tree[answer_of(tree)].to_dataset()
    error = 0.5 * np.abs(result.coefficient.values)
    aligned = error * np.sign(result.coefficient.values)
    result.standard_error.values[:] = error
    # Of lambda and zeta the difference alone is known: each may be zero, both may not.
    result.covariance.values[:] = np.diag(error**2)
    result.covariance.values[:2, :2] = np.outer(*2 * [aligned[:2] * [1, -1]]) + 1e-4 * np.diag(error[:2] ** 2)
    tree[answer_of(tree)] = xr.DataTree(result)
    choices = sufficient_forces(result)
    assert [list(forces) for forces in choices] == [["lambda"], ["zeta"]]
    value, uncertainty = choices[0]["lambda"]
    assert value == pytest.approx(2.0 * result.coefficient.values[0], rel=1e-3)
    assert uncertainty < 0.1 * error[0]
    (sentence,) = separation_sentences(tree)
    assert "does not separate" in sentence
    assert sentence.endswith("; or zeta.")
    assert dict(next_step(tree).options) == {"forces": "lambda"}


def test_the_next_command_takes_over_what_was_given(tmp_path):
    record = tmp_path / "a swing.csv"
    given = dataclasses.replace(DecayOptions(), records=[record], angle="theta", units="deg", window="2:60")
    model = dataclasses.replace(ModelOptions(), forces="zeta", omega0="8.87±0.02")
    constraint = dataclasses.replace(ConstraintOptions(), fix=["zeta=0.01", "lambda=0"])
    groups = (given, model, constraint)
    compare = shlex.split(command_after(NextStep("compare", ""), groups))
    assert compare[:3] == ["sysid-trib", "compare", str(record)]
    for pair in (["--angle", "theta"], ["--window", "2:60"], ["--fix", "zeta=0.01"], ["--fix", "lambda=0"]):
        assert " ".join(pair) in " ".join(compare)
    assert "8.87±0.02" in compare
    discover = shlex.split(command_after(NextStep("discover", "", without=("units",)), groups))
    assert discover[-2:] == ["--forces", "zeta"]
    # These are no options of discover, or not wanted.
    assert not {"--units", "--omega0", "--fix"} & set(discover)
    other = command_after(NextStep("identify", "", {"window": "3:"}, ("b.csv",)), groups)
    assert "2:60" not in other
    assert other.endswith("--window 3:")
    assert f"{shlex.quote(str(record))} b.csv" in other


@pytest.mark.slow
def test_the_last_line_is_the_next_command_and_runs(tmp_path):
    path = write_csv(tmp_path / "swing.csv", time=np.arange(0.0, 12.0, 0.02))
    ending = run("identify", path, "--forces", "zeta", "--quiet", "-o", tmp_path / "result.nc")
    last = [line for line in ending.out.splitlines() if line.startswith("Next: ")]
    assert len(last) == 1
    command = shlex.split(last[0].removeprefix("Next: "), comments=True)
    assert command[:3] == ["sysid-trib", "compare", str(path)]
    assert command[3:] == ["--forces", "zeta"]
    told = json.loads(run("identify", path, "--forces", "zeta", "--json").out)
    assert told["next"] == last[0].removeprefix("Next: ")
    st.report(st.load(tmp_path / "result.nc"), tmp_path / "report.html")
    assert "Next: sysid-trib compare" in (tmp_path / "report.html").read_text()


# A model that does not explain the record.


def test_coefficients_of_a_model_that_does_not_explain_are_said_to_be_effective():
    text = " ".join(sentences_of(identification_blocks(unexplained())))
    assert "effective values of a model that is not complete" in text
    assert "errors allow for that" in text
    assert "effective values" not in " ".join(sentences_of(identification_blocks(explained())))


def test_widening_is_the_residual_over_the_noise_and_not_twice():
    plain = known(PAPER)
    assert widening(plain, 12.0) == 12.0
    assert widening(plain, 0.5) == 1.0
    assert widening(plain.assign(birge_ratio=4.0), 12.0) == 3.0
    assert widening(plain.assign(birge_ratio=20.0), 12.0) == 1.0
    density = {"density": 1e-5, "standard_error": 1e-6, "p_value": 1e-9}
    pushed = plain.assign({f"random_force_{name}": value for name, value in density.items()})
    assert widening(pushed, 12.0) == 1.0


def test_what_follows_is_said_of_models_that_hold():
    assert any("weigh the same" in line for line in consequences(explained()))
    assert consequences(unexplained()) == [
        "Weights, crossovers and arrest are not given: the model does not explain the record."
    ]
    assert "refused" in identification_json(unexplained())["consequences"]
    assert "weights" in identification_json(explained())["consequences"]


def test_what_follows_is_said_of_significant_forces():
    errors = np.diag([1.0, 1e-4, 1e-3, 1e-3, 1e-3, 1e-3]) ** 2
    result = known(PAPER, errors)
    assert significant(result).tolist() == [False, True, True, True, True]
    text = " ".join(physics_sentences(result, [0.02, 0.3]))
    assert "zeta and delta weigh the same" in text
    # lambda may be zero: nothing is said of it, nor of the arrest that it would decide.
    assert "lambda" not in text
    assert "stop" not in text
    errors[0, 0] = 1e-14
    assert "stop" in " ".join(physics_sentences(known(PAPER, errors), [0.02, 0.3]))


# Methods that break down.


def test_a_motion_no_nearer_than_rest_is_a_breakdown():
    time = np.arange(0.0, 30.0, 0.01)
    angle = 0.3 * np.exp(-0.05 * time) * np.cos(W * time)
    assert no_nearer_than_rest(angle, 0.9 * angle) == ""
    for name, part in zip(("first", "second", "last"), np.array_split(np.arange(len(time)), 3), strict=True):
        residual = np.zeros_like(angle)
        residual[part] = 1.01 * angle[part]
        assert f"over the {name} third" in no_nearer_than_rest(angle, residual)
    assert "diverges" in no_nearer_than_rest(angle, np.full_like(angle, np.nan))


def test_a_method_that_failed_is_neither_tabulated_nor_drawn():
    tree = with_motion(explained(), "averaging", np.nan)
    assert breakdown(tree, "averaging")
    assert not breakdown(tree, "direct")
    heads = [str(column.header) for column in identification_table(tree).columns]
    assert heads == ["force", "formula", "direct"]
    text = " ".join(sentences_of(identification_blocks(tree)))
    assert "Averaging failed: its motion diverges" in text
    assert "agree" not in text
    drawn = motion_data(tree, 0)
    assert list(drawn.lines) == ["direct"]
    assert identification_json(tree)["methods"]["averaging"]["failed"]


# One noise.


def test_there_is_one_noise():
    tree = explained()
    noise = sensor_noise(tree["record"].to_dataset())
    assert record_noise(tree) == noise
    assert motion_data(tree, 0).noise == noise
    assert identification_json(tree)["cross_check"]["noise"] == noise
    compared = st.compare(tree["record"].to_dataset()[["angle"]], FORCES, [st.methods.Direct()])
    assert compared["comparison"].noise.item() == pytest.approx(noise)
    assert f"noise: {noise:.2g} rad" in words(identification_table(tree))[1]


# The fingerprint of slip.


def sharp(coefficients, library=None):
    count = len(coefficients) + 1
    return known(coefficients, 1e-10 * np.eye(count), library=library)


@pytest.mark.parametrize(
    ("coefficients", "speaks"),
    [
        ({"zeta": 0.01, "delta": 0.04, "alpha": 0.2, "nu": -0.09}, True),
        ({"zeta": 0.01, "delta": 0.04, "alpha": -0.2, "nu": -0.09}, False),
        ({"zeta": 0.01, "delta": 0.04, "alpha": 0.2, "nu": 0.09}, False),
        ({"zeta": 0.01, "delta": -0.04, "alpha": 0.2, "nu": -0.09}, False),
        ({"zeta": 0.01, "delta": 1e-5, "alpha": 0.2, "nu": -0.09}, False),
        ({"zeta": 0.01, "delta": 0.04, "nu": -0.09}, False),
    ],
)
def test_slip_needs_a_contact_that_softens_and_takes_energy(coefficients, speaks):
    result = sharp(coefficients)
    assert speaks_of_slip(result) is speaks
    assert any("slip" in line for line in physics_sentences(result, 0.3)) is speaks


# Another unit.


def test_sentences_are_in_the_unit_of_the_record():
    tree = explained().copy(deep=True)
    for node in tree.subtree:
        for variable in node.variables.values():
            if variable.attrs.get("units") == "rad":
                variable.attrs["units"] = "mm"
    tree["record"].angle.attrs["units"] = "mm"
    told = [*sentences_of(identification_blocks(tree)), *words(identification_table(tree))[1]]
    text = " ".join(told).replace("(rad/s^2)^2/Hz", "").replace("rad/s", "")
    assert " mm" in text
    assert not re.search(r"\bm?rad\b", text)


def test_a_file_that_begins_with_a_dash_is_no_option():
    given = DecayOptions(records=[Path("-a.csv"), Path("b.csv")])
    assert command_after(NextStep("identify", ""), [given]) == "sysid-trib identify ./-a.csv b.csv"


def test_forces_of_one_s_own_that_were_candidates_are_known_to_the_next_command():
    groups = [SearchOptions(candidates="own.toml"), ModelOptions()]
    step = NextStep("identify", "", {"forces": "zeta,slip"})
    assert command_after(step, groups) == "sysid-trib identify --library own.toml --forces zeta,slip"
    assert "--candidates own.toml" in command_after(NextStep("discover", ""), groups)
    both = [SearchOptions(candidates="own.toml"), ModelOptions(library="other.toml")]
    assert "--library other.toml" in command_after(step, both)
