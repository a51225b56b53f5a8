"""Public benchmarks: official splits and metrics, files that are missing or wrong, stand-ins end to end."""

import json
import shutil
from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from zipfile import BadZipFile

import nonlinear_benchmarks
import numpy as np
import pandas as pd
import pytest
from nonlinear_benchmarks.not_splitted_benchmarks import BoucWen
from scipy import io

import sysid_trib as st
from benchmarks.public import command, downloads, files, models, stand_ins
from benchmarks.public.report import Reporting, Score, score, to_submit
from benchmarks.public.signals import Signals, Split, Test as PublicTest, Units
from sysid_trib.errors import RecordError, SysidTribError

IN_METRES = Reporting("m", 1.0, ".3", "")
BOUC_WEN_UNITS = Units("N", "m", "smooth")
# Archives whose presence tells the official package that it has downloaded them.
ARCHIVES = (
    "Silverbox/SilverboxFiles.zip",
    "EMPS/EMPS.zip",
    "BoucWen/Hysteretic Benchmark with a Dynamic Nonlinearity_1_all.zip",
)
SIGNALS = Path("BoucWen/BoucWenFiles/Test signals/Validation signals")


@pytest.fixture(scope="module")
def layout(tmp_path_factory):
    """Stand-ins in the layout of the official package, as if it had downloaded them."""
    folder = tmp_path_factory.mktemp("official")
    for write in (stand_ins.write_silverbox, stand_ins.write_emps, stand_ins.write_bouc_wen):
        write(folder)
    for archive in ARCHIVES:
        (folder / archive).touch()
    return folder


@pytest.fixture
def own_copy(layout, tmp_path):
    """A copy of the stand-ins that a test may damage."""
    return shutil.copytree(layout, tmp_path / "copy")


def asked(**options) -> Namespace:
    usual = {"only": "", "folder": None, "out": None, "stand_ins": False, "unverified": False}
    return Namespace(**(usual | options))


def ending(capsys, **options) -> tuple[int, str]:
    """Return the exit status of the command, and what it says on errors."""
    try:
        command.public(asked(**options))
    except SystemExit as end:
        return int(end.code), capsys.readouterr().err
    return 0, capsys.readouterr().err


def same(test: PublicTest, official, per_input: float = 1.0) -> None:
    np.testing.assert_array_equal(test.signals.u, per_input * official.u)
    np.testing.assert_array_equal(test.signals.y, official.y)
    assert test.start_samples == (official.state_initialization_window_length or 0)


def test_the_split_of_silverbox_is_the_official_one(layout):
    split = files.read_silverbox(layout, verify=False)
    training, tests = nonlinear_benchmarks.Silverbox(dir_placement=layout)
    np.testing.assert_array_equal(split.training.u, training.u)
    np.testing.assert_array_equal(split.training.y, training.y)
    assert split.training.sampling_time == training.sampling_time
    for test, official in zip(split.tests, tests, strict=True):
        same(test, official)


def test_the_split_of_emps_is_the_official_one(layout):
    split = files.read_emps(layout, verify=False)
    training, test = nonlinear_benchmarks.EMPS(dir_placement=layout)
    np.testing.assert_array_equal(split.training.y, training.y)
    np.testing.assert_array_equal(split.training.u, stand_ins.CARRIAGE_DRIVE * training.u)
    assert split.training.sampling_time == pytest.approx(training.sampling_time, rel=1e-9)
    same(split.tests[0], test, stand_ins.CARRIAGE_DRIVE)
    pushed = split.tests[1].signals.u - split.tests[0].signals.u
    np.testing.assert_allclose(np.unique(np.round(pushed, 9)), [-60.0, 0.0, 60.0])
    assert [one.submitted for one in split.tests] == [True, False]


def test_the_tests_of_bouc_wen_are_the_official_ones(layout, capsys):
    split = files.read_bouc_wen(layout)
    for test, official in zip(split.tests, BoucWen(dir_placement=layout), strict=True):
        same(test, official)
    assert [test.periodic for test in split.tests] == [True, False]


