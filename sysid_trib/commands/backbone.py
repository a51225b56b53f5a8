"""`sysid-trib backbone`."""

import json

from sysid_trib.commands.destination import Files
from sysid_trib.commands.options import DecayOptions, with_options


@with_options
def backbone(*, given: DecayOptions, files: Files) -> None:
    """Frequency and damping ratio against amplitude, with bands, without a model."""
    from sysid_trib.commands.terminal import command_line, print_blocks, print_written, working

    with working(given.records) as tell:
        from functools import partial

        import xarray as xr

        from sysid_trib.averaging.backbone import backbone as curves_of
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.printing.blocks import Layer
        from sysid_trib.printing.looked import backbone_blocks, backbone_csv, backbone_json
        from sysid_trib.results.per_run import group_names

        files.check(given.records)
        tell("reading")
        decays, sources = read_decays(given)
        names = group_names("backbone", len(decays))
        tell("frequency and damping against amplitude")
        backbones = {name: curves_of(decay) for name, decay in zip(names, decays, strict=True)}
        tree = xr.DataTree.from_dict(backbones)
        tree.attrs["command"] = command_line()
        files.save(tree, {files.csv: lambda _: backbone_csv(backbones)})
        files.draw(
            lambda plots: [(name, partial(plots.backbone, data)) for name, data in backbones.items()], tell
        )
    if files.as_json:
        print(json.dumps(backbone_json(backbones), indent=2, allow_nan=False))
        return
    print_blocks(backbone_blocks(backbones, sources), Layer.DEFAULT)
    print_written(*files.places)
