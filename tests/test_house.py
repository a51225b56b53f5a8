"""The house: rooms import only from rooms below, and speak in the words of the field."""

import ast
import io
import re
import tokenize
from collections import Counter

import pytest
from house import (
    PACKAGE,
    SLACK,
    arrows,
    circles,
    imported_modules,
    measures,
    modules,
    names_across_walls,
    reading,
    room_of,
    room_of_dotted,
    stored_measures,
    trees,
    unreachable,
    words_of,
)

import sysid_trib as st

ROOT = PACKAGE.parent

# From the ground up; each room imports only from rooms before it.
_split = re.compile(r"\S+").findall
ROOMS = _split("""
    errors _version _lazy plugins arrays forces datasets records simulation results cycles likelihood
    motion_fit methods validation smooth_laws discovery questions physics control campaigns printing plots
    reporting app commands cli
""")
# Words for which the field has others, as a part of an identifier (between its underscores).
WORDS = set(
    _split("""
    astray beside blind carrying course disagreement forecast freedom gap hint hopeless kick kicks
    kin labelled leaning leans leaves loud misfit moved narrowness needless oscillations probe
    probes promised pushed pushes remembered seeing sees slack spread standing steepness
    thinned thinning told twin twins unknowns visibility wander wild
""")
)
# Common words, as a whole identifier: there they hide what the thing is.
COMMON_WORDS = set(
    _split("""
    about agreement alone basis_of beyond chance cost each exchanged found fractional generic
    holding_out Guess left lost Moved no_better one Path Place price Problem Record Run scan
    scans share shared simpler stage stages_of strength unknown
""")
)
# Public names, the words that hold a forbidden one in a right sense, and keys of JSON.
NAMESPACES = ["campaigns", "datasets", "forces", "methods", "physics", "plots", "records", "validation"]
SPACES = (st, *(getattr(st, name) for name in NAMESPACES))
EXEMPT = {*(name for space in SPACES for name in dir(space)), "degrees_of_freedom", "freedoms"}
PHRASES = re.compile(
    r"""
    \b(?: (?<!paper_) twins? | lean(?:s|ing)?\b(?=\s(?:on|against|upon)) | forecasts? | misfits? | narrowness
    | steepness | remember(?:s|ed|ing) | (?<!shear.)thinn(?:ed|ing) | wild\ssamples? | blind\sto
    | holding\sout | no\sbetter\sthan
    | chance\s(?:of\serror|that) | with(?:out)?\sa\spast | carr(?:y|ies|ied|ying)\salong | needless(?:ly)?
    | (?:is|are|was|were)\stold | taken\sfor\sone
    | (?<!degrees\sof\s)(?<!of\n[ ]{8})freedom | disagreement(?!_map) | visibility
    | spreads?\sof ) \b
    """,
    re.VERBOSE | re.IGNORECASE,
)
# First words of docstrings that begin with a clause, a preposition or a pronoun.
CLAUSE = re.compile(
    r"(?:(?:Return|Yield) (?:what|how|why|where|whether|which|it|by how)"
    r"|What|How|Which|That|Whether|If|Nor|Not|No|None|Where|When|Why|Of|Those|These|The same|One that|It|So"
    r"|As|At|By|Up|In|On|For|From|With|Without|Beside|Only|Both|Along|Above|Below|Over|Until|Else|To)\b"
)
# First words of docstrings that begin with a noun phrase.
NOUN = re.compile(
    r"(?:The|An?|True|Each|Every|All|One|Its|RMS|[Pp]-value|[A-Z][\w-]* of|[A-Z][\w-]+[^s\W]s)\b"
)
# Names of types that every module may give to the same thing.
ALIASES = {"Array", "Vector", "Index", "Mask"}


def wrong(found_in, is_wrong):
    """Return the places where a module has something wrong; `found_in` gives words and their lines."""
    return [
        f"{name}:{line}: {word}"
        for name, module in modules().items()
        for word, line in found_in(*module)
        if room_of(name) in ROOMS and is_wrong(word)
    ]


def identifiers(tree, _):
    """Every identifier of a module with its line."""
    return [(name, node.lineno) for node in ast.walk(tree) if (name := identifier(node))]


