"""`sysid-trib discover`."""

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sysid_trib.commands import options
from sysid_trib.commands.terminal import command_line, print_records, print_table, print_written, printable

if TYPE_CHECKING:
    import xarray as xr

# What the embedded example starts from: it then has two elastic forces to find.
DISSIPATIVE = "lambda,zeta,delta"

Start = Annotated[
    str | None,
    typer.Option(
        metavar="A,B,...",
        help=f"Forces of the start model; default: all, for the embedded example {DISSIPATIVE}.",
    ),
]
Candidates = Annotated[
    str | None,
    typer.Option(
        metavar="NAME|FILE",
        help="What may be missing; default: the library's other forces, and candidate_effects.",
    ),
]
Effects = Annotated[int, typer.Option(metavar="N", min=0, help="Effects added at most.")]
Holdout = Annotated[
    str | None,
    typer.Option(
        metavar="START:STOP",
        help="Part of each record, in s, that takes no part and is predicted; default: the last third, by "
        "models fitted again without it.",
    ),
]


def discover(
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
    forces: Start = None,
    candidates: Candidates = None,
    max_effects: Effects = 4,
    holdout: Holdout = None,
    reference_frequency: options.Reference = None,
    output: options.Output = None,
    as_json: options.Json = False,
    plot: options.Plot = None,
) -> None:
    """Find what a model lacks to explain a decay, name it, add it, and tell how far the gap shrinks."""
    from sysid_trib.commands import checks, discovery_inputs
    from sysid_trib.discrepancy.discover import discover
    from sysid_trib.results import files

    checks.check_positive(reference_frequency, "--reference-frequency")
    if forces is None and not records:
        forces = DISSIPATIVE
    start = checks.offered_forces(library, forces, reference_frequency is not None)
    offered = discovery_inputs.offered_candidates(library, candidates, start)
    checks.check_output(output, ".nc", reads=records)
    checks.check_folder(plot)
    columns = checks.Columns(time, angle, signal, units, sampling_rate, time_units)
    decays, told = checks.read_decays(records, columns, window, equilibrium)
    for each in decays:
        checks.check_reference(reference_frequency, each)
    seen, held = discovery_inputs.held_out(decays, holdout)
    with _progress() as tell:
        tree = discover(
            seen,
            start,
            offered,
            reference_frequency=reference_frequency,
            max_effects=max_effects,
            holdout=held,
            tell=tell,
        )
    if holdout is not None:
        tree.attrs["held_out"] = discovery_inputs.window_text(holdout, len(held))
    tree.attrs["command"] = command_line()
    if output is not None:
        files.save(tree, output)
    if plot is not None:
        _save_figures(tree, plot)
    if as_json:
        from sysid_trib.printing.discovery_tables import discovery_json

        print(json.dumps(discovery_json(tree), indent=2, allow_nan=False))
        return
    _tell(tree, told)
    print_written(output, plot)


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """What is under way, on stderr, gone when all is done; nothing where no terminal is."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = Console(stderr=True, markup=False)
    columns = (SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn())
    # How many scans there will be, nobody knows: a bar would lie.
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:
        task = shown.add_task("", total=None)
        yield lambda text: shown.update(task, description=text)


def _tell(tree: "xr.DataTree", told: list[str]) -> None:
    from sysid_trib.printing.discovery_story import discovery_story
    from sysid_trib.printing.discovery_tables import RANKING, ranking_table

    print_records(tree, told)
    for title, sentences in discovery_story(tree).items():
        print(f"\n{title}")
        for sentence in sentences:
            indent = len(sentence) - len(sentence.lstrip())
            print(" " * indent + printable(sentence))
    print(f"\n{RANKING}")
    print_table(ranking_table(tree))


def _save_figures(tree: "xr.DataTree", folder: Path) -> None:
    from sysid_trib import plots
    from sysid_trib.records.runs import group_names, record_groups
    from sysid_trib.results.files import write_figure

    runs = len(record_groups(tree))
    for run, name in enumerate(group_names("discovery", runs)):
        write_figure(plots.discovery(tree, run), folder / name)
    for name, draw in (
        ("disagreement", plots.disagreement),
        ("ranking", plots.rankings),
        ("forecast", plots.forecasts),
    ):
        write_figure(draw(tree), folder / name)
