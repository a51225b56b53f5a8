"""`sysid-trib identify`."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from sysid_trib.commands.destination import Destination, check_output, figures_of_runs
from sysid_trib.commands.options import (
    MODEL,
    ConstraintOptions,
    DecayOptions,
    ModelOptions,
    option,
    switch,
    with_options,
)
from sysid_trib.commands.terminal import keep_next
from sysid_trib.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import xarray as xr
    from matplotlib.figure import Figure

    from sysid_trib.errors import Tell


@dataclass(frozen=True)
class ScaleOptions:
    """What gives coefficients SI units."""

    title: ClassVar[str] = MODEL

    inertia: str | None = option("KG*M^2[±ERROR]", "Moment of inertia: torques in SI units too.")
    mass: str | None = option("KG[±ERROR]", "Mass that is displaced: forces in SI units too.")
    load: str | None = option("N[±ERROR]", "Normal load of the contact: the coefficient of friction.")
    radius: str | None = option(
        "M[±ERROR]", "At which the contact rubs, of an angle: 2/3 of a disc that spins under even pressure."
    )

    def measured(self) -> "dict[str, tuple[float, float]]":
        """What is given with its errors; refused where it is too little for what it is for."""
        from sysid_trib.commands import checks
        from sysid_trib.physics.si_units import check_measured

        read = {k: checks.parse_value_with_error(v, f"--{k}") for k, v in vars(self).items()}
        given = {name: pair for name, pair in read.items() if pair is not None}
        if given:
            check_measured(given.keys())
        return given


@dataclass(frozen=True)
class TestOptions:
    """What the answer is tried on."""

    title: ClassVar[str] = MODEL

    test: Path | None = option("RECORD", "Another record, read alike, which the answer predicts.")
    warm_up: float | None = option(
        "S", "Beginning of driven records that does not count; to it the start of --test is fitted."
    )


@dataclass(frozen=True)
class SurenessOptions:
    """How sure the answer is."""

    title: ClassVar[str] = "How sure"

    profile: str | None = option(
        "A,B,...",
        "Coefficients and shapes (dahl.s) with intervals of the profile likelihood; lambda:delta, contours.",
    )
    sensitivity: bool = switch(
        "--sensitivity", "Fit the same forces over windows, starts, sampling, noise models and methods."
    )

    def profiled(self) -> tuple[list[str], list[str]]:
        """Parameters that have a profile, and the pair that has contours.

        Raises
        ------
        UsageError
            More than one pair.
        """
        given = [name.strip() for name in (self.profile or "").split(",")]
        asked = [name for name in dict.fromkeys(given) if name]
        pairs = [name for name in asked if ":" in name]
        if len(pairs) > 1:
            raise UsageError(
                f"--profile draws contours of one pair, not of {' and '.join(pairs)}; ask for one."
            )
        return [name for name in asked if ":" not in name], pairs


@dataclass(frozen=True)
class IdentificationFiles(Destination):
    """Where the result of an identification goes, and what a paper says of it."""

    methods: Path | None = option(
        "FILE.tex", "Where to write a paragraph on the methods, and FILE.bib with what it cites."
    )

    @property
    def places(self) -> "list[Path | None]":
        """What is written, where it is asked for."""
        bibliography = self.methods and self.methods.with_suffix(".bib")
        return [*super().places, self.methods, bibliography]

    def check(self, records: "Sequence[Path]") -> None:
        """Refuse, before the work is done, places that cannot be written."""
        super().check(records)
        for place, ending in zip(self.places[-2:], (".tex", ".bib"), strict=True):
            check_output(place, ending, reads=records, flag="--methods")

    def texts(self, tree: "xr.DataTree") -> "dict[Path | None, Callable[[], str]]":
        """What stands in files of text, by their places: the paragraph and its bibliography too."""
        from sysid_trib.printing.exported import cited, methods_text

        text, bibliography = self.places[-2:]
        more = {text: lambda: methods_text(tree), bibliography: lambda: cited(methods_text(tree))}
        return super().texts(tree) | more


@with_options
def identify(
    *,
    given: DecayOptions,
    model: ModelOptions,
    scale: ScaleOptions,
    constraint: ConstraintOptions,
    sure: SurenessOptions,
    tried: TestOptions,
    destination: IdentificationFiles,
) -> None:
    """Identify the forces of a decay in two ways, and cross-check them.

    Examples
    --------
    sysid-trib identify swing.csv -o forces.nc --plot figures
    sysid-trib identify swing.csv --forces zeta,delta,nu,epsilon --bound zeta=0: --explain
    """
    from sysid_trib.commands.terminal import working

    with working(given.records) as tell:
        from sysid_trib.commands import checks
        from sysid_trib.commands.record_inputs import calibration_of, read_decays
        from sysid_trib.methods.scope import with_random_force
        from sysid_trib.physics.si_units import check_length_unit
        from sysid_trib.records.signal import unit_of_signal
        from sysid_trib.results.references import with_scale_error
        from sysid_trib.validation.driven import is_driven
        from sysid_trib.validation.identify import identify, usual_methods

        measured, calibration = scale.measured(), calibration_of(given)
        asked = checks.asked_model(model, constraint, given.system)
        profiled = sure.profiled()
        destination.check(given.records)
        tell("reading")
        decays, sources = read_decays(given, model, driven=True)
        if "mass" in measured:
            check_length_unit(unit_of_signal(decays[0]))
        if is_driven(decays) and (measured or destination.methods):
            raise UsageError("SI units and --methods are of free decays; leave them out of a driven record.")
        if tried.warm_up is not None and not (tried.warm_up >= 0.0 and (is_driven(decays) or tried.test)):
            raise UsageError(
                "--warm-up is a time from 0 s of a driven record, or of --test; cut decays by --window."
            )
        own = tuple(name.strip() for name in (constraint.own or "").split(",") if name.strip())
        usual = usual_methods(
            decays, asked.library, asked.reference_frequency, asked.shapes, own, tried.warm_up or 0.0
        )
        tree = identify(
            decays,
            asked.library,
            [with_random_force(method, asked.random_force) for method in usual],
            constraints=asked.constraints.table,
            contactless=asked.contactless,
            tell=tell,
        )
        predicted = _predicted(tree, tried, given, tell)
        _add_sureness(tree, decays, sure.sensitivity, tell, *profiled)
        if calibration[1]:
            tree = with_scale_error(tree, calibration[1] / calibration[0])
        _add_si_units(tree, measured)
        if not is_driven(decays):
            keep_next(tree, given, model, constraint)
    _deliver(tree, sources, predicted, destination)


def _add_sureness(
    tree: "xr.DataTree", decays: "list[xr.Dataset]", refits: bool, tell: "Tell", *profiled: list[str]
) -> None:
    """Add what is asked of how sure the answer is, as groups of the result."""
    names, pairs = profiled
    if not (names or pairs or refits):
        return
    from sysid_trib.validation.findings import answer_of
    from sysid_trib.validation.profiles import contour, profile
    from sysid_trib.validation.refits import sensitivity

    answer = tree[answer_of(tree)].to_dataset()
    if names:
        tree["profile"] = profile(decays, answer, names, tell=tell)
    for pair in pairs:
        tree["contour"] = contour(decays, answer, pair.split(":"), tell=tell)
    if refits:
        tree["sensitivity"] = sensitivity(decays, answer, tell=tell)


def _add_si_units(tree: "xr.DataTree", measured: "dict[str, tuple[float, float]]") -> None:
    """Add the answer in SI units, if what they take is given."""
    import xarray as xr

    from sysid_trib.physics.si_units import SI, in_si_units
    from sysid_trib.validation.findings import answer_of, kept_results

    answer = answer_of(tree)
    if measured and (result := kept_results(tree).get(answer)) is not None:
        converted = in_si_units(result, **measured)
        # What has a covariance of forces is an identification.
        tree[SI] = xr.DataTree(converted.drop_dims("other_force").assign_attrs(of_method=answer))


def _predicted(
    tree: "xr.DataTree", tried: TestOptions, given: DecayOptions, tell: "Tell"
) -> "list[xr.Dataset]":
    """What the answer predicts of the record that it is tried on; nothing where there is none."""
    from sysid_trib.commands.record_inputs import read_decays
    from sysid_trib.validation.driven import predict

    if tried.test is None:
        return []
    tell("prediction")
    others, _ = read_decays(replace(given, records=[tried.test]), as_it_is=True, driven=True)
    answer = tree[tree["comparison"].attrs["answer"]].to_dataset()
    return [predict(answer, other, warm_up=tried.warm_up) for other in others]


def _deliver(
    tree: "xr.DataTree",
    sources: "list[str]",
    predicted: "list[xr.Dataset]",
    destination: Destination,
) -> None:
    """Print and write an identification, of free decays or with inputs."""
    from sysid_trib.commands.terminal import record_sentences
    from sysid_trib.printing import ALWAYS, Block
    from sysid_trib.printing.driven import driven_blocks, driven_json, prediction_json, prediction_sentences
    from sysid_trib.printing.identification import identification_blocks
    from sysid_trib.printing.json_results import identification_json
    from sysid_trib.printing.sureness import sureness_blocks, sureness_json
    from sysid_trib.results.files import kind_of

    driven = kind_of(tree) == "driven"

    def blocks() -> list[Block]:
        sentences = record_sentences(tree, sources)
        if driven:
            said = [*driven_blocks(tree, sentences), *sureness_blocks(tree)]
        else:
            said = identification_blocks(tree, sentences)
        return [*said, Block(prediction_sentences(predicted), ALWAYS)]

    def data() -> dict[str, Any]:
        whole = driven_json(tree) if driven else identification_json(tree)
        return whole | prediction_json(predicted) | sureness_json(tree)

    destination.deliver(tree, blocks, data, partial(_figures, tree))


def _figures(tree: "xr.DataTree", plots: Any) -> "list[tuple[str, Callable[[], Figure]]]":
    """The figures of each run, and of those groups that the result has."""
    from sysid_trib.results.variables import group_names, record_groups

    count = len(record_groups(tree))
    followed, bands = (group_names(name, count) for name in ("innovations", "prediction_bands"))
    groups_of: dict[str, tuple[Any, tuple[str, ...]]] = {
        "profile": (plots.profile, ("profile", "contour")),
        "sensitivity": (plots.sensitivity, ("sensitivity",)),
    } | {name: (plots.innovations, (name, ahead)) for name, ahead in zip(followed, bands, strict=True)}
    figures = figures_of_runs(tree, "overview", plots.overview)
    for name, (draw, groups) in groups_of.items():
        if data := [tree[group].to_dataset() for group in groups if group in tree.children]:
            figures.append((name, partial(draw, *data)))
    return figures
