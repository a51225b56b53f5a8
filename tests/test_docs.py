"""The documentation is true: its code runs, its tables are those of the program, docstrings are complete."""

import doctest
import importlib.util
import inspect
import json
import re
import shlex
import sys
from pathlib import Path

import command_line
import numpy as np
import pytest
from command_line import write_csv
from numpydoc.validate import validate

import sysid_trib as st
from sysid_trib.physics.consequences import with_consequences
from sysid_trib.printing.campaign import difference_json
from sysid_trib.printing.comparison import comparison_json
from sysid_trib.printing.discovery import discovery_json
from sysid_trib.printing.driven import driven_json, prediction_json
from sysid_trib.printing.identification import identification_json
from sysid_trib.printing.laws import laws_json
from sysid_trib.questions.difference import held_against

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
if not DOCS.is_dir():
    pytest.skip("the documentation is in the repository, not in this package", allow_module_level=True)

README = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PAGES = [
    path for path in sorted(DOCS.glob("*.md")) if re.search(r"^```(py|sh)", path.read_text(), re.MULTILINE)
]
MODULES = (
    st,
    *(st.campaigns, st.control, st.datasets, st.forces, st.methods, st.physics),
    *(st.plots, st.records, st.validation),
)
# No docstring; a summary without a full stop, or longer than a line; parameters that do not exist.
ALWAYS = {"GL08", "SS03", "SS06", "PR02"}
# Parameters not documented, in another order, of another form; something returned that is not described.
WHOLE = {"PR01", "PR03", "PR06", "RT01"}


def script(name):
    """Import a script of the folder of the documentation."""
    spec = importlib.util.spec_from_file_location(name, DOCS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def generated():
    """The script that generates parts of the documentation."""
    return script("generated")


def _outputs():
    """Pages with the output of a command, and the command; pages on measured records take long."""
    for page in (ROOT / "README.md", *sorted(DOCS.glob("*.md"))):
        for command in re.findall(r"^\$ (sysid-trib .+)$", page.read_text(encoding="utf-8"), re.MULTILINE):
            marks = [pytest.mark.slow] if page.name != "README.md" else []
            yield pytest.param(page, command, id=f"{page.stem}: {command}", marks=marks)


@pytest.mark.parametrize(("page", "command"), list(_outputs()))
def test_printed_output_on_a_page_is_that_of_the_command(page, command, generated):
    text = page.read_text(encoding="utf-8")
    for made in re.findall(r"^\$ sysid-trib (simulate .*)$", text, re.MULTILINE):
        generated.printed(*shlex.split(made))
    block = next(m[0] for m in generated.CONSOLE.finditer(text) if f"sysid-trib {m[1]}" == command)
    number = re.compile(r"[+-]?(\d[\d.]*)")
    written, today = (number.split(shown.partition("\n")[2]) for shown in (block, generated.refreshed(block)))
    # Equal words up to blanks, and numbers that are equal up to differences between processors.
    assert [" ".join(words.split()) for words in written[::2]] == [" ".join(w.split()) for w in today[::2]]
    numbers = [[float(digits.rstrip(".")) for digits in shown[1::2]] for shown in (written, today)]
    if not command.startswith("sysid-trib compare"):
        np.testing.assert_allclose(*numbers, rtol=0.03, atol=0.11)


def _sentences(text):
    """Sentences of a page, without code, tables' lines and addresses."""
    hidden = r"^```.*?^```$|<!--.*?-->|^    [^\n]*$|^#[^\n]*$"
    text = re.sub(hidden, "\n\n", text, flags=re.MULTILINE | re.DOTALL)
    for block in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.)\s)|\|", re.sub(r"\]\([^)]*\)", "]", text)):
        yield from re.split(r"(?<=[.!?:])\s+|(?<=[.:?]\*\*)\s+", " ".join(block.split()))


@pytest.mark.parametrize(
    "name", ["README", *(f"docs/{page}" for page in ("start", "choosing", "discrepancy"))]
)
def test_sentences_of_the_first_pages_are_short_and_no_command_is_hidden(name):
    text = (ROOT / f"{name}.md").read_text(encoding="utf-8")
    assert [sentence for sentence in _sentences(text) if len(sentence.split()) > 30] == []
    assert "<!-- output" not in text


