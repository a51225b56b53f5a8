"""The one schema of an identification; its files, whole or the older ones; files that are no records."""

import json
import os

import numpy as np
import pytest
import xarray as xr
from command_line import TIME as WRITTEN_TIME, linear, run, write_csv
from helpers import FIVE, SIX, W, paper_run
from matplotlib.figure import Figure

import sysid_trib
import sysid_trib as st
from sysid_trib import load_library
from sysid_trib.commands.shown import write_record
from sysid_trib.discovery.to_xarray import TABLES
from sysid_trib.errors import RecordError, UsageError
from sysid_trib.methods import Averaging, Direct
from sysid_trib.reporting.page import write_page
from sysid_trib.results.files import load, save, write_figure
from sysid_trib.results.frequencies import asymptotic_frequency, covariance_with_frequency
from sysid_trib.results.models import library_of
from sysid_trib.results.schema import Estimate, identification, model_of
from sysid_trib.results.variables import RESULT_TABLES, scaling_of
from sysid_trib.simulation.trajectory import trajectory

FORCES = load_library()
PER_FORCE = {"coefficient", "standard_error", "covariance", "active", "refers_to"}
SCALARS = {"reference_frequency", "asymptotic_frequency", "noise", "birge_ratio"}


def record(**attrs):
    return paper_run().decay(0).assign_attrs(attrs)


@pytest.mark.parametrize("method", [Averaging(correct=False), Direct(), Direct(form="strong")], ids=str)
def test_every_method_returns_the_same_schema(method):
    result = method.identify(record(), FORCES)
    assert set(result.data_vars) >= PER_FORCE | SCALARS
    assert result.covariance.dims == ("force", "other_force")
    assert all(result[name].dims == () for name in SCALARS)
    assert all(v.attrs.get("long_name") for v in result.data_vars.values())
    assert all("units" in result[name].attrs for name in SCALARS)
    np.testing.assert_allclose(np.sqrt(np.diag(result.covariance)), result.standard_error, rtol=1e-9)
    assert result.unit.values.tolist() == ["1"] * 5
    assert result.formula.sel(force="zeta").item() == "2*v"
    assert np.all(result.refers_to == result.reference_frequency)


def test_provenance():
    attrs = Direct(W, shapes={}).identify(record(source="run.csv", record_checksum="abc"), FORCES).attrs
    assert attrs["method"] == "direct"
    assert json.loads(attrs["options"])["reference_frequency"] == W
    assert attrs["sysid_trib_version"] == sysid_trib.__version__
    assert (attrs["record_source"], attrs["record_checksum"]) == (["run.csv"], ["abc"])
    assert attrs["library_title"] == FORCES.title
    # netCDF supports only these types of attributes.
    assert all(isinstance(value, str | int | float | list) for value in attrs.values())


def test_library_and_model_come_back():
    result = Direct(W, significance=0.01).identify(record(), FORCES)
    assert library_of(result).symbols == tuple(SIX)
    assert library_of(result, whole=True).forces == FORCES.forces
    model = model_of(result)
    assert set(model.coefficients) == set(FIVE)
    assert model.reference_frequency == W
    assert model.coefficients["nu"] == result.coefficient.sel(force="nu").item()


def test_a_model_read_back_moves_as_the_record():
    result = Direct(W).identify(record(), FORCES)
    time = record().time.values
    angle = trajectory(model_of(result), time, result.start_angle.item(), result.start_rate.item()).angle
    gap = record().angle.values - result.offset.item() - angle
    assert np.sqrt(np.mean(gap**2)) == pytest.approx(1e-4, rel=0.05)


def test_saved_and_read_back_the_same(tmp_path):
    result = Averaging(correct=False).identify(record(), FORCES)
    save(result, tmp_path / "one.nc")
    xr.testing.assert_identical(load(tmp_path / "one.nc").to_dataset(), result)
    tree = xr.DataTree.from_dict({"averaging": result, "direct": Direct(W).identify(record(), FORCES)})
    save(tree, tmp_path / "two.nc")
    back = load(tmp_path / "two.nc")
    xr.testing.assert_identical(back, tree)
    assert back["direct"].active.dtype == bool
    assert sorted(p.name for p in tmp_path.iterdir()) == ["one.nc", "two.nc"]


def test_unreadable_result_is_refused(tmp_path):
    with pytest.raises(UsageError, match="no file"):
        load(tmp_path / "missing.nc")
    (tmp_path / "text.nc").write_text("time,angle\n")
    with pytest.raises(RecordError, match=r"text\.nc: not a result"):
        load(tmp_path / "text.nc")
    save(xr.Dataset(attrs={"sysid_trib_version": "0.1.0", "format_version": 2}), tmp_path / "old.nc")
    with pytest.raises(RecordError, match=r"old\.nc: a result in format 2, .* make the result again"):
        load(tmp_path / "old.nc")


