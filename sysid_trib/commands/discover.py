"""`sysid-trib discover`."""

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sysid_trib.commands import options
from sysid_trib.commands.destination import Destination, figures_of_runs

if TYPE_CHECKING:
    import xarray as xr

# What the embedded example starts from: it then has two elastic forces to find.
START_FORCES = "lambda,zeta,delta"

Start = Annotated[
    str | None,
    typer.Option(
        metavar="A,B,...",
        help=f"Forces of the start model; default: all, for the embedded example {START_FORCES}.",
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
    explain: options.Explain = False,
    quiet: options.Quiet = False,
) -> None:
    """Find what a model lacks to explain a decay, name it, add it, and say how far the gap shrinks."""
    from sysid_trib.commands import checks, discovery_inputs
    from sysid_trib.commands.terminal import progress, record_sentences
    from sysid_trib.discrepancy.discover import discover
    from sysid_trib.printing.discovery_json import discovery_json
    from sysid_trib.printing.discovery_story import discovery_blocks

    destination = Destination(output, plot, as_json, explain, quiet)
    checks.check_positive(reference_frequency, "--reference-frequency")
    if forces is None and not records:
        forces = START_FORCES
    start = checks.offered_forces(library, forces, reference_frequency is not None)
    offered = discovery_inputs.offered_candidates(library, candidates, start)
    destination.check(records)
    columns = checks.RecordOptions(time, angle, signal, units, sampling_rate, time_units)
    decays, sources = checks.read_decays(records, columns, window, equilibrium, reference_frequency)
    seen, held = discovery_inputs.held_out(decays, holdout)
    with progress() as tell:
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
    destination.deliver(
        tree,
        lambda: discovery_blocks(tree, record_sentences(tree, sources)),
        lambda: discovery_json(tree),
        lambda: _figures(tree),
    )


def _figures(tree: "xr.DataTree") -> list[Any]:
    from sysid_trib import plots

    whole = {"disagreement": plots.disagreement, "ranking": plots.rankings, "forecast": plots.forecasts}
    return [
        *figures_of_runs(tree, "story", plots.story),
        *figures_of_runs(tree, "discovery", plots.discovery),
        *((name, partial(draw, tree)) for name, draw in whole.items()),
    ]