def test_scores_are_the_textbook_ones_and_leave_the_start_out():
    y = np.array([9.0, 9.0, 1.0, 2.0, 3.0, 6.0])
    run = np.array([0.0, 0.0, 1.0, 3.0, 3.0, 4.0])
    found = score(PublicTest("", Signals(y, y, 1.0), 2), run, replace(IN_METRES, per_unit=1e3))
    # Errors 0, 1, 0, 2; the outputs 1, 2, 3, 6 have the mean 3 and the variance 14/4.
    rmse = np.sqrt(5.0 / 4.0)
    nrmse = rmse / np.sqrt(14.0 / 4.0)
    assert found.rmse == pytest.approx(1e3 * rmse, rel=1e-12)
    assert found.mae == pytest.approx(1e3 * 3.0 / 4.0, rel=1e-12)
    assert found.nrmse == pytest.approx(nrmse, rel=1e-12)
    assert found.r_squared == pytest.approx(1.0 - 5.0 / 14.0, rel=1e-12)
    assert found.fit_index == pytest.approx(100.0 * (1.0 - nrmse), rel=1e-12)
    assert found.samples == 4


def test_numbers_to_submit_have_the_form_of_the_templates():
    scores = [Score("", rmse, 0.0, 0.0, 0.0, 0.0, 1) for rmse in (0.28869, 12.3456, 1234.5)]
    silverbox, emps, _ = (benchmark.reporting for benchmark in command.BENCHMARKS)
    # What f"{x:.3}" and f"{x:.2f}" of the templates give.
    assert to_submit(scores, silverbox) == "[0.289; 12.3; 1.23e+03]"
    assert to_submit(scores[1:2], emps) == "12.35"


def test_a_free_run_sees_the_granted_samples_of_the_output_alone():
    model = st.Model(models.forces(("gain", "zeta")), {"gain": 0.05, "zeta": 0.02}, 9.9)
    time = 0.02 * np.arange(600)
    u = np.cos(6.0 * time)
    y = st.simulate(model, time, 0.1, 0.3, inputs={"u": u}).angle.values
    units = Units("N", "rad", "smooth")
    record = Signals(u, y, 0.02)
    result = st.methods.Direct(random_force="off").identify(record.record(units), model.library)
    test = PublicTest("", record, 50)
    run = models.free_run(result, test, units)
    assert np.abs(run - y).max() < 1e-3
    hidden = np.where(np.arange(len(y)) < 50, y, 1e3 * np.sin(time))
    other = PublicTest("", replace(record, y=hidden), 50)
    np.testing.assert_array_equal(models.free_run(result, other, units), run)
    at_rest = PublicTest("", replace(record, y=np.zeros(len(y))), 50)
    assert np.all(np.isfinite(models.free_run(result, at_rest, units)))


# The published equations in the words of the library.
TRUE_SHAPES = {"bouc_wen_g.s": 1.25e-3, "bouc_wen_g.g": -1.375}


def true_bouc_wen() -> st.Model:
    frequency = np.sqrt(stand_ins.STIFFNESS / stand_ins.MASS)
    zeta = stand_ins.DAMPING / (2.0 * stand_ins.MASS * frequency)
    truth = {"gain": 1.0 / stand_ins.STIFFNESS, "zeta": zeta, "bouc_wen_g": 1.0}
    return st.Model(models.forces(tuple(truth)), truth, frequency, TRUE_SHAPES)


def test_the_stand_in_of_bouc_wen_is_the_exact_motion_of_its_equations():
    record = stand_ins.bouc_wen_multisine().part(0, 1500)
    period = stand_ins.bouc_wen_multisine().u
    elapsed = record.sampling_time * np.arange(1500)
    exact = st.simulate(true_bouc_wen(), elapsed, 0.0, inputs={"u": period[:1500]}).angle.values
    integrated = stand_ins.bouc_wen_response(period, 1)[:1500]
    # The spline of the input is not exact in its first and last samples.
    assert np.std(integrated - exact) < 1e-3 * np.std(exact)


def test_the_measured_training_record_of_bouc_wen_is_that_of_the_equations(data_folder):
    record, said = files.bouc_wen_training_record(data_folder)
    response = stand_ins.bouc_wen_response(record.u[: stand_ins.PERIOD], stand_ins.PERIODS)
    assert np.std(record.y - response) == pytest.approx(stand_ins.BOUC_WEN_NOISE, rel=0.02)
    assert "train.csv" in said


