"""The command line. Commands import what they need when they run, so that --help is quick."""

import json
import os
import sys
import traceback
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid_trib.errors import SysidTribError, UsageError

if TYPE_CHECKING:
    import xarray as xr
    from rich.table import Table

INTERRUPTED = 130
# Columns of a table that is not cut short.
WIDEST = 2000

app = typer.Typer(
    help="Which forces act in an oscillator, learned from its free decay.",
    no_args_is_help=False,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

Record = Annotated[
    Path | None,
    typer.Argument(
        help="File with a decay; without it the embedded example runs.", show_default=False, readable=False
    ),
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
    str, typer.Option(metavar="VALUE|auto", help="Equilibrium angle, in the unit of the record's column.")
]
Library = Annotated[str, typer.Option(metavar="NAME|FILE", help="Force library.")]
Forces = Annotated[str | None, typer.Option(metavar="A,B,...", help="Symbols of the forces to identify.")]
Omega0 = Annotated[
    str | None, typer.Option(metavar="VALUE[±ERROR]", help="Frequency without contact (rad/s): adds alpha.")
]
Reference = Annotated[
    float | None, typer.Option(metavar="RAD/S", help="Reference frequency, held; default: fitted.")
]
Shapes = Annotated[
    list[str], typer.Option("--set", metavar="SYMBOL.SHAPE=VALUE", help="A shape parameter to hold; repeat.")
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
    set_: Shapes = [],  # noqa: B006 - typer copies it
    output: Output = None,
    as_json: Json = False,
    plot: Plot = None,
) -> None:
    """Identify the forces of a decay in two ways, and cross-check them."""
    from sysid_trib import cli_input, result_files, results
    from sysid_trib.identification import cross_check
    from sysid_trib.methods import Averaging, Direct

    contactless = cli_input.parse_value_with_error(omega0, "--omega0")
    cli_input.check_positive(reference_frequency, "--reference-frequency")
    if contactless and reference_frequency:
        raise UsageError("--omega0 and --reference-frequency each give alpha a meaning: choose one.")
    offered = cli_input.offered_forces(library, forces, bool(contactless or reference_frequency))
    shapes = cli_input.held_shapes(set_, offered)
    cli_input.check_output(output, ".nc", reads=record)
    cli_input.check_folder(plot)
    options = {
        "time": time,
        "angle": angle,
        "signal": signal,
        "units": units,
        "sampling_rate": sampling_rate,
        "time_units": time_units,
    }
    decay, told = cli_input.read_decay(record, options, window, equilibrium)
    cli_input.check_reference(reference_frequency, decay)
    methods = (
        Averaging(reference_frequency=reference_frequency, shapes=shapes),
        Direct(reference_frequency=reference_frequency, shapes=shapes),
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

        print(json.dumps(identification_json(tree), indent=2, allow_nan=False))
        return
    _tell(tree, _printable(told))
    for place in (output, plot):
        if place is not None:
            print(f"Written: {place}")


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
    from sysid_trib import cli_input
    from sysid_trib.library_files import load_library
    from sysid_trib.model import Model
    from sysid_trib.simulation_file import simulated_record, write_record

    cli_input.check_output(output, ".csv .nc")
    offered = load_library(library)
    coefficients, shapes = cli_input.settings(set_, offered, papers=library == "contact_forces")
    cli_input.check_positive(reference_frequency, "--reference-frequency")
    cli_input.check_positive(duration, "--duration")
    cli_input.check_positive(sampling_rate, "--sampling-rate")
    model = Model(offered, coefficients, reference_frequency, shapes)
    record = simulated_record(model, duration, sampling_rate, (angle0, rate0), noise=noise, seed=seed)
    write_record(record, output)
    stop = record.stop_time.item()
    ending = f"; it stops at {stop:.4g} s" if stop == stop else ""
    print(f"{output}: {record.sizes['time']} simulated samples{ending}.")


@app.command()
def forces(
    library: Annotated[str, typer.Argument(metavar="NAME|FILE", help="Force library.")] = "contact_forces",
) -> None:
    """Show the forces of a library, with their signatures in envelope and frequency."""
    from sysid_trib.library_files import load_library
    from sysid_trib.tables import force_table

    offered = load_library(library)
    print(offered.title)
    _print(force_table(offered))


def _tell(tree: "xr.DataTree", told: str) -> None:
    from sysid_trib.tables import identification_table, verdict

    print(told)
    print(tree["record"].attrs.get("free_decay", ""))
    print()
    _print(identification_table(tree))
    print()
    for sentence in verdict(tree):
        print(sentence)


def _print(table: "Table") -> None:
    from rich.console import Console

    # Markup would take a bracket in the name of a force for a command.
    console = Console(highlight=False, markup=False, emoji=False)
    # A result must be whole wherever it goes: a terminal may fold words but not numbers, a pipe nothing.
    if not console.is_terminal:
        console.width = console.measure(table, options=console.options.update(width=WIDEST)).maximum
    console.print(table, crop=False)


def _save_figure(tree: "xr.DataTree", folder: Path) -> None:
    from sysid_trib import plots
    from sysid_trib.result_files import write_figure

    write_figure(plots.identification(tree), folder / "identification")


def _printable(text: str) -> str:
    """One line without control characters: a file's column names may hold any."""
    return "".join(c if c.isprintable() else "?" for c in " ".join(text.split()))


def main() -> None:
    """Run the command line: errors in one line on stderr, exit status as documented."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal or pipe that is not UTF-8 must not turn ± into a traceback.
        stream.reconfigure(errors="replace")  # type: ignore[union-attr]
    with warnings.catch_warnings():
        # Numerical libraries warn in their own terms; what matters of it is in the result, or an error here.
        warnings.showwarning = lambda *_, **__: None
        status, message = _outcome()
    if message:
        print(f"sysid-trib: {_printable(message)}", file=sys.stderr)
    sys.exit(status)


def _outcome() -> tuple[int, str]:
    """Exit status of the command, and the line for stderr if it failed."""
    # Typer brings its own click or uses the one installed, by its version: take the class from where it is.
    click_error: type[Exception] = next(
        k for k in typer.BadParameter.__mro__ if k.__name__ == "ClickException"
    )
    try:
        status = app(standalone_mode=False) or 0
        sys.stdout.flush()
        # Typer turns an interrupt into this status, silently.
        return status, "interrupted." if status == INTERRUPTED else ""
    except SysidTribError as error:
        return error.exit_status, str(error)
    except click_error as error:
        return 2, f"{error.format_message().rstrip('.')}. See sysid-trib --help."  # type: ignore[attr-defined]
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED, "interrupted."
    except OSError as error:
        if error.filename is not None:
            return 1, f"{error.filename}: {error.strerror}; choose another file."
        # What is left in the buffer must not fail once more at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            return 0, ""  # the reader has enough
        return 1, f"standard output cannot be written: {error.strerror or error}."
    except MemoryError:
        return 1, "Out of memory; take a shorter window, or a lower sampling rate."
    except Exception as error:
        # A fault of this package, but still no traceback: a line that finds the place.
        frame = next(t for t in reversed(traceback.extract_tb(error.__traceback__)))
        place = f"{Path(frame.filename).name}:{frame.lineno}"
        return 1, f"Internal error ({type(error).__name__} in {place}: {error}); please report it."
