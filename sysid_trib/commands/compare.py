"""`sysid-trib compare`."""

from typing import TYPE_CHECKING, Any

from sysid_trib.commands import options
from sysid_trib.commands.destination import Destination
from sysid_trib.commands.terminal import progress, record_sentences

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
    fix: options.Fixes = [],  # noqa: B006 - typer copies it
    bound: options.Bounds = [],  # noqa: B006 - typer copies it
    tie: options.Ties = [],  # noqa: B006 - typer copies it
    output: options.Output = None,
    as_json: options.Json = False,
    plot: options.Plot = None,
    explain: options.Explain = False,
    quiet: options.Quiet = False,
) -> None:
    """Identify the forces of a decay by every method, and test each on a part that it has not seen."""
    from sysid_trib.commands import checks
    from sysid_trib.forces.constraints import Constraints
    from sysid_trib.forces.to_identify import forces_to_identify
    from sysid_trib.printing.comparison import comparison_blocks, comparison_json
    from sysid_trib.validation import compare as comparison

    destination = Destination(output, plot, as_json, explain, quiet)
    contactless, alpha = checks.known_frequencies(omega0, reference_frequency)
    offered = checks.offered_forces(library, forces, alpha)
    shapes = checks.held_shapes(set_, offered)
    constraints = Constraints.from_texts(fix, bound, tie)
    constraints.check(forces_to_identify(offered, reference_frequency))
    destination.check(records)
    columns = checks.RecordOptions(time, angle, signal, units, sampling_rate, time_units)
    decays, sources = checks.read_decays(records, columns, window, equilibrium, reference_frequency)
    methods = comparison.every_method(reference_frequency, shapes)
    with progress(len(methods)) as tell:
        tree = comparison.compare(
            decays, offered, methods, contactless=contactless, constraints=constraints, tell=tell
        )
    destination.deliver(
        tree,
        lambda: comparison_blocks(tree, record_sentences(tree, sources)),
        lambda: comparison_json(tree),
        lambda: _figures(tree),
    )


def _figures(tree: "xr.DataTree") -> list[Any]:
    from sysid_trib import plots

    return [("comparison", lambda: plots.comparison(tree))]
