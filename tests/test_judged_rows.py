"""Rows of a campaign's store are what the single command judges, for each task and each kind of record."""

import json
import re
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from command_line import linear, run, write_csv

import sysid_trib as st
from sysid_trib.campaigns.task import Task, empty_row
from sysid_trib.discovery import judged_models
from sysid_trib.errors import RecordError
from sysid_trib.records.inputs import KnownInput
from sysid_trib.results.store import JUDGED_NAMES, STORE_FORMAT
from sysid_trib.simulation.simulate import trajectory

pytest.importorskip("zarr", reason="campaigns need the extra of this name")
TIME = np.arange(0.0, 12.0, 0.02)
LIBRARY = st.load_library().select(["lambda", "zeta"])


@cache
def decay(units="rad", force="lambda"):
    """Return a decay with one force more than viscous damping."""
    model = st.Model(st.load_library(), {force: 1e-3, "zeta": 0.01}, 9.9)
    angle = st.simulate(model, TIME, 0.3).angle.values
    noise = 3e-4 * np.random.default_rng(5).standard_normal(TIME.size)
    return st.free_decay(xr.Dataset({"angle": ("time", angle + noise, {"units": units})}, {"time": TIME}))


def driven():
    """Return an oscillator that a sine drives."""
    push = 3.0 * np.sin(8.0 * TIME)
    inputs = {"u": KnownInput(TIME, push)}
    model = st.Model(st.library(zeta="2*v", gain="-u"), {"zeta": 0.02, "gain": 0.01}, 9.0, inputs=inputs)
    angle = trajectory(model, TIME, 0.1, 0.0).angle
    angle = angle + 1e-4 * np.random.default_rng(0).standard_normal(len(TIME))
    return xr.Dataset(
        {"angle": ("time", angle, {"units": "rad"}), "u": ("time", push, {"role": "input"})}, {"time": TIME}
    )


def row_of(task, record, folder):
    """Return the row of a record in a store that is read back."""
    st.campaign([record], task, output=folder / "one.zarr", workers=0)
    return st.campaigns.open_store(folder / "one.zarr").isel(record=0).load()


def assert_is_row(row, table, labels=None):
    """Compare the judged variables of a row with those of a result: the same numbers, to the bit."""
    models = table.model.values.tolist()
    labels = labels or models
    for name in JUDGED_NAMES:
        kept = row[name].sel(model=labels).values
        np.testing.assert_array_equal(kept, table[name].values, err_msg=name)
    others = row.drop_sel(model=labels)
    assert set(others.verdict.values.tolist()) <= {""}
    assert np.isnan(others.residual_rms.values).all()
    assert row.preferred.item() == dict(zip(models, labels, strict=True))[table.attrs["preferred"]]


def few_candidates():
    return st.library(friction="sign(v)", drag="v*abs(v)")


METHODS = {"by averages": st.methods.Averaging(), "by the motion": st.methods.Direct()}
# Task and the single call, of a record.
TASKS = {
    "identify": (Task("identify", LIBRARY), lambda record: st.identify(record, LIBRARY)),
    "compare": (
        Task("compare", LIBRARY, METHODS),
        lambda record: st.compare(record, LIBRARY, METHODS),
    ),
    "discover": (
        Task("discover", st.library(zeta="2*v"), candidates=few_candidates()),
        lambda record: st.discover(record, st.library(zeta="2*v"), few_candidates()),
    ),
    "laws": (
        Task("laws", st.load_library(), speeds=(0.5,)),
        lambda record: st.laws(record, library=st.load_library()),
    ),
}


@pytest.mark.parametrize(
    "name", ["identify", *(pytest.param(name, marks=pytest.mark.slow) for name in [*TASKS][1:])]
)
def test_a_row_equals_the_judgement_of_the_single_call(name, tmp_path):
    task, alone = TASKS[name]
    record = decay()
    result = alone(record)
    row = row_of(task, record, tmp_path)
    assert_is_row(row, result["judged"].to_dataset())
    if name == "identify":
        assert row.agreement_p_value.item() == result["agreement"].p_value.item()
    if name == "discover":
        assert row.search_outcome.item() == result.attrs["search_outcome"]
        assert row.converged.item() == bool(result["converged"])


def test_a_displacement_is_judged_in_its_unit(tmp_path):
    row = row_of(Task("identify", LIBRARY), decay("mm"), tmp_path)
    assert_is_row(row, st.identify(decay("mm"), LIBRARY)["judged"].to_dataset())
    assert (row.residual_rms.attrs["units"], row.signal_units.item()) == ("see signal_units", "mm")


def test_methods_of_ones_own_have_their_labels(tmp_path):
    tree = st.identify(decay(), LIBRARY, [*METHODS.values()])
    row = row_of(Task("identify", LIBRARY, METHODS, cross_checked=True), decay(), tmp_path)
    assert_is_row(row, tree["judged"].to_dataset(), [*METHODS])
    assert np.isfinite(row.coefficient.values).all()


def test_methods_without_a_cross_check_are_judged(tmp_path):
    row = row_of(Task("identify", LIBRARY, METHODS), decay(), tmp_path)
    judged = st.identify(decay(), LIBRARY, [*METHODS.values()])["judged"].to_dataset()
    assert_is_row(row, judged.assign_attrs(preferred="direct"), [*METHODS])
    assert "agreement_p_value" not in row


