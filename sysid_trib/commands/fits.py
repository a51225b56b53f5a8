"""Commands `identify`, `discover`, `compare` and `difference`."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import xarray as xr

from sysid_trib.commands.app import parse_value_with_error, parse_window
from sysid_trib.commands.asked import AskedModel, asked_constraints, asked_model, asked_search, driving_of
from sysid_trib.commands.next_step import keep_next
from sysid_trib.commands.options import (
    EXAMPLE_FORCES,
    CompareOptions,
    DestinationOptions,
    DifferenceOptions,
    DiscoverOptions,
    IdentifyOptions,
    SIOptions,
)
from sysid_trib.commands.record_inputs import calibration_of, read_decays
from sysid_trib.commands.terminal import deliver
from sysid_trib.errors import DecayError, Tell, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.methods.options import with_random_force
from sysid_trib.methods.scope import Method
from sysid_trib.methods.trajectory import KINDS_OF_STARTS, StartsOption
from sysid_trib.physics.consequences import with_consequences
from sysid_trib.physics.si_units import check_angle_unit, check_length_unit, check_measured, in_si_units
from sysid_trib.printing import Block, comparison, discovery, driven, exported, identification, sureness
from sysid_trib.printing.campaign import difference_blocks, difference_json
from sysid_trib.questions import profiles
from sysid_trib.questions.difference import held_against
from sysid_trib.questions.law_difference import laws_held_against
from sysid_trib.records.signal import unit_of_signal
from sysid_trib.results import judged
from sysid_trib.results.kinds import SI, kind_of
from sysid_trib.results.references import with_scale_error
from sysid_trib.results.variables import record_groups
from sysid_trib.smooth_laws.method import law_methods
from sysid_trib.validation import refits
from sysid_trib.validation.compare import compare as compared, every_method
from sysid_trib.validation.driven import is_driven, predict
from sysid_trib.validation.identify import identify as identified, usual_methods

# End of an error message of `identify`.
OR_FEWER = "give a longer record or fewer."


def own_names(text: str | None) -> tuple[str, ...]:
    """Return the names that are each run's own; raise an error for a text without a name.

    Raises
    ------
    UsageError
        The text has none.
    """
    names = tuple(names_in(text))
    if text is not None and not names:
        raise UsageError(f"--own '{text}' names nothing; name what is each run's own, or leave --own out.")
    return names


def names_in(text: str | None) -> list[str]:
    """Return the names in a comma-separated text, without duplicates."""
    names = [name.strip() for name in (text or "").split(",")]
    return list(dict.fromkeys(filter(None, names)))


def _texts(given: DestinationOptions, tree: xr.DataTree) -> dict[Path | None, Callable[[], str]]:
    """Return the text files of a result, by their paths."""
    return {given.csv: partial(exported.csv_text, tree), given.latex: partial(exported.latex_text, tree)}


def record_sentences(tree: xr.DataTree, sentences: Sequence[str]) -> list[str]:
    """Return a sentence on each record and on its cuts."""
    said = []
    for sentence, group in zip(sentences, record_groups(tree), strict=True):
        said.append(sentence)
        said.append(tree[group].attrs.get("free_decay", ""))
    return said


def identify(tell: Tell, given: IdentifyOptions) -> Callable[[], None]:
    """Identify the forces of records in two ways."""
    measured = measured_given(given)
    calibration = calibration_of(given)
    wanted = asked_model(given)
    profiled = names_in(given.profile)
    tell("reading")
    decays, sources = read_decays(given, driven=True)
    driven = is_driven(decays)
    if driven and (measured or given.methods_text):
        raise UsageError("SI units and --methods-text are for free decays; omit them for a driven record.")
    if "mass" in measured:
        check_length_unit(unit_of_signal(decays[0]))
    if "inertia" in measured:
        check_angle_unit(unit_of_signal(decays[0]))
    if given.warm_up is not None and not (given.warm_up >= 0.0 and (driven or given.test)):
        raise UsageError(
            "--warm-up is 0 s or more of a driven record, or of --test; use --window to cut decays."
        )
    own = own_names(given.own)
    warm_up = given.warm_up or 0.0
    starts = checked_starts(given.starts, driven=driven or given.test is not None)
    asked = wanted.reference_frequency, wanted.shapes, own, warm_up, starts
    usual = usual_methods(decays, wanted.library, *asked)
    with _fewer_forces_named(wanted.library):
        tree = identified(
            decays,
            wanted.library,
            [with_random_force(method, wanted.random_force) for method in usual],
            constraints=wanted.constraints,
            contactless=wanted.contactless,
            tell=tell,
        )
    predicted = []
    if given.test is not None:
        tell("prediction")
        of_test = given.but(records=[given.test], omega0=None, reference_frequency=None)
        others, _ = read_decays(of_test, as_it_is=True, driven=True, warm_up=given.warm_up)
        answer = tree[judged.preferred_of(tree)].to_dataset()
        predicted = [predict(answer, other, warm_up=given.warm_up, starts=starts) for other in others]
    _add_sureness(tree, decays, given.sensitivity, profiled, tell)
    if calibration[1]:
        tree = with_scale_error(tree, calibration[1] / calibration[0])
    if measured and (result := judged.kept_results(tree).get(judged.preferred_of(tree))) is not None:
        # A dataset with a covariance of forces is an identification.
        converted = in_si_units(result, **measured).drop_dims("other_force")
        tree[SI] = xr.DataTree(converted.assign_attrs(of_method=judged.preferred_of(tree)))
    tree = with_consequences(tree)
    keep_next(tree, given)
    texts = _texts(given, tree)
    if given.methods_text is not None:
        texts[given.methods_text] = partial(exported.methods_text, tree)
        texts[given.methods_text.with_suffix(".bib")] = lambda: exported.cited(exported.methods_text(tree))
    says = partial(_blocks, tree, sources, predicted), partial(_data, tree, predicted)
    return deliver(given, tell, says, tree, texts)


def checked_starts(word: str, *, driven: bool) -> StartsOption:
    """Return the kind of start of the runs; raise an error for another word, or for free decays."""
    if word not in KINDS_OF_STARTS:
        raise UsageError(f"--starts '{word}' must be {' or '.join(KINDS_OF_STARTS)}.")
    if word != KINDS_OF_STARTS[0] and not driven:
        raise UsageError("--starts is for driven records (--input); the start of a decay is fitted.")
    return word  # type: ignore[return-value]


@contextmanager
def _fewer_forces_named(library: ForceLibrary) -> Iterator[None]:
    """Add to the error of a record that is too short for all forces: viscous friction alone."""
    try:
        yield
    except DecayError as error:
        viscous = next(iter(library.damping_factors), "")
        if not str(error).endswith(OR_FEWER) or not viscous:
            raise
        choice = f"{str(error).removesuffix('.')}, such as --forces {viscous}."
        raise DecayError(choice) from None


def measured_given(given: SIOptions) -> dict[str, tuple[float, float]]:
    """Return the given quantities for SI units, with errors; raise an error if one is missing."""
    texts = {"inertia": given.inertia, "mass": given.mass, "load": given.load, "radius": given.radius}
    pairs = {name: parse_value_with_error(text, f"--{name}") for name, text in texts.items()}
    known = {name: pair for name, pair in pairs.items() if pair is not None}
    if known:
        check_measured(known.keys())
    return known


def _add_sureness(
    tree: xr.DataTree, decays: list[xr.Dataset], varied: bool, profiled: Sequence[str], tell: Tell
) -> None:
    """Add the requested measures of uncertainty as groups of the result."""
    if not (varied or profiled):
        return
    answer = tree[judged.preferred_of(tree)].to_dataset()
    if profiled:
        tree["profile"] = profiles.profile(decays, answer, profiled, tell=tell)
    if varied:
        tree["sensitivity"] = refits.sensitivity(decays, answer, tell=tell)


def _blocks(tree: xr.DataTree, sources: list[str], predicted: list[xr.Dataset]) -> list[Block]:
    """Return the blocks of an identification, of free decays or with inputs."""
    sentences = record_sentences(tree, sources)
    of_kind = driven.driven_blocks if kind_of(tree) == "driven" else identification.identification_blocks
    return [*of_kind(tree, sentences), driven.prediction_block(predicted)]


def _data(tree: xr.DataTree, predicted: list[xr.Dataset]) -> dict[str, Any]:
    of_kind = driven.driven_json if kind_of(tree) == "driven" else identification.identification_json
    return of_kind(tree) | driven.prediction_json(predicted) | sureness.sureness_json(tree)


def discover(tell: Tell, given: DiscoverOptions) -> Callable[[], None]:
    """Search for the effects that a model lacks."""
    # The other commands of this module need neither a search nor its imports.
    from sysid_trib.discovery.discover import discover as searched

    driving = driving_of(given)
    is_example = not given.records and given.forces is None
    asked = given.but(forces=EXAMPLE_FORCES) if is_example else given
    start, offered, options = asked_search(asked, driving)
    tell("reading")
    decays, sources = read_decays(given, driven=True)
    seen, held, said = _held_out(decays, given.holdout)
    tree = searched(seen, start, offered, holdout=held, tell=tell, **options)
    if said:
        tree.attrs["held_out"] = said
    keep_next(tree, given)
    stretches = tree.attrs["stretches"]
    sentences = [*sources, stretches] if stretches else record_sentences(tree, sources)
    says = partial(discovery.discovery_blocks, tree, sentences), partial(discovery.discovery_json, tree)
    return deliver(given, tell, says, tree, _texts(given, tree))


def _held_out(decays: list[xr.Dataset], window: str | None) -> tuple[list[xr.Dataset], list[xr.Dataset], str]:
    """Split decays into a part for identification and a held-out window, and describe the window."""
    if window is None:
        return decays, [], ""
    low, high = parse_window(window, "--holdout")
    seen = []
    held = []
    for decay in decays:
        part = decay.sel(time=slice(low, high))
        rest = decay.drop_sel(time=part.time)
        here = f"the decay is from {decay.time[0]:.4g} s to {decay.time[-1]:.4g} s"
        if not (part.sizes["time"] and rest.sizes["time"]):
            amount = "all" if part.sizes["time"] else "nothing"
            raise DecayError(f"--holdout '{window}' holds out {amount}: {here}.")
        ends_of_part = {part.time[0].item(), part.time[-1].item()}
        ends_of_decay = {decay.time[0].item(), decay.time[-1].item()}
        if not ends_of_part & ends_of_decay:
            raise UsageError(f"--holdout '{window}' must reach to the start or the end: {here}.")
        seen.append(rest)
        held.append(part)
    said = f"up to {high:g} s" if low is None else f"from {low:g} s on" if high is None else ""
    said = said or f"{low:g} s to {high:g} s"
    return seen, held, said + (" of each run" if len(decays) > 1 else "")


def methods_asked(asked: AskedModel) -> dict[str, Method]:
    """Return every method by its label, with the given frequency, shapes and random force."""
    methods = every_method(asked.reference_frequency, asked.shapes) | law_methods()
    return {label: with_random_force(method, asked.random_force) for label, method in methods.items()}


def compare(tell: Tell, given: CompareOptions) -> Callable[[], None]:
    """Identify the forces of records by every method."""
    asked = asked_model(given)
    tell("reading")
    decays, sources = read_decays(given, driven=True)
    tree = compared(
        decays,
        asked.library,
        methods_asked(asked),
        contactless=asked.contactless,
        constraints=asked.constraints,
        tell=tell,
    )
    keep_next(tree, given)
    blocks = partial(comparison.comparison_blocks, tree, record_sentences(tree, sources))
    says = blocks, partial(comparison.comparison_json, tree)
    return deliver(given, tell, says, tree, _texts(given, tree))


# Separator of the records of the two samples.
AND = Path(":")


def difference(tell: Tell, given: DifferenceOptions) -> Callable[[], None]:
    """Compare two samples."""
    sides = _sides(given.records)
    asked = asked_model(given)
    tell("reading")
    (first, of_first), (second, of_second) = (
        read_decays(given.but(records=side), driven=True) for side in sides
    )
    if given.laws and is_driven([*first, *second]):
        raise UsageError("difference --laws is for free decays; leave it out for driven records.")
    sums, others = ({run.attrs.get("record_checksum") for run in side} for side in (first, second))
    if sums & others - {None}:
        raise UsageError("A record is given in both samples; their differences would share its noise.")
    usual = usual_methods([*first, *second], asked.library, asked.reference_frequency, asked.shapes)
    method = with_random_force(usual[-1], asked.random_force)
    tree = held_against(first, second, asked.library, method, constraints=asked.constraints, tell=tell)
    if given.laws:
        for name, group in laws_of_samples(first, second, given, asked, tell).items():
            tree[name] = xr.DataTree(group)
    blocks = partial(difference_blocks, tree, [*of_first, *of_second])
    says = blocks, partial(difference_json, tree)
    return deliver(given, tell, says, tree, _texts(given, tree))


def laws_of_samples(
    first: Sequence[xr.Dataset],
    second: Sequence[xr.Dataset],
    given: DifferenceOptions,
    asked: AskedModel,
    tell: Tell,
) -> dict[str, xr.Dataset]:
    """Return the laws of both samples and their difference, with the fixed forces of the system."""
    return laws_held_against(
        first,
        second,
        system=given.system,
        constraints=asked_constraints(given.fix, given.bound, given.tie).table,
        library=load_library(given.library),
        # The laws determine themselves whether a random force improves the fit.
        random_force="off" if asked.random_force == "auto" else asked.random_force,
        tell=tell,
    )


def _sides(records: list[Path]) -> tuple[list[Path], list[Path]]:
    """Return the records of each sample."""
    marks = [at for at, record in enumerate(records) if record == AND]
    if not marks and len(records) == 2:
        return records[:1], records[1:]
    if len(marks) == 1 and 0 < marks[0] < len(records) - 1:
        return records[: marks[0]], records[marks[0] + 1 :]
    raise UsageError(
        "difference needs two samples: A.csv B.csv, or the runs of each with ' : ' between, A*.csv : B*.csv."
    )
