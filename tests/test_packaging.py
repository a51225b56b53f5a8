"""What a release is made of: versions, addresses, the change log, the recipe and the workflows agree."""

import ast
import re
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path

import pytest
import yaml

import sysid_trib as st

ROOT = Path(__file__).resolve().parent.parent
NEEDED = ("pyproject.toml", ".ci", ".github", "recipe", "CITATION.cff", "CHANGELOG.md", "Makefile")
if not all((ROOT / name).exists() for name in NEEDED):
    pytest.skip("the repository is not in this package", allow_module_level=True)

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
URLS = PROJECT["urls"]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
# A dependency: name, extras, bounds.
DEPENDENCY = re.compile(r"([\w.-]+)(?:\[(\w+)\])?(\S+)")
# Packages whose names on conda-forge differ.
CONDA_NAMES = {"matplotlib": "matplotlib-base"}


def text_of(name):
    return (ROOT / name).read_text(encoding="utf-8")


def yaml_of(path):
    return yaml.safe_load((ROOT / path).read_text(encoding="utf-8"))


def script(name, *words):
    """Run a script of `.ci` and return how it ended."""
    command = [sys.executable, ROOT / ".ci" / name, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, encoding="utf-8")


def test_versions_agree():
    assert "version" in PROJECT["dynamic"]
    citation, recipe = yaml_of("CITATION.cff"), yaml_of("recipe/recipe.yaml")
    assert citation["version"] == recipe["context"]["version"] == st.__version__


def test_addresses_are_those_of_pyproject():
    """Every address of the repository or of its pages in a document begins like one of pyproject.toml."""
    citation, about = yaml_of("CITATION.cff"), yaml_of("recipe/recipe.yaml")["about"]
    assert (citation["repository-code"], citation["url"]) == (URLS["Repository"], URLS["Documentation"])
    assert (about["repository"], about["documentation"]) == (URLS["Repository"], URLS["Documentation"])
    assert about["homepage"] == URLS["Homepage"]
    documents = [
        *ROOT.glob("*.md"),
        *(ROOT / "docs").rglob("*.*"),
        *(ROOT / ".github").rglob("*.*"),
        *ROOT.glob("recipe/*"),
    ]
    address = re.compile(
        r"(?:https?://)?(?:www\.)?(?:[\w-]+\.github\.io|github\.com)/[\w./-]*sysid[_-]trib[\w./-]*"
    )
    found = {
        (path.relative_to(ROOT).as_posix(), match[0])
        for path in documents
        if path.suffix in (".md", ".yml", ".yaml", ".py", ".html", ".js", ".cff")
        for match in address.finditer(path.read_text(encoding="utf-8"))
    }
    ours = tuple(url.rstrip("/") for url in URLS.values())
    assert len(found) > 5
    assert {(name, url) for name, url in found if not url.startswith(ours)} == set()


def test_the_recipe_has_the_dependencies_of_pyproject():
    run = []
    for line in PROJECT["dependencies"]:
        name, extra, bounds = DEPENDENCY.fullmatch(line).groups()
        run += [f"{CONDA_NAMES.get(name, name)} {bounds}", *([extra] if extra else [])]
    build = tomllib.loads(text_of("pyproject.toml"))["build-system"]["requires"]
    host = [" ".join(DEPENDENCY.fullmatch(line).group(1, 3)) for line in build]
    recipe = yaml_of("recipe/recipe.yaml")
    assert recipe["requirements"]["run"] == ["python >=${{ python_min }}", *run]
    assert recipe["requirements"]["host"] == ["python ${{ python_min }}.*", "pip", *host]
    assert recipe["build"]["python"]["entry_points"] == [f"{k} = {v}" for k, v in PROJECT["scripts"].items()]
    about = recipe["about"]
    assert (about["summary"], about["license"]) == (PROJECT["description"], PROJECT["license"])


def test_a_release_completes_the_recipe(tmp_path):
    sdist = tmp_path / "sysid_trib-1.2.3.tar.gz"
    with tarfile.open(sdist, "w:gz"):
        pass
    ended = script("recipe.py", sdist)
    assert (ended.returncode, ended.stderr) == (0, "")
    complete, stored = yaml.safe_load(ended.stdout), yaml_of("recipe/recipe.yaml")
    assert complete["context"].pop("version") == "1.2.3"
    assert re.fullmatch("[0-9a-f]{64}", complete["source"].pop("sha256"))
    del stored["context"]["version"]
    assert complete == stored


def test_the_change_log_has_the_version_and_a_place_for_the_next():
    headings = re.findall(r"^## \[(.+?)\](.*)$", text_of("CHANGELOG.md"), re.MULTILINE)
    (first, date), (second, released) = headings[:2]
    assert (first, date, second) == ("Unreleased", "", st.__version__)
    assert released == f" - {yaml_of('CITATION.cff')['date-released']}"
    kinds = re.findall(r"^### (.+)$", text_of("CHANGELOG.md"), re.MULTILINE)
    assert set(kinds) <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
    links = dict(re.findall(r"^\[(.+?)\]: (\S+)$", text_of("CHANGELOG.md"), re.MULTILINE))
    assert set(links) == {name for name, _ in headings}


def test_the_notes_of_a_release_are_its_section():
    ended = script("release.py", f"v{st.__version__}")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.strip() in text_of("CHANGELOG.md")
    assert "## [" not in ended.stdout


