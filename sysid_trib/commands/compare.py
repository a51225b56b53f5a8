"""`sysid-trib compare` and `difference`: methods held against each other on a record, and two samples."""

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from sysid_trib.commands.destination import Destination, figures_of_runs
from sysid_trib.commands.options import ConstraintOptions, DecayOptions, ModelOptions, with_options
from sysid_trib.commands.terminal import keep_next
from sysid_trib.errors import UsageError

if TYPE_CHECKING:
    import xarray as xr


@with_options
def compare(
    *, given: DecayOptions, model: ModelOptions, constraint: ConstraintOptions, destination: Destination
) -> None:
    """Identify the forces of a decay by every method, and test each on a part that it has not seen.

    Examples
    --------
    sysid-trib compare swing.csv -o methods.nc
    sysid-trib compare swing.csv --forces zeta,delta,nu,epsilon --window 0:15 --csv methods.csv
    """
    from sysid_trib.commands.terminal import record_sentences, working

    with working(given.records) as tell:
        from sysid_trib.commands import checks
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.printing.comparison import comparison_blocks
        from sysid_trib.printing.json_results import comparison_json
        from sysid_trib.validation.compare import compare

        asked = checks.asked_model(model, constraint, given.system)
        destination.check(given.records)
        tell("reading")
        decays, sources = read_decays(given, model, driven=True)
        tree = compare(
            decays,
            asked.library,
            asked.every_method,
            contactless=asked.contactless,
            constraints=asked.constraints.table,
            tell=tell,
        )
        keep_next(tree, given, model, constraint)
    destination.deliver(
        tree,
        lambda: comparison_blocks(tree, record_sentences(tree, sources)),
        lambda: comparison_json(tree),
        lambda plots: [
            *figures_of_runs(tree, "overview", plots.overview),
            ("comparison", partial(plots.comparison, tree)),
        ],
    )


# Stands between the records of the two samples.
AND = Path(":")


@with_options
def difference(
    *, given: DecayOptions, model: ModelOptions, constraint: ConstraintOptions, destination: Destination
) -> None:
    """Hold two samples against each other, A... : B...: which coefficients differ, and by how much.

    Examples
    --------
    sysid-trib difference swing.csv soft.csv -o difference.nc --plot figures
    sysid-trib difference 'swing.csv' : soft.csv --forces zeta,delta,nu --explain
    """
    from sysid_trib.commands.terminal import working

    sides = _sides(given.records)
    with working([record for side in sides for record in side]) as tell:
        from sysid_trib.commands import checks
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.methods.scope import with_random_force
        from sysid_trib.printing.sureness import difference_blocks, difference_json
        from sysid_trib.validation.identify import usual_methods
        from sysid_trib.validation.samples import held_against

        asked = checks.asked_model(model, constraint, given.system)
        destination.check([record for side in sides for record in side])
        tell("reading")
        (first, of_first), (second, of_second) = (
            read_decays(replace(given, records=side), model) for side in sides
        )
        _check_apart(first, second)
        usual = usual_methods([*first, *second], asked.library, asked.reference_frequency, asked.shapes)
        tree = held_against(
            first,
            second,
            asked.library,
            with_random_force(usual[-1], asked.random_force),
            constraints=asked.constraints.table,
            tell=tell,
        )
    destination.deliver(
        tree,
        lambda: difference_blocks(tree, [*of_first, *of_second]),
        lambda: difference_json(tree),
        lambda plots: [("difference", lambda: plots.difference(tree))],
    )


def _sides(records: list[Path]) -> tuple[list[Path], list[Path]]:
    """The records of each sample."""
    marks = [at for at, record in enumerate(records) if record == AND]
    if not marks and len(records) == 2:
        return records[:1], records[1:]
    if len(marks) == 1 and 0 < marks[0] < len(records) - 1:
        return records[: marks[0]], records[marks[0] + 1 :]
    raise UsageError(
        "difference wants two samples: A.csv B.csv, or the runs of each with ' : ' between, A*.csv : B*.csv."
    )


def _check_apart(first: "list[xr.Dataset]", second: "list[xr.Dataset]") -> None:
    """Refuse a record that is in both samples, and samples in different units."""
    sums, others = ({run.attrs.get("record_checksum") for run in side} for side in (first, second))
    if sums & others - {None}:
        raise UsageError("A record is given in both samples; their differences would share its noise.")
