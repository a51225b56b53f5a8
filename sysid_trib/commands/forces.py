"""`sysid-trib forces`."""

from typing import Annotated

import typer

from sysid_trib.commands.terminal import print_table, progress


def forces(
    library: Annotated[str, typer.Argument(metavar="NAME|FILE", help="Force library.")] = "contact_forces",
) -> None:
    """Show the forces of a library, with their signatures in envelope and frequency."""
    with progress():
        from sysid_trib.forces.library import load_library
        from sysid_trib.printing.forces import force_table

        offered = load_library(library)
        table = force_table(offered)
    print(offered.title)
    print_table(table)
