"""Where the result of a command goes: files, figures, and standard output."""

import json
import os
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid_trib.commands.app import Asked, check_between
from sysid_trib.commands.terminal import command_line, print_blocks
from sysid_trib.errors import RecordError, Tell, UsageError, printable
from sysid_trib.printing import Block, Layer

if TYPE_CHECKING:
    import xarray as xr

# mm.
INCH = 25.4
# Options that name what a command reads.
READ = ("result", "test", "library", "candidates", "system")


def check_values(given: Asked) -> None:
    """Refuse, before the work is done, a number out of its range, and places that cannot be written.

    Raises
    ------
    UsageError
        A number out of its range, a file of another ending, or options that exclude each other.
    RecordError
        A place that cannot be written, or the result would replace what is read.
    """
    values = vars(given)
    if values.get("explain") and values.get("quiet"):
        raise UsageError("--explain prints more and --quiet prints less: choose one.")
    reads = [*values.get("records", ()), *(Path(values[name]) for name in READ if values.get(name))]
    for name, option in given.options.items():
        if option.within:
            check_between(values[name], option.flag, *option.within)
        if option.ending:
            check_output(values[name], option.ending, reads=reads, flag=option.flag)
    if values.get("methods") and "plot" in values:
        check_output(values["methods"].with_suffix(".bib"), ".bib", reads=reads, flag="--methods")
    check_folder(values.get("plot"))


def check_output(target: Path | None, ending: str, *, reads: Sequence[Path] = (), flag: str = "-o") -> None:
    """Refuse a file that cannot be written before the work is done, not after."""
    if target is None:
        return
    if target.is_dir():
        raise RecordError(f"{target}: cannot be written, it is a directory; name a file in it with {flag}.")
    if target.suffix.lower() not in ending.split():
        raise UsageError(f"{target}: the ending must be {ending.replace(' ', ' or ')}.")
    reason = ""
    if not os.access(target.parent, os.W_OK | os.X_OK):
        there = target.parent.is_dir()
        reason = f"cannot be written, its folder {'is not writable' if there else 'does not exist'}"
    elif target.exists() and any(os.path.exists(read) and target.samefile(read) for read in reads):
        reason = "the result would replace a file that is read"
    if reason:
        raise RecordError(f"{target}: {reason}; choose another place with {flag}.")


def check_folder(folder: Path | None) -> None:
    """Refuse a folder for figures that is a file, or lies in one."""
    if folder is None:
        return
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        reason = "is not writable" if there.is_dir() else "is a file"
        raise RecordError(f"{folder}: cannot be written, {there} {reason}; choose another folder for --plot.")


def deliver(
    given: Asked,
    tell: Tell,
    says: tuple[Callable[[], Sequence[Block]], Callable[[], dict[str, Any]]],
    tree: "xr.DataTree",
    texts: Mapping[Path | None, Callable[[], str]] | None = None,
    *,
    kind: str = "",
) -> Callable[[], None]:
    """Save and draw a result.

    Parameters
    ----------
    given : Asked
        Where it goes.
    tell : Tell
        Called with what begins.
    says : pair of callable
        What is printed, in layers, and as JSON.
    tree : DataTree
        What a file of netCDF holds, with the command that made it.
    texts : mapping of Path to callable, optional
        What stands in files of text; None as a place is no file.
    kind : str
        Figures of which kind are drawn, where that of the result does not say it.

    Returns
    -------
    callable
        Prints it.
    """
    from sysid_trib.results.files import save, write_file

    tell("files")
    written = {place: text_of for place, text_of in (texts or {}).items() if place is not None}
    places = [vars(given).get("output"), *written, given.plot]
    tree.attrs["command"] = command_line()
    if places[0] is not None:
        save(tree, places[0])
    for place, text_of in written.items():
        write_file(place, text_of().encode())
    if given.plot is not None:
        _draw(tree, kind, given.plot, given.width / INCH, tell)
    tell("what is to be said")
    whole = "explain" in given.options
    following = tree.attrs.get("next", "") if whole else ""
    if given.as_json:
        return partial(print_json, says[1]() | ({"next": following} if whole else {}))
    layer = Layer.DEFAULT
    if whole:
        layer = Layer.QUIET if given.quiet else Layer.EXPLAIN if given.explain else Layer.DEFAULT
    ends = ["More: --explain."] if whole and layer is Layer.DEFAULT else []
    ends += [f"Next: {printable(following)}"] if following else []
    return partial(print_blocks, says[0](), layer, ends, places)


def print_json(data: Mapping[str, Any]) -> None:
    """Print what a command gives with --json."""
    print(json.dumps(data, indent=2, allow_nan=False))


def _draw(tree: "xr.DataTree", kind: str, folder: Path, width: float, tell: Tell) -> None:
    """Write the figures of a result, of a width in inches."""
    tell("figures")
    from sysid_trib.plots.declared import figures_of
    from sysid_trib.results.files import kind_of, write_figure

    drawings = [drawn for figure in figures_of(kind or kind_of(tree)) for drawn in figure.drawings(tree)]
    for at, (name, _, draw) in enumerate(drawings):
        tell(f"figure {name}", at / len(drawings))
        write_figure(draw(width=width), folder / name)


def texts_of(given: Asked, tree: "xr.DataTree") -> dict[Path | None, Callable[[], str]]:
    """What stands in the files of text of a result, by their places."""
    from sysid_trib.printing.exported import csv_text, latex_text

    return {given.csv: partial(csv_text, tree), given.latex: partial(latex_text, tree)}