@pytest.mark.slow
def test_a_driven_record_is_judged_by_the_methods_that_it_takes(tmp_path):
    library = st.library(zeta="2*v", gain="-u")
    row = row_of(Task("identify", library), driven(), tmp_path)
    assert_is_row(row, st.identify(driven(), library)["judged"].to_dataset())
    assert np.isnan(row.coefficient.sel(model="averaging").values).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "words"),
    [
        ("identify", ["--forces", "zeta,delta"]),
        ("compare", ["--forces", "zeta"]),
        ("discover", ["--forces", "zeta", "--candidates", "few.toml"]),
        ("laws", []),
    ],
)
def test_json_of_a_campaign_is_that_of_the_command(task, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "few.toml").write_text('[[force]]\nsymbol = "drag"\nformula = "v*abs(v)"\n')
    write_csv(tmp_path / "one.csv", TIME, decay().angle.values)
    alone = run(task, "one.csv", *words, "--json")
    speeds = ["--speeds", "0.5"] if task == "laws" else []
    many = run(
        "campaign", "one.csv", "--task", task, *words, *speeds, "--json", "-o", "a.zarr", "--workers", "0"
    )
    assert (alone.err, many.err) == ("", "")
    said, found = json.loads(alone.out), json.loads(many.out)
    assert found["judged"]["one.csv"] == said["judged"]
    assert found["verdicts"] == {said["judged"][next(iter(found["preferred"]))]["verdict"]: 1}
    if task == "discover":
        assert found["search_outcomes"] == {said["search_outcome"]: 1}
    page = (Path(__file__).parents[1] / "docs" / "json.md").read_text(encoding="utf-8")
    section = page.partition("\n## campaign\n")[2].partition("\n## ")[0]
    assert set(found) <= set(re.findall(r"`([a-z_]+)", section))


def older(change):
    """Return a function that changes the attributes of a store."""

    def edit(place):
        file = place / ".zattrs"
        file.write_text(json.dumps(change(json.loads(file.read_text()))))

    return edit


OLDER = {
    "without a number": (
        older(lambda attrs: {k: v for k, v in attrs.items() if k != "format_version"}),
        "a format before 5",
    ),
    "of another number": (older(lambda attrs: attrs | {"format_version": 99}), "format 99"),
}


@pytest.mark.parametrize("which", OLDER)
def test_a_store_of_another_format_gets_one_sentence(which, tmp_path):
    edit, text = OLDER[which]
    file = write_csv(tmp_path / "r.csv", TIME, linear(TIME, 0.01))
    words = ("campaign", file, "--forces", "zeta", "--methods", "direct", "--workers", "0")
    place = tmp_path / "a.zarr"
    assert run(*words, "-o", place).status == 0
    edit(place)
    with pytest.raises(RecordError, match=f"{text}, and this version of sysid_trib reads and continues"):
        st.campaigns.open_store(place)
    ending = run(*words, "-o", place)
    assert ending.status == 1
    assert ending.err.count("\n") == 1
    assert f"a.zarr: this store of a campaign has {text}" in ending.complaint
    assert f"format {STORE_FORMAT}; run the campaign again" in ending.complaint


@pytest.mark.slow
def test_speeds_that_no_record_visits_are_reported(tmp_path):
    file = write_csv(tmp_path / "r.csv", TIME, linear(TIME, 0.01))
    words = ("campaign", file, "--task", "laws", "--workers", "0")
    ending = run(*words, "--speeds", "0.5,50", "-o", tmp_path / "a.zarr")
    assert "No record visits the speed of friction(50): give smaller --speeds." in ending.out
    ending = run(*words, "--speeds", "0.5", "-o", tmp_path / "b.zarr")
    assert "No record visits" not in ending.out


def searched(force, monkeypatch):
    """Return a discovery of a record, and how many models were identified again for its verdicts."""
    counted, again = [], judged_models._identified_again
    monkeypatch.setattr(
        judged_models, "_identified_again", lambda *given: counted.append(given) or again(*given)
    )
    start = st.library(zeta="2*v", friction="sign(v)") if force == "lambda" else st.library(zeta="2*v")
    return st.discover(decay(force=force), start, st.library(drag="v*abs(v)")), len(counted)


def test_a_model_to_which_nothing_is_added_is_judged_once(monkeypatch):
    tree, count = searched("lambda", monkeypatch)
    assert tree["steps"].attrs["count"] == 0
    assert count == 1
    before, after = (tree["judged"].to_dataset().sel(model=name, drop=True) for name in ("before", "after"))
    xr.testing.assert_equal(before.drop_vars("held_out_rms"), after.drop_vars("held_out_rms"))
    assert tree["judged"].attrs["preferred"] == "after"


def test_the_variables_of_a_row_depend_on_its_task_alone():
    def names(task):
        return set(empty_row(task))

    checked, methods = Task("identify", LIBRARY), Task("identify", LIBRARY, METHODS)
    assert names(checked) - names(methods) == {"agreement_p_value"}
    # The order in which tasks are asked changes nothing.
    assert names(checked) - names(methods) == {"agreement_p_value"}
    assert names(TASKS["discover"][0]) - names(methods) == {
        *("search_outcome", "converged", "named", "tied", "effect_p_value")
    }
