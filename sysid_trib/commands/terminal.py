"""Text, tables and progress on the terminal, and the command that follows from a result."""

import shlex
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from sysid_trib.commands.app import COMMANDS, Asked, options_of
from sysid_trib.errors import DecayError, Tell, printable, readable, silent
from sysid_trib.printing import Block, Layer

if TYPE_CHECKING:
    from pathlib import Path

    import xarray as xr
    from rich.table import Table


def print_table(table: "Table") -> None:
    """Print a table whole."""
    from rich.console import Console

    # Markup would take a bracket in the name of a force for a command.
    console = Console(highlight=False, markup=False, emoji=False)
    # A result must be whole wherever it goes: a terminal may fold words but not numbers, a pipe nothing.
    if not console.is_terminal:
        # Columns of a table that is not cut short.
        console.width = console.measure(table, options=console.options.update(width=2000)).maximum
    console.print(table, crop=False)


def print_blocks(
    blocks: Iterable[Block],
    layer: Layer = Layer.DEFAULT,
    ends: Iterable[str] = (),
    written: "Iterable[Path | None]" = (),
) -> None:
    """Print the blocks of a layer, with an empty line between two; `--explain` has headings.

    Below them stand the lines `ends`, and the files and folders that were written.
    """
    shown = [block for block in blocks if layer in block.layers and (block.sentences or block.table)]
    section = ""
    for at, block in enumerate(shown):
        if at:
            print()
        if block.title not in ("", section) and layer is Layer.EXPLAIN:
            print(block.title)
        section = block.title
        for sentence in block.sentences:
            print(printable(sentence))
        if block.table is not None:
            if block.caption:
                print(block.caption)
            print_table(block.table)
    for sentence in ends:
        print(sentence)
    print_written(*written)


def record_sentences(tree: "xr.DataTree", sentences: Sequence[str]) -> list[str]:
    """The sentence on each record, and what was cut of it."""
    from sysid_trib.results.variables import record_groups

    pairs = zip(sentences, record_groups(tree), strict=True)
    return [text for sentence, group in pairs for text in (sentence, tree[group].attrs.get("free_decay", ""))]


def print_written(*places: "Path | None") -> None:
    """Print the files and folders that were written."""
    for place in places:
        if place is not None:
            print(f"Written: {place}")


@contextmanager
def working(records: "Sequence[Path]" = ()) -> Iterator[Tell]:
    """How a command works: it says what is under way, computes in one thread, and names what is refused.

    Parameters
    ----------
    records : sequence of Path
        Files; none for the embedded example.
    """
    with progress() as tell, one_thread():
        try:
            yield tell
        except DecayError as error:
            # A method knows numbers alone. A colon stands between two samples.
            said, names = str(error), [record.name for record in records if record.name != ":"]
            if not names or any(name in said for name in names):
                raise
            more = f" and {len(names) - 1} more" if len(names) > 1 else ""
            raise DecayError(f"{names[0]}{more}: {said}") from None


@contextmanager
def progress() -> Iterator[Tell]:
    """What is under way, on stderr, gone when all is done; nothing where no terminal is.

    To import what computes takes longer than a reader likes to see nothing: a command begins with this.

    Yields
    ------
    Tell
        Takes the name of what begins; where the part of it that is done is known, the time left is shown.
    """
    from rich import progress as bar
    from rich.console import Console

    console = Console(stderr=True, markup=False)
    if not console.is_terminal:
        # A Progress that is disabled ends with an empty line in older releases.
        yield silent
        return
    times = bar.TaskProgressColumn(), bar.TimeRemainingColumn(), bar.TimeElapsedColumn()
    columns = bar.SpinnerColumn(), bar.TextColumn("{task.description}", markup=False), *times
    # Of all that is done since an activity began, however seldom it says so.
    with bar.Progress(*columns, console=console, transient=True, speed_estimate_period=1e9) as shown:
        task = shown.add_task("start", total=None)
        shown.refresh()

        def tell(activity: str, done: float | None = None) -> None:
            nonlocal task
            if done is None or done < shown.tasks[0].completed:
                # Something else begins.
                shown.remove_task(task)
                task = shown.add_task(activity, total=None)
            total = None if done is None else 1.0
            shown.update(task, description=activity, total=total, completed=done or 0.0)

        yield tell


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra in one thread, and after it in as many as before.

    Tables are tall and narrow: threads of BLAS wait for each other longer than they compute, a third of the
    time of a long record.
    """
    # Only libraries that are loaded can be limited: that of numpy, and one of scipy's own.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1, user_api="blas"):
        yield


def command_line() -> str:
    """The command that runs, as it can be given again."""
    return readable(shlex.join(["sysid-trib", *sys.argv[1:]]))


RECORDS = "records"
# What the next command asks of the same records and forces.
TAKEN_OVER = options_of(RECORDS, "model", "start", "search")


def keep_next(tree: "xr.DataTree", given: Asked) -> None:
    """Keep the command that follows from a result as its attribute `next`.

    Parameters
    ----------
    tree : DataTree
        Result of a command.
    given : Asked
        What the command was given; the next command takes over the options that it knows.
    """
    from sysid_trib.printing.next_step import next_step

    command, reason, options = next_step(tree)
    tree.attrs["next"] = f"{command_after(command, options, given)} # {reason}"


def command_after(command: str, others: Mapping[str, str | None], given: Asked) -> str:
    """A command with the options that were given before, and others in their place (see `next_step`)."""
    known, options = options_of(*COMMANDS[command]["options"]), given.options
    changed = {name: vars(given)[name] for name in options if name in TAKEN_OVER}
    if "candidates" not in known and "library" in changed and not given.changed(["library"]):
        # Forces that the package ships are known to every command, one's own candidates by their file.
        changed["library"] = changed.get("candidates") or changed["library"]
    # A dash at the beginning of a word would be an option.
    files = map(str, changed.pop(RECORDS, []))
    words = [f"./{file}" if file.startswith("-") else file for file in files]
    words += [file for name, file in others.items() if name == RECORDS and file]
    for name, value in changed.items():
        if name in known and name.strip("_") not in others and value != options[name].default:
            for item in value if isinstance(value, list | tuple) else [value]:
                # A switch is its flag alone.
                words += [options[name].flag] if isinstance(item, bool) else [options[name].flag, str(item)]
    for name, value in others.items():
        if value is not None and name != RECORDS:
            words += [f"--{name.replace('_', '-')}", *filter(None, [value])]
    return readable(shlex.join(["sysid-trib", command, *words]))
