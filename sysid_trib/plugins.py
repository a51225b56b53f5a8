"""Methods and force libraries of other installed packages, by their entry points."""

from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from sysid_trib.errors import UsageError

METHOD_PLUGINS, LIBRARY_PLUGINS = "sysid_trib.methods", "sysid_trib.libraries"


@lru_cache(maxsize=2)
def installed(group: str) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name; the first of several with the same name.

    Parameters
    ----------
    group : str
        `METHOD_PLUGINS` or `LIBRARY_PLUGINS`.
    """
    entries = entry_points(group=group)
    return {entry.name: entry for entry in reversed(list(entries))}


def loaded(entry: EntryPoint) -> Any:
    """Return the object named by an entry point.

    Raises
    ------
    UsageError
        The package that declares it cannot be imported, or lacks this object.
    """
    try:
        return entry.load()
    # Importing another package may raise any exception.
    except Exception as error:
        package = entry.dist.name if entry.dist is not None else "an installed package"
        raise UsageError(
            f"'{entry.name}' of {package} cannot be loaded ({type(error).__name__}: {error}); repair or "
            "remove that package."
        ) from error
