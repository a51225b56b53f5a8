"""Every public name has an example in its docstring, which runs as a newcomer would paste it."""

import doctest
import inspect
from functools import cached_property
from pathlib import Path

import pytest

import sysid_trib as st

# Examples that compute for more than a second, by their names without the package's.
SLOW = {
    "physics.law_difference",
    "physics.law_formulas",
    "physics.law_table",
    "physics.laws_in_si",
    "plots.friction_coefficient",
    "plots.interaction",
    "plots.law_difference",
    "plots.laws",
    "plots.overview",
    "plots.own_laws",
    "plots.ranking",
    "plots.sensitivity",
    "plots.story",
    "report",
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
            # Other packages may declare methods.
            own = getattr(thing, "__module__", "").partition(".")[0] == "sysid_trib"
            if callable(thing) and own:
                found.setdefault(id(thing), (f"{space.__name__}.{name}", thing))
    return dict(found.values())


PUBLIC = public_names()
FINDER = doctest.DocTestFinder(recurse=False)


def is_slow(name):
    return name.removeprefix("sysid_trib.") in SLOW


def members(name, thing):
    """Functions and properties of a public class by name."""
    kinds = (property, cached_property)
    own = vars(thing).items() if inspect.isclass(thing) else ()
    return {f"{name}.{key}": one for key, one in own if inspect.isfunction(one) or isinstance(one, kinds)}


def examples():
    """Examples of public names and, if they have their own, of their members."""
    for name, thing in PUBLIC.items():
        for full, one in {name: thing, **members(name, thing)}.items():
            yield from FINDER.find(one, full, module=False, globs={})


EXAMPLES = [test for test in examples() if test.examples]


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_name_has_an_example_with_a_result(name):
    text = inspect.getdoc(PUBLIC[name]) or ""
    _, heading, section = text.partition("\nExamples\n--------\n")
    written = doctest.DocTestParser().get_examples(section)
    assert heading, f"{name} needs a section Examples in its docstring (CONTRIBUTING.md)"
    assert any(example.want for example in written), f"the example of {name} shows no result"
    assert not any(example.options.get(doctest.SKIP) for example in written), f"{name} skips its example"
    assert written[0].source.startswith(("import", "from")), f"the example of {name} needs its imports"


@pytest.mark.parametrize(
    "test",
    [pytest.param(test, id=test.name, marks=[pytest.mark.slow] * is_slow(test.name)) for test in EXAMPLES],
)
def test_an_example_gives_what_it_shows(test, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    doctest.DocTestRunner(verbose=False, optionflags=FLAGS).run(test, out=said.append)
    assert not said, "".join(said)


def test_no_module_hides_a_public_name():
    """Importing a module sets its name in the package, in place of a public name that is the same."""
    for space in namespaces()[1:]:
        modules = {
            path.stem for folder in getattr(space, "__path__", ()) for path in Path(folder).glob("*.py")
        }
        assert modules.isdisjoint(space.__all__), space.__name__


def test_every_example_of_the_package_is_run():
    sources = [path.read_text(encoding="utf-8") for path in Path(st.__file__).parent.rglob("*.py")]
    written = sum(line.lstrip().startswith(">>> ") for text in sources for line in text.splitlines())
    assert written == sum(len(test.examples) for test in EXAMPLES)


def test_every_slow_example_exists():
    assert sorted(test.name.removeprefix("sysid_trib.") for test in EXAMPLES if is_slow(test.name)) == sorted(
        SLOW
    )
