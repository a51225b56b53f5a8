"""`sysid-trib identify`."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sysid_trib.commands.destination import Destination, figures_of_runs, random_force_figures
from sysid_trib.commands.naming import named
from sysid_trib.commands.next_command import keep_next
from sysid_trib.commands.options import ConstraintOptions, DecayOptions, ModelOptions, option, with_options
from sysid_trib.commands.threads import one_thread
from sysid_trib.errors import UsageError

if TYPE_CHECKING:
    import xarray as xr

    from sysid_trib.forces.force import ForceLibrary
    from sysid_trib.methods.scope import Method
    from sysid_trib.validation.progress import Tell


@dataclass(frozen=True)
class ScaleOptions:
    """What gives coefficients SI units."""

    inertia: float | None = option("KG*M^2", "Moment of inertia: coefficients in SI units too.")
    mass: float | None = option(
        "KG", "Mass that is displaced: coefficients of a displacement in SI units too."
    )
    load: float | None = option("N", "Normal load of the contact: with --mass, the coefficient of friction.")

    def check(self) -> None:
        """Refuse what is not positive, and a load without a mass."""
        from sysid_trib.commands import checks

        for name in ("inertia", "mass", "load"):
            checks.check_positive(getattr(self, name), f"--{name}")
        if self.load is not None and self.mass is None:
            raise UsageError("--load gives the coefficient of friction together with --mass: give both.")


@with_options
def identify(
    *,
    given: DecayOptions,
    model: ModelOptions,
    scale: ScaleOptions,
    constraint: ConstraintOptions,
    destination: Destination,
) -> None:
    """Identify the forces of a decay in two ways, and cross-check them."""
    from sysid_trib.commands.terminal import progress

    with progress() as tell, one_thread(), named(given.records):
        from sysid_trib.commands import checks
        from sysid_trib.commands.record_inputs import read_decays
        from sysid_trib.commands.terminal import record_sentences
        from sysid_trib.decays.signal import unit_of_signal
        from sysid_trib.forces.systems import load_system
        from sysid_trib.methods.scope import constrained, with_random_force
        from sysid_trib.physics.translation import check_length_unit
        from sysid_trib.printing.identification import identification_blocks, identification_json
        from sysid_trib.printing.layers import Block
        from sysid_trib.printing.own_quantity import own_quantity
        from sysid_trib.printing.translation import second_of, translation_json, translation_sentences
        from sysid_trib.results.contactless import with_contactless_frequency
        from sysid_trib.results.schema import map_identifications

        scale.check()
        swinging = None if given.system is None else load_system(given.system)
        offered, shapes, constraints, contactless = checks.asked_model(model, constraint, swinging)
        random_force = checks.parse_random_force(model.random_force)
        destination.check(given.records)
        tell("reading")
        decays, sources = read_decays(
            given, model.reference_frequency, contactless, as_it_is=bool(model.forces)
        )
        if scale.mass is not None:
            check_length_unit(unit_of_signal(decays[0]))
        methods, draws = _methods(offered, shapes, model.reference_frequency, decays)
        methods = [with_random_force(constrained(method, constraints), random_force) for method in methods]
        tree = _cross_checked(decays, offered, methods, draws, tell)
        if contactless is not None:
            tree = map_identifications(tree, lambda result: with_contactless_frequency(result, *contactless))
        keep_next(tree, given, model, constraint)
    destination.deliver(
        tree,
        lambda: [
            *identification_blocks(
                tree,
                [*record_sentences(tree, sources), *own_quantity(tree)],
                scale.inertia,
            ),
            Block(translation_sentences(second_of(tree), scale.mass, scale.load)),
        ],
        lambda: (
            identification_json(tree, scale.inertia)
            | translation_json(second_of(tree), scale.mass, scale.load)
        ),
        lambda plots: [
            # A run with few half periods has none.
            *(figure for figure in figures_of_runs(tree, "backbone", plots.backbone) if figure[0] in tree),
            *figures_of_runs(tree, "overview", plots.overview),
            *figures_of_runs(tree, "identification", plots.identification),
            *random_force_figures(tree, plots),
        ],
    )


def _cross_checked(
    decays: "list[xr.Dataset]", offered: "ForceLibrary", methods: "list[Method]", draws: int, tell: "Tell"
) -> "xr.DataTree":
    """Both identifications held against each other; of several runs, whether these agree."""
    import xarray as xr

    from sysid_trib.printing.translation import second_of
    from sysid_trib.records.runs import one_or_all
    from sysid_trib.validation.cross_check import identified_and_checked
    from sysid_trib.validation.homogeneity import run_agreement

    decay = one_or_all(decays)
    tree = identified_and_checked(decay, offered, methods, draws=draws, tell=tell)
    if len(decays) > 1:
        tell("each run by itself")
        tree["runs"] = xr.DataTree(run_agreement(decays, second_of(tree)))
    return tree


def _methods(
    offered: "ForceLibrary",
    shapes: dict[str, float],
    reference_frequency: float | None,
    decays: "list[xr.Dataset]",
) -> "tuple[list[Method], int]":
    """The two methods that are held against each other, and on how many simulated records."""
    from sysid_trib.methods import Averaging, Direct, Trajectory
    from sysid_trib.trajectory_fit.observation import MEASURED
    from sysid_trib.validation.cross_check import SIMULATED_RECORDS
    from sysid_trib.validation.simulated_pairs import fewest_records

    direct = Direct(reference_frequency=reference_frequency, shapes=shapes)
    averaging = Averaging(reference_frequency=reference_frequency, shapes=shapes)
    trajectory = Trajectory(reference_frequency=reference_frequency, shapes=shapes)
    # A fit of the motion takes seconds: no more simulated records than decide whether the two agree.
    few = min(SIMULATED_RECORDS, fewest_records(len(offered) + 1))
    # Amplitudes and frequencies tell no term of the sensor from a force: with one, the motion is fitted.
    forces_alone = all(force.kind == "force" for force in offered)
    if any(MEASURED in decay for decay in decays):
        # What is reported last is that in the quantity that was measured.
        return [averaging if forces_alone else direct, trajectory], few
    # One that is too short or grows has no envelope to be averaged.
    if not forces_alone or any(decay.attrs.get("taken_as_it_is") for decay in decays):
        return [trajectory, direct], few
    return [averaging, direct], SIMULATED_RECORDS
