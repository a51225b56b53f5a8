"""The commands as one program: options, help and examples of each; what works is imported when it runs."""

import inspect
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand

from sysid_trib._version import __version__
from sysid_trib.commands import terminal
from sysid_trib.commands.destination import check_values
from sysid_trib.commands.options import COMMANDS, Asked, options_of


class GroupedCommand(TyperCommand):
    """A command whose help has its options under the title of their group, and its examples at the end."""

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
        """Write the examples, each on a line of its own that can be copied."""
        with formatter.section("Examples"):
            for example in COMMANDS[str(self.name)]["examples"]:
                formatter.write(f"  {example}\n")


app = typer.Typer(
    no_args_is_help=False, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None
)


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
    """Which forces act in an oscillator, learned from its free decay."""


def _add(name: str, home: str, options: list[str], help: str, examples: list[str]) -> None:
    """Make a command of its row in the table.

    The function of its name in the module `home`, which is imported when it runs, takes what says how far it
    is and what was given, and gives what prints.
    """
    known = options_of(*options)

    def run(**values: Any) -> None:
        given = Asked(known, **values)
        with terminal.working(values.get(terminal.RECORDS, ())) as tell:
            check_values(given)
            say = getattr(import_module(f"sysid_trib.commands.{home}"), name)(tell, given)
        say()

    parameters = [option.parameter for option in known.values()]
    run.__name__, run.__doc__ = name, help
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    app.command(name, cls=GroupedCommand, help=help)(run)


for _name, _row in COMMANDS.items():
    _add(_name, **_row)
