"""The documentation is true: its code runs, its tables are those of the program, docstrings are complete."""

import doctest
import importlib.util
import inspect
import re
import shlex
import sys
from pathlib import Path

import command_line
import numpy as np
import pytest
from numpydoc.validate import validate

import sysid_trib as st
from sysid_trib.printing.comparison import comparison_json
from sysid_trib.printing.discovery_tables import discovery_json
from sysid_trib.printing.identification import identification_json

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
if not DOCS.is_dir():
    pytest.skip("the documentation is in the repository, not in this package", allow_module_level=True)

README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = [
    path for path in sorted(DOCS.glob("*.md")) if re.search(r"^```(py|sh)", path.read_text(), re.MULTILINE)
]
MODULES = (st, st.methods, st.plots)
# No docstring; a summary without a full stop, or longer than a line; parameters that do not exist.
ALWAYS = {"GL08", "SS03", "SS06", "PR02"}
# Parameters not documented, in another order, of another form; something returned that is not told.
WHOLE = {"PR01", "PR03", "PR06", "RT01"}


@pytest.fixture(scope="module")
def generated():
    """The script that makes parts of the documentation."""
    spec = importlib.util.spec_from_file_location("generated", DOCS / "generated.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["generated"] = module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_code_of_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = page.read_text(encoding="utf-8")
    for command in re.findall(r"^<!-- generated: run sysid-trib (simulate .*) -->$", text, re.MULTILINE):
        _command(command)
    names: dict[str, object] = {"__name__": page.stem}
    for kind, code in BLOCK.findall(text):
        if kind == "toml":
            Path(re.match(r"# (\w+\.toml)\n", code)[1]).write_text(code, encoding="utf-8")
        elif kind == "sh":
            for line in code.splitlines():
                _command(line.removeprefix("sysid-trib "))
        elif kind == "python":
            exec(compile(code, str(page), "exec"), names)
        elif kind == "pycon":
            _session(code, names, page.name)


def test_code_of_the_readme_runs_and_tells_what_it_finds(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for command in re.findall(r"sysid-trib (simulate -o (?:[^`\n\\]|\\\n)+)", README):
        _command(command.replace("\\\n", " "))
    names: dict[str, object] = _motion()
    _swing(names["t"], names["theta"])
    for kind, code in BLOCK.findall(README):
        if kind == "python":
            exec(compile(code, "README.md", "exec"), names)
        elif kind == "toml":
            Path("own.toml").write_text(code, encoding="utf-8")
            assert st.load_library("own.toml").symbols == (re.search(r'symbol = "(\w+)"', code)[1],)
    assert st.run_agreement(names["runs"], names["together"]).attrs["verdict"] == "agree"
    added = names["added"]
    error = added.stiffness_difference_standard_error.item()
    assert f"stiffness_difference {added.stiffness_difference.item():.6f} ± {error:.6f}" in README
    damped = st.damp(names["together"], amplitude=0.1)
    frequency, ratio = damped.natural_frequency.values[0], damped.damping_ratio.values[0]
    assert f"{frequency:.4f} rad/s, damping ratio {ratio:.5f}" in README


def _command(line):
    ending = command_line.run(*shlex.split(line, comments=True))
    assert ending.status == 0, f"sysid-trib {line}: {ending.err}"


def _session(code, names, name):
    example = doctest.DocTestParser().get_doctest(code, names, name, name, 0)
    said: list[str] = []
    runner = doctest.DocTestRunner(verbose=False)
    runner.run(example, out=said.append, clear_globs=False)
    assert not runner.failures, "".join(said)
    names.update(example.globs)


def _motion():
    """What the README's lines on pysindy take for granted: a motion, as angle, rate and acceleration."""
    w = 9.91
    model = st.Model(st.load_library(), {"zeta": 0.0097, "epsilon": 0.3}, w)
    motion = st.simulate(model, np.arange(0.0, 10.0, 0.005), 0.3)
    tau = w * motion.time.values
    rate = motion.rate.values / w
    states = np.column_stack((motion.angle.values, rate))
    return {
        "t": motion.time.values,
        "theta": motion.angle.values,
        "states": states,
        "tau": tau,
        "acceleration": np.gradient(rate, tau),
    }


def _swing(time, angle):
    rows = "\n".join(f"{t:.6g},{a:.9g}" for t, a in zip(time, np.degrees(angle), strict=True))
    Path("swing.csv").write_text(f"time,theta\n{rows}\n", encoding="utf-8")


def test_json_keys_are_those_documented(generated):
    page = (DOCS / "files.md").read_text(encoding="utf-8")
    results = generated.small_results()
    told = {
        "identify": identification_json(results["identify"]),
        "compare": comparison_json(results["compare"]),
        "discover": discovery_json(results["discover"]),
    }
    for command, data in told.items():
        section = re.split(r"^### ", page.split("## JSON")[1], flags=re.MULTILINE)
        table = next(part for part in section if part.startswith(f"{command}\n"))
        rows = re.findall(r"^\| (`.+?`) \| (.+) \|$", table, re.MULTILINE)
        documented = {
            key
            for cells, words in rows
            if "several runs" not in words
            for key in re.findall(r"`(.+?)`", cells)
        }
        found = {_general(path, documented) for path in _paths(data)}
        assert sorted(found - documented) == sorted(documented - found) == []


def _paths(data, path=""):
    """Every path to a value that is neither a mapping nor a list."""
    if isinstance(data, dict) and data:
        for key, value in data.items():
            yield from _paths(value, f"{path}.{key}" if path else key)
    elif isinstance(data, list) and data and isinstance(data[0], dict):
        yield from _paths(data[0], f"{path}[]")
    else:
        yield path


def _general(path, documented):
    """The path with names for what is the user's, cut at a key that is documented as a whole."""
    for pattern, name in (
        (r"(?<=^methods\.)[^.]+", "METHOD"),
        (r"(?<=^cross_check\.models\.)[^.]+", "METHOD"),
        (r"(?<=^cross_check\.differences\.)[^.]+", "QUANTITY"),
        (r"(?<=\.coefficients\.)[^.]+", "FORCE"),
    ):
        path = re.sub(pattern, name, path)
    whole = [key for key in documented if path.startswith((f"{key}.", f"{key}["))]
    return max(whole, key=len, default=path)


def _public():
    """Names of functions and classes, and of what public classes have."""
    for module in MODULES:
        for name in module.__all__:
            thing = getattr(module, name)
            if inspect.ismodule(thing):
                continue
            yield f"{module.__name__}.{name}"
            if inspect.isclass(thing):
                own = [k for k, v in vars(thing).items() if inspect.isfunction(v) or isinstance(v, property)]
                yield from (f"{module.__name__}.{name}.{k}" for k in own if not k.startswith("_"))


@pytest.mark.parametrize("name", list(_public()))
def test_docstring_is_complete(name):
    owner = name.rpartition(".")[0]
    # What a method of a class takes and returns is told of the function that calls it, `identify`.
    checks = ALWAYS | (WHOLE if owner in {module.__name__ for module in MODULES} else set())
    if owner == "sysid_trib.plots":
        checks -= {"RT01"}
    missing = [f"{code} {text}" for code, text in validate(name)["errors"] if code in checks]
    # That a panel takes and returns an `ax` is told once, of the module.
    assert not [told for told in missing if told != "PR01 Parameters {'ax'} not documented"]


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_every_public_name_is_in_the_reference(module, generated):
    found = re.findall(r"auto(?:class|function):: (\S+)", generated.api(module.__name__))
    names = [name for name in module.__all__ if not inspect.ismodule(getattr(module, name))]
    assert sorted(found) == sorted(f"{module.__name__}.{name}" for name in names)