def test_a_sweep_begins_at_rest_and_ends_at_fifty_hertz():
    sweep = stand_ins.bouc_wen_sweep()
    assert len(sweep) == 135_000
    assert np.abs(sweep.u).max() == pytest.approx(40.0, rel=1e-4)
    assert sweep.y[0] == 0.0
    crossings = np.flatnonzero(np.diff(np.sign(sweep.u[-750:])))
    assert len(crossings) == pytest.approx(2 * 50, abs=2)


def test_the_official_record_of_silverbox_is_recognised(data_folder):
    part = files.signals_of(data_folder / "silverbox" / "multisine_1_to_6.csv", "V1", "V2", 1.0)
    before = np.zeros(files.SILVERBOX_PRINT.first)
    whole = Signals(np.concatenate([before, part.u]), np.concatenate([before, part.y]), 1.0)
    assert files.SILVERBOX_PRINT.fits(whole)
    for other in (
        whole.part(1),
        replace(whole, y=1.003 * whole.y),
        replace(whole, u=-whole.u),
        replace(whole, u=whole.y, y=whole.u),
        replace(whole, y=whole.y[::-1]),
    ):
        assert not files.SILVERBOX_PRINT.fits(other)


def test_the_official_training_record_of_emps_is_recognised(data_folder, own_copy):
    shutil.copy(data_folder / "emps" / "DATA_EMPS.mat", own_copy / "EMPS" / "DATA_EMPS.mat")
    # The pulses are still the simulated ones.
    with pytest.raises(RecordError, match=r"DATA_EMPS_PULSES\.mat: its SHA-256 begins with"):
        files.read_emps(own_copy)


def rewritten(path: Path, **changed) -> None:
    """Write a file of MATLAB anew with other vectors; None leaves one out."""
    content = {name: value for name, value in io.loadmat(path).items() if not name.startswith("__")}
    content |= changed
    path.unlink()
    io.savemat(path, {name: value for name, value in content.items() if value is not None})


def test_plain_files_beside_each_other_are_read_as_the_official_layout_is(layout, tmp_path):
    for name, place in (("silverbox", "Silverbox/SilverboxFiles"), ("emps", "EMPS"), ("bouc_wen", SIGNALS)):
        shutil.copytree(layout / place, tmp_path / name)
    for benchmark in command.BENCHMARKS:
        official, plain = (benchmark.read(folder, verify=False) for folder in (layout, tmp_path))
        for one, other in zip(official.tests, plain.tests, strict=True):
            np.testing.assert_array_equal(one.signals.y, other.signals.y)


def test_tables_of_text_are_read_too(layout, tmp_path):
    whole = io.loadmat(layout / "Silverbox/SilverboxFiles/SNLS80mV.mat")
    (tmp_path / "silverbox").mkdir()
    (tmp_path / "bouc_wen").mkdir()
    table = pd.DataFrame({"V1": whole["V1"][0], "V2": whole["V2"][0]})
    table.to_csv(tmp_path / "silverbox/SNLS80mV.csv", index=False)
    found = files.read_silverbox(tmp_path, verify=False).tests[1].signals
    official = files.read_silverbox(layout, verify=False).tests[1].signals
    np.testing.assert_allclose(found.y, official.y, rtol=1e-12)
    tests = files.read_bouc_wen(layout).tests
    for name, test in zip(("multisine", "sinesweep"), tests, strict=True):
        signals = test.signals.part(0, 8192)
        time = signals.sampling_time * np.arange(8192)
        table = pd.DataFrame({"time (s)": time, "u (N)": signals.u, "y (m)": signals.y})
        table.to_csv(tmp_path / f"bouc_wen/test_{name}.csv", index=False)
    for one, other in zip(files.read_bouc_wen(tmp_path).tests, tests, strict=True):
        np.testing.assert_allclose(one.signals.u, other.signals.u[:8192], rtol=1e-12)


