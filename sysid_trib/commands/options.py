"""Options of all commands, in groups: dataclasses whose fields are options."""

from copy import copy
from dataclasses import Field, dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar

import typer

DEFAULT_LIBRARY = "contact_forces"
# What the embedded example starts from: a search then has two elastic forces to find.
EXAMPLE_FORCES = "lambda,zeta,delta"
WHERE_TO_WRITE, WRITTEN_BY = "Where to write; replaces what is there.", ("-o", "--output")
# Titles of groups of options that several dataclasses have.
MODEL, HOLDS, OUTPUT = "Model", "Constraints", "Output"
# No oscillator is outside of this range in rad/s, Hz or s; far beyond it arithmetic overflows.
LEAST, MOST = 1e-9, 1e9
POSITIVE = (LEAST, MOST, "")


def option(
    metavar: str | None,
    text: str,
    default: Any = None,
    *,
    flags: tuple[str, ...] = (),
    least: int | None = None,
    within: tuple[float, float, str] | None = None,
    title: str = "",
    ending: str = "",
    positional: bool = False,
) -> Any:
    """A field of a dataclass that typer reads as an option.

    Parameters
    ----------
    metavar : str, optional
        What stands for its value in the help; none of a switch.
    text : str
        Its help.
    default : object
        Its default; an ellipsis where it must be given.
    flags : tuple of str
        How it is written, where not as the field's name.
    least : int, optional
        Smallest value.
    within : (float, float, str), optional
        Least and largest number, and their unit.
    title : str
        Of its group, where not that of its dataclass.
    ending : str
        Of the file that it names, one that the command writes; several with a space between.
    positional : bool
        Whether it is given without a flag.
    """
    given: Any = typer.Option(*flags, metavar=metavar, help=text, min=least)
    if positional:
        # What cannot be read is refused where it is read.
        shown = default != []
        given = typer.Argument(metavar=metavar, help=text, show_default=shown, readable=False)
    metadata = {"typer": given, "flags": flags, "title": title, "ending": ending, "within": within}
    return field(default_factory=lambda: copy(default), metadata=metadata)


def switch(flag: str, text: str, title: str = "") -> Any:
    """A field that is true where its flag is given."""
    return option(None, text, False, flags=(flag,), title=title)


@dataclass(frozen=True)
class DecayOptions:
    """Which records are read, how, and what of them is the decay."""

    title: ClassVar[str] = "Records"

    records: list[Path] = option(
        "[RECORD]...",
        "Files with decays, runs of one experiment; without any the embedded example runs "
        "(not in a campaign).",
        [],
        positional=True,
    )
    time: str | None = option("COLUMN", "Time column, by name or number from 0.")
    angle: str | None = option(
        "COLUMN", "Column of the signal, by name or number (the time counts too), or a formula of columns."
    )
    signal: str | None = option(
        "angle|displacement|rate|acceleration|accelerometer",
        "What was measured; default: what unit and name say.",
    )
    units: str | None = option(
        "rad|deg|mm|px|V|au|rad/s|g|...",
        "Unit of the signal; default: the header's, or what its numbers say.",
    )
    sampling_rate: float | None = option("HZ", "Sampling rate, where there is no time column.")
    time_units: str | None = option("s|ms|us|min|h|days", "Unit of time; default: the header's, or s.")
    window: str = option("START:STOP", "Part of the record in s; either side may be empty.", ":")
    equilibrium: str = option("VALUE|auto", "Equilibrium angle, in the unit of the record's column.", "auto")
    decay: int | None = option(
        "N", "Which decay of a file that holds several; default: all, as runs.", least=1
    )
    keep_outliers: bool = switch("--keep-outliers", "Keep samples that leap out of the swing.")
    system: str | None = option(
        "NAME|FILE",
        "What moves: pendulum, torsion, spring, ship, tribometer, cantilever or axis; sets its usual forces.",
    )
    input_: str | None = option(
        "COLUMN|NAME=COLUMN,...",
        "What drives the motion: a column, u of formulas, or several by their names; FILE:COLUMN of another "
        "file, *_y.mat:y of that most like each record's.",
        flags=("--input",),
    )
    between: str = option("smooth|linear|held", "What an input is between its samples.", "smooth")
    scale: str = option(
        "VALUE[±ERROR]",
        "By which the signal is multiplied; identify carries its error into those of coefficients.",
        "1",
    )
    length: float | None = option("M", "Length of a pendulum: a displacement becomes an angle.")
    distance: float | None = option("M", "Of an accelerometer from the axis of the pendulum that it is on.")