def identifier(node):
    """The identifier that a node of a tree holds itself, else None."""
    attribute = {ast.Name: "id", ast.Attribute: "attr", ast.arg: "arg", ast.keyword: "arg"}
    attribute |= dict.fromkeys((ast.FunctionDef, ast.ClassDef), "name")
    return getattr(node, attribute.get(type(node), ""), None)


def bound(tree, _):
    """Identifiers that a module defines; `left` beside `right` is a side."""
    names = [
        (identifier(node), node.lineno)
        for node in ast.walk(tree)
        if isinstance(node, ast.arg | ast.FunctionDef | ast.ClassDef)
        or (isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))
    ]
    sides = {"left"} if "right" in {name for name, _ in names} else set()
    return [(name, line) for name, line in names if name not in sides]


def said(tree, text):
    """Forbidden phrases of comments, docstrings and texts with their lines; a lone word is a key."""
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            yield from phrases(token.string, token.start[0])
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and not node.value.isidentifier():
            yield from phrases(node.value, node.lineno)


def first_lines(tree, _):
    """Yield the first lines of docstrings."""
    for node in ast.walk(tree):
        holds = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        if holds and (text := ast.get_docstring(node)):
            yield text.splitlines()[0], node.body[0].lineno


def first_lines_of_functions(tree, _):
    """Yield the first lines of functions that are neither properties nor captions."""
    named = ("property", "cached_property", "shows", "decrement")
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and (text := ast.get_docstring(node)):
            decorators = [ast.unparse(decorator).partition("(")[0] for decorator in node.decorator_list]
            if not set(decorators) & set(named):
                yield text.splitlines()[0], node.body[0].lineno


def phrases(text, line=1):
    """Forbidden phrases of a text, with their lines."""
    return [(m[0], line + text.count("\n", 0, m.start())) for m in PHRASES.finditer(text)]


def test_a_room_imports_only_from_rooms_below():
    up = [(room, other) for room, other in arrows() if ROOMS.index(other) > ROOMS.index(room)]
    assert not up


def test_discovery_has_one_door():
    assert names_across_walls()["discovery"] == {"discovery.discover:discover"}


# What printers and figures read: results, forces as data, and plain helpers.
READ = {"results", "forces", "errors", "arrays", "_version", "_lazy", "printing", "plots"}
# Names of inputs and constants in a record: no computation.
ROLES = "records.roles"
# Figures of a record, which need no result.
OF_RECORDS = {"plots.looked", "plots.at_a_glance", "plots.over_time"}
# Lines that must be read to follow a printer.
MOST_TO_READ = 3500


def imports_that_compute(room):
    """Modules of a room that import rooms in which something is computed, with these imports."""
    of_room = (module for module in trees() if room_of_dotted(module) == room)
    found = {m: {i for i in imported_modules(m) if room_of_dotted(i) not in READ} - {ROLES} for m in of_room}
    return {module: imports for module, imports in found.items() if imports}


def test_printers_compute_nothing():
    """What a printer says is computed where the result is made, and stored in it."""
    assert not imports_that_compute("printing")


def test_only_figures_of_records_compute():
    assert set(imports_that_compute("plots")) <= OF_RECORDS


def test_a_printer_is_soon_read():
    printers = (module for module in trees() if room_of_dotted(module) == "printing")
    assert {module: reading(module) for module in printers if reading(module) > MOST_TO_READ} == {}


def test_every_room_is_in_the_list():
    assert {room_of(name) for name in modules()} - {"__init__", "__main__"} == set(ROOMS)


def test_no_circle_of_imports():
    assert not circles()


@pytest.mark.parametrize("measure", measures())
def test_a_measure_grows_little_in_one_landing(measure):
    """`python tests/house.py --write` stores the measures of a landing."""
    assert measures()[measure] <= (1.0 + SLACK) * stored_measures()[measure]


def test_every_measure_is_stored():
    assert set(stored_measures()) == set(measures())


