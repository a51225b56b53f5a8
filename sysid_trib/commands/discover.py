"""`sysid-trib discover`, and the part of a record that its search does not see."""

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
from sysid_trib.errors import DecayError, UsageError

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
    """Find what a model lacks to explain a decay, name it, add it, and say how far the gap shrinks.

    Examples
    --------
    sysid-trib discover swing.csv --forces zeta,delta,nu -o missing.nc
    sysid-trib discover swing.csv --max-effects 1 --time-limit 60 --json
    """
    from sysid_trib.commands.terminal import record_sentences, working

    with working(given.records) as tell:
        from sysid_trib.commands.checks import asked_search
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.discovery.discover import discover
        from sysid_trib.printing.discovery import discovery_blocks
        from sysid_trib.printing.json_results import discovery_json
        from sysid_trib.records.inputs import named_inputs

        forces = EXAMPLE_FORCES if model.forces is None and not given.records else model.forces
        driving = named_inputs(given.input_ and given.input_.split(","))
        start, offered, options = asked_search(model, forces, asked, given.system, driving)
        destination.check(given.records)
        tell("reading")
        decays, sources = read_decays(given, model, driven=True)
        seen, held, said = _held_out(decays, model.holdout)
        tree = discover(seen, start, offered, holdout=held, tell=tell, **options)
        if said:
            tree.attrs["held_out"] = said
        if not driving:
            keep_next(tree, given, model, asked)
        stretches = tree.attrs["stretches"]
        sentences = [*sources, stretches] if stretches else record_sentences(tree, sources)
    destination.deliver(
        tree, lambda: discovery_blocks(tree, sentences), lambda: discovery_json(tree), partial(_figures, tree)
    )


def _held_out(
    decays: "list[xr.Dataset]", window: str | None
) -> "tuple[list[xr.Dataset], list[xr.Dataset], str]":
    """What is learned from, what is kept for prediction: a window of each decay, and its words."""
    from sysid_trib.commands.checks import parse_window

    if window is None:
        return decays, [], ""
    low, high = parse_window(window, "--holdout")
    pairs = [_parted(decay, low, high, window) for decay in decays]
    ends = "" if low is None else f"from {low:g} s on" if high is None else f"{low:g} s to {high:g} s"
    said = (ends or f"up to {high:g} s") + (" of each run" if len(decays) > 1 else "")
    return [seen for seen, _ in pairs], [held for _, held in pairs], said


def _parted(
    decay: "xr.Dataset", low: float | None, high: float | None, window: str
) -> "tuple[xr.Dataset, xr.Dataset]":
    import numpy as np

    time = decay.time.values
    inside = (time >= (time[0] if low is None else low)) & (time <= (time[-1] if high is None else high))
    here = f"the decay is from {time[0]:.4g} s to {time[-1]:.4g} s"
    if not inside.any() or inside.all():
        raise DecayError(f"--holdout '{window}' holds out {'all' if inside.any() else 'nothing'}: {here}.")
    if not (inside[0] or inside[-1]):
        raise UsageError(f"--holdout '{window}' must reach to the start or the end: {here}.")
    return decay.isel(time=np.flatnonzero(~inside)), decay.isel(time=np.flatnonzero(inside))


def _figures(tree: "xr.DataTree", plots: Any) -> list[Any]:
    over_time = {"overview": plots.overview, "story": plots.story}
    return [
        *(figure for name, draw in over_time.items() for figure in figures_of_runs(tree, name, draw)),
        ("ranking", partial(plots.ranking, tree)),
    ]
