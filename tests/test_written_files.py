"""What this package wrote and is no record: what it is, and what shows it."""

import numpy as np
import pytest
import xarray as xr
from command_line import TIME, linear, run, write_csv

import sysid_trib as st

SHOWN = {
    "by_command.nc": "this is a result of identify, no record; sysid-trib report by_command.nc -o by_command",
    "from_python.nc": "this is a result of direct, no record; sysid-trib report from_python.nc",
    "printed.json": "this is what a command printed with --json, no record; -o RESULT.nc keeps",
    "facts.json": "this is what a command printed with --json",
    "page.html": "this is a page of HTML, no record; a browser shows it",
    "many.zarr": "this is the store of a campaign, no record; its page many.html shows it",
    # Not of this package: what was said of it before is right.
    "folder": "this is a directory; name a file in it",
    "other.nc": "there are no numbers in it",
    "other.json": "no column for the angle",
    "cut.json": "no rows of numbers",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Files of each kind."""
    there = tmp_path_factory.mktemp("written")
    noise = 1e-4 * np.random.default_rng(1).standard_normal(1000)
    record = write_csv(there / "record.csv", TIME[:1000], linear(TIME[:1000]) + noise)
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
def test_what_is_no_record_is_named_with_what_shows_it(folder, name):
    ending = run("look", folder / name)
    assert SHOWN[name] in ending.complaint
    assert ending.status == 1


@pytest.mark.slow
def test_every_command_that_reads_records_says_so(folder):
    assert SHOWN["by_command.nc"] in run("discover", folder / "by_command.nc").complaint
    assert SHOWN["from_python.nc"] in run("identify", folder / "from_python.nc", "--units", "deg").complaint


def test_report_says_what_writes_a_result(folder):
    complaint = run("report", folder / "record.csv", "-o", folder / "x.html").complaint
    assert "record.csv: not a result in netCDF, as identify, compare and discover write with -o" in complaint
