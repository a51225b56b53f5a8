"""Every public name has an example in its docstring, which runs as a newcomer would paste it."""

import doctest
import inspect

import pytest

import sysid_trib as st

# Examples whose computation takes more than a second.
SLOW = {
    "sysid_trib.report",
    *(f"sysid_trib.physics.{name}" for name in ("law_difference", "law_formulas", "law_table", "laws_in_si")),
    *(
        f"sysid_trib.plots.{name}"
        for name in ("friction_coefficient", "interaction", "law_difference", "laws")
    ),
    *(f"sysid_trib.plots.{name}" for name in ("overview", "own_laws", "ranking", "story")),
}
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def namespaces():
    """The package, and the modules among its public names: a new one is covered as soon as it is listed."""
    modules = (getattr(st, name) for name in dir(st))
    return [st, *(module for module in modules if inspect.ismodule(module) and hasattr(module, "__all__"))]


def public_names():
    """Public functions and classes by name; one that several namespaces have is listed once."""
    found = {}
    for space in namespaces():
        for name in sorted({*space.__all__, *dir(space)}):
            thing = getattr(space, name)
            if callable(thing) and not name.startswith("_"):
                found.setdefault(id(thing), (f"{space.__name__}.{name}", thing))
    return dict(found.values())


PUBLIC = public_names()
FINDER = doctest.DocTestFinder(recurse=False)


def examples():
    """Examples of public names and, if they have their own, of their members."""
    for name, thing in PUBLIC.items():
        own = vars(thing).items() if inspect.isclass(thing) else ()
        members = {f"{name}.{key}": member for key, member in own if not key.startswith("_")}
        for full, one in {name: thing, **members}.items():
            for test in FINDER.find(one, full, module=False, globs={}):
                yield pytest.param(test, id=full, marks=[pytest.mark.slow] * (full in SLOW))


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_name_has_an_example_with_a_result(name):
    text = inspect.getdoc(PUBLIC[name]) or ""
    _, heading, section = text.partition("\nExamples\n--------\n")
    written = doctest.DocTestParser().get_examples(section)
    assert heading, f"{name} needs a section Examples in its docstring (CONTRIBUTING.md)"
    assert any(example.want for example in written), f"the example of {name} shows no result"
    assert written[0].source.startswith(("import", "from")), f"the example of {name} needs its imports"


@pytest.mark.parametrize("test", list(examples()))
def test_an_example_gives_what_it_shows(test, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    doctest.DocTestRunner(verbose=False, optionflags=FLAGS).run(test, out=said.append)
    assert not said, "".join(said)


def test_no_slow_example_was_renamed():
    assert set(PUBLIC) >= SLOW