TASKS_OF_PYTHON = 6


def test_a_task_in_python_takes_eight_lines_at_most():
    text = (DOCS / "python.md").read_text(encoding="utf-8").partition("\n## What there is\n")[0]
    tasks = text.split("\n## ")[1:]
    assert len(tasks) == TASKS_OF_PYTHON
    for task in tasks:
        (code,) = (code for kind, code in BLOCK.findall(task) if kind == "python")
        assert len(code.splitlines()) <= 8


# Pages whose code takes seconds; code on other pages is slow.
QUICK_PAGES = {"adding_a_method", "forces", "start"}


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=page.stem, marks=[pytest.mark.slow] * (page.stem not in QUICK_PAGES))
        for page in PAGES
    ],
)
def test_code_of_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = page.read_text(encoding="utf-8")
    for command in re.findall(r"^\$ sysid-trib (simulate .*)$", text, re.MULTILINE):
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


def test_code_of_the_readme_runs_and_finds_the_missing_force(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    model = st.Model(st.load_library(), {"zeta": 0.0097, "epsilon": 0.3}, 9.91)
    motion = st.simulate(model, np.arange(0.0, 10.0, 0.02), 0.3)
    write_csv(Path("swing.csv"), motion.time.values, motion.angle.values, "time,theta")
    names: dict[str, object] = {}
    for kind, code in BLOCK.findall(README):
        if kind == "python":
            exec(compile(code, "README.md", "exec"), names)
    assert names["missing"]["steps"].symbol.values.tolist() == ["epsilon"]
    assert st.load("result.nc").identical(names["tree"])


def _command(line):
    ending = command_line.run(*shlex.split(line, comments=True))
    assert ending.status == 0, f"sysid-trib {line}: {ending.err}"


def _session(code, names, name):
    example = doctest.DocTestParser().get_doctest(code, names, name, name, 0)
    printed: list[str] = []
    runner = doctest.DocTestRunner(verbose=False)
    runner.run(example, out=printed.append, clear_globs=False)
    assert not runner.failures, "".join(printed)
    names.update(example.globs)


# Pages that are lists of others.
LISTS = ("index", "notebooks")


def test_every_page_is_in_the_list_of_one_page():
    listed = []
    for page in LISTS:
        for entries in re.findall(
            r"^```{toctree}\n(.*?)^```", (DOCS / f"{page}.md").read_text(), re.M | re.S
        ):
            listed += [line for line in entries.splitlines() if line and not line.startswith(":")]
    assert sorted(listed) == sorted(
        ["notebooks/*", *(p.stem for p in DOCS.glob("*.md") if p.stem != "index")]
    )


@pytest.mark.parametrize("page", sorted(set(DOCS.glob("*.md")) - {DOCS / "index.md"}), ids=lambda p: p.stem)
def test_a_page_begins_with_what_it_is_for(page):
    text = re.sub(r"\A---\n.*?\n---\n", "", page.read_text(encoding="utf-8"), flags=re.DOTALL).strip()
    title, first = text.split("\n\n")[:2]
    assert re.fullmatch(r"# .+", title)
    assert re.match(r"This page \w+s ", first)


def test_links_of_pages_lead_somewhere_in_the_repository():
    """Readers of the repository follow them, too; `make docs` checks those of the site, with headings."""
    for page in (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *DOCS.glob("*.md")):
        text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
        targets = re.findall(r"\]\((?!\w+:)([^)#]+)", text)
        assert [target for target in targets if not (page.parent / target).exists()] == [], page.name


def test_the_gallery_shows_every_figure_in_a_few_lines_with_a_description():
    text = (DOCS / "gallery.md").read_text(encoding="utf-8")
    cells = re.findall(
        r"^### `(\w+)`\n\n[^\n]+\n\n```{code-cell}\n---\n(.*?)\n---\n(.*?)^```$", text, re.M | re.S
    )
    assert sorted(name for name, _, _ in cells) == sorted(st.plots.__all__)
    for name, options, code in cells:
        assert re.fullmatch(r'mystnb:\n  image:\n    alt: ".{20,}"', options), name
        assert f"st.plots.{name}(" in code.splitlines()[-1]
        assert len(code.splitlines()) <= 8, name
        assert max(map(len, code.splitlines())) <= 90, name


GOOD = '<h1 id="top">A page</h1><a href="#top">up</a><a href="https://example.org">elsewhere</a>'


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        (GOOD, ""),
        (f'{GOOD}<link rel="canonical" href="https://example.org/a.html">', ""),
        ('<a href="b.html">other</a>', "a.html links to b.html, which does not exist."),
        ('<a href="a.html#below">below</a>', "a.html links to a.html#below, which does not exist."),
        ('<img src="_images/a.png">', "a.html links to _images/a.png, which does not exist."),
        (
            '<script src="https://cdn.example.org/a.js"></script>',
            "a.html loads https://cdn.example.org/a.js, which is on another host.",
        ),
        (
            '<link rel="stylesheet" href="//fonts.example.org/a.css">',
            "a.html loads //fonts.example.org/a.css, which is on another host.",
        ),
    ],
)
def test_built_pages_have_no_dead_link_and_load_nothing_from_another_host(body, fault, tmp_path):
    (tmp_path / "a.html").write_text(f"<html>{body}</html>", encoding="utf-8")
    assert script("check_pages").faults_of(tmp_path) == ([fault] if fault else [])


