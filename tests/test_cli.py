"""The command line in its intended use: tables, JSON, files, figures, help and examples."""

import contextlib
import itertools
import json
import re
import shlex

import numpy as np
import pytest
from command_line import run
from scipy import io

from sysid_trib import load_library
from sysid_trib.commands import local_page
from sysid_trib.commands.options import COMMANDS, OPTIONS_OF, defaults_of, rows_of_command
from sysid_trib.commands.terminal import print_table
from sysid_trib.plots.figure import figures_of
from sysid_trib.printing.identification import identification_table
from sysid_trib.printing.layout import shortened, value_with_error
from sysid_trib.results import files as result_files
from sysid_trib.simulation.simulate import PAPER_COEFFICIENTS, PAPER_FREQUENCY

DAHL = """
[[force]]
symbol = "zeta"
formula = "2*v"
[[force]]
symbol = "dahl"
name = "presliding [/b] hysteresis (±)"
formula = "z"
state = { z = "(v - abs(v)*z)/s" }
shape = { s = { default = 0.01, low = 1e-4, high = 0.3 } }
[[force]]
symbol = "jenkins"
formula = "max(-s, min(s, zr + x - xr))"
memory = { xr = "x", zr = "max(-s, min(s, zr + x - xr))" }
start = { xr = "x", zr = "0" }
shape = { s = { default = 0.02, low = 1e-4, high = 0.5 } }
[[force]]
symbol = "drift"
formula = "t"
kind = "sensor"
"""


