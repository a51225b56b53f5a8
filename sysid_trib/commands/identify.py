"""`sysid-trib identify`."""

from typing import TYPE_CHECKING, Any

from sysid_trib.commands import options
from sysid_trib.commands.destination import Destination, figures_of_runs

if TYPE_CHECKING:
    import xarray as xr


def identify(
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
    inertia: options.Inertia = None,
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
    """Identify the forces of a decay in two ways, and cross-check them."""
    import xarray as xr

    from sysid_trib.commands import checks
    from sysid_trib.commands.terminal import record_sentences
    from sysid_trib.forces.constraints import Constraints
    from sysid_trib.forces.to_identify import forces_to_identify
    from sysid_trib.methods import Averaging, Direct
    from sysid_trib.methods.scope import constrained
    from sysid_trib.printing.identification import identification_blocks, identification_json
    from sysid_trib.records.runs import one_or_all
    from sysid_trib.results.contactless import with_contactless_frequency
    from sysid_trib.results.schema import map_identifications
    from sysid_trib.validation.cross_check import cross_check
    from sysid_trib.validation.homogeneity import run_agreement

    destination = Destination(output, plot, as_json, explain, quiet)
    contactless, alpha = checks.known_frequencies(omega0, reference_frequency)
    checks.check_positive(inertia, "--inertia")
    offered = checks.offered_forces(library, forces, alpha)
    shapes = checks.held_shapes(set_, offered)
    constraints = Constraints.from_texts(fix, bound, tie)
    constraints.check(forces_to_identify(offered, reference_frequency))
    destination.check(records)
    columns = checks.RecordOptions(time, angle, signal, units, sampling_rate, time_units)
    decays, sources = checks.read_decays(records, columns, window, equilibrium, reference_frequency)
    methods = (
        Averaging(reference_frequency=reference_frequency, shapes=shapes),
        Direct(reference_frequency=reference_frequency, shapes=shapes),
    )
    decay = one_or_all(decays)
    tree = cross_check(decay, *(constrained(m, constraints).identify(decay, offered) for m in methods))
    if len(decays) > 1:
        tree["runs"] = xr.DataTree(
            run_agreement(decays, tree[tree["comparison"].attrs["second"]].to_dataset())
        )
    if contactless is not None:
        tree = map_identifications(tree, lambda result: with_contactless_frequency(result, *contactless))
    destination.deliver(
        tree,
        lambda: identification_blocks(tree, record_sentences(tree, sources), inertia),
        lambda: identification_json(tree, inertia),
        lambda: _figures(tree),
    )


def _figures(tree: "xr.DataTree") -> list[Any]:
    from sysid_trib import plots

    return figures_of_runs(tree, "identification", plots.identification)
