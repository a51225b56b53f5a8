"""One result of each kind, and the page of each."""

import pytest
import xarray as xr
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


LIBRARY = st.load_library().select(["lambda", "zeta", "delta", "nu", "epsilon"])
FEW = LIBRARY.select(["zeta", "delta", "epsilon"])
METHODS = {
    "direct": st.methods.Direct(),
    "averaging": st.methods.Averaging(),
    "logarithmic decrement": st.methods.LogarithmicDecrement(),
}


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    """Records, and results in files: of the embedded example, and of a record whose model lacks a force."""
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
    ending = run("discover", there / "cubic.csv", *offered, "-o", there / "discover.nc")
    assert (ending.status, ending.err) == (0, "")
    st.save(st.identify(decays_of(there)[1], LIBRARY, st.methods.Direct()), there / "identify.nc")
    checked, _ = cross_checked(st.free_decay(st.records.paper_twin(), window=(0.0, 10.0)))
    st.save(checked, there / "cross_check.nc")
    return there


def decays_of(there):
    return [st.free_decay(st.read_record(there / f"{name}.csv")) for name in ("small", "large")]


def cross_checked(decay):
    """Return the cross-check of both identifications, as `identify` makes it."""
    first, second = (st.identify(decay, FEW, m) for m in (st.methods.Averaging(), st.methods.Direct()))
    return st.cross_check(decay, first, second), second


@pytest.fixture(scope="session")
def results(folder):
    """The results by kind."""
    decays = decays_of(folder)
    runs, second = cross_checked(decays)
    runs["runs"] = xr.DataTree(st.validation.run_agreement(decays, second))
    made = {"runs": runs, "compare": st.compare(decays[1], LIBRARY, METHODS)}
    return made | {path.stem: st.load(path) for path in folder.glob("*.nc")}


@pytest.fixture
def without_figures(monkeypatch):
    """Pages without figures, which take a second each."""
    monkeypatch.setattr("sysid_trib.reporting.page.inline_svg", lambda *_: "")


@pytest.fixture(scope="session")
def pages(results):
    """The page of each, as text; that of two runs, the figures of which are those of one, has none."""
    whole = {kind: page(tree) for kind, tree in results.items() if kind != "runs"}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sysid_trib.reporting.page.inline_svg", lambda *_: "")
        return whole | {"runs": page(results["runs"])}
