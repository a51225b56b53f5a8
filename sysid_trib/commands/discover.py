"""`sysid-trib discover`."""

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

from sysid_trib.commands.destination import Destination, figures_of_runs
from sysid_trib.commands.options import (
    DEFAULT_LIBRARY,
    MODEL,
    DecayOptions,
    SearchOptions,
    option,
    with_options,
)
from sysid_trib.commands.terminal import keep_next

if TYPE_CHECKING:
    import xarray as xr

# What the embedded example starts from: it then has two elastic forces to find.
EXAMPLE_FORCES = "lambda,zeta,delta"


@dataclass(frozen=True)
class StartOptions:
    """From which model a search starts, and what of a record it does not see."""

    title: ClassVar[str] = MODEL

    library: str = option("NAME|FILE", "Force library.", DEFAULT_LIBRARY)
    forces: str | None = option(
        "A,B,...",
        "Forces of the start model; default: viscous friction alone, "
        f"for the embedded example {EXAMPLE_FORCES}.",
    )
    reference_frequency: float | None = option("RAD/S", "Reference frequency, held; default: fitted.")
    holdout: str | None = option(
        "START:STOP",
        "Part of each record, in s, that takes no part and is predicted; default: the last third.",
    )


@with_options
def discover(
    *, given: DecayOptions, model: StartOptions, asked: SearchOptions, destination: Destination
) -> None:
    """Find what a model lacks to explain a decay, name it, add it, and say how far the gap shrinks."""
    from sysid_trib.commands.terminal import record_sentences, working

    with working(given.records) as tell:
        from sysid_trib.commands import discovery_inputs
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.discovery.discover import discover
        from sysid_trib.printing.discovery import discovery_blocks
        from sysid_trib.printing.json_results import discovery_json
        from sysid_trib.records.inputs import named_inputs

        forces = EXAMPLE_FORCES if model.forces is None and not given.records else model.forces
        driving = named_inputs(given.input_ and given.input_.split(","))
        start, offered, options = discovery_inputs.asked_search(model, forces, asked, given.system, driving)
        destination.check(given.records)
        tell("reading")
        decays, sources = read_decays(given, model.reference_frequency, as_it_is=bool(forces), driven=True)
        seen, held = discovery_inputs.held_out(decays, model.holdout)
        tree = discover(seen, start, offered, holdout=held, tell=tell, **options)
        if model.holdout is not None:
            tree.attrs["held_out"] = discovery_inputs.window_text(model.holdout, len(held))
        if not driving:
            keep_next(tree, given, model, asked)
        stretches = tree.attrs["stretches"]
        sentences = [*sources, stretches] if stretches else record_sentences(tree, sources)
    destination.deliver(
        tree, lambda: discovery_blocks(tree, sentences), lambda: discovery_json(tree), partial(_figures, tree)
    )


def _figures(tree: "xr.DataTree", plots: Any) -> list[Any]:
    from sysid_trib.results.files import is_of_driven

    # Its motion has no half periods.
    over_time = (
        [("driven", plots.driven), ("story", plots.story)]
        if is_of_driven(tree)
        else [("overview", plots.overview), ("story", plots.story)]
    )
    whole = {"disagreement": plots.disagreement, "ranking": plots.ranking}
    return [
        *(figure for name, draw in over_time for figure in figures_of_runs(tree, name, draw)),
        *((name, partial(draw, tree)) for name, draw in whole.items()),
    ]