def test_links_of_a_notebook_are_right_on_the_site():
    pages = script("notebook_pages")
    text = "[a](../docs/files.md#clock) [b](run.py) [c](../docs/none.md) [d](01_six_forces.ipynb) [e](https://e.org)"
    found = re.findall(r"\((.+?)\)", pages.with_links_of_the_site(text, pages.NOTEBOOKS, pages.COPIES))
    in_repository = f"{pages.REPOSITORY}/notebooks/run.py"
    assert found == [
        "../files.md#clock",
        in_repository,
        "../docs/none.md",
        "01_six_forces.ipynb",
        "https://e.org",
    ]
    page = pages.with_links_of_the_site("[a](../notebooks/01_six_forces.ipynb)", DOCS, DOCS)
    assert page == "[a](notebooks/01_six_forces.ipynb)"


def test_versions_are_published_side_by_side(tmp_path):
    publish, pages, site = script("publish").publish, tmp_path / "pages", tmp_path / "site"
    pages.mkdir()
    listed = []
    for version in ("main", "v0.9.0", "v0.10.0", "v0.9.1", "main"):
        (pages / "index.html").write_text(version, encoding="utf-8")
        publish(pages, site, version)
        listed.append(json.loads((site / "versions.json").read_text()))
    assert listed[0] == ["latest"]
    assert listed[1] == ["latest", "stable", "v0.9"]
    assert listed[-1] == ["latest", "stable", "v0.10", "v0.9"]
    shown = {name: (site / name / "index.html").read_text() for name in listed[-1]}
    assert shown == {"latest": "main", "stable": "v0.10.0", "v0.10": "v0.10.0", "v0.9": "v0.9.1"}
    assert 'url=stable/"' in (site / "index.html").read_text()
    with pytest.raises(SystemExit, match="neither main nor a tag"):
        publish(pages, site, "v1")


def test_the_logo_is_that_of_its_script():
    logo = script("logo")
    assert logo.LOGO.read_text(encoding="utf-8") == logo.drawn(), "write it again: python docs/logo.py"


def test_no_command_draws_over_a_picture_of_the_documentation():
    """A figure has the name of the function that draws it; `--plot docs/pictures` replaces such files."""
    pictures = {path.stem for path in (DOCS / "pictures").iterdir()}
    assert pictures
    assert pictures.isdisjoint(st.plots.__all__)


def test_no_page_selects_by_an_argument_that_xarray_has_itself():
    pages = [*DOCS.glob("*.md"), *(ROOT / "notebooks").glob("*.py"), ROOT / "README.md"]
    assert [page.name for page in pages if "sel(method=" in page.read_text(encoding="utf-8")] == []
    assert 'sel(model="direct")' in (DOCS / "campaigns.md").read_text(encoding="utf-8")


