"""`sysid-trib compare`."""

from functools import partial

from sysid_trib.commands.destination import Destination, figures_of_runs
from sysid_trib.commands.options import ConstraintOptions, DecayOptions, ModelOptions, with_options
from sysid_trib.commands.terminal import keep_next


@with_options
def compare(
    *, given: DecayOptions, model: ModelOptions, constraint: ConstraintOptions, destination: Destination
) -> None:
    """Identify the forces of a decay by every method, and test each on a part that it has not seen."""
    from sysid_trib.commands.terminal import record_sentences, working

    with working(given.records) as tell:
        from sysid_trib.commands import checks
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.methods.scope import with_random_force
        from sysid_trib.printing.comparison import comparison_blocks
        from sysid_trib.printing.comparison_tables import comparison_json
        from sysid_trib.validation import compare as comparison

        asked = checks.asked_model(model, constraint, given.system)
        destination.check(given.records)
        tell("reading")
        decays, sources = read_decays(
            given, asked.reference_frequency, asked.contactless, as_it_is=bool(model.forces), driven=True
        )
        methods = {
            label: with_random_force(method, asked.random_force)
            for label, method in comparison.every_method(asked.reference_frequency, asked.shapes).items()
        }
        tree = comparison.compare(
            decays,
            asked.library,
            methods,
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
