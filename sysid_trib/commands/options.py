"""Options that commands share, in groups: dataclasses whose fields are options."""

import inspect
from collections.abc import Callable
from copy import copy
from dataclasses import Field, dataclass, field, fields, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeAlias, get_type_hints

import typer

DEFAULT_LIBRARY = "contact_forces"
WHERE_TO_WRITE = "Where to write; replaces what is there."
# Titles of groups of options that several dataclasses have.
MODEL, OUTPUT = "Model", "Output"

RESULT_FILE: TypeAlias = Annotated[
    Path,
    typer.Argument(
        metavar="RESULT.nc",
        help="What identify, compare or discover wrote with -o.",
        rich_help_panel="Result",
    ),
]


def option(
    metavar: str | None,
    text: str,
    default: Any = None,
    *,
    flags: tuple[str, ...] = (),
    least: int | None = None,
) -> Any:
    """A field of a dataclass that typer reads as an option.

    Parameters
    ----------
    metavar : str, optional
        What stands for its value in the help; none of a switch.
    text : str
        Its help.
    default : object
        Its default.
    flags : tuple of str
        How it is written, where not as the field's name.
    least : int, optional
        Smallest value.
    """
    given = typer.Option(*flags, metavar=metavar, help=text, min=least)
    return field(default_factory=lambda: copy(default), metadata={"typer": given, "flags": flags})


def switch(flag: str, text: str) -> Any:
    """A field that is true where its flag is given."""
    return option(None, text, False, flags=(flag,))


@dataclass(frozen=True)
class DecayOptions:
    """Which records are read, how, and what of them is the decay."""

    title: ClassVar[str] = "Records"

    records: list[Path] = field(
        default_factory=list,
        metadata={
            "typer": typer.Argument(
                metavar="[RECORD]...",
                help="Files with decays, runs of one experiment; without any the embedded example runs "
                "(not in a campaign).",
                show_default=False,
                readable=False,
            )
        },
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
    """Which forces are identified."""

    title: ClassVar[str] = MODEL

    library: str = option("NAME|FILE", "Force library.", DEFAULT_LIBRARY)
    forces: str | None = option("A,B,...", "Symbols of the forces to identify, and of sensor terms.")
    omega0: str | None = option("VALUE[±ERROR]", "Frequency without contact (rad/s): adds alpha.")
    reference_frequency: float | None = option("RAD/S", "Reference frequency, held; default: fitted.")
    random_force: str = option(
        "auto|off|estimated|VALUE",
        "Random acceleration of the motion: where one is found and tested, never, estimated in any case, or "
        "its one-sided density in (rad/s^2)^2/Hz.",
        "auto",
    )


@dataclass(frozen=True)
class ConstraintOptions:
    """What is held, bounded or tied."""

    title: ClassVar[str] = "Constraints"

    set_: list[str] = option("SYMBOL.SHAPE=VALUE", "A shape parameter to hold; repeat.", [], flags=("--set",))
    fix: list[str] = option("NAME=VALUE", "A coefficient or shape to hold: lambda=0; repeat.", [])
    bound: list[str] = option("NAME=LOW:HIGH", "Bounds of one; either may be empty: zeta=0:.", [])
    tie: list[str] = option("NAME=FORMULA", 'One by others: "nu=-2.356*delta"; repeat.', [])
    own: str | None = option("A,B,...", "Forces whose coefficient is each run's own, of driven records.")


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
        "S", "Ends a search of discover with what it has after so long; default: none."
    )


def flag_of(part: "Field[Any]") -> str:
    """How an option is written."""
    # Typer takes the first of them for a default, until it reads the command.
    flags = part.metadata.get("flags") or (f"--{part.name.replace('_', '-')}",)
    return str(flags[-1])


def default_of(part: "Field[Any]") -> Any:
    """Default of an option."""
    made = part.default_factory
    return made() if callable(made) else part.default


def changed_flags(group: Any) -> list[str]:
    """The options of a group that were given another value than their default."""
    return [flag_of(part) for part in fields(group) if getattr(group, part.name) != default_of(part)]


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """The command as typer takes it: an argument that is a group becomes the options of the group.

    Parameters
    ----------
    command : callable
        Has keyword arguments only.
    """
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    parameters: list[inspect.Parameter] = []
    for name, parameter in inspect.signature(command).parameters.items():
        parameters += _options(groups[name]) if name in groups else [parameter]

    @wraps(command)
    def run(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{part.name: values.pop(part.name) for part in fields(group)})
        command(**values)

    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return run


def _options(group: Any) -> list[inspect.Parameter]:
    """The fields of a group as arguments of a function, under the group's title in its help."""
    keyword, parameters = inspect.Parameter.KEYWORD_ONLY, []
    for part in fields(group):
        given = copy(part.metadata["typer"])
        given.rich_help_panel = group.title
        made = {"default": default_of(part), "annotation": Annotated[part.type, given]}
        parameters.append(inspect.Parameter(part.name, keyword, **made))
    return parameters
