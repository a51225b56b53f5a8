"""The house in numbers: `python tests/house.py` prints the lines of code of each room and their arrows.

`python tests/house.py --write` stores the measures of `house_measures.toml`, which `test_house.py` reads.
"""

import ast
import io
import re
import statistics
import sys
import tokenize
import tomllib
from collections import Counter
from functools import cache
from pathlib import Path

import sysid_trib

PACKAGE = Path(sysid_trib.__file__).parent
MEASURES = Path(__file__).with_name("house_measures.toml")
# By how much a measure may grow in one landing.
SLACK = 0.02
# Modules whose reading is measured: a method, the answer to one record, and its printer.
READ = ("methods.direct", "validation.identify", "printing.identification")
LAYOUT_TOKENS = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


@cache
def modules():
    """Every module by its path within the package, as a tree and as text."""
    paths = {path.relative_to(PACKAGE).as_posix(): path for path in sorted(PACKAGE.rglob("*.py"))}
    texts = {name: path.read_text(encoding="utf-8") for name, path in paths.items()}
    return {name: (ast.parse(text), text) for name, text in texts.items()}


def room_of(name):
    return name.partition("/")[0].removesuffix(".py")


def imported(tree):
    """Rooms that a module imports from."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "sysid_trib":
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("sysid_trib."):
            yield node.module.split(".")[1]
        elif isinstance(node, ast.Import):
            yield from (a.name.split(".")[1] for a in node.names if a.name.startswith("sysid_trib."))


def arrows():
    """Pairs of rooms in which the first imports from the second."""
    pairs = {(room_of(name), room) for name, (tree, _) in modules().items() for room in imported(tree)}
    return {(room, other) for room, other in pairs if room != other and not room.startswith("__")}


def circles():
    """Modules in an import cycle, found from the imports at their top level."""
    homes = {"sysid_trib." + name.removesuffix(".py").replace("/", "."): name for name in modules()}
    imports = {
        name: {homes[n.module] for n in tree.body if isinstance(n, ast.ImportFrom) and n.module in homes}
        for name, (tree, _) in modules().items()
    }
    while free := {name for name, needs in imports.items() if not needs & set(imports)}:
        imports = {name: needs for name, needs in imports.items() if name not in free}
    return imports


def words_of(node):
    """Names that a piece of code uses, also as attributes, arguments, and words of texts."""
    words = set()
    for part in ast.walk(node):
        for field in ("id", "attr", "arg", "name", "module"):
            words.add(getattr(part, field, None))
        if isinstance(part, ast.Constant) and isinstance(part.value, str):
            words.update(re.findall(r"\w+", part.value) if len(part.value) < 200 else ())
    return words


def definitions():
    """Functions, classes, methods and constants of all modules: (module, name), what each needs and uses."""
    for module, (tree, _) in modules().items():
        for node in tree.body:
            methods = [n for n in getattr(node, "body", ()) if isinstance(n, ast.FunctionDef)]
            if isinstance(node, ast.FunctionDef):
                yield (module, node.name), {node.name}, words_of(node)
            elif isinstance(node, ast.ClassDef):
                # Each method is separate; Python itself calls some of them when the class exists.
                for method in methods:
                    needed = {node.name} if method.name.startswith("__") else {node.name, method.name}
                    yield (module, f"{node.name}.{method.name}"), needed, words_of(method)
                rest = ast.Module(
                    [*node.bases, *node.decorator_list, *(n for n in node.body if n not in methods)]
                )
                yield (module, node.name), {node.name}, words_of(rest)
            elif isinstance(node, ast.Assign | ast.AnnAssign | ast.AugAssign):
                names = [n for n in ast.walk(node) if isinstance(n, ast.Name)]
                for name in {n.id for n in names if isinstance(n.ctx, ast.Store)}:
                    yield (module, name), {name}, words_of(node)
            elif isinstance(node, ast.For | ast.If):
                yield (module, "(when imported)"), set(), words_of(node)
            elif isinstance(node, ast.ImportFrom) and module.endswith("/__init__.py"):
                # Names that a package imports, or that are in its stub, are public.
                yield (module, "(public)"), set(), words_of(node)


def unreachable(doors):
    """Definitions that nothing reaches by name from the doors, a set of words."""
    reached, rest = set(doors), list(definitions())
    while found := [definition for definition in rest if definition[1] <= reached]:
        rest = [definition for definition in rest if definition not in found]
        reached |= set().union(*(used for *_, used in found))
    return sorted({f"{module}: {name}" for (module, name), *_ in rest})


def docstring_lines(tree):
    """Line numbers of the docstrings of a module, its classes and its functions."""
    lines = set()
    for node in ast.walk(tree):
        holds = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        if holds and ast.get_docstring(node, clean=False) is not None:
            lines |= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return lines


def code_lines(tree, text):
    """Lines of a module that are neither blank nor a comment nor a docstring."""
    lines = {i for i, line in enumerate(text.splitlines(), 1) if line.strip() and line.strip()[0] != "#"}
    return len(lines - docstring_lines(tree))


def code_tokens(tree, text):
    """Tokens of a module without comments, docstrings, line ends and indentation."""
    docstrings = docstring_lines(tree)
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(token.type not in LAYOUT_TOKENS and token.start[0] not in docstrings for token in tokens)


def dotted(name):
    """Name of a module within the package, as in an import: "methods.direct"."""
    return name.removesuffix(".py").replace("/", ".").removesuffix(".__init__")


def room_of_dotted(module):
    return module.partition(".")[0]


@cache
def trees():
    """Trees of the modules by their dotted names."""
    return {dotted(name): tree for name, (tree, _) in modules().items()}


def is_folder(module):
    """True for a package, such as "methods"."""
    return bool(module) and (PACKAGE / module.replace(".", "/")).is_dir()


def imported_names(module):
    """Each name that a module imports from the package: (module of origin, name there, name here)."""
    for node in ast.walk(trees()[module]):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("sysid_trib"):
            source = node.module.removeprefix("sysid_trib").lstrip(".")
            yield from ((source, alias.name, alias.asname or alias.name) for alias in node.names)


@cache
def imported_modules(module):
    """Modules that a module imports, also within functions."""
    found = set()
    for source, name, _ in imported_names(module):
        for candidate in (f"{source}.{name}".lstrip("."), source):
            if candidate in trees():
                found.add(candidate)
                break
    return found


@cache
def lines_of_modules():
    """Code lines of each module by its dotted name."""
    return {dotted(name): code_lines(*module) for name, module in modules().items()}


def reading(start):
    """Code lines that must be read to understand a module: its own and those of all imported modules.

    The `__init__.py` of a package counts only where the module itself imports the package.
    """
    lines = lines_of_modules()
    seen, waiting = set(), [start]
    while waiting:
        module = waiting.pop()
        if module not in seen:
            seen.add(module)
            waiting += [m for m in imported_modules(module) if module == start or not is_folder(m)]
    return sum(lines[module] for module in seen)


def names_across_walls():
    """Names of each room that other rooms use: room to "module:name"."""
    used = {}

    def note(module, source, name):
        if room_of_dotted(source) != room_of_dotted(module):
            used.setdefault(room_of_dotted(source), set()).add(f"{source}:{name}")

    for module, tree in trees().items():
        modules_here = {}
        for source, name, name_here in imported_names(module):
            whole = f"{source}.{name}".lstrip(".")
            if whole in trees() or is_folder(whole):
                modules_here[name_here] = whole
            elif source:
                note(module, source, name)
        for node in ast.walk(tree):
            owner = getattr(node, "value", None)
            if isinstance(node, ast.Attribute) and getattr(owner, "id", None) in modules_here:
                note(module, modules_here[owner.id], node.attr)
    return used


def named_numbers():
    """Numbers that have a name in a module, alone or in a tuple."""
    count = 0
    for tree in trees().values():
        for node in tree.body:
            if isinstance(node, ast.Assign | ast.AnnAssign):
                values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                count += sum(is_number(value) for value in values)
    return count


def is_number(node):
    value = getattr(node, "value", None) if isinstance(node, ast.Constant) else None
    return isinstance(value, int | float) and not isinstance(value, bool)


def docstrings_with_what():
    """First lines of docstrings that begin with "What" instead of a verb or a noun."""
    nodes = [node for tree in trees().values() for node in ast.walk(tree)]
    texts = [ast.get_docstring(n) for n in nodes if isinstance(n, ast.FunctionDef | ast.ClassDef)]
    return sum((text or "").startswith("What ") for text in texts)


@cache
def measures():
    """Return the measures that may grow by `SLACK` at most."""
    tokens = sum(code_tokens(*module) for module in modules().values())
    lines = sum(code_lines(*module) for module in modules().values())
    tables = [path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.toml")]
    aliases = re.compile(r"^\w+: TypeAlias = tuple\[", re.MULTILINE)
    return {
        "tokens": tokens,
        "tokens of TOML": sum(len(re.findall(r"[\w.]+|[^\s\w]", text)) for text in tables),
        "tokens a line": round(tokens / lines, 2),
        **{f"lines to read for {module}": reading(module) for module in READ},
        "names across walls": sum(map(len, names_across_walls().values())),
        "named numbers": named_numbers(),
        "positional tuple aliases": sum(len(aliases.findall(text)) for _, text in modules().values()),
        "docstrings that begin with What": docstrings_with_what(),
    }


def stored_measures():
    """Return the measures at the last landing."""
    return tomllib.loads(MEASURES.read_text(encoding="utf-8"))


def lines_beside(folder):
    """Code lines of tests or benchmarks."""
    texts = [path.read_text(encoding="utf-8") for path in (PACKAGE.parent / folder).rglob("*.py")]
    return sum(code_lines(ast.parse(text), text) for text in texts)


def import_lines(name):
    """Lines of a module that import."""
    nodes = [node for node in ast.walk(modules()[name][0]) if isinstance(node, ast.Import | ast.ImportFrom)]
    return sum(node.end_lineno - node.lineno + 1 for node in nodes)


@cache
def numbers():
    """Return the measures of the structure."""
    code = {name: code_lines(*module) for name, module in modules().items()}
    lines = [count for name, count in code.items() if not name.endswith("__init__.py")]
    return {
        "code lines": sum(code.values()),
        "files": len(code),
        "rooms": len({room_of(name) for name in code if "/" in name}),
        "arrows": len(arrows()),
        "modules in circles": len(circles()),
        "classes": sum(isinstance(n, ast.ClassDef) for tree, _ in modules().values() for n in ast.walk(tree)),
        "median code lines of a module": statistics.median(lines),
        "modules of fewer than 40": sum(count < 40 for count in lines),
        "modules of more than 300 with docstrings": sum(
            text.count("\n") > 300 for _, text in modules().values()
        ),
        "per cent of code that imports": round(100 * sum(map(import_lines, code)) / sum(code.values()), 1),
        "public names at the top": len(sysid_trib.__all__),
        **{f"code lines of {folder}": lines_beside(folder) for folder in ("tests", "benchmarks")},
    }


if __name__ == "__main__":
    rooms = Counter()
    for name, module in modules().items():
        rooms[room_of(name) if "/" in name else "(loose)"] += code_lines(*module)
    for title, count in [*rooms.most_common(), *numbers().items(), *measures().items()]:
        print(f"{count:>8}  {title}")
    for room, names in sorted(names_across_walls().items(), key=lambda item: -len(item[1])):
        print(f"{len(names):>8}  names of {room} in other rooms")
    if "--write" in sys.argv:
        MEASURES.write_text("".join(f'"{title}" = {value}\n' for title, value in measures().items()))