@pytest.mark.parametrize("tag", ["v9.9.9", st.__version__, f"v{st.__version__}rc1"])
def test_a_tag_that_is_not_the_version_is_refused(tag):
    ended = script("release.py", tag)
    assert (ended.returncode, ended.stdout) == (1, "")
    assert ended.stderr == (
        f"The tag is {tag}, but sysid_trib/_version.py has {st.__version__}: "
        f"tag v{st.__version__}, or change the version.\n"
    )


def steps():
    """Every step of every job, with the name of its workflow."""
    return [
        (path.name, step)
        for path in WORKFLOWS
        for job in yaml_of(path)["jobs"].values()
        for step in job["steps"]
    ]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_a_workflow_is_whole(path):
    workflow = yaml_of(path)
    # YAML 1.1 reads the key `on` as true.
    assert workflow[True]
    assert workflow["permissions"] == {"contents": "read"}
    jobs = workflow["jobs"]
    for job in jobs.values():
        assert job["timeout-minutes"] <= 60
        needs = job.get("needs", [])
        assert set([needs] if isinstance(needs, str) else needs) <= set(jobs)
        for step in job["steps"]:
            assert ("run" in step) != ("uses" in step)
            # A version of the action, not its newest state.
            assert re.fullmatch(r"[\w-]+/[\w/.-]+@(v\d+|release/v\d+)", step.get("uses", "some/action@v1"))


def test_workflows_run_scripts_and_targets_that_exist():
    targets = set(re.findall(r"^([\w-]+):", text_of("Makefile"), re.MULTILINE))
    commands = (
        "\n".join(step.get("run", "") for _, step in steps())
        + text_of(".ci/run")
        + text_of(".ci/wheel_check.sh")
    )
    made = {
        target
        for words in re.findall(r"^(?:\S+=\S+ )*make( .+)$", commands, re.MULTILINE)
        for target in words.split()
        if "=" not in target
    }
    scripts = set(re.findall(r"(?<![\w/])\.ci/[\w.]+", commands))
    assert {"test", "test-lowest", "coverage"} <= made <= targets
    assert {".ci/run", ".ci/try_wheel.py", ".ci/lowest.py", ".ci/release.py"} <= scripts
    assert {name for name in scripts if not (ROOT / name).is_file()} == set()


def test_the_same_action_has_one_version():
    used = {tuple(step["uses"].split("@")) for _, step in steps() if "uses" in step}
    assert len(used) == len(dict(used))


def test_scripts_are_python_for_the_lowest_version():
    lowest = tuple(map(int, PROJECT["requires-python"].removeprefix(">=").split(".")))
    for path in (ROOT / ".ci").glob("*.py"):
        assert ast.parse(path.read_text(encoding="utf-8"), feature_version=lowest)


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.name)
def test_an_issue_form_is_whole(path):
    form = yaml_of(path)
    if path.name == "config.yml":
        assert form["contact_links"]
        return
    assert form["name"]
    assert form["description"]
    fields = [part for part in form["body"] if part["type"] != "markdown"]
    assert {part["type"] for part in fields} <= {"input", "textarea", "dropdown", "checkboxes"}
    assert len({part["id"] for part in fields}) == len(fields)
    for command in re.findall(r"^\s*sysid-trib (\w+)", path.read_text(encoding="utf-8"), re.MULTILINE):
        assert command in ("identify", "report")


def test_links_of_the_readme_lead_to_the_release():
    """The front page of a release has no relative link; the files that the links name exist."""
    hooks = tomllib.loads(text_of("pyproject.toml"))["tool"]["hatch"]["metadata"]["hooks"]
    readme = text_of("README.md")
    relative = set(re.findall(r"\]\((?!https?://|#)([^)#]+)", readme))
    assert len(relative) > 5
    assert {name for name in relative if not (ROOT / name).exists()} == set()
    for change in hooks["fancy-pypi-readme"]["substitutions"]:
        readme = re.sub(change["pattern"], change["replacement"], readme)
    addresses = set(re.findall(r"\]\(([^)]+)\)", readme))
    assert all(re.match(rf"https://|#|{URLS['Repository']}/(raw|blob)/v", address) for address in addresses)
    pictures = re.findall(r"!\[[^]]*\]\(([^)]+\.png)\)", readme)
    assert pictures
    assert all(picture.startswith(f"{URLS['Repository']}/raw/v$HFPR_VERSION/") for picture in pictures)


def test_classifiers_name_the_versions_that_are_tested():
    stated = {c.rpartition(" ")[2] for c in PROJECT["classifiers"] if re.search(r":: 3\.\d+$", c)}
    tested = {
        str(step["with"]["python-version"]) for _, step in steps() if "python-version" in step.get("with", {})
    }
    matrix = yaml_of(".github/workflows/ci.yml")["jobs"]["test"]["strategy"]["matrix"]["python"]
    assert stated == {version for version in tested if "{" not in version} | set(matrix)


def test_the_sdist_has_what_tests_and_documentation_need():
    included = set(
        tomllib.loads(text_of("pyproject.toml"))["tool"]["hatch"]["build"]["targets"]["sdist"]["only-include"]
    )
    # The build adds these itself.
    itself = {"README.md", "LICENSE", "pyproject.toml", ".gitignore"}
    kept = {
        path.name
        for path in ROOT.iterdir()
        if path.suffix in (".md", ".cff", ".toml") or path.name == "Makefile"
    }
    assert kept - itself <= included
    assert {"tests", "docs", "benchmarks", "notebooks", "libraries", ".ci", ".github", "recipe"} <= included
    assert {name for name in included if not (ROOT / name).exists()} == set()
