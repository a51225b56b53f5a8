"""One result of each kind, as the commands save it."""

import pytest
from command_line import run

import sysid_trib as st
from sysid_trib.reporting.page import page

CANDIDATES = """
[[force]]
symbol = "drag"
formula = "v*abs(v)"
[[force]]
symbol = "cubic"
formula = "x**3"
[[force]]
symbol = "gravity"
formula = "sin(x) - x"
"""


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """Results in files: of the embedded example, of two runs, of a record that lacks a cubic force."""
    there = tmp_path_factory.mktemp("results")
    (there / "candidates.toml").write_text(CANDIDATES, encoding="utf-8")
    short = ("--duration", "8", "--sampling-rate", "50", "--noise", "3e-4")
    for name, *options in (
        ("small", "--angle0", "0.1"),
        ("large", "--angle0", "0.6"),
        ("cubic", "--set", "zeta=0.01,epsilon=0.8"),
    ):
        assert run("simulate", "-o", there / f"{name}.csv", *options, *short).status == 0
    offered = ("--forces", "zeta", "--candidates", there / "candidates.toml")
    for command, result, *options in (
        ("identify", "cross_check"),
        ("identify", "runs", there / "small.csv", there / "large.csv", "--omega0", "8.87±0.02"),
        ("compare", "compare", there / "large.csv"),
        ("discover", "discover", there / "cubic.csv", *offered),
    ):
        ending = run(command, *options, "-o", there / f"{result}.nc")
        assert (ending.status, ending.err) == (0, "")
    library = st.load_library().select(["lambda", "zeta", "delta", "nu", "epsilon"])
    decay = st.free_decay(st.read_record(there / "large.csv"))
    st.save(st.identify(decay, library, st.methods.Direct()), there / "identify.nc")
    return there


@pytest.fixture(scope="session")
def results(folder):
    """The results by kind."""
    return {path.stem: st.load(path) for path in folder.glob("*.nc")}


@pytest.fixture(scope="session")
def pages(results):
    """The page of each, as text; its pictures are small."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sysid_trib.reporting.page.PAPER_DPI", 50)
        return {kind: page(tree) for kind, tree in results.items()}
