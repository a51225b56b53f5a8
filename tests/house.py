"""The house in numbers: `python tests/house.py` prints the lines of code of each room and their arrows."""

import ast
import re
import statistics
from collections import Counter
from functools import cache
from pathlib import Path

import sysid_trib

PACKAGE = Path(sysid_trib.__file__).parent


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
    """Pairs of rooms of which the first imports from the second."""
    pairs = {(room_of(name), room) for name, (tree, _) in modules().items() for room in imported(tree)}
    return {(room, other) for room, other in pairs if room != other and not room.startswith("__")}


def circles():
    """Modules that cannot be imported without themselves, by what they import at once."""
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
    """Each module's functions, classes, methods, constants: (module, name), what it needs, what it uses."""
    for module, (tree, _) in modules().items():
        for node in tree.body:
            methods = [n for n in getattr(node, "body", ()) if isinstance(n, ast.FunctionDef)]
            if isinstance(node, ast.FunctionDef):
                yield (module, node.name), {node.name}, words_of(node)
            elif isinstance(node, ast.ClassDef):
                # Each method stands alone; Python itself calls some as soon as there is the class.
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
                # What a package imports is public, as what its stub lists.
                yield (module, "(public)"), set(), words_of(node)


def unreachable(doors):
    """Definitions that nothing reaches by name from the doors, a set of words."""
    reached, rest = set(doors), list(definitions())
    while found := [definition for definition in rest if definition[1] <= reached]:
        rest = [definition for definition in rest if definition not in found]
        reached |= set().union(*(used for *_, used in found))
    return sorted({f"{module}: {name}" for (module, name), *_ in rest})


def code_lines(tree, text):
    """Lines of a module that are neither blank nor a comment nor a docstring."""
    lines = {i for i, line in enumerate(text.splitlines(), 1) if line.strip() and line.strip()[0] != "#"}
    for node in ast.walk(tree):
        holds = isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        if holds and ast.get_docstring(node, clean=False) is not None:
            lines -= set(range(node.body[0].lineno, node.body[0].end_lineno + 1))
    return len(lines)


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
    """What the house is measured by."""
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
    for title, count in [*rooms.most_common(), *numbers().items()]:
        print(f"{count:>8}  {title}")
