"""Output of a command: text and tables on the terminal, files, figures; and its progress."""

import json
import os
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid_trib.commands.app import check_between
from sysid_trib.commands.options import (
    CommandOptions,
    DestinationOptions,
    FileOptions,
    IdentifyOptions,
    OptionRows,
    RecordOptions,
    ShownOptions,
)
from sysid_trib.datasets.fetching import files
from sysid_trib.datasets.registry import dataset_name, published
from sysid_trib.errors import DecayError, RecordError, Tell, UsageError, printable, readable, silent
from sysid_trib.printing import Block, Layer

if TYPE_CHECKING:
    import xarray as xr
    from rich.table import Table


def print_table(table: "Table") -> None:
    """Print a table without truncation."""
    from sysid_trib.printing.written import write_table

    write_table(table)


def print_blocks(
    blocks: Iterable[Block],
    layer: Layer = Layer.DEFAULT,
    ends: Iterable[str] = (),
    written: Iterable[Path | None] = (),
) -> None:
    """Print the blocks of a layer (see `write_blocks`), then the names of the written files."""
    from sysid_trib.printing.written import write_blocks

    write_blocks(blocks, layer, ends)
    print_written(*written)


def print_written(*places: Path | None) -> None:
    """Print the names of written files and folders."""
    for place in places:
        if place is not None:
            print(f"Written: {place}")


@contextmanager
def working(records: Sequence[Path] = ()) -> Iterator[Tell]:
    """Run a command: show progress, use one thread, and name the records in errors.

    Parameters
    ----------
    records : sequence of Path
        Files; none for the embedded example.
    """
    with progress() as tell, one_thread():
        try:
            yield tell
        except DecayError as error:
            # A method knows its records only by their numbers. A colon separates two samples.
            said = str(error)
            names = [record.name for record in records if record.name != ":"]
            if not names or any(name in said for name in names):
                raise
            more = f" and {len(names) - 1} more" if len(names) > 1 else ""
            raise DecayError(f"{names[0]}{more}: {said}") from None


@contextmanager
def progress() -> Iterator[Tell]:
    """Show progress on stderr, and remove it at the end; nothing if stderr is not a terminal.

    The import of computing modules takes noticeable time, so a command starts with this.

    Yields
    ------
    Tell
        Function that is given the name of the next activity; if its completed fraction is known, the
        remaining time is shown.
    """
    from rich import progress as bar
    from rich.console import Console

    console = Console(stderr=True, markup=False)
    if not console.is_terminal:
        # In older releases, a disabled Progress ends with an empty line.
        yield silent
        return
    times = bar.TaskProgressColumn(), bar.TimeRemainingColumn(), bar.TimeElapsedColumn()
    columns = bar.SpinnerColumn(), bar.TextColumn("{task.description}", markup=False), *times
    # Speed is estimated from the whole time since the start of an activity, even if reports are rare.
    with bar.Progress(*columns, console=console, transient=True, speed_estimate_period=1e9) as shown:
        task = shown.add_task("start", total=None)
        shown.refresh()

        def tell(activity: str, done: float | None = None) -> None:
            nonlocal task
            if done is None or done < shown.tasks[0].completed:
                # Another activity starts.
                shown.remove_task(task)
                task = shown.add_task(activity, total=None)
            total = None if done is None else 1.0
            shown.update(task, description=activity, total=total, completed=done or 0.0)

        yield tell


@contextmanager
def one_thread() -> Iterator[None]:
    """Run linear algebra in one thread, and restore the number of threads afterwards.

    The arrays are tall and narrow: threads of BLAS wait for each other longer than they compute, which costs
    a third of the time for a long record.
    """
    # Only loaded libraries can be limited: that of numpy, and a separate one of scipy.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield


def command_line() -> str:
    """Return the running command in a form in which it can be given again."""
    return readable(shlex.join(["sysid-trib", *sys.argv[1:]]))


# One inch in mm.
INCH = 25.4
# Options that name input files of a command.
READ = ("result", "test", "library", "candidates", "system")


def check_values(given: CommandOptions, rows: OptionRows) -> None:
    """Raise an error, before any computation, for a number out of range or a path that cannot be written.

    Raises
    ------
    UsageError
        A number is out of its range, a file has another extension, or options exclude each other.
    RecordError
        A path cannot be written, or the result would replace an input file.
    """
    if isinstance(given, DestinationOptions) and given.explain and given.quiet:
        raise UsageError("--explain prints more and --quiet prints less: choose one.")
    values = vars(given)
    reads = [Path(values[name]) for name in READ if values.get(name)]
    if isinstance(given, RecordOptions):
        reads += given.records
    for name, row in rows.items():
        if "within" in row:
            check_between(values[name], row["flag"], *row["within"])
        if "ending" in row:
            check_output(values[name], row["ending"], reads=reads, flag=row["flag"])
    if isinstance(given, IdentifyOptions) and given.methods_text is not None:
        check_output(given.methods_text.with_suffix(".bib"), ".bib", reads=reads, flag="--methods-text")
    if isinstance(given, ShownOptions):
        check_folder(given.plot)


