"""Public names of a package, each imported on first use, so that the command line starts quickly."""

import ast
import sys
import warnings
from collections.abc import Callable
from importlib import import_module
from importlib.util import resolve_name
from pathlib import Path
from typing import Any

from sysid_trib.errors import did_you_mean


def public_names(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return `__getattr__`, `__dir__` and `__all__` of a package, from the names in its stub `__init__.pyi`.

    The stub may map old names to new ones in `__deprecated__`. An old name is not listed; it gives a
    `DeprecationWarning` and the object with the new name.

    Parameters
    ----------
    package, file : str
        `__name__` and `__file__` of the package.
    """
    homes: dict[str, tuple[str, str]] = {}
    listed: list[str] = []
    replacements: dict[str, str] = {}
    for node in ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            home = resolve_name("." * node.level + (node.module or ""), package)
            homes |= {alias.name: (home, alias.name) for alias in node.names}
        elif isinstance(node, ast.Assign):
            assigned = ast.literal_eval(node.value)
            if ast.unparse(node.targets[0]) == "__deprecated__":
                replacements = assigned
            else:
                listed = assigned

    def load(name: str) -> Any:
        if name in replacements:
            new = replacements[name]
            message = f"{package}.{name} is deprecated and will be removed; use {package}.{new}."
            warnings.warn(message, DeprecationWarning, stacklevel=2)
            name = new
        if name not in homes:
            # Names that begin with an underscore are requested by tools, which do not show the message to a
            # user.
            nearest = "" if name.startswith("_") else did_you_mean(name, homes)
            raise AttributeError(f"module {package!r} has no attribute {name!r}.{nearest}")
        home, attribute = homes[name]
        # A name from the package itself is one of its modules.
        value = (
            import_module(f"{home}.{attribute}")
            if home == package
            else getattr(import_module(home), attribute)
        )
        vars(sys.modules[package])[name] = value
        return value

    return load, lambda: sorted(homes), listed or sorted(homes)
