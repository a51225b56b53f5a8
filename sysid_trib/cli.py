"""The command line. Commands import what they need when they run, so that --help is quick."""

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid_trib.errors import SysidTribError

if TYPE_CHECKING:
    import xarray as xr
    from rich.table import Table

app = typer.Typer(
    help="Which forces act in an oscillator, learned from its free decay.",
    no_args_is_help=False,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Record = Annotated[
    Path | None,
    typer.Argument(help="File with a decay; without it the embedded example runs.", show_default=False),
]
Time = Annotated[str | None, typer.Option(metavar="COLUMN", help="Time column, by name or number from 0.")]
Angle = Annotated[
    str | None, typer.Option(metavar="COLUMN", help="Angle (or rate) column, by name or number.")
]
Signal = Annotated[str, typer.Option(metavar="angle|rate", help="What was measured.")]
Units = Annotated[
    str | None, typer.Option(metavar="rad|deg", help="Unit of the angle; default: the header's, or rad.")
]
Rate = Annotated[
    float | None, typer.Option(metavar="HZ", help="Sampling rate, where there is no time column.")
]
TimeUnits = Annotated[
    str | None, typer.Option(metavar="s|ms|us|min", help="Unit of time; default: the header's, or s.")
]
Window = Annotated[
    str, typer.Option(metavar="START:STOP", help="Part of the record in s; either side may be empty.")
]
Equilibrium = Annotated[
    str, typer.Option(metavar="VALUE|auto", help="Equilibrium angle in the record's unit.")
]
Library = Annotated[str, typer.Option(metavar="NAME|FILE", help="Force library.")]
Forces = Annotated[str | None, typer.Option(metavar="A,B,...", help="Symbols of the forces to identify.")]
Omega0 = Annotated[
    str | None, typer.Option(metavar="VALUE[±ERROR]", help="Frequency without contact (rad/s): adds alpha.")
]
Reference = Annotated[
    float | None, typer.Option(metavar="RAD/S", help="Reference frequency, held; default: fitted.")
]
Output = Annotated[Path | None, typer.Option("-o", "--output", metavar="FILE", help="Where to write.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")]
Plot = Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the figure (PDF and PNG).")]


@app.command()
def identify(
    record: Record = None,
    time: Time = None,
    angle: Angle = None,
    signal: Signal = "angle",
    units: Units = None,
    sampling_rate: Rate = None,
    time_units: TimeUnits = None,
    window: Window = ":",
    equilibrium: Equilibrium = "auto",
    library: Library = "contact_forces",
    forces: Forces = None,
    omega0: Omega0 = None,
    reference_frequency: Reference = None,
    output: Output = None,
    as_json: Json = False,
    plot: Plot = None,
) -> None:
    """Identify the forces of a decay in two ways, and cross-check them."""
    from sysid_trib import cli_input, result_files, results
    from sysid_trib.identification import cross_check
    from sysid_trib.methods import Averaging, Direct

    contactless = cli_input.parse_value_with_error(omega0, "--omega0")
    alpha = contactless is not None or reference_frequency is not None
    offered = cli_input.offered_forces(library, forces, alpha)
    options = {
        "time": time,
        "angle": angle,
        "signal": signal,
        "units": units,
        "sampling_rate": sampling_rate,
        "time_units": time_units,
    }
    decay, told = cli_input.read_decay(record, options, window, equilibrium)
    methods = (
        Averaging(reference_frequency=reference_frequency),
        Direct(reference_frequency=reference_frequency),
    )
    tree = cross_check(decay, *(method.identify(decay, offered) for method in methods))
    if contactless is not None:
        tree = results.map_identifications(
            tree, lambda result: results.with_contactless_frequency(result, *contactless)
        )
    if output is not None:
        result_files.save(tree, output)
    if plot is not None:
        _save_figure(tree, plot)
    if as_json:
        from sysid_trib.tables import identification_json

        typer.echo(json.dumps(identification_json(tree), indent=2, ensure_ascii=False, allow_nan=False))
        return
    _tell(tree, told)
    for place in (output, plot):
        if place is not None:
            typer.echo(f"Written: {place}")


@app.command()
def simulate(
    output: Annotated[Path, typer.Option("-o", "--output", metavar="RECORD.csv|.nc", help="Where to write.")],
    set_: Annotated[
        list[str],
        typer.Option("--set", metavar="SYMBOL=VALUE", help="A coefficient or shape (dahl.s=0.02); repeat."),
    ] = [],  # noqa: B006 - typer copies it
    library: Library = "contact_forces",
    reference_frequency: Annotated[float, typer.Option(metavar="RAD/S", help="Reference frequency.")] = 9.91,
    duration: Annotated[float, typer.Option(metavar="S", help="Length of the record.")] = 25.0,
    sampling_rate: Annotated[float, typer.Option(metavar="HZ", help="Samples a second.")] = 100.0,
    angle0: Annotated[float, typer.Option(metavar="RAD", help="Angle at the start.")] = 0.3,
    rate0: Annotated[float, typer.Option(metavar="RAD/S", help="Angular rate at the start.")] = 0.0,
    noise: Annotated[float, typer.Option(metavar="RAD", help="Standard deviation of white noise.")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the noise.")] = 0,
) -> None:
    """Simulate the decay of a model; without --set, of the paper's PDMS/glass run."""
    from sysid_trib import cli_input, example
    from sysid_trib.library_files import load_library
    from sysid_trib.model import Model
    from sysid_trib.simulation_file import simulated_record, write_record

    coefficients, shapes = cli_input.parse_settings(set_)
    model = Model(load_library(library), coefficients or example.COEFFICIENTS, reference_frequency, shapes)
    record = simulated_record(model, duration, sampling_rate, (angle0, rate0), noise=noise, seed=seed)
    write_record(record, output)
    stop = record.stop_time.item()
    ending = f"; it stops at {stop:.4g} s" if stop == stop else ""
    typer.echo(f"{output}: {record.sizes['time']} simulated samples{ending}.")


@app.command()
def forces(
    library: Annotated[str, typer.Argument(metavar="NAME|FILE", help="Force library.")] = "contact_forces",
) -> None:
    """Show the forces of a library, with their signatures in envelope and frequency."""
    from sysid_trib.library_files import load_library
    from sysid_trib.tables import force_table

    offered = load_library(library)
    typer.echo(offered.title)
    _print(force_table(offered))


def _tell(tree: "xr.DataTree", told: str) -> None:
    from sysid_trib.tables import identification_table, verdict

    typer.echo(told)
    typer.echo(tree["record"].attrs.get("free_decay", ""))
    typer.echo("")
    _print(identification_table(tree))
    typer.echo("")
    for sentence in verdict(tree):
        typer.echo(sentence)


def _print(table: "Table") -> None:
    from rich.console import Console

    # Rich would cut columns to a pipe's 80 characters: a result must be whole wherever it goes.
    console = Console(highlight=False)
    Console(highlight=False, width=max(console.width, 160) if not console.is_terminal else None).print(table)


def _save_figure(tree: "xr.DataTree", folder: Path) -> None:
    from sysid_trib import plots
    from sysid_trib.result_files import write_figure

    write_figure(plots.identification(tree), folder / "identification")


def main() -> None:
    """Run the command line: errors in one line on stderr, exit status as documented."""
    # Typer brings its own click or uses the one installed, by its version: take the class from where it is.
    click_error = next(k for k in typer.BadParameter.__mro__ if k.__name__ == "ClickException")
    for stream in (sys.stdout, sys.stderr):
        # A terminal or pipe that is not UTF-8 must not turn ± into a traceback.
        stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except SysidTribError as error:
        _fail(str(error), error.exit_status)
    except click_error as error:
        _fail(f"{error.format_message()} See sysid-trib --help.", 2)  # type: ignore[attr-defined]
    except (KeyboardInterrupt, typer.Abort):
        _fail("interrupted.", 130)
    except BrokenPipeError:
        sys.stderr.close()
        sys.exit(0)


def _fail(message: str, status: int) -> None:
    print("sysid-trib: " + " ".join(message.split()), file=sys.stderr)
    sys.exit(status)
