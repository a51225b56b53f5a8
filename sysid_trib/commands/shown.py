"""What `sysid-trib look`, `backbone`, `report`, `export` and `forces` do: they show what is there."""

from collections.abc import Callable
from functools import partial

import xarray as xr

from sysid_trib.commands.asked import model_of_file
from sysid_trib.commands.destination import check_output, deliver
from sysid_trib.commands.options import Given
from sysid_trib.commands.record_inputs import decays_within, read_decays, read_sources
from sysid_trib.commands.terminal import command_after, print_table, print_written
from sysid_trib.cycles.backbone import backbone as curves_of
from sysid_trib.cycles.look import look as facts
from sysid_trib.errors import DecayError, RecordError, Tell, UsageError
from sysid_trib.forces.library import load_library
from sysid_trib.printing import looked
from sysid_trib.printing.equation import model_code
from sysid_trib.printing.exported import forces_latex
from sysid_trib.printing.next_step import NextStep
from sysid_trib.results.files import load, write_file
from sysid_trib.results.variables import group_names


def backbone(tell: Tell, given: Given) -> Callable[[], None]:
    """The curves of each decay."""
    tell("reading")
    decays, sources = read_decays(given)
    names = group_names("backbone", len(decays))
    tell("frequency and damping against amplitude")
    curves = {name: curves_of(decay) for name, decay in zip(names, decays, strict=True)}
    says = partial(looked.backbone_blocks, curves, sources), partial(looked.backbone_json, curves)
    texts = {given.csv: partial(looked.backbone_csv, curves)}
    return deliver(given, tell, says, xr.DataTree.from_dict(curves), texts, kind="backbone")


def look(tell: Tell, given: Given) -> Callable[[], None]:
    """What is in files."""
    tell("reading")
    sources = read_sources(given)
    records = [run for _, runs, _ in sources for run in runs]
    sentences = [sentence for _, runs, sentence in sources for _ in runs]
    try:
        tree = facts(records, [decay for source in sources for decay in decays_within(given, source)[0]])
    except DecayError as error:
        # What was understood helps to see why.
        return partial(_refuse, [] if given.as_json else sentences, error)
    asked = looked.pointed_options(tree, given.system is not None)
    command = command_after(NextStep("identify", "the forces of this decay", asked), given)
    says = partial(looked.look_blocks, tree, sentences, command), partial(looked.look_json, tree, command)
    return deliver(given, tell, says, tree, kind="look")


def _refuse(sentences: list[str], error: DecayError) -> None:
    """Print what was understood, each sentence once, before what it ended with."""
    for sentence in dict.fromkeys(sentences):
        print(sentence)
    raise error


def report(tell: Tell, given: Given) -> Callable[[], None]:
    """The page of a result."""
    from sysid_trib.reporting.page import page, write_page

    tell("reading")
    tree = load(given.result)
    tell("page")
    try:
        text = page(tree)
    except (RecordError, UsageError) as error:
        raise RecordError(f"{given.result}: {error}") from None
    write_page(text, given.output)
    return partial(print_written, given.output)


def export(tell: Tell, given: Given) -> Callable[[], None]:
    """The equation of a result as a program."""
    result, language, output = given.result, given.language, given.output
    check_output(output, ".m" if language == "simulink" else ".py", reads=[result])
    text = model_code(model_of_file(result, load(result)), language)
    if output is None:
        return partial(print, text, end="")
    write_file(output, text.encode())
    return partial(print_written, output)


def forces(tell: Tell, given: Given) -> Callable[[], None]:
    """The forces of a library."""
    offered = load_library(given.library)
    table = looked.force_table(offered)
    if given.latex is not None:
        write_file(given.latex, forces_latex(offered).encode())

    def say() -> None:
        print(f"{offered.title}\n{looked.NORMALISED}\n")
        print_table(table)
        print_written(given.latex)

    return say
