"""`sysid-trib look`."""

import json
from pathlib import Path
from typing import Annotated

import typer

from sysid_trib.commands.options import DecayOptions, with_options
from sysid_trib.errors import DecayError


@with_options
def look(
    *,
    given: DecayOptions,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the facts as JSON, and nothing else.")
    ] = False,
    plot: Annotated[Path | None, typer.Option(metavar="DIR", help="Folder for the figure.")] = None,
) -> None:
    """Say what is in a file and what to do next, without a fit."""
    from sysid_trib.commands.terminal import print_blocks, print_written, progress

    understood: list[str] = []
    try:
        with progress() as tell:
            from sysid_trib.commands.destination import check_folder
            from sysid_trib.commands.next_command import command_after
            from sysid_trib.commands.record_inputs import decays_within, read_sources
            from sysid_trib.looking.look import look as facts
            from sysid_trib.printing.layers import Layer
            from sysid_trib.printing.looked import look_blocks, look_json, pointed_options
            from sysid_trib.printing.next_step import NextStep

            check_folder(plot)
            tell("reading")
            records, sentences = read_sources(given)
            understood = sentences
            decays = decays_within(given, records)
            tree = facts(records, decays)
            asked = pointed_options(tree, given.system is not None)
            command = command_after(NextStep("identify", "the forces of this decay", asked), (given,))
            if plot is not None:
                tell("figure")
                from sysid_trib import plots
                from sysid_trib.results import files

                files.write_figure(plots.look(tree), plot / "look")
    except DecayError:
        # What was understood helps to see why.
        if not as_json and understood:
            print("\n".join(dict.fromkeys(understood)))
        raise
    if as_json:
        print(json.dumps(look_json(tree, command), indent=2, allow_nan=False))
        return
    print_blocks(look_blocks(tree, sentences, command), Layer.DEFAULT)
    print_written(None, plot)
