"""`sysid-trib identify`."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

from sysid_trib.commands import options
from sysid_trib.commands.terminal import command_line, print_records, print_table, print_written

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
    output: options.Output = None,
    as_json: options.Json = False,
    plot: options.Plot = None,
) -> None:
    """Identify the forces of a decay in two ways, and cross-check them."""
    import xarray as xr

    from sysid_trib.commands import checks
    from sysid_trib.methods import Averaging, Direct
    from sysid_trib.records.runs import one_or_all
    from sysid_trib.results import files, schema
    from sysid_trib.validation.cross_check import cross_check
    from sysid_trib.validation.homogeneity import run_agreement

    contactless = checks.parse_value_with_error(omega0, "--omega0")
    checks.check_positive(reference_frequency, "--reference-frequency")
    checks.check_positive(inertia, "--inertia")
    checks.check_alpha(contactless, reference_frequency)
    offered = checks.offered_forces(library, forces, bool(contactless or reference_frequency))
    shapes = checks.held_shapes(set_, offered)
    checks.check_output(output, ".nc", reads=records)
    checks.check_folder(plot)
    columns = checks.Columns(time, angle, signal, units, sampling_rate, time_units)
    decays, told = checks.read_decays(records, columns, window, equilibrium)
    for each in decays:
        checks.check_reference(reference_frequency, each)
    methods = (
        Averaging(reference_frequency=reference_frequency, shapes=shapes),
        Direct(reference_frequency=reference_frequency, shapes=shapes),
    )
    decay = one_or_all(decays)
    tree = cross_check(decay, *(method.identify(decay, offered) for method in methods))
    if len(decays) > 1:
        tree["runs"] = xr.DataTree(
            run_agreement(decays, tree[tree["comparison"].attrs["second"]].to_dataset())
        )
    if contactless is not None:
        tree = schema.map_identifications(
            tree, lambda result: schema.with_contactless_frequency(result, *contactless)
        )
    tree.attrs["command"] = command_line()
    if output is not None:
        files.save(tree, output)
    if plot is not None:
        _save_figures(tree, plot)
    if as_json:
        from sysid_trib.printing.identification import identification_json

        print(json.dumps(identification_json(tree, inertia), indent=2, allow_nan=False))
        return
    _tell(tree, told, inertia)
    print_written(output, plot)


def _tell(tree: "xr.DataTree", told: list[str], inertia: float | None) -> None:
    from sysid_trib.printing.identification import (
        consequences,
        identification_sentences,
        identification_table,
    )
    from sysid_trib.printing.runs import runs_sentences, runs_table

    print_records(tree, told)
    print()
    print_table(identification_table(tree))
    print()
    for sentence in identification_sentences(tree):
        print(sentence)
    print()
    for sentence in consequences(tree, inertia):
        print(sentence)
    if "runs" in tree:
        print()
        print_table(runs_table(tree["runs"].to_dataset()))
        print()
        for sentence in runs_sentences(tree["runs"].to_dataset()):
            print(sentence)


def _save_figures(tree: "xr.DataTree", folder: Path) -> None:
    from sysid_trib import plots
    from sysid_trib.records.runs import group_names, record_groups
    from sysid_trib.results.files import write_figure

    runs = len(record_groups(tree))
    for run, name in enumerate(group_names("identification", runs)):
        write_figure(plots.identification(tree, run), folder / name)
