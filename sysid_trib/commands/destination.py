"""Where the result of a command goes: a file, figures, and standard output."""

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, ClassVar

from sysid_trib.commands.options import OUTPUT, WHERE_TO_WRITE, option, switch
from sysid_trib.commands.terminal import command_line, print_blocks, print_written, progress
from sysid_trib.errors import RecordError, UsageError, printable
from sysid_trib.printing import Block, Layer

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

    from sysid_trib.errors import Tell

    Figures = Callable[[Any], Iterable[tuple[str, Callable[[], Figure]]]]


# mm; widths of figures between which texts have room.
PAGE_WIDTH, WIDTHS, INCH = 180.0, (80.0, 400.0), 25.4


@dataclass(frozen=True)
class Shown:
    """What standard output shows, and where figures go."""

    title: ClassVar[str] = OUTPUT

    as_json: bool = switch("--json", "Print the result as JSON, and nothing else.")
    plot: Path | None = option("DIR", "Folder for the figures (PDF and PNG).")
    width: float = option("MM", "Of the figures: 88 of a column, 180 of a page.", PAGE_WIDTH)

    def check(self, records: Sequence[Path]) -> None:
        """Refuse, before the work is done, places that cannot be written.

        Parameters
        ----------
        records : sequence of Path
            Files that the result must not replace.

        Raises
        ------
        UsageError
            A file of another ending.
        RecordError
            A place that cannot be written.
        """
        from sysid_trib.commands.checks import check_between

        check_folder(self.plot)
        check_between(self.width, "--width", *WIDTHS, " mm")

    @property
    def places(self) -> "list[Path | None]":
        """What is written, where it is asked for."""
        return [getattr(self, name, None) for name in ("output", "csv", "latex", "plot")]

    def say(self, data: Callable[[], dict[str, Any]], blocks: Callable[[], Sequence[Block]]) -> None:
        """Print a result, as JSON or in words."""
        print_result(data, blocks, self.places, as_json=self.as_json)

    def draw(self, figures: "Figures", tell: "Tell") -> None:
        """Write the figures, if they are asked for.

        Parameters
        ----------
        figures : callable
            Takes the room of the figures, and gives the name of each figure and what draws it.
        tell : Tell
            Called with the name of each.
        """
        if self.plot is None:
            return
        tell("figures")
        from sysid_trib import plots
        from sysid_trib.results.files import write_figure

        sized = {name: partial(getattr(plots, name), width=self.width / INCH) for name in dir(plots)}
        drawn = list(figures(SimpleNamespace(**sized)))
        for at, (name, draw) in enumerate(drawn):
            tell(f"figure {name}", at / len(drawn))
            write_figure(draw(), self.plot / name)


@dataclass(frozen=True)
class Files(Shown):
    """Where else the numbers go."""

    output: Path | None = option("FILE", WHERE_TO_WRITE, flags=("-o", "--output"))
    csv: Path | None = option("FILE", "Where to write the numbers as a table (CSV).")

    def check(self, records: Sequence[Path]) -> None:
        """Refuse, before the work is done, places that cannot be written."""
        check_output(self.output, ".nc", reads=records)
        check_output(self.csv, ".csv", reads=records, flag="--csv")
        super().check(records)

    def save(self, tree: "xr.DataTree", texts: Mapping[Path | None, Callable[[], str]]) -> None:
        """Write the result with the command that made it, and its tables, where they are asked for."""
        from sysid_trib.results import files

        tree.attrs["command"] = command_line()
        if self.output is not None:
            files.save(tree, self.output)
        for place, text_of in texts.items():
            if place is not None:
                files.write_file(place, text_of().encode())