def test_every_definition_is_reached_from_the_doors():
    """Public names, the program, and what typer, scikit-learn and numba call: tests keep nothing alive."""
    stubs = [ast.parse(path.read_text(encoding="utf-8")) for path in PACKAGE.rglob("*.pyi")]
    doors = {"app", "main", "format_epilog", "format_options", "get_feature_names"}
    doors |= {"load_overload", "save_overload", "_repr_html_"}
    assert not unreachable(doors.union(*map(words_of, stubs)))


def test_identifiers_are_the_words_of_the_field():
    assert not wrong(identifiers, lambda word: word not in EXEMPT and WORDS & set(word.lower().split("_")))


def test_identifiers_name_the_thing():
    assert not wrong(bound, lambda word: word.strip("_") in COMMON_WORDS)


def test_docstrings_begin_with_a_verb_or_the_name_of_a_thing():
    """A clause such as "What ..." or "By how much ..." names neither."""
    assert not wrong(first_lines, CLAUSE.match)


def test_docstrings_of_functions_begin_with_a_verb():
    """Other forms than "The distance" or "Distance of" are left to the reader."""
    assert not wrong(first_lines_of_functions, NOUN.match)


def test_texts_are_in_the_words_of_the_field():
    assert not wrong(said, bool)


@pytest.mark.parametrize("place", ["docs", "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "libraries"])
def test_pages_are_in_the_words_of_the_field(place):
    if not (ROOT / place).exists():
        pytest.skip("not in this package")
    paths = [ROOT / place] if (ROOT / place).is_file() else sorted((ROOT / place).glob("*.*"))
    for path in (path for path in paths if path.suffix in (".md", ".toml")):
        # Names in backticks are public ones, or keys of JSON.
        assert not phrases(re.sub(r"`[^`\n]+`", "", path.read_text(encoding="utf-8"))), path.name


def test_a_constant_or_class_means_one_thing():
    homes = Counter(word for name, (tree, _) in modules().items() for word in set(defined(tree)))
    assert not {word for word, count in homes.items() if count > 1} - ALIASES


# What is decided in one place, and read everywhere.
HOMES = {
    "as_runs": "records/runs.py",
    "kind_of": "results/kinds.py",
    "departure_time": "validation/residuals.py",
    "widening": "validation/verdict.py",
    "verdict_word": "validation/judge.py",
    "preferred_of": "results/judged.py",
    "move_of": "discovery/exchange.py",
}


def functions():
    """Every function with the name of its module."""
    walked = ((name, node) for name, (tree, _) in modules().items() for node in ast.walk(tree))
    return [(name, node) for name, node in walked if isinstance(node, ast.FunctionDef)]


def test_each_decision_is_made_in_one_place():
    defined_in = {
        (node.name.strip("_"), name)
        for name, (tree, _) in modules().items()
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
    }
    assert {(function, name) for function, name in defined_in if function in HOMES} == set(HOMES.items())


def test_the_kind_of_a_result_is_asked_not_guessed():
    guess = re.compile(r'"(?:steps|ranking|stiffness_difference)" (?:not )?in \w+')
    guesses = {name for name, (_, text) in modules().items() if guess.search(text)}
    assert guesses == {"results/kinds.py"}


def defined(tree):
    """Constants and classes of a module."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            names = [n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]
            yield from (name for name in names if not name.islower() and name != "_")


def test_caches_are_bounded():
    unbounded = ("cache", "functools.cache", "lru_cache(maxsize=None)")
    assert not [
        f"{name}: {node.name}"
        for name, node in functions()
        if _arguments(node) and any(ast.unparse(decorator) in unbounded for decorator in node.decorator_list)
    ]


def test_functions_are_small():
    assert not [f"{name}: {node.name}" for name, node in functions() if _length(node) > 60]


def _length(function):
    first = function.body[1 if ast.get_docstring(function) else 0 :] or function.body
    return function.end_lineno - first[0].lineno + 1


def _arguments(function):
    given = function.args
    names = [arg.arg for arg in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return len([name for name in names if name not in ("self", "cls")])


@pytest.mark.skipif(not (ROOT / "README.md").exists(), reason="README is not in this package")
def test_the_front_door_is_short():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 175
