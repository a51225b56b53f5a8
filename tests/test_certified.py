"""The certified decays: what is shipped is what is made, and holds against an independent engine."""

import gzip

import numpy as np
import pandas as pd
import pytest
from command_line import run

import sysid_trib as st
from benchmarks.certified import (
    AGREEMENT,
    DECAYS,
    FOLDER,
    LEVELS,
    bounds,
    checked,
    contents,
    noisy,
    record_name,
    seed_of,
)
from sysid_trib.errors import RecordError, UsageError

NAMES = [record_name(decay, noise) for decay in DECAYS for noise in LEVELS]
# Decays whose check takes a second: friction that jumps and stops, and few samples.
QUICK = [decay for decay in DECAYS if decay.name in ("stops", "short")]


def test_the_set_is_complete_and_small():
    assert [name for name in st.datasets.names() if name.startswith("certified/")] == NAMES
    assert len(NAMES) == 36
    assert {path.name.partition(".")[0] for path in FOLDER.glob("*.csv.gz")} == {
        name.partition("/")[2] for name in NAMES
    }
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 1_000_000


def test_seeds_differ():
    assert len({seed_of(decay, noise) for decay in DECAYS for noise in LEVELS}) == 36


@pytest.mark.parametrize("decay", DECAYS, ids=lambda decay: decay.name)
def test_a_record_is_the_stated_motion_with_the_stated_noise(decay):
    motion = st.simulate(decay.model, decay.time, decay.angle, decay.rate).angle.values
    for noise in LEVELS:
        name = record_name(decay, noise)
        record, truth = st.datasets.load(name), st.datasets.truth(name)
        np.testing.assert_allclose(record.time, decay.time, atol=1e-9)
        rest = record.angle.values - motion
        assert np.std(rest) == pytest.approx(noise, rel=4.0 / np.sqrt(2.0 * len(rest)))
        np.testing.assert_array_equal(record.angle, noisy(decay, motion, noise, truth.attrs["seed"]))


@pytest.mark.parametrize("decay", DECAYS, ids=lambda decay: decay.name)
def test_the_truth_is_that_of_the_decay(decay):
    truths = [st.datasets.truth(record_name(decay, noise)) for noise in LEVELS]
    for noise, truth in zip(LEVELS, truths, strict=True):
        assert truth.quantity.values.tolist() == decay.unknowns
        assert truth.value.values.tolist() == [decay.truth[name] for name in decay.unknowns]
        assert truth.noise.item() == noise
        assert truth.reference_frequency.item() == decay.w
        assert ("reference_frequency" in truth.quantity.values) != truth.attrs["reference_frequency_is_given"]
        # A bound is proportional to the noise.
        np.testing.assert_allclose(truth.bound / noise, truths[0].bound / LEVELS[0], rtol=1e-10)


@pytest.mark.parametrize("decay", QUICK, ids=lambda decay: decay.name)
def test_motion_and_bounds_are_those_of_an_independent_engine(decay):
    other = checked(decay)
    stored = st.datasets.truth(record_name(decay, LEVELS[0]))
    independent = [LEVELS[0] * other.bounds()[name] for name in decay.unknowns]
    np.testing.assert_allclose(stored.bound, independent, rtol=AGREEMENT)


def test_a_wrong_bound_is_noticed(monkeypatch):
    wrong = {name: 1.00001 * bound for name, bound in bounds(QUICK[0]).items()}
    monkeypatch.setattr("benchmarks.certified.bounds", lambda decay: wrong)
    with pytest.raises(AssertionError, match="two engines differ"):
        checked(QUICK[0])


@pytest.mark.slow
def test_the_set_made_anew_is_the_shipped_one():
    for decay in DECAYS:
        checked(decay)
    for name, content in contents().items():
        if name == "truth.csv":
            made = pd.DataFrame([line.split(",") for line in content.decode().splitlines()[1:]])
            shipped = pd.read_csv(FOLDER / name)
            assert made[[0, 1]].to_numpy().tolist() == shipped[["name", "quantity"]].to_numpy().tolist()
            numbers = made[[2, 3]].to_numpy(dtype=float)
            np.testing.assert_allclose(numbers, shipped[["value", "bound"]], rtol=AGREEMENT)
        elif name == "decays.csv":
            assert (FOLDER / name).read_bytes() == content
        else:
            assert gzip.decompress((FOLDER / f"{name}.gz").read_bytes()) == content