@dataclass(frozen=True)
class Destination(Files):
    """Where the result of an identification or a search goes, and how much is printed of it."""

    latex: Path | None = option("FILE", "Where to write the table and the equation for LaTeX.")
    explain: bool = switch("--explain", "Print all that was tested, and what follows.")
    quiet: bool = switch("--quiet", "Print the verdict and tables alone.")

    def check(self, records: Sequence[Path]) -> None:
        """Refuse besides options that exclude each other."""
        if self.explain and self.quiet:
            raise UsageError("--explain prints more and --quiet prints less: choose one.")
        check_output(self.latex, ".tex", reads=records, flag="--latex")
        super().check(records)

    def texts(self, tree: "xr.DataTree") -> dict[Path | None, Callable[[], str]]:
        """What stands in files of text, by their places."""
        from sysid_trib.printing.exported import csv_text, latex_text

        return {self.csv: lambda: csv_text(tree), self.latex: lambda: latex_text(tree)}

    def deliver(
        self,
        tree: "xr.DataTree",
        blocks: Callable[[], Sequence[Block]],
        data: Callable[[], dict[str, Any]],
        figures: "Figures",
    ) -> None:
        """Save, draw and print a result.

        Parameters
        ----------
        tree : DataTree
            The result.
        blocks : callable
            What is printed, in layers.
        data : callable
            What is printed as JSON.
        figures : callable
            See `draw`.
        """
        with progress() as tell:
            tell("files")
            self.save(tree, self.texts(tree))
            self.draw(figures, tell)
            tell("what is to be said")
            said = [] if self.as_json else blocks()
        following = tree.attrs.get("next", "")
        if self.as_json:
            print(json.dumps(data() | {"next": following}, indent=2, allow_nan=False))
            return
        layer = Layer.QUIET if self.quiet else Layer.EXPLAIN if self.explain else Layer.DEFAULT
        print_blocks(said, layer)
        if layer is Layer.DEFAULT:
            print("More: --explain.")
        if following:
            print(f"Next: {printable(following)}")
        print_written(*self.places)


def figures_of_runs(
    tree: "xr.DataTree", name: str, draw: "Callable[[xr.DataTree, int], Figure]"
) -> "list[tuple[str, Callable[[], Figure]]]":
    """The figure of each run of a result: its name, and what draws it."""
    from sysid_trib.results.variables import group_names, record_groups

    names = group_names(name, len(record_groups(tree)))
    return [(label, partial(draw, tree, run)) for run, label in enumerate(names)]


def print_result(
    data: Callable[[], dict[str, Any]],
    blocks: Callable[[], Sequence[Block]],
    places: "Iterable[Path | None]",
    *,
    as_json: bool,
) -> None:
    """Print a result as JSON, or in words with where it was written."""
    if as_json:
        print(json.dumps(data(), indent=2, allow_nan=False))
        return
    print_blocks(blocks(), Layer.DEFAULT)
    print_written(*places)


def check_output(target: Path | None, ending: str, *, reads: Sequence[Path] = (), flag: str = "-o") -> None:
    """Refuse a file that cannot be written before the work is done, not after."""
    if target is None:
        return
    if target.is_dir():
        raise RecordError(f"{target}: cannot be written, it is a directory; name a file in it with {flag}.")
    if target.suffix.lower() not in ending.split():
        raise UsageError(f"{target}: the ending must be {ending.replace(' ', ' or ')}.")
    if not os.access(target.parent, os.W_OK | os.X_OK):
        reason = "is not writable" if target.parent.is_dir() else "does not exist"
        raise RecordError(
            f"{target}: cannot be written, its folder {reason}; choose another place with {flag}."
        )
    if target.exists() and any(record.exists() and target.samefile(record) for record in reads):
        raise RecordError(
            f"{target}: the result would replace a file that is read; choose another place with {flag}."
        )


def check_folder(folder: Path | None) -> None:
    """Refuse a folder for figures that is a file, or lies in one."""
    if folder is None:
        return
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not there.is_dir() or not os.access(there, os.W_OK | os.X_OK):
        reason = "is not writable" if there.is_dir() else "is a file"
        raise RecordError(f"{folder}: cannot be written, {there} {reason}; choose another folder for --plot.")
