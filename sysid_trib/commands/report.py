"""`sysid-trib report`."""

from pathlib import Path
from typing import Annotated

import typer

from sysid_trib.commands.options import WHERE_TO_WRITE
from sysid_trib.commands.terminal import print_written, progress
from sysid_trib.errors import RecordError, UsageError


def report(
    result: Annotated[
        Path, typer.Argument(metavar="RESULT.nc", help="What identify, compare or discover wrote with -o.")
    ],
    output: Annotated[Path, typer.Option("-o", "--output", metavar="REPORT.html", help=WHERE_TO_WRITE)],
) -> None:
    """Show a saved result as one self-contained page, with figures and tables."""
    with progress() as tell:
        from sysid_trib.commands.destination import check_output
        from sysid_trib.reporting.page import page, write_page
        from sysid_trib.results import files

        check_output(output, ".html .htm", reads=[result])
        tell("reading")
        tree = files.load(result)
        tell("page")
        try:
            text = page(tree)
        except (RecordError, UsageError) as error:
            raise RecordError(f"{result}: {error}") from None
        write_page(text, output)
    print_written(output)
