"""The commands as one program, with options in groups and examples; they import what they need when run."""

import inspect
from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperCommand

from sysid_trib._version import __version__
from sysid_trib.commands.campaign import campaign
from sysid_trib.commands.compare import compare, difference
from sysid_trib.commands.discover import discover
from sysid_trib.commands.identify import identify
from sysid_trib.commands.predicted import plan, response, simulate
from sysid_trib.commands.shown import backbone, export, forces, look, report


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
            for example in examples_of(self.callback):
                formatter.write(f"  {example}\n")


def examples_of(command: Callable[..., Any] | None) -> list[str]:
    """The examples in the docstring of a command, each a line that can be copied."""
    return (inspect.getdoc(command) or "").partition("Examples\n--------\n")[2].splitlines()


app = typer.Typer(
    no_args_is_help=False,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
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


COMMANDS = (look, backbone, identify, discover, compare, difference, plan, response, campaign, simulate)
for command in (*COMMANDS, report, export, forces):
    purpose = (inspect.getdoc(command) or "").partition("\n\n")[0]
    app.command(cls=GroupedCommand, help=purpose)(command)
