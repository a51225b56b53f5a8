"""`sysid-trib compare`."""

from functools import partial

from sysid_trib.commands.destination import Destination, figures_of_runs
from sysid_trib.commands.naming import named
from sysid_trib.commands.next_command import keep_next
from sysid_trib.commands.options import ConstraintOptions, DecayOptions, ModelOptions, with_options
from sysid_trib.commands.terminal import progress, record_sentences
from sysid_trib.commands.threads import one_thread


@with_options
def compare(
    *, given: DecayOptions, model: ModelOptions, constraint: ConstraintOptions, destination: Destination
) -> None:
    """Identify the forces of a decay by every method, and test each on a part that it has not seen."""
    with progress() as tell, one_thread(), named(given.records):
        from sysid_trib.commands import checks
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.forces.systems import load_system
        from sysid_trib.methods.scope import with_random_force
        from sysid_trib.printing.comparison import comparison_blocks, comparison_json
        from sysid_trib.validation import compare as comparison

        swinging = None if given.system is None else load_system(given.system)
        offered, shapes, constraints, contactless = checks.asked_model(model, constraint, swinging)
        random_force = checks.parse_random_force(model.random_force)
        destination.check(given.records)
        tell("reading")
        decays, sources = read_decays(
            given, model.reference_frequency, contactless, as_it_is=bool(model.forces)
        )
        methods = {
            label: with_random_force(method, random_force)
            for label, method in comparison.every_method(model.reference_frequency, shapes).items()
        }
        tree = comparison.compare(
            decays, offered, methods, contactless=contactless, constraints=constraints.table, tell=tell
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
