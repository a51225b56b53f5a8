"""The commands as one program; their options and help come from the table `commands.toml`.

Modules that compute are imported when a command runs.
"""

import gc
import re
import shlex
import sys
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import fields
from importlib import import_module
from inspect import Parameter, Signature
from math import isfinite
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from sysid_trib._version import __version__
from sysid_trib.commands.completion import completer_of
from sysid_trib.commands.options import (
    COMMANDS,
    OPTIONS_OF,
    POSITIVE,
    CommandOptions,
    defaults_of,
    rows_of,
    rows_of_command,
)
from sysid_trib.errors import UsageError, readable

PARAMETER = re.compile(r"[^\W\d]\w*(\.[^\W\d]\w*)?")
PLUS_MINUS = re.compile(r"\s*(?:±|\+/-|\+-)\s*")


def _parameter(name: str, row: Mapping[str, Any], kind: Any, default: Any) -> Parameter:
    """Return an option as an argument for typer, under the title of its group in the help."""
    usual = {
        "metavar": row.get("value"),
        "help": row["help"],
        "rich_help_panel": row["title"],
        "autocompletion": completer_of(name, row),
    }
    if row.get("positional"):
        # An unreadable value is refused by the code that reads it.
        read = typer.Argument(show_default=default != [], readable=False, **usual)
    else:
        flags = ("-o", "--output") if row["flag"] == "-o" else (row["flag"], *row.get("formerly", ()))
        read = typer.Option(*flags, min=row.get("least"), **usual)
    return Parameter(name, Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, read])


RECORDS = "records"
# Options that the next command on the same records and forces takes over.
TAKEN_OVER = {**rows_of(RECORDS, "model", "start", "search"), "passive": rows_of("laws")["passive"]}


def command_after(command: str, others: Mapping[str, str | None], given: CommandOptions) -> str:
    """Return a command with the given options, some of them replaced (`next_step.NextStep`)."""
    known = rows_of_command(command)
    defaults = defaults_of(type(given))
    taken = {name: value for name, value in vars(given).items() if name in TAKEN_OVER}
    if taken.get("candidates") and "candidates" not in known and taken["library"] == defaults["library"]:
        # Forces of the package are known to every command, a user's own candidates only by their file.
        taken["library"] = taken["candidates"]
    # Values as the user wrote them. A word that begins with a dash would be read as an option.
    written = {Path(word): word for word in sys.argv[1:]}
    files = [written.get(file, str(file)) for file in taken.pop(RECORDS, [])]
    words = [f"./{file}" if file.startswith("-") else file for file in files]
    words += [file for name, file in others.items() if name == RECORDS and file]
    for name, row in TAKEN_OVER.items():
        value = taken.get(name)
        if name in taken and name in known and name.strip("_") not in others and value != defaults[name]:
            for item in value if isinstance(value, list) else [value]:
                # A switch consists of its flag alone.
                words += [row["flag"], *([] if isinstance(item, bool) else [_as_given(item)])]
    for name, value in others.items():
        if value is not None and name != RECORDS:
            words += [f"--{name.replace('_', '-')}", *filter(None, [value])]
    return readable(shlex.join(["sysid-trib", command, *words]))


def _as_given(value: Any) -> str:
    """Return the value of an option as a user would write it: 10000, not 10000.0."""
    return str(value).removesuffix(".0") if isinstance(value, float) else str(value)


def check_between(value: float | None, option: str, low: float, high: float, units: str = "") -> None:
    """Raise an error, naming the option, for a number outside of a range."""
    if value is not None and not low <= value <= high:
        raise UsageError(f"{option} '{value:g}' must be a number from {low:g} to {high:g}{units}.")


def parse_window(
    text: str, option: str, form: str = "START:STOP in seconds, such as 15:75, 25: or :60"
) -> tuple[float | None, float | None]:
    """Parse `15:75`; either side may be empty. `form` describes the notation."""
    sides = text.split(":")
    if len(sides) != 2:
        raise UsageError(f"{option} '{text}' must be {form}.")
    low, high = (parse_number(side, f"{option} '{text}'") if side.strip() else None for side in sides)
    return low, high