def with_stored_inputs(given: CommandOptions) -> CommandOptions:
    """Return the options with the inputs that are stored for `dataset:NAME`, if none are given.

    The datasets are downloaded if need be.

    Raises
    ------
    UsageError
        There is no such dataset, or the datasets have different inputs.
    RecordError
        A dataset cannot be downloaded, or its file is another one.
    """
    if not isinstance(given, RecordOptions):
        return given
    names = [name for record in given.records if (name := dataset_name(record)) is not None]
    for name in names:
        files(name)
    if given.input_ is not None:
        return given
    stored = {name: published(name).reading.get("inputs", {}) for name in names}
    texts = {
        ",".join(column if name == "u" else f"{name}={column}" for name, column in inputs.items()): dataset
        for dataset, inputs in stored.items()
    }
    if len(texts) > 1:
        first, second, *_ = texts.values()
        raise UsageError(f"dataset:{first} and dataset:{second} have different inputs; give --input.")
    return given.but(input_=next(iter(texts), "") or None)


def check_output(target: Path | None, ending: str, *, reads: Sequence[Path] = (), flag: str = "-o") -> None:
    """Raise an error, before any computation, for a file that cannot be written."""
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
    """Raise an error for a folder of figures that is a file, or that is inside a file."""
    if folder is None:
        return
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        reason = "is not writable" if there.is_dir() else "is a file"
        raise RecordError(f"{folder}: cannot be written, {there} {reason}; choose another folder for --plot.")


def deliver(
    given: ShownOptions,
    tell: Tell,
    says: tuple[Callable[[], Iterable[Block]], Callable[[], dict[str, Any]]],
    tree: "xr.DataTree",
    texts: Mapping[Path | None, Callable[[], str]] | None = None,
    *,
    kind: str = "",
) -> Callable[[], None]:
    """Save and draw a result.

    Parameters
    ----------
    given : ShownOptions
        Options for the output.
    tell : Tell
        Function that is given the name of each activity.
    says : pair of callable
        Functions that return the printed blocks, in layers, and the JSON.
    tree : DataTree
        Contents of the netCDF file, with the command that made it.
    texts : mapping of Path to callable, optional
        Contents of text files, by path; a path of None is not written.
    kind : str
        Kind of the figures, if it does not follow from the result.

    Returns
    -------
    callable
        Function that prints the result.
    """
    from sysid_trib.results.files import save, write_file

    tell("files")
    blocks_of, data_of = says
    output = given.output if isinstance(given, FileOptions) else None
    written = {place: text_of for place, text_of in (texts or {}).items() if place is not None}
    tree.attrs["command"] = command_line()
    if output is not None:
        save(tree, output)
    for place, text_of in written.items():
        write_file(place, text_of().encode())
    if given.plot is not None:
        _draw(tree, kind, given.plot, given.width / INCH, tell)
    tell("what is to be said")
    whole = isinstance(given, DestinationOptions)
    following = str(tree.attrs.get("next", ""))
    others = str(tree.attrs.get("alternatives", "")).splitlines()
    if given.as_json:
        further = {"next": following, **({"alternatives": others} if others else {})}
        return partial(print_json, data_of() | (further if whole else {}))
    layer = Layer.DEFAULT
    if isinstance(given, DestinationOptions):
        layer = Layer.QUIET if given.quiet else Layer.EXPLAIN if given.explain else Layer.DEFAULT
    ends = ["More: --explain."] if whole and layer is Layer.DEFAULT else []
    ends += map(printable, others)
    ends += [f"Next: {printable(following)}"] if following else []
    return partial(print_blocks, [*blocks_of()], layer, ends, (output, *written, given.plot))


def print_json(data: Mapping[str, Any]) -> None:
    """Print the JSON output of a command."""
    from sysid_trib.printing.layout import plain

    print(json.dumps(plain(data), indent=2, allow_nan=False))


def _draw(tree: "xr.DataTree", kind: str, folder: Path, width: float, tell: Tell) -> None:
    """Write the figures of a result with a width in inches."""
    tell("figures")
    from sysid_trib.plots.figure import figures_of
    from sysid_trib.results.files import write_figure
    from sysid_trib.results.kinds import kind_of

    drawings = [drawn for figure in figures_of(kind or kind_of(tree)) for drawn in figure.drawings(tree)]
    for at, (name, _, draw) in enumerate(drawings):
        tell(f"figure {name}", at / len(drawings))
        write_figure(draw(width=width), folder / name)
