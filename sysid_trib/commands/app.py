"""The commands as one program, with options in groups and examples; they import what they need when run."""

from typing import Any

import typer
from typer.core import TyperCommand

from sysid_trib._version import __version__
from sysid_trib.commands.campaign import campaign
from sysid_trib.commands.compare import compare, difference
from sysid_trib.commands.discover import discover
from sysid_trib.commands.identify import identify
from sysid_trib.commands.plan import plan
from sysid_trib.commands.response import response
from sysid_trib.commands.shown import backbone, forces, look, report
from sysid_trib.commands.simulate import simulate

# Each takes what one before it made: they are run by the tests in this order.
EXAMPLES = {
    "simulate": (
        "sysid-trib simulate --noise 1e-4 -o swing.csv",
        "sysid-trib simulate --set zeta=0.01 --set nu=-0.2 --duration 30 --noise 1e-4 -o soft.csv",
    ),
    "look": ("sysid-trib look swing.csv", "sysid-trib look swing.csv --angle 1 --units rad --plot figures"),
    "backbone": ("sysid-trib backbone", "sysid-trib backbone swing.csv --csv curves.csv --plot figures"),
    "identify": (
        "sysid-trib identify swing.csv -o forces.nc --plot figures",
        "sysid-trib identify swing.csv --forces zeta,delta,nu,epsilon --bound zeta=0: --explain",
    ),
    "discover": (
        "sysid-trib discover swing.csv --forces zeta,delta,nu -o missing.nc",
        "sysid-trib discover swing.csv --max-effects 1 --time-limit 60 --json",
    ),
    "compare": (
        "sysid-trib compare swing.csv -o methods.nc",
        "sysid-trib compare swing.csv --forces zeta,delta,nu,epsilon --window 0:15 --csv methods.csv",
    ),
    "difference": (
        "sysid-trib difference swing.csv soft.csv -o difference.nc --plot figures",
        "sysid-trib difference 'swing.csv' : soft.csv --forces zeta,delta,nu --explain",
    ),
    "plan": (
        "sysid-trib plan forces.nc --amplitude 0.05:0.6 --duration :60",
        "sysid-trib plan swing.csv --want delta=0.0002 --repeats 2 --plot figures",
    ),
    "response": (
        "sysid-trib response forces.nc --drive 0.002",
        "sysid-trib response forces.nc --drive 0.002 --frequencies 0.9:1.1 --csv response.csv --plot figures",
    ),
    "campaign": (
        "sysid-trib campaign 'swing*.csv' -o results.zarr",
        "sysid-trib campaign 'swing*.csv' --methods direct --workers 0 -o direct.zarr",
    ),
    "report": (
        "sysid-trib report forces.nc -o forces.html",
        "sysid-trib report missing.nc -o missing.html",
    ),
    "forces": ("sysid-trib forces", "sysid-trib forces candidate_effects"),
}


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
            for example in EXAMPLES[str(self.name)]:
                formatter.write(f"  {example}\n")


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


for command in (
    look,
    backbone,
    identify,
    discover,
    compare,
    difference,
    plan,
    response,
    campaign,
    simulate,
    report,
    forces,
):
    app.command(cls=GroupedCommand)(command)