@dataclass(frozen=True)
class ModelOptions:
    """Which forces are identified, and what of them is held, bounded or tied."""

    title: ClassVar[str] = MODEL

    library: str = option("NAME|FILE", "Force library.", DEFAULT_LIBRARY)
    forces: str | None = option("A,B,...", "Symbols of the forces to identify, and of sensor terms.")
    omega0: str | None = option("VALUE[±ERROR]", "Frequency without contact (rad/s): adds alpha.")
    reference_frequency: float | None = option(
        "RAD/S", "Reference frequency, held; default: fitted.", within=POSITIVE
    )
    random_force: str = option(
        "auto|off|estimated|VALUE",
        "Random acceleration of the motion: where one is found and tested, never, estimated in any case, or "
        "its one-sided density in (rad/s^2)^2/Hz.",
        "auto",
    )
    set_: list[str] = option(
        "SYMBOL.SHAPE=VALUE", "A shape parameter to hold; repeat.", [], flags=("--set",), title=HOLDS
    )
    fix: list[str] = option(
        "NAME=VALUE", "A coefficient or shape to hold: lambda=0; repeat.", [], title=HOLDS
    )
    bound: list[str] = option(
        "NAME=LOW:HIGH", "Bounds of one; either may be empty: zeta=0:.", [], title=HOLDS
    )
    tie: list[str] = option("NAME=FORMULA", 'One by others: "nu=-2.356*delta"; repeat.', [], title=HOLDS)
    own: str | None = option(
        "A,B,...", "Forces whose coefficient is each run's own, of driven records.", title=HOLDS
    )


@dataclass(frozen=True)
class SearchOptions:
    """How `discover` searches, of one record or of each of many."""

    title: ClassVar[str] = "Search"

    candidates: str | None = option(
        "NAME|FILE",
        "What may be missing, of discover; default: the library's other forces, and candidate_effects.",
    )
    max_effects: int = option("N", "Effects that discover adds at most.", 4, least=0)
    refit: bool = switch("--refit", "Fit the models that discover found again, to the whole records.")
    level: float = option("P", "Significance level of discover, shared by its tests.", 0.01)
    time_limit: float | None = option(
        "S", "Ends a search of discover with what it has after so long; default: none.", within=POSITIVE
    )


@dataclass(frozen=True)
class StartOptions:
    """From which model a search starts, and what of a record it does not see."""

    title: ClassVar[str] = MODEL

    library: str = option("NAME|FILE", "Force library.", DEFAULT_LIBRARY)
    forces: str | None = option(
        "A,B,...",
        "Forces of the start model; default: viscous friction alone, "
        f"for the embedded example {EXAMPLE_FORCES}.",
    )
    reference_frequency: float | None = option(
        "RAD/S", "Reference frequency, held; default: fitted.", within=POSITIVE
    )
    holdout: str | None = option(
        "START:STOP",
        "Part of each record, in s, that takes no part and is predicted; default: the last third.",
    )


@dataclass(frozen=True)
class Shown:
    """What standard output shows, and where figures go."""

    title: ClassVar[str] = OUTPUT

    as_json: bool = switch("--json", "Print the result as JSON, and nothing else.")
    plot: Path | None = option("DIR", "Folder for the figures (PDF and PNG).")
    # Between these widths texts have room.
    width: float = option(
        "MM", "Of the figures: 88 of a column, 180 of a page.", 180.0, within=(80.0, 400.0, " mm")
    )


@dataclass(frozen=True)
class Files(Shown):
    """Where else the numbers go."""

    output: Path | None = option("FILE", WHERE_TO_WRITE, flags=WRITTEN_BY, ending=".nc")
    csv: Path | None = option("FILE", "Where to write the numbers as a table (CSV).", ending=".csv")


@dataclass(frozen=True)
class Destination(Files):
    """Where the result of an identification or a search goes, and how much is printed of it."""

    latex: Path | None = option("FILE", "Where to write the table and the equation for LaTeX.", ending=".tex")
    explain: bool = switch("--explain", "Print all that was tested, and what follows.")
    quiet: bool = switch("--quiet", "Print the verdict and tables alone.")


def flag_of(part: Field[Any]) -> str:
    """How an option is written."""
    # Typer takes the first of them for a default, until it reads the command.
    flags = part.metadata.get("flags") or (f"--{part.name.replace('_', '-')}",)
    return str(flags[0 if flags[-1] == "--output" else -1])


def default_of(part: Field[Any]) -> Any:
    """Default of an option."""
    made = part.default_factory
    return made() if callable(made) else part.default


def changed_flags(*groups: Any) -> list[str]:
    """The options of groups that were given another value than their default."""
    pairs = [(group, part) for group in groups for part in fields(group)]
    return [flag_of(part) for group, part in pairs if getattr(group, part.name) != default_of(part)]
