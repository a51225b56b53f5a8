"""`sysid-trib compare`."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from sysid_trib.commands import options
from sysid_trib.commands.terminal import command_line, print_records, print_table, print_written

if TYPE_CHECKING:
    import xarray as xr


def compare(
    records: options.Records = [],  # noqa: B006 - typer copies it
    time: options.Time = None,
    angle: options.Angle = None,
    signal: options.Signal = "angle",
    units: options.Units = None,
    sampling_rate: options.Rate = None,
    time_units: options.TimeUnits = None,
    window: options.Window = ":",
    equilibrium: options.Equilibrium = "auto",
    library: options.Library = "contact_forces",
    forces: options.Forces = None,
    omega0: options.Omega0 = None,
    reference_frequency: options.Reference = None,
    set_: options.Shapes = [],  # noqa: B006 - typer copies it
    output: options.Output = None,
    as_json: options.Json = False,
    plot: options.Plot = None,
) -> None:
    """Identify the forces of a decay by every method, and test each on a part that it has not seen."""
    from sysid_trib.commands import checks
    from sysid_trib.results import files
    from sysid_trib.validation import compare as comparison

    contactless = checks.parse_value_with_error(omega0, "--omega0")
    checks.check_positive(reference_frequency, "--reference-frequency")
    checks.check_alpha(contactless, reference_frequency)
    offered = checks.offered_forces(library, forces, bool(contactless or reference_frequency))
    shapes = checks.held_shapes(set_, offered)
    checks.check_output(output, ".nc", reads=records)
    checks.check_folder(plot)
    columns = checks.Columns(time, angle, signal, units, sampling_rate, time_units)
    decays, told = checks.read_decays(records, columns, window, equilibrium)
    for each in decays:
        checks.check_reference(reference_frequency, each)
    methods = comparison.every_method(reference_frequency, shapes)
    with _progress(len(methods)) as tell:
        tree = comparison.compare(decays, offered, methods, contactless=contactless, tell=tell)
    tree.attrs["command"] = command_line()
    if output is not None:
        files.save(tree, output)
    if plot is not None:
        from sysid_trib import plots

        files.write_figure(plots.comparison(tree), plot / "comparison")
    if as_json:
        from sysid_trib.printing.comparison import comparison_json

        print(json.dumps(comparison_json(tree), indent=2, allow_nan=False))
        return
    _tell(tree, told)
    print_written(output, plot)


@contextmanager
def _progress(steps: int) -> Iterator[Callable[[str], None]]:
    """A bar on stderr with what is under way, gone when all is done; nothing where no terminal is."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(stderr=True, markup=False)
    with Progress(console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("", total=steps)
        done = -1

        def tell(label: str) -> None:
            nonlocal done
            done += 1
            bar.update(task, completed=done, description=label)

        yield tell


def _tell(tree: "xr.DataTree", told: list[str]) -> None:
    from sysid_trib.printing.comparison import comparison_sentences, comparison_tables

    print_records(tree, told)
    for title, table in comparison_tables(tree).items():
        print(f"\n{title}")
        print_table(table)
    print()
    for sentence in comparison_sentences(tree):
        print(sentence)