@pytest.fixture
def dahl_library(tmp_path):
    path = tmp_path / "own.toml"
    path.write_text(DAHL, encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def twin(tmp_path_factory):
    """The embedded example with everything written: (folder, JSON)."""
    folder = tmp_path_factory.mktemp("twin")
    ending = run("identify", "--json", "-o", folder / "twin.nc", "--plot", folder / "new" / "figures")
    assert (ending.status, ending.err) == (0, "")
    return folder, json.loads(ending.out)


@pytest.fixture(scope="module")
def tree(twin):
    return result_files.load(twin[0] / "twin.nc")


@pytest.fixture(scope="module")
def simulated(tmp_path_factory):
    """A record of the paper's model as CSV."""
    path = tmp_path_factory.mktemp("simulated") / "run.csv"
    ending = run("simulate", "-o", path, "--noise", "1e-4", "--seed", "3")
    assert (ending.status, ending.out) == (0, f"{path}: 2500 simulated samples.\n")
    return path


def number(text):
    """A number that is neither NaN nor Infinity, which JSON does not have."""
    raise AssertionError(f"{text} is not JSON")


def test_json_follows_the_schema(twin):
    found = twin[1]
    assert set(found["methods"]) == {"averaging", "direct"}
    for method in found["methods"].values():
        assert set(method["coefficients"]) == set(PAPER_COEFFICIENTS)
        for symbol, truth in PAPER_COEFFICIENTS.items():
            one = method["coefficients"][symbol]
            assert abs(one["value"] - truth) < 4.5 * one["standard_error"]
        for key in ("reference_frequency", "asymptotic_frequency", "noise"):
            assert isinstance(method[key], float)
        assert method["reference_frequency"] == pytest.approx(PAPER_FREQUENCY, rel=2e-4)
    check = found["cross_check"]
    assert check["verdict"] == "agree"
    assert check["p_value"] > 0.01
    assert {*PAPER_COEFFICIENTS, "asymptotic frequency"} == set(check["quantity"])
    # The twin's models never leave the noise: a time that is not finite is null.
    assert found["judged"]["direct"]["departure_time"] is None
    assert "simulation of the PDMS" in found["record"]["source"]


def test_result_file(twin, tree):
    curves = {"backbone", "lack_of_fit", "consequences"}
    assert set(tree.children) == {"record", "envelope", "averaging", "direct", "judged", "agreement"} | curves
    for method, found in twin[1]["methods"].items():
        for symbol, one in found["coefficients"].items():
            assert tree[method].ds.coefficient.sel(force=symbol).item() == one["value"]
    assert tree["record"].ds.simulated_angle.sizes["model"] == 2


def test_figure(twin, tree):
    written = sorted(path.name for path in (twin[0] / "new" / "figures").iterdir())
    names = {name for figure in figures_of("cross_check") for name, *_ in figure.drawings(tree)}
    assert written == [f"{name}.{kind}" for name in sorted(names) for kind in ("pdf", "png")]
    assert "overview" in names
    assert (twin[0] / "new/figures/overview.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_fixed_shape_parameter_is_used_and_printed(tmp_path, dahl_library):
    record = tmp_path / "dahl.csv"
    made = ("--set", "zeta=0.01", "--set", "jenkins=2e-2", "--set", "jenkins.s=0.05", "--noise", "1e-4")
    assert run("simulate", "-o", record, "--library", dahl_library, *made).status == 0
    asked = ("identify", record, "--library", dahl_library, "--forces", "zeta,jenkins")
    told = run(*asked, "--set", "jenkins.s=0.05").out
    assert re.search(r"jenkins\.s +shape parameter +0\.05 \(held\)", told)
    assert "--set jenkins.s=0.05" in told.split("Next: ")[1]
    assert "The model explains the record" in told
    # At the library's own value the same record is not explained, and that is said.
    assert "The model explains the record" not in run(*asked).out
    wrong = run(*asked, "--set", "jenkins.q=0.05")
    assert wrong.status == 2
    assert "jenkins.s" in wrong.complaint


def test_forces_of_an_own_library(dahl_library):
    ending = run("forces", dahl_library)
    assert (ending.status, ending.err) == (0, "")
    title, normalised, _, _, _, head, *rows = ending.out.splitlines()
    assert title == "own.toml"
    assert "v = theta'/w, tau = w t" in normalised
    assert head.split("  ")[0] == "symbol"
    # The continuation lines of a force have no symbol.
    assert [row.split()[0] for row in rows if not row.startswith(" ")] == ["zeta", "dahl", "jenkins", "drift"]
    assert "presliding [/b] hysteresis (±)" in ending.out
    assert "presliding [/b] hysteresis (?)" in run("forces", dahl_library, encoding="ascii").out


def test_forces_have_the_papers_signatures():
    rows = {row.split()[0]: row for row in run("forces").out.splitlines()[6:] if row.strip()}
    assert "-4/(3 pi) a^2" in rows["delta"]
    assert "3/8 a^3" in rows["epsilon"]


@pytest.mark.parametrize("name", ["contact_forces", "candidate_effects", "hysteresis", "inputs", "water"])
def test_forces_fit_a_page_and_say_their_equations(name, tmp_path):
    ending = run("forces", name, "--latex", tmp_path / "forces.tex")
    assert ending.status == 0, ending.err
    assert max(map(len, ending.out.splitlines()[:-1])) <= 100
    text = (tmp_path / "forces.tex").read_text(encoding="utf-8")
    library = load_library(name)
    for force in library:
        assert f"${force.latex_symbol}$ & " in text
        for state in force.state:
            assert f"d{state}/dtau = " in ending.out
            assert rf"\dot{{{state}}}/\omega = " in text
        for shape in force.shape.values():
            assert f"{shape.default:g} ({shape.low:g}" in ending.out
    assert text.count(r"\\") == 1 + len(library)
    assert text.count("{") == text.count("}")


@pytest.mark.parametrize("colour", [{"NO_COLOR": "1"}, {}], ids=["plain", "colour"])
def test_narrow_terminal_cuts_no_number(tree, monkeypatch, capsys, colour):
    for name, value in {"COLUMNS": "60", "FORCE_COLOR": "1", "TERM": "xterm", **colour}.items():
        monkeypatch.setenv(name, value)
    print_table(identification_table(tree))
    printed = capsys.readouterr().out
    assert "…" not in printed
    for method in ("averaging", "direct"):
        result = tree[method].ds
        for symbol in PAPER_COEFFICIENTS:
            one = result.sel(force=symbol)
            assert value_with_error(one.coefficient.item(), one.standard_error.item()) in printed
    assert run("forces").out.count("4/(3 pi) a^2") == 2


EXAMPLES = {name: row["examples"] for name, row in COMMANDS.items()}


def test_every_command_has_two_examples():
    for name, examples in EXAMPLES.items():
        assert len(examples) == 2
        said = run(name, "--help").out
        assert said.endswith(f"Examples:\n  {examples[0]}\n  {examples[1]}\n")


def blow(folder):
    """Write `blow.mat`, of an accelerometer after a blow: the record that no command simulates."""
    time = np.arange(6000) / 2000.0
    swings = [
        size * np.exp(-zeta * 2.0 * np.pi * frequency * time) * np.sin(2.0 * np.pi * frequency * time)
        for size, zeta, frequency in ((50.0, 0.004, 80.0), (25.0, 0.003, 298.0))
    ]
    noise = 0.01 * np.random.default_rng(0).standard_normal(time.size)
    columns = {"time_s": time, "acceleration_m_s2": sum(swings) + noise}
    io.savemat(folder / "blow.mat", {name: values[:, None] for name, values in columns.items()})


# Records of the user, beside those that `simulate` writes.
GIVEN = {"blow.mat": blow}


def files_named(example):
    """The files that an example reads, and those that it writes."""
    words = shlex.split(example)
    written = [b for a, b in itertools.pairwise(words) if a in ("-o", "--csv")]
    read = [word for word in words if re.search(r"\.(csv|mat|nc)$", word) and "*" not in word]
    return set(read) - set(written), set(written)


def test_examples_name_records_that_other_examples_write_or_that_are_given():
    named = [files_named(example) for examples in EXAMPLES.values() for example in examples]
    assert set().union(*(read for read, _ in named)) <= set(GIVEN).union(*(made for _, made in named))


def _works(names, folder):
    for write in GIVEN.values():
        write(folder)
    with contextlib.chdir(folder):
        # simulate writes the record of the other examples; report and export read their results.
        for name in sorted(names, key=lambda name: (name != "simulate", name in ("report", "export"))):
            for example in EXAMPLES[name]:
                program, *words = shlex.split(example)
                ending = run(*words)
                assert program == "sysid-trib"
                assert ending.status == 0, f"{example}: {ending.err}"


@pytest.mark.slow
def test_examples_that_are_quick_work(tmp_path, monkeypatch):
    without_server(monkeypatch)
    _works(("simulate", "look", "backbone", "identify", "response", "forces", "datasets", "app"), tmp_path)


@pytest.mark.in_full
def test_all_examples_work(tmp_path, monkeypatch):
    without_server(monkeypatch)
    _works(EXAMPLES, tmp_path)


def without_server(monkeypatch):
    """Let `app` end: its server, which tests/app starts, runs until Ctrl-C."""

    def ended(record, port, *, open_browser):
        assert record is None or record.exists()
        assert 0 <= port < 65536

    monkeypatch.setattr(local_page, "serve", ended)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_option_has_a_type_and_a_text_of_help(command):
    assert set(defaults_of(OPTIONS_OF[command])) == set(rows_of_command(command))


@pytest.mark.parametrize(("length", "shown"), [(48, 48), (49, 48), (200, 48)])
def test_a_long_formula_is_cut_in_a_table(length, shown):
    formula = "v" * length
    text = shortened(formula)
    assert len(text) == shown
    assert (text == formula) == (length <= shown)