def without_samples(folder):
    path = folder / "Silverbox/SilverboxFiles/SNLS80mV.mat"
    content = io.loadmat(path)
    rewritten(path, V1=content["V1"][:, 41000:41900], V2=content["V2"][:, 41000:41900])


def without_output(folder):
    rewritten(folder / "Silverbox/SilverboxFiles/SNLS80mV.mat", V2=None)


def cut_off(folder):
    path = folder / "Silverbox/SilverboxFiles/SNLS80mV.mat"
    path.write_bytes(path.read_bytes()[:5000])


def a_page_of_a_login(folder):
    (folder / "EMPS/DATA_EMPS_PULSES.mat").write_text("<!DOCTYPE html><html>Sign in</html>")


def a_folder_for_a_file(folder):
    path = folder / "EMPS/DATA_EMPS_PULSES.mat"
    path.unlink()
    path.mkdir()


def uneven_times(folder):
    path = folder / "EMPS/DATA_EMPS_PULSES.mat"
    time = io.loadmat(path)["t"]
    rewritten(path, t=time + 0.4e-3 * (np.arange(len(time)) % 2)[:, None])


def no_drive(folder):
    rewritten(folder / "EMPS/DATA_EMPS.mat", gtau=None)


def not_a_number(folder):
    path = folder / SIGNALS / "yval_multisine.mat"
    values = io.loadmat(path)["yval_multisine"]
    values[0, 7] = np.nan
    rewritten(path, yval_multisine=values)


def another_length(folder):
    path = folder / SIGNALS / "yval_sinesweep.mat"
    rewritten(path, yval_sinesweep=io.loadmat(path)["yval_sinesweep"][:, :-1])


def no_motion(folder):
    path = folder / SIGNALS / "yval_multisine.mat"
    rewritten(path, yval_multisine=np.full((1, 8192), 1e-3))


def no_sweep(folder):
    (folder / SIGNALS / "uval_sinesweep.mat").unlink()


@pytest.mark.parametrize(
    ("damage", "only", "said"),
    [
        (without_samples, "silverbox", "it has 900 samples, and the official split needs 127400"),
        (without_output, "silverbox", "there is no single column 'V2'; its columns are"),
        (cut_off, "silverbox", "SNLS80mV.mat"),
        (a_page_of_a_login, "emps", "DATA_EMPS_PULSES.mat"),
        (a_folder_for_a_file, "emps", "this is a directory"),
        (uneven_times, "emps", "the times t are not equally spaced"),
        (no_drive, "emps", "it does not state gtau"),
        (not_a_number, "bouc_wen", "samples that are no finite number"),
        (another_length, "bouc_wen", "the input has 135000 samples and the output 134999"),
        (no_motion, "bouc_wen", "the output does not move"),
        (no_sweep, "bouc_wen", "uval_sinesweep.mat or test_sinesweep.csv or test_sinesweep.mat is not in"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_damaged_file_ends_in_one_sentence_and_status_one(own_copy, capsys, damage, only, said):
    damage(own_copy)
    status, text = ending(capsys, only=only, folder=own_copy, unverified=True)
    assert status == 1
    assert said in text
    assert len(text.splitlines()) == 1


@pytest.mark.parametrize("only", ["silverbox", "emps"])
def test_files_that_are_not_official_are_refused(layout, capsys, only):
    status, text = ending(capsys, only=only, folder=layout)
    assert status == 1
    assert "give --unverified to use it anyway, as a record that is not official" in text


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda signals: signals.part(0, 8000), "the test multisine has 8000 samples, the official one 8192"),
        (lambda signals: replace(signals, u=1e-3 * signals.u), "RMS 0.05 N, the official one 50 N"),
        (lambda signals: replace(signals, u=signals.y, y=signals.u), "the official one 50 N"),
    ],
)
def test_signals_that_bouc_wen_does_not_describe_are_refused(own_copy, change, said):
    place = own_copy / SIGNALS
    changed = change(stand_ins.bouc_wen_multisine())
    rewritten(place / "uval_multisine.mat", uval_multisine=changed.u[None, :])
    rewritten(place / "yval_multisine.mat", yval_multisine=changed.y[None, :])
    with pytest.raises(RecordError, match=said):
        files.read_bouc_wen(own_copy)


