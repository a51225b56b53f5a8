"""`sysid-trib backbone`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from sysid_trib.commands.options import WHERE_TO_WRITE, DecayOptions, with_options
from sysid_trib.commands.threads import one_thread


@with_options
def backbone(
    *,
    given: DecayOptions,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", metavar="FILE", help=WHERE_TO_WRITE)
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the curves as JSON, and nothing else.")
    ] = False,
    csv: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Where to write the curves as a table (CSV).")
    ] = None,
    plot: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the figure.")] = None,
) -> None:
    """Frequency and damping ratio against amplitude, with bands, without a model."""
    from sysid_trib.commands.terminal import command_line, print_blocks, print_written, progress

    with progress() as tell, one_thread():
        import xarray as xr

        from sysid_trib.averaging.backbone import backbone as curves_of
        from sysid_trib.commands.destination import check_folder, check_output
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.printing.backbone import backbone_blocks, backbone_csv, backbone_json
        from sysid_trib.printing.layers import Layer
        from sysid_trib.results import files
        from sysid_trib.results.per_run import group_names

        check_output(output, ".nc", reads=given.records)
        check_output(csv, ".csv", reads=given.records, flag="--csv")
        check_folder(plot)
        tell("reading")
        decays, sources = read_decays(given)
        names = group_names("backbone", len(decays))
        tell("frequency and damping against amplitude")
        backbones = {name: curves_of(decay) for name, decay in zip(names, decays, strict=True)}
        if output is not None:
            tree = xr.DataTree.from_dict(backbones)
            tree.attrs["command"] = command_line()
            files.save(tree, output)
        if csv is not None:
            files.write_file(csv, backbone_csv(backbones).encode())
        if plot is not None:
            tell("figure")
            from sysid_trib import plots

            for name, data in backbones.items():
                files.write_figure(plots.backbone(data), plot / name)
    if as_json:
        print(json.dumps(backbone_json(backbones), indent=2, allow_nan=False))
        return
    print_blocks(backbone_blocks(backbones, sources), Layer.DEFAULT)
    print_written(output, csv, plot)
