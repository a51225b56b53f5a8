"""`sysid-trib discover`."""

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from sysid_trib.commands.destination import Destination, figures_of_runs
from sysid_trib.commands.naming import named
from sysid_trib.commands.next_command import keep_next
from sysid_trib.commands.options import DEFAULT_LIBRARY, DecayOptions, option, with_options
from sysid_trib.commands.threads import one_thread

if TYPE_CHECKING:
    import xarray as xr

# What the embedded example starts from: it then has two elastic forces to find.
EXAMPLE_FORCES = "lambda,zeta,delta"


@dataclass(frozen=True)
class SearchOptions:
    """What is searched for, and beside which model."""

    library: str = option("NAME|FILE", "Force library.", DEFAULT_LIBRARY)
    forces: str | None = option(
        "A,B,...",
        "Forces of the start model; default: viscous friction alone, "
        f"for the embedded example {EXAMPLE_FORCES}.",
    )
    candidates: str | None = option(
        "NAME|FILE", "What may be missing; default: the library's other forces, and candidate_effects."
    )
    max_effects: int = option("N", "Effects added at most.", 4, least=0)
    holdout: str | None = option(
        "START:STOP",
        "Part of each record, in s, that takes no part and is predicted; default: the last third.",
    )
    refit: bool = option(
        None, "Fit the models that were found again, to the whole records.", False, flags=("--refit",)
    )
    level: float = option("P", "Family-wise significance level of each test.", 0.01)
    reference_frequency: float | None = option("RAD/S", "Reference frequency, held; default: fitted.")
    time_limit: float | None = option("S", "Ends the search with what it has after so long; default: none.")


@with_options
def discover(*, given: DecayOptions, asked: SearchOptions, destination: Destination) -> None:
    """Find what a model lacks to explain a decay, name it, add it, and say how far the gap shrinks."""
    from sysid_trib.commands.terminal import progress

    with progress() as tell, one_thread(), named(given.records):
        from sysid_trib.commands import checks, discovery_inputs
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.commands.terminal import record_sentences
        from sysid_trib.discrepancy.discover import discover
        from sysid_trib.forces.systems import load_system, without_impossible
        from sysid_trib.printing.discovery_json import discovery_json
        from sysid_trib.printing.discovery_story import discovery_blocks

        checks.check_positive(asked.reference_frequency, "--reference-frequency")
        checks.check_positive(asked.time_limit, "--time-limit")
        discovery_inputs.check_level(asked.level)
        forces = EXAMPLE_FORCES if asked.forces is None and not given.records else asked.forces
        swinging = None if given.system is None else load_system(given.system)
        start = discovery_inputs.start_forces(asked.library, forces, asked.reference_frequency, swinging)
        offered = discovery_inputs.offered_candidates(asked.library, asked.candidates, start)
        offered = replace(offered, forces=without_impossible(offered, swinging))
        destination.check(given.records)
        tell("reading")
        decays, sources = read_decays(given, asked.reference_frequency)
        seen, held = discovery_inputs.held_out(decays, asked.holdout)
        tree = discover(
            seen,
            start,
            offered,
            reference_frequency=asked.reference_frequency,
            max_effects=asked.max_effects,
            holdout=held,
            refit=asked.refit,
            level=asked.level,
            time_limit=asked.time_limit or float("inf"),
            tell=tell,
        )
        if asked.holdout is not None:
            tree.attrs["held_out"] = discovery_inputs.window_text(asked.holdout, len(held))
        keep_next(tree, given, asked)
    destination.deliver(
        tree,
        lambda: discovery_blocks(tree, record_sentences(tree, sources)),
        lambda: discovery_json(tree),
        partial(_figures, tree),
    )


def _figures(tree: "xr.DataTree", plots: Any) -> list[Any]:
    whole = {"disagreement": plots.disagreement, "ranking": plots.rankings, "forecast": plots.forecasts}
    return [
        *figures_of_runs(tree, "overview", plots.overview),
        *figures_of_runs(tree, "story", plots.story),
        *figures_of_runs(tree, "discovery", plots.discovery),
        *((name, partial(draw, tree)) for name, draw in whole.items()),
    ]
