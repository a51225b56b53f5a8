"""Command `laws`: friction and restoring force as curves without a formula."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import xarray as xr

from sysid_trib.commands.asked import asked_constraints, parse_random_force
from sysid_trib.commands.fits import measured_given, own_names, record_sentences
from sysid_trib.commands.next_step import keep_next
from sysid_trib.commands.options import LawsOptions
from sysid_trib.commands.record_inputs import calibration_of, read_decays
from sysid_trib.commands.terminal import deliver
from sysid_trib.errors import Tell, UsageError
from sysid_trib.forces.library import load_library
from sysid_trib.forces.systems import load_system
from sysid_trib.physics.si_laws import laws_in_si
from sysid_trib.physics.si_units import check_angle_unit, check_length_unit
from sysid_trib.printing import Block, driven, laws as printed
from sysid_trib.printing.si_laws import si_blocks, si_json
from sysid_trib.records.signal import unit_of_signal
from sysid_trib.results.judged import best
from sysid_trib.results.law_curves import LAWS_SI
from sysid_trib.smooth_laws.calibration import with_scale_error
from sysid_trib.smooth_laws.laws import laws as identified
from sysid_trib.validation.driven import is_driven, predict


def laws(tell: Tell, given: LawsOptions) -> Callable[[], None]:
    """Identify the laws of records."""
    constraints = asked_constraints(given.fix, given.bound, given.tie)
    random_force = parse_random_force(given.random_force)
    if random_force == "auto":
        raise UsageError("--random-force 'auto' is not for laws: give off, estimated, or a density.")
    if given.warm_up is not None and not (given.warm_up >= 0.0 and given.test):
        raise UsageError("--warm-up is 0 s or more of the record of --test: give both.")
    measured = measured_given(given)
    calibration = calibration_of(given)
    system = load_system(given.system)
    library = load_library(given.library) if given.changed(["library"]) else None
    tell("reading")
    decays, sources = read_decays(given, driven=True)
    if "mass" in measured:
        check_length_unit(unit_of_signal(decays[0]))
    if "inertia" in measured:
        check_angle_unit(unit_of_signal(decays[0]))
    tree = identified(
        decays,
        system,
        constraints.table,
        library=library,
        random_force=random_force,
        own=own_names(given.own),
        passive=given.passive,
        tell=tell,
    )
    predicted = _predicted(tree, given, tell)
    if calibration[1]:
        tree = with_scale_error(tree, calibration[1] / calibration[0])
    if measured:
        tree[LAWS_SI] = xr.DataTree(laws_in_si(tree, **measured))
    if not is_driven(decays):
        keep_next(tree, given)
    says = partial(_blocks, tree, sources, predicted), partial(_data, tree, predicted)
    texts: dict[Path | None, Callable[[], str]] = {
        given.csv: partial(printed.laws_csv, tree),
        given.latex: partial(printed.laws_latex, tree),
    }
    return deliver(given, tell, says, tree, texts)


def _predicted(tree: xr.DataTree, given: LawsOptions, tell: Tell) -> list[xr.Dataset]:
    """Predict the records of --test with the preferred laws."""
    if given.test is None:
        return []
    tell("prediction")
    of_test = given.but(records=[given.test])
    others, _ = read_decays(of_test, as_it_is=True, driven=True, warm_up=given.warm_up)
    return [predict(best(tree), other, warm_up=given.warm_up) for other in others]


def _blocks(tree: xr.DataTree, sources: list[str], predicted: list[xr.Dataset]) -> list[Block]:
    sentences = record_sentences(tree, sources)
    return [
        *printed.laws_blocks(tree, sentences),
        *si_blocks(tree),
        printed.prediction_block(tree, predicted),
    ]


def _data(tree: xr.DataTree, predicted: list[xr.Dataset]) -> dict[str, Any]:
    return printed.laws_json(tree) | si_json(tree) | driven.prediction_json(predicted)