def test_asymptotic_frequency_and_its_gradient():
    coefficients = np.array([1e-3, 0.05, 0.037, 0.25, -0.4, 0.3])
    found, gradient = asymptotic_frequency(FORCES, coefficients, W)
    # Le Bot et al. 2019, with alpha and zeta together: not the product sqrt(1 + alpha) sqrt(1 - zeta^2).
    assert found / W == pytest.approx(1.116915, abs=5e-7)
    step = 1e-6
    for j in range(7):
        moved = np.append(coefficients, W)
        moved[j] += step
        there, _ = asymptotic_frequency(FORCES, moved[:-1], moved[-1])
        assert gradient[j] == pytest.approx((there - found) / step, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("zeta", [0.02, 1.3], ids=["oscillates", "overdamped at rest"])
def test_the_covariance_with_the_frequency_comes_back(zeta):
    library = FORCES.select(["lambda", "zeta", "delta"])
    factor = np.random.default_rng(0).standard_normal((4, 4)) * 1e-3
    covariance = factor @ factor.T
    estimate = Estimate(np.array([1e-3, zeta, 0.03]), covariance, W, [1e-3])
    result = identification(Direct(), record(), library, estimate, offered=library)
    assert (result.asymptotic_frequency.item() == 0.0) == (zeta > 1.0)
    np.testing.assert_allclose(covariance_with_frequency(result), covariance, rtol=1e-9)


TIME = np.arange(1500) / 100.0
RECORD = xr.Dataset({"angle": ("time", 0.3 * np.cos(9.91 * TIME))}, {"time": TIME})
NAMES = ["one.nc", "one.csv", "one.html", "one.pdf"]


def write(target):
    """Write some 15 to 60 kB."""
    if target.suffix == ".html":
        write_page("<p>" * 20_000, target)
    elif target.suffix == ".pdf":
        figure = Figure()
        figure.subplots().plot(TIME, RECORD.angle)
        write_figure(figure, target.with_suffix(""))
    else:
        write_record(RECORD, target)


def full(_):
    raise OSError(28, "No space left on device")


def cut_short(descriptor):
    os.ftruncate(descriptor, 10)


@pytest.mark.slow
@pytest.mark.parametrize(("fault", "reason"), [(full, "No space left"), (cut_short, "read back")])
@pytest.mark.parametrize("name", NAMES)
def test_a_disk_that_fills_up_leaves_the_older_file(tmp_path, monkeypatch, fault, reason, name):
    target = tmp_path / name
    target.write_text("older")
    monkeypatch.setattr(os, "fsync", fault)
    with pytest.raises(
        RecordError, match=rf"{name}: cannot be written \(.*{reason}.*\); choose another place\.$"
    ):
        write(target)
    assert [p.name for p in tmp_path.iterdir()] == [name]
    assert target.read_text() == "older"


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_a_result_may_be_read_by_all_whom_the_umask_allows(tmp_path):
    save(RECORD, tmp_path / "one.nc")
    (tmp_path / "plain").write_text("")
    assert (tmp_path / "one.nc").stat().st_mode == (tmp_path / "plain").stat().st_mode


SHOWN = {
    "by_command.nc": "this is a result of identify, no record; sysid-trib report by_command.nc -o by_command",
    "from_python.nc": "this is a result of direct, no record; sysid-trib report from_python.nc",
    "printed.json": "this is the output of a command with --json, no record; -o RESULT.nc saves",
    "facts.json": "this is the output of a command with --json",
    "page.html": "this is a page of HTML, no record; a browser shows it",
    "many.zarr": "this is the store of a campaign, no record; its page many.html shows it",
    # Not files of this package: their messages are unchanged.
    "folder": "this is a directory; name a file in it",
    "other.nc": "there are no numbers in it",
    "other.json": "there is no column of numbers for the signal",
    "cut.json": "no rows of numbers",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files of each kind."""
    there = tmp_path_factory.mktemp("written")
    noise = 1e-4 * np.random.default_rng(1).standard_normal(1000)
    record = write_csv(there / "record.csv", WRITTEN_TIME[:1000], linear(WRITTEN_TIME[:1000]) + noise)
    printed = run("identify", record, "--forces", "zeta", "-o", there / "by_command.nc", "--json")
    (there / "printed.json").write_text(printed.out)
    (there / "facts.json").write_text(run("look", record, "--json").out)
    decay = st.free_decay(st.read_record(record))
    library = st.load_library("contact_forces").select(["zeta"])
    st.save(st.identify(decay, library, st.methods.Direct()), there / "from_python.nc")
    run("report", there / "by_command.nc", "-o", there / "page.html")
    (there / "many.zarr").mkdir()
    (there / "many.zarr" / "zarr.json").write_text("{}")
    (there / "folder").mkdir()
    xr.Dataset(attrs={"title": "empty"}).to_netcdf(there / "other.nc", engine="h5netcdf")
    (there / "other.json").write_text('{"next": null, "values": ["a"]}')
    (there / "cut.json").write_text('{"next": "sysid-trib ')
    return there


@pytest.mark.parametrize("name", SHOWN)
def test_other_files_than_records_are_named_with_the_command_for_them(folder, name):
    ending = run("look", folder / name)
    assert SHOWN[name] in ending.complaint
    assert ending.status == 1


def test_a_variable_scales_equally_in_every_table():
    rows = [(name, row) for table in RESULT_TABLES.values() for name, row in table.items()]
    rows += [(name, row) for table in TABLES.values() for name, row in table.items()]
    assert [name for name, row in rows if len(row) > 3 and row[3] != scaling_of(name)] == []
    # A frequency or a phase is no signal, though its unit is that of angles.
    angular = [name for name, row in rows if name.endswith(("frequency", "phase")) and "rad" in row[1]]
    assert {scaling_of(name) for name in angular} == {"fixed"}
    assert (scaling_of("noise"), scaling_of("start_rate")) == ("unit", "unit")
    assert scaling_of("reference_frequency_standard_error") == "fixed"


def test_true_and_false_come_back_as_booleans(tmp_path):
    made = Direct().identify(paper_run(duration=8.0).decay(1), st.load_library().select(["lambda", "zeta"]))
    assert made.refined.dtype == bool
    st.save(made, tmp_path / "result.nc")
    read = st.load(tmp_path / "result.nc")["refined"]
    assert (read.dtype, read.item()) == (bool, made.refined.item())