def parse_value_with_error(text: str | None, option: str) -> tuple[float, float] | None:
    """Parse `8.87`, `8.87±0.01` or `8.87+-0.01`."""
    if text is None:
        return None
    parts = PLUS_MINUS.split(text.strip())
    if len(parts) > 2:
        raise UsageError(f"{option} '{text}' must be VALUE or VALUE±ERROR.")
    value = parse_number(parts[0], option)
    error = parse_number(parts[1], option) if len(parts) == 2 else 0.0
    check_between(value, option, *POSITIVE)
    if not 0.0 <= error <= value:
        raise UsageError(f"{option} '{text}': the error must be positive and below the value.")
    return value, error


def texts_by_name(texts: Iterable[str], option: str, form: str) -> dict[str, str]:
    """Parse names and texts of an option, `NAME=VALUE`; `form` describes the notation."""
    pairs: dict[str, str] = {}
    for text in texts:
        name, _, value = (part.strip() for part in text.partition("="))
        if not value or not PARAMETER.fullmatch(name):
            raise UsageError(f"{option} '{text}' must be {form}.")
        if name in pairs:
            raise UsageError(f"{option} is given twice for {name}; choose one.")
        pairs[name] = value
    return pairs


def numbers_by_name(texts: Iterable[str], option: str, form: str) -> dict[str, float]:
    """Parse names and numbers of an option, `NAME=VALUE,...`."""
    pairs = texts_by_name((part for text in texts for part in text.split(",")), option, form)
    return {name: parse_number(value, f"{option} '{name}={value}'") for name, value in pairs.items()}


def parse_number(text: str, option: str) -> float:
    """Parse a finite number; the error names the option."""
    value = float("nan")
    with suppress(ValueError):
        value = float(text)
    if not isfinite(value):
        raise UsageError(f"{option}: '{text.strip()}' is not a finite number.")
    return value


class GroupedCommand(TyperCommand):
    """A command whose help shows its options under the titles of their groups, and examples at the end."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options, group by group."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for parameter in self.get_params(ctx):
            if row := parameter.get_help_record(ctx):
                groups.setdefault(getattr(parameter, "rich_help_panel", None) or "Other", []).append(row)
        for title, rows in groups.items():
            with formatter.section(title):
                formatter.write_dl(rows)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples, each on its own line so that it can be copied."""
        with formatter.section("Examples"):
            for example in COMMANDS[str(self.name)]["examples"]:
                formatter.write(f"  {example}\n")


app = typer.Typer(no_args_is_help=False, pretty_exceptions_enable=False, rich_markup_mode=None)


def _show_version(asked: bool) -> None:
    if asked:
        print(f"sysid-trib {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_show_version, is_eager=True, help="Show the version."
    ),
) -> None:
    """Identify the forces of an oscillator from its free decay."""


def _imported(home: str) -> ModuleType:
    """Import and return the module of a command; the garbage collector ignores all imported objects.

    Modules exist as long as the process. Repeated searches of them would take a fifth of the time of a short
    command.
    """
    if home in sys.modules:
        return sys.modules[home]
    gc.disable()
    try:
        return import_module(home)
    finally:
        gc.freeze()
        gc.enable()


def _add(name: str, home: str, options: list[str], help: str, examples: list[str]) -> None:
    """Add the command described by a row of the table.

    The function with the name of the command in the module `home`, which is imported when it runs, is called
    with a progress function and the given options, and returns a function that prints.
    """
    rows = rows_of_command(name)
    options_class = OPTIONS_OF[name]

    def run(**values: Any) -> None:
        from sysid_trib.commands import terminal

        with terminal.working(values.get(RECORDS, ())) as tell:
            given = terminal.with_stored_inputs(options_class(**values))
            terminal.check_values(given, rows)
            say = getattr(_imported(f"sysid_trib.commands.{home}"), name)(tell, given)
        say()

    kinds = {option.name: option.type for option in fields(options_class)}
    defaults = defaults_of(options_class)
    parameters = [_parameter(option, row, kinds[option], defaults[option]) for option, row in rows.items()]
    run.__name__, run.__doc__ = name, help
    run.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
    app.command(name, cls=GroupedCommand, help=help)(run)


for _name, _row in COMMANDS.items():
    _add(_name, **_row)