@pytest.mark.parametrize(
    "failure", [ConnectionError("no route"), BadZipFile("a page"), Exception("five tries")]
)
def test_without_network_each_benchmark_says_where_its_files_are(monkeypatch, tmp_path, capsys, failure):
    def load(*, data_file_locations, dir_placement):
        assert data_file_locations
        # What an interrupted download leaves behind.
        (Path(dir_placement) / "EMPS").mkdir()
        raise failure

    monkeypatch.setenv("SYSID_TRIB_BENCHMARKS", str(tmp_path))
    monkeypatch.setattr(downloads, "loaders", lambda: dict.fromkeys(("Silverbox", "EMPS", "BoucWen"), load))
    status, text = ending(capsys)
    lines = text.splitlines()
    assert status == 1
    assert [line.partition(":")[0] for line in lines] == ["Silverbox", "EMPS", "Bouc-Wen"]
    assert all("nonlinearbenchmark.org" in line and "--folder" in line for line in lines)
    assert list(tmp_path.iterdir()) == []


def test_a_download_is_made_once_and_kept(monkeypatch, tmp_path, layout, capsys):
    calls = []

    def load(*, data_file_locations, dir_placement):
        calls.append(dir_placement)
        print("extracting file...")
        shutil.copytree(layout / "EMPS", Path(dir_placement) / "EMPS")

    monkeypatch.setenv("SYSID_TRIB_BENCHMARKS", str(tmp_path))
    monkeypatch.setattr(downloads, "loaders", lambda: {"EMPS": load})
    assert downloads.download("EMPS") == downloads.download("EMPS") == tmp_path
    assert len(calls) == 1
    assert files.read_emps(tmp_path, verify=False).tests[0].name == "pulses"
    assert [path.name for path in tmp_path.iterdir()] == ["EMPS"]
    status, text = ending(capsys, only="emps")
    assert status == 1
    assert f"Delete {tmp_path / 'EMPS'} to download it anew." in text


def test_the_official_loaders_have_the_options_that_are_used(layout):
    for name, load in downloads.loaders().items():
        assert Path(np.atleast_1d(load(data_file_locations=True, dir_placement=layout))[-1]).exists(), name


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"only": "silverbx"}, "Did you mean 'silverbox'?"),
        ({"folder": Path("/no/such/folder")}, "there is no such folder"),
        ({"out": Path("/no/such/folder/out.json")}, "name a file in a folder that exists"),
    ],
)
def test_wrong_options_end_with_status_two(capsys, options, said):
    status, text = ending(capsys, **options)
    assert status == 2
    assert said in text


def trial(parameters: int, error: float) -> models.Trial:
    return models.Trial(models.Candidate("", parameters, lambda records: None), error)


@pytest.mark.parametrize(
    ("trials", "parameters"),
    [
        ([trial(5, 1.0), trial(8, 0.5), trial(12, 0.499)], 8),
        ([trial(5, 1.0), trial(8, 0.5), trial(12, 0.4)], 12),
        ([trial(12, 0.4), trial(8, 0.5)], 12),
        ([trial(5, 1.0), trial(8, 1.2)], 5),
    ],
)
def test_a_further_parameter_must_be_worth_one_per_cent(trials, parameters):
    assert models._smallest_sufficient(trials).candidate.parameters == parameters


def test_of_two_models_with_as_many_parameters_the_better_one_is_chosen():
    assert models._smallest_sufficient([trial(5, 1.005), trial(5, 1.0), trial(6, 0.995)]).error == 1.0


def test_a_candidate_that_cannot_be_fitted_is_left_out_and_none_is_an_error():
    def refused(records):
        raise SysidTribError("no fit")

    whole = Signals(np.ones(3), np.ones(3), 1.0).record(BOUC_WEN_UNITS)
    good = models.Candidate("good", 5, lambda records: whole)
    bad = models.Candidate("bad", 3, refused)

    def error(one):
        return float(one.fit([whole]).angle.sum())

    chosen = models._choose([bad, good], error, whole, "")
    assert chosen.trial.candidate.name == "good"
    with pytest.raises(SysidTribError, match="no fit"):
        models._choose([bad], error, whole, "")