@pytest.mark.slow
def test_json_keys_are_those_documented(generated):
    page = (DOCS / "json.md").read_text(encoding="utf-8")
    results = generated.small_results()
    printed = {
        "identify": identification_json(results["identify"]),
        "compare": comparison_json(results["compare"]),
        "discover": discovery_json(results["discover"]),
    }
    record, library = [results["identify"]["record"].to_dataset()], st.load_library().select(["zeta"])
    printed["difference"] = difference_json(held_against(record, record, library, st.methods.Direct()))
    printed["laws"] = laws_json(results["laws"])
    driven = with_consequences(results[generated.DRIVEN])
    predicted = st.predict(driven["direct"].to_dataset(), driven["record"].to_dataset())
    printed[generated.DRIVEN] = driven_json(driven) | prediction_json([predicted])
    sections = re.split(r"^## ", page, flags=re.MULTILINE)
    tables = {
        part.partition("\n")[0]: re.findall(r"^\| (`.+?`) \| (.+) \|$", part, re.MULTILINE)
        for part in sections
    }
    shared, used = _listed(tables["Several commands"]), set()
    for command, data in printed.items():
        own = _listed(tables[command])
        of_groups = _held_by_groups([*tables["Several commands"], *tables[command]], results.get(command))
        keys = {_general(path, own | shared | of_groups) for path in _paths(data)}
        assert sorted(keys - own - shared - of_groups) == sorted(own - keys) == []
        used |= keys
    assert sorted(shared - used) == []


GROUP = re.compile(r"^group `(\w+)`")


def _listed(rows):
    """Keys that rows list themselves; those that only several runs have are left out."""
    own = [cell for cell, words in rows if "several runs" not in words and not GROUP.match(words)]
    return {key for cell in own for key in re.findall(r"`(.+?)`", cell)}


def _held_by_groups(rows, result):
    """Keys with the names of variables and attributes of the groups of a result that rows refer to."""
    groups = [(cell.strip("`"), match[1]) for cell, words in rows if (match := GROUP.match(words))]
    return {
        f"{key}.{name}"
        for key, group in groups
        if result is not None and group in result.children
        for name in (*result[group].variables, *result[group].attrs)
    }


def _paths(data, path=""):
    """Paths to all values that are neither mappings nor lists."""
    if isinstance(data, dict) and data:
        for key, value in data.items():
            yield from _paths(value, f"{path}.{key}" if path else key)
    elif isinstance(data, list) and data and isinstance(data[0], dict):
        yield from _paths(data[0], f"{path}[]")
    else:
        yield path


def _general(path, documented):
    """The path with placeholders for the user's names, cut at a key that is documented as a whole."""
    for pattern, name in (
        (r"(?<=^methods\.)[^.]+", "METHOD"),
        (r"(?<=^coefficients\.)[^.]+", "FORCE"),
        (r"(?<=^judged\.)[^.]+", "METHOD"),
        (r"(?<=^cross_check\.quantity\.)[^.]+", "QUANTITY"),
        (r"(?<=^per_input\.)[^.]+", "QUANTITY"),
        (r"(?<=\.coefficients\.)[^.]+", "FORCE"),
    ):
        path = re.sub(pattern, name, path)
    whole = [key for key in documented if path.startswith((f"{key}.", f"{key}["))]
    return max(whole, key=len, default=path)


def _public():
    """Names of functions and classes, and of public members of classes."""
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
    # Parameters and results of methods of a class are described in the function that calls them, `identify`.
    checks = ALWAYS | (WHOLE if owner in {module.__name__ for module in MODULES} else set())
    if owner == "sysid_trib.plots":
        checks -= {"RT01"}
    missing = [f"{code} {text}" for code, text in validate(name)["errors"] if code in checks]
    # The argument and result `ax` of panels is described once, in the module.
    assert not [error for error in missing if error != "PR01 Parameters {'ax'} not documented"]


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.__name__)
def test_every_public_name_is_in_the_reference(module, generated):
    found = re.findall(r"auto(?:class|function):: (\S+)", generated.api(module.__name__))
    names = [name for name in module.__all__ if not inspect.ismodule(getattr(module, name))]
    assert sorted(found) == sorted(f"{module.__name__}.{name}" for name in names)
