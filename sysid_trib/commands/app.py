"""The commands as one program. They import what they need when they run, so that --help is quick."""

import typer

from sysid_trib._version import __version__
from sysid_trib.commands.backbone import backbone
from sysid_trib.commands.campaign import campaign
from sysid_trib.commands.compare import compare
from sysid_trib.commands.discover import discover
from sysid_trib.commands.help import GroupedCommand
from sysid_trib.commands.identify import identify
from sysid_trib.commands.shown import forces, look, report
from sysid_trib.commands.simulate import simulate

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


for command in (look, backbone, identify, discover, compare, campaign, simulate, report, forces):
    app.command(cls=GroupedCommand)(command)