def answers(**changed):
    """Return answers for a decay that are off by one bound each."""
    truth = st.datasets.truth("certified/viscous_1e-4").sel(quantity=["zeta", "reference_frequency"])
    table = {
        "name": "certified/viscous_1e-4",
        "coefficient": truth.quantity.values,
        "value": truth.value.values + truth.bound.values * [1.0, -1.0],
        "error": 2.0 * truth.bound.values,
    }
    return pd.DataFrame(table | changed)


def test_a_score_is_the_error_over_the_bound(tmp_path):
    score = st.datasets.score(answers())
    assert score.index.names == ["name", "coefficient"]
    np.testing.assert_allclose(score.error_over_bound, [1.0, -1.0], rtol=1e-6)
    np.testing.assert_allclose(score.stated_over_bound, 2.0)
    answers().to_csv(tmp_path / "answers.csv", index=False)
    pd.testing.assert_frame_equal(st.datasets.score(tmp_path / "answers.csv"), score)


def test_a_missing_answer_counts_as_failed():
    for table in (answers().iloc[:1], answers(value=[0.01, np.inf]), answers(value=["0.01", None])):
        assert st.datasets.score(table).error_over_bound.isna().tolist() == [False, True]


def test_errors_need_not_be_stated():
    score = st.datasets.score(answers().drop(columns="error"))
    assert score.stated_over_bound.isna().all()
    assert score.error_over_bound.notna().all()


@pytest.mark.parametrize(
    ("table", "kind", "said"),
    [
        (answers(name="certified/viscos_1e-4"), UsageError, "Did you mean 'certified/viscous_1e-4'"),
        (answers(coefficient=["zeta", "delta"]), UsageError, "has no coefficient 'delta'; it has zeta"),
        (answers(coefficient=["zeta", "start_angle"]), UsageError, "no coefficient 'start_angle'"),
        (answers(coefficient="zeta"), RecordError, "answered twice"),
        (answers(value="much"), RecordError, "'much' is no number"),
        (answers().drop(columns="value"), RecordError, "no column value"),
        (answers().iloc[:0], RecordError, "has no row"),
    ],
)
def test_bad_answers_are_refused(table, kind, said):
    with pytest.raises(kind, match=said):
        st.datasets.score(table)


def test_answers_that_are_no_table_are_refused(tmp_path):
    with pytest.raises(UsageError, match="no such file"):
        st.datasets.score(tmp_path / "absent.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x01" * 100)
    with pytest.raises(RecordError):
        st.datasets.score(tmp_path / "binary.csv")
    (tmp_path / "empty.csv").write_bytes(b"")
    with pytest.raises(RecordError, match="no table of answers"):
        st.datasets.score(tmp_path / "empty.csv")


def test_the_truth_of_a_measured_record_is_unknown():
    with pytest.raises(UsageError, match="is not certified"):
        st.datasets.truth("ship_roll")


def test_direct_identification_reaches_the_bound_on_one():
    name = "certified/three_frictions_1e-4"
    library = st.load_library("contact_forces").select(["lambda", "zeta", "delta"])
    result = st.identify(st.datasets.load(name), library, st.methods.Direct())
    truth = st.datasets.truth(name)
    found = [*result.coefficient.values, result.reference_frequency.item()]
    scored = truth.sel(quantity=[*library.symbols, "reference_frequency"])
    assert np.all(np.abs(found - scored.value) < 4.0 * scored.bound)


def test_a_certified_decay_is_a_record_of_commands(monkeypatch):
    # It needs neither a folder of data nor pooch.
    monkeypatch.setenv("SYSID_TRIB_DATA", "/nowhere")
    monkeypatch.setitem(__import__("sys").modules, "pooch", None)
    ending = run("look", "dataset:certified/viscous_1e-4")
    assert ending.status == 0
    assert "Record: dataset:certified/viscous_1e-4, angle in rad" in ending.out
    ending = run("look", "dataset:certified/viscous_1e-2")
    assert ending.status == 2
