"""The commands as one program: options, help and examples of each; what works is imported when it runs."""

import inspect
from collections.abc import Callable
from importlib import import_module
from typing import Any

import typer
from typer.core import TyperCommand

from sysid_trib._version import __version__
from sysid_trib.commands import terminal
from sysid_trib.commands.destination import check_values
from sysid_trib.commands.options import Given, options_of


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


Declared = Callable[[], None]
FILES = ("shown", "files")
DESTINATION = (*FILES, "destination")


def command(home: str, *groups: str) -> Callable[[Declared], None]:
    """Make a command of a name, a docstring and options.

    Parameters
    ----------
    home : str
        Module of this folder, imported when the command runs, whose function of the same name works: it
        takes what says how far it is and what was given, and gives what prints.
    *groups : str
        Groups of options, by their names in `options.toml`.
    """
    options = options_of(*groups)

    def register(declared: Declared) -> None:
        def run(**values: Any) -> None:
            given = Given(options, **values)
            with terminal.working(values.get(terminal.RECORDS, ())) as tell:
                check_values(given)
                work = getattr(import_module(f"sysid_trib.commands.{home}"), declared.__name__)
                say = work(tell, given)
            say()

        parameters = [option.parameter for option in options.values()]
        run.__name__, run.__doc__ = declared.__name__, declared.__doc__
        run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        purpose = (inspect.getdoc(declared) or "").partition("\n\n")[0]
        app.command(declared.__name__, cls=GroupedCommand, help=purpose)(run)

    return register


@command("shown", "records", "shown")
def look() -> None:
    """Say what is in a file and what to do next, without a fit.

    Examples
    --------
    sysid-trib look swing.csv
    sysid-trib look swing.csv --angle 1 --units rad --plot figures
    """


@command("shown", "records", *FILES)
def backbone() -> None:
    """Frequency and damping ratio against amplitude, with bands, without a model.

    Examples
    --------
    sysid-trib backbone
    sysid-trib backbone swing.csv --csv curves.csv --plot figures
    """


@command("fits", "records", "model", "identify", *DESTINATION)
def identify() -> None:
    """Identify the forces of a decay in two ways, and cross-check them.

    Examples
    --------
    sysid-trib identify swing.csv -o forces.nc --plot figures
    sysid-trib identify swing.csv --forces zeta,delta,nu,epsilon --bound zeta=0: --explain
    """


@command("predicted", "records", "start", "search", *DESTINATION)
def discover() -> None:
    """Find what a model lacks to explain a decay, name it, add it, and say how far the gap shrinks.

    Examples
    --------
    sysid-trib discover swing.csv --forces zeta,delta,nu -o missing.nc
    sysid-trib discover swing.csv --max-effects 1 --time-limit 60 --json
    """


@command("fits", "records", "model", *DESTINATION)
def compare() -> None:
    """Identify the forces of a decay by every method, and test each on a part that it has not seen.

    Examples
    --------
    sysid-trib compare swing.csv -o methods.nc
    sysid-trib compare swing.csv --forces zeta,delta,nu,epsilon --window 0:15 --csv methods.csv
    """


@command("fits", "records", "model", *DESTINATION)
def difference() -> None:
    """Hold two samples against each other, A... : B...: which coefficients differ, and by how much.

    Examples
    --------
    sysid-trib difference swing.csv soft.csv -o difference.nc --plot figures
    sysid-trib difference 'swing.csv' : soft.csv --forces zeta,delta,nu --explain
    """


@command("predicted", "records", "model", "plan", "shown")
def plan() -> None:
    """Say which run to make next: RESULT.nc of identify or discover, or records.

    Examples
    --------
    sysid-trib plan forces.nc --amplitude 0.05:0.6 --duration :60
    sysid-trib plan swing.csv --want delta=0.0002 --repeats 2 --plot figures
    """


@command("predicted", "result", "sweep", *FILES)
def response() -> None:
    """Steady response of an identified model to a harmonic drive, with bands and its unstable branch.

    Examples
    --------
    sysid-trib response forces.nc --drive 0.002
    sysid-trib response forces.nc --drive 0.002 --frequencies 0.9:1.1 --csv response.csv --plot figures
    """


@command("campaign", "records", "model", "search", "campaign")
def campaign() -> None:
    """Do one task with many records, on several processes, into a store that can be gone on with.

    Examples
    --------
    sysid-trib campaign 'swing*.csv' -o results.zarr
    sysid-trib campaign 'swing*.csv' --methods direct --workers 0 -o direct.zarr
    """


@command("predicted", "simulation")
def simulate() -> None:
    """Simulate the decay of a model; without --set, of the paper's PDMS/glass run.

    Examples
    --------
    sysid-trib simulate --noise 1e-4 -o swing.csv
    sysid-trib simulate --set zeta=0.01 --set nu=-0.2 --duration 30 --noise 1e-4 -o soft.csv
    """


@command("shown", "result", "page")
def report() -> None:
    """Show a saved result as one self-contained page, with figures and tables.

    Examples
    --------
    sysid-trib report forces.nc -o forces.html
    sysid-trib report missing.nc -o missing.html
    """


@command("shown", "result", "code")
def export() -> None:
    """Write an identified equation as a Python function, for sympy, or as a function block of Simulink.

    Examples
    --------
    sysid-trib export forces.nc
    sysid-trib export missing.nc --as simulink -o missing.m
    """


@command("shown", "offered")
def forces() -> None:
    """Show the forces of a library: equations, kind, and signatures in envelope and frequency.

    Examples
    --------
    sysid-trib forces
    sysid-trib forces candidate_effects
    """
