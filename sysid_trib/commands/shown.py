"""`sysid-trib look`, `backbone`, `report`, `export` and `forces`: what shows what is there, without a fit."""

from pathlib import Path
from typing import Annotated

import typer

from sysid_trib.commands.destination import Files, Shown
from sysid_trib.commands.options import OUTPUT, RESULT_FILE, WHERE_TO_WRITE, DecayOptions, with_options
from sysid_trib.errors import DecayError, RecordError, UsageError


@with_options
def backbone(*, given: DecayOptions, files: Files) -> None:
    """Frequency and damping ratio against amplitude, with bands, without a model.

    Examples
    --------
    sysid-trib backbone
    sysid-trib backbone swing.csv --csv curves.csv --plot figures
    """
    from sysid_trib.commands.terminal import working

    with working(given.records) as tell:
        from functools import partial

        import xarray as xr

        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.cycles.backbone import backbone as curves_of
        from sysid_trib.printing.looked import backbone_blocks, backbone_csv, backbone_json
        from sysid_trib.results.variables import group_names

        files.check(given.records)
        tell("reading")
        decays, sources = read_decays(given)
        names = group_names("backbone", len(decays))
        tell("frequency and damping against amplitude")
        backbones = {name: curves_of(decay) for name, decay in zip(names, decays, strict=True)}
        tree = xr.DataTree.from_dict(backbones)
        files.save(tree, {files.csv: lambda: backbone_csv(backbones)})
        files.draw(
            lambda plots: [(name, partial(plots.backbone, data)) for name, data in backbones.items()], tell
        )
    files.say(lambda: backbone_json(backbones), lambda: backbone_blocks(backbones, sources))


@with_options
def look(*, given: DecayOptions, shown: Shown) -> None:
    """Say what is in a file and what to do next, without a fit.

    Examples
    --------
    sysid-trib look swing.csv
    sysid-trib look swing.csv --angle 1 --units rad --plot figures
    """
    from sysid_trib.commands.terminal import progress

    understood: list[str] = []
    try:
        with progress() as tell:
            from sysid_trib.commands.record_inputs import decays_within, read_sources
            from sysid_trib.commands.terminal import command_after
            from sysid_trib.cycles.look import look as facts
            from sysid_trib.printing.looked import look_blocks, look_json, pointed_options
            from sysid_trib.printing.next_step import NextStep

            shown.check(given.records)
            tell("reading")
            records, sentences = read_sources(given)
            understood = sentences
            decays = decays_within(given, records)
            tree = facts(records, decays)
            asked = pointed_options(tree, given.system is not None)
            command = command_after(NextStep("identify", "the forces of this decay", asked), (given,))
            shown.draw(lambda plots: [("look", lambda: plots.look(tree))], tell)
    except DecayError:
        # What was understood helps to see why.
        if not shown.as_json and understood:
            print("\n".join(dict.fromkeys(understood)))
        raise
    shown.say(lambda: look_json(tree, command), lambda: look_blocks(tree, sentences, command))


def report(
    result: RESULT_FILE,
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="REPORT.html", help=WHERE_TO_WRITE, rich_help_panel=OUTPUT),
    ],
) -> None:
    """Show a saved result as one self-contained page, with figures and tables.

    Examples
    --------
    sysid-trib report forces.nc -o forces.html
    sysid-trib report missing.nc -o missing.html
    """
    from sysid_trib.commands.terminal import print_written, progress

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


def export(
    result: RESULT_FILE,
    language: Annotated[
        str,
        typer.Option("--as", metavar="python|sympy|simulink", help="Language.", rich_help_panel=OUTPUT),
    ] = "python",
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="FILE", help=WHERE_TO_WRITE, rich_help_panel=OUTPUT),
    ] = None,
) -> None:
    """Write an identified equation as a Python function, for sympy, or as a function block of Simulink.

    Examples
    --------
    sysid-trib export forces.nc
    sysid-trib export missing.nc --as simulink -o missing.m
    """
    from sysid_trib.commands.terminal import print_written, progress

    with progress():
        from sysid_trib.commands.checks import model_of_file
        from sysid_trib.commands.destination import check_output
        from sysid_trib.printing.equation import model_code
        from sysid_trib.results.files import load, write_file

        check_output(output, ".m" if language == "simulink" else ".py", reads=[result])
        text = model_code(model_of_file(result, load(result)), language)
        if output is not None:
            write_file(output, text.encode())
    if output is None:
        print(text, end="")
    print_written(output)


def forces(
    library: Annotated[
        str, typer.Argument(metavar="NAME|FILE", help="Force library.", rich_help_panel="Library")
    ] = "contact_forces",
    latex: Annotated[
        Path | None,
        typer.Option("--latex", metavar="FILE", help="Where to write it for LaTeX.", rich_help_panel=OUTPUT),
    ] = None,
) -> None:
    """Show the forces of a library: equations, kind, and signatures in envelope and frequency.

    Examples
    --------
    sysid-trib forces
    sysid-trib forces candidate_effects
    """
    from sysid_trib.commands.terminal import print_table, print_written, progress

    with progress():
        from sysid_trib.commands.destination import check_output
        from sysid_trib.forces.library import load_library
        from sysid_trib.printing.exported import forces_latex
        from sysid_trib.printing.looked import NORMALISED, force_table
        from sysid_trib.results.files import write_file

        check_output(latex, ".tex", reads=[Path(library)], flag="--latex")
        offered = load_library(library)
        table = force_table(offered)
        if latex is not None:
            write_file(latex, forces_latex(offered).encode())
    print(f"{offered.title}\n{NORMALISED}\n")
    print_table(table)
    print_written(latex)
