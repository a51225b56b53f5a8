"""`sysid-trib forces`."""

from typing import Annotated

import typer

from sysid_trib.commands.terminal import print_table


def forces(
    library: Annotated[str, typer.Argument(metavar="NAME|FILE", help="Force library.")] = "contact_forces",
) -> None:
    """Show the forces of a library, with their signatures in envelope and frequency."""
    from sysid_trib.forces.library import load_library
    from sysid_trib.printing.forces import force_table

    offered = load_library(library)
    print(offered.title)
    print_table(force_table(offered))