@pytest.fixture(scope="module")
def answer():
    """The answer on the steady response of a linear oscillator, whose model is given, not chosen."""
    random = np.random.default_rng(3)
    lines = np.arange(5, 60)
    elapsed = np.arange(4 * 512) / 750.0
    phases = random.uniform(0.0, 2.0 * np.pi, len(lines))
    u = np.cos(2.0 * np.pi * np.outer(elapsed, lines * 750.0 / 512) + phases).sum(axis=1)
    model = st.Model(models.forces(("gain", "zeta")), {"gain": 2e-5, "zeta": 0.05}, 158.0)
    y = st.simulate(model, elapsed, 0.0, inputs={"u": u}).angle.values
    last = Signals(u, y, 1.0 / 750.0).part(3 * 512)
    result = st.methods.Direct(random_force="off").identify(last.record(BOUC_WEN_UNITS), model.library)
    split = Split(last, (PublicTest("multisine", last, 0, periodic=True),), "said", official=True)
    taken = models.Trial(models.Candidate("gain zeta", 3, lambda records: result), 1.0)
    chosen = models.Chosen((taken,), taken, result, "given", 1.0)
    benchmark = replace(command.BENCHMARKS[2], choose=lambda training, units: chosen)
    return command.answered(benchmark, split, "Bouc-Wen")


def test_a_periodic_test_is_run_in_its_steady_state_without_its_output(answer):
    assert answer.scores[0].samples == 512
    assert answer.scores[0].nrmse < 1e-2


def test_the_fields_of_a_submission_are_written(answer, tmp_path, capsys):
    path = tmp_path / "submission.json"
    command.write([answer, replace(answer, split=replace(answer.split, official=False))], path)
    official, other = json.loads(path.read_text(encoding="utf-8"))
    assert official["RMSE_to_submit"] == format(answer.scores[0].rmse, ".3")
    assert other["RMSE_to_submit"] is None
    wanted = {"title", "authors", "model_class", "RMSE", "link", "number_of_parameters", "training_time_s"}
    assert wanted < official.keys()
    with pytest.raises(RecordError, match="cannot be written"):
        command.write([answer], tmp_path)
    answer.show()
    assert f"RMSE to submit = {official['RMSE_to_submit']}" in capsys.readouterr().out
    replace(answer, split=replace(answer.split, official=False)).show()
    assert "not to be submitted" in capsys.readouterr().out


@pytest.mark.in_full
def test_bouc_wen_end_to_end(layout, tmp_path, capsys):
    """From simulated training data the equations are found; noise leaves less than a thousandth."""
    path = tmp_path / "out.json"
    assert ending(capsys, only="bouc_wen", folder=layout, out=path)[0] == 0
    (fields,) = json.loads(path.read_text(encoding="utf-8"))
    assert fields["model"].startswith("gain zeta bouc_wen_g")
    assert all(scores["NRMSE"] < 1e-3 for scores in fields["other_scores"].values())


@pytest.mark.in_full
def test_silverbox_end_to_end(layout, tmp_path, capsys):
    """A Duffing circuit is followed to its noise where the arrow extrapolates."""
    path = tmp_path / "out.json"
    assert ending(capsys, only="silverbox", folder=layout, out=path, unverified=True)[0] == 0
    (fields,) = json.loads(path.read_text(encoding="utf-8"))
    assert not fields["official_tests"]
    assert set(fields["RMSE"]) == {"multisine", "arrow (full)", "arrow (no extrapolation)"}
    # mV; the RMS of 30,000 samples of noise is known to 0.4 %.
    assert all(0.99 <= rmse / (1e3 * stand_ins.CIRCUIT_NOISE) < 1.2 for rmse in fields["RMSE"].values())


@pytest.mark.slow
def test_emps_end_to_end(layout, tmp_path, capsys):
    path = tmp_path / "out.json"
    assert ending(capsys, only="emps", folder=layout, out=path, unverified=True)[0] == 0
    (fields,) = json.loads(path.read_text(encoding="utf-8"))
    assert fields["other_scores"]["pulses"]["NRMSE"] < 0.05
