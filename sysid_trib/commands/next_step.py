"""The next step after a result: a command, and the reason for it."""

import shlex
from collections.abc import Mapping
from typing import NamedTuple

import xarray as xr

from sysid_trib.commands.app import command_after
from sysid_trib.commands.options import FileOptions, IdentifyOptions, MeasuredOptions, RecordOptions
from sysid_trib.cycles.look import PENDULUM, pointers
from sysid_trib.cycles.suggested import suggested
from sysid_trib.errors import readable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import EFFECTS, is_free_to_move
from sysid_trib.forces.systems import load_system, load_systems
from sysid_trib.printing.comparison import ratio_of_best
from sysid_trib.results import effects, judged, kinds
from sysid_trib.results.kinds import identifications_of, kind_of
from sysid_trib.results.models import library_of, shape_values_of
from sysid_trib.results.variables import record_groups

# Placeholder for a file that the user has to measure first; the brackets show that it does not exist.
SECOND_RECORD = "<SECOND_RECORD.csv>"
# Number of effects beyond `--max-effects` if further candidates are significant.
MORE_EFFECTS = 2


class NextStep(NamedTuple):
    """A command to run after a result.

    Attributes
    ----------
    command : str
    reason : str
        Purpose of the command, in a few words.
    options : mapping of str to str or None
        Options that replace those of the previous command: a switch has an empty value, and None means that
        the option is omitted; `records` is also possible.
    """

    command: str
    reason: str
    options: Mapping[str, str | None]


# Commands that follow from each state of a result, and their purpose. An empty command ends the chain. Each
# chain ends after at most four commands and repeats none of them.
NEXT_COMMANDS: dict[str, tuple[str, str]] = {
    # After identify.
    "explained": ("compare", "every method, and its prediction of a held-out part"),
    "explained, no coefficient is known by itself": ("identify", "the fewest forces that suffice"),
    "approximate": ("laws", "friction and restoring force as curves, without choosing a form"),
    "not explained": ("laws", "friction and restoring force as curves, without choosing a form"),
    "not explained, swings as a pendulum": (
        "identify",
        "amplitude and frequency are those of a pendulum under gravity",
    ),
    # With effects that are in no usual library, because an earlier search named them.
    "approximate with named effects": (
        "laws",
        "friction and restoring force as curves, without choosing a form",
    ),
    # After identify or discover.
    "undetermined": ("identify", "fewer forces, with the whole record"),
    "undetermined by the viscous force alone": ("", ""),
    # After laws.
    "laws explain": ("", ""),
    "laws without a curve explain": ("identify", "coefficients of the named forces"),
    "laws do not explain": ("", ""),
    # After compare.
    "compared, explained": ("", ""),
    "compared, not explained": ("discover", "finds and names the missing force"),
    # After discover.
    "out of time": ("discover", "the same search without a time limit"),
    "named": ("identify", "two methods, cross-checked"),
    "nothing missing": ("plan", "the next run that reduces the errors most"),
    "nothing missing of a driven record": ("identify", "two methods, cross-checked"),
    "unknown effect": ("laws", "friction and restoring force as curves, without choosing a form"),
    "unknown effect of a driven record": ("", ""),
}


def next_step(tree: xr.DataTree) -> NextStep | None:
    """Return the command that follows from a result; None at the end of a chain."""
    after = {"discover": _after_discovery, "compare": _after_comparison, "laws": _after_laws}
    state, options = after.get(kind_of(tree), _after_identification)(tree)
    command, reason = NEXT_COMMANDS[state]
    return NextStep(command, reason, options) if command else None


class StateOfResult(NamedTuple):
    """A state of `NEXT_COMMANDS`, and options of the next command."""

    name: str
    options: Mapping[str, str | None]


def _after_identification(tree: xr.DataTree) -> StateOfResult:
    verdict = judged.verdict_of(tree)
    if verdict == "undetermined":
        return _undetermined(judged.last_of(tree))
    if not judged.is_explained(tree):
        library = _largest_library(tree)
        # A driven record has no backbone.
        named = _effects_named(library) and not kinds.is_of_driven(tree)
        state = "approximate with named effects" if named else verdict
        return StateOfResult(state, {} if named else _search_options(library))
    if fewer := judged.fewer_forces(tree):
        return StateOfResult("explained, no coefficient is known by itself", {"forces": ",".join(fewer[0])})
    return StateOfResult("explained", {})


def _undetermined(result: xr.Dataset) -> StateOfResult:
    """Return the step after a record that does not determine the forces: fewer forces."""
    viscous = [*library_of(result, whole=True).damping_factors][:1]
    if viscous and result.force.values.tolist() != viscous:
        return StateOfResult("undetermined", {"forces": viscous[0], "window": None})
    return StateOfResult("undetermined by the viscous force alone", {})


def _after_laws(tree: xr.DataTree) -> StateOfResult:
    if judged.verdict_of(tree) != "explained":
        return StateOfResult("laws do not explain", {})
    without = tree["judged"].attrs["reason"]
    return StateOfResult("laws without a curve explain" if without else "laws explain", {})


def _after_comparison(tree: xr.DataTree) -> StateOfResult:
    if ratio_of_best(judged.comparison_of(tree)) <= judged.LARGE:
        return StateOfResult("compared, explained", {})
    return StateOfResult("compared, not explained", _search_options(_largest_library(tree)))


def _largest_library(tree: xr.DataTree) -> ForceLibrary:
    """Return the largest set of forces in a result: methods for two forces have only those."""
    return library_of(max(identifications_of(tree).values(), key=lambda result: result.sizes["force"]))


def _search_options(library: ForceLibrary) -> dict[str, str]:
    """Return the given forces, as options, if others are missing; sensor terms are only candidates."""
    forces = [force.symbol for force in library if force.kind != "sensor"]
    return {"forces": ",".join(forces)} if len(forces) < len(library) else {}


def _effects_named(library: ForceLibrary) -> bool:
    """Return true if a model has effects that only an earlier search or the user can have named."""
    of_systems = (symbol for system in load_systems().values() for symbol in system.symbols)
    usual = {*load_library().symbols, *of_systems}
    return bool(set(library.symbols) & set(load_library(EFFECTS).symbols) - usual)


def _after_discovery(tree: xr.DataTree) -> StateOfResult:
    if tree.attrs.get("out_of_time"):
        return StateOfResult("out of time", {"time_limit": None})
    after, driven = tree["after"].to_dataset(), kinds.is_of_driven(tree)
    unexplained = judged.has_unknown_effect(tree)
    if unexplained and not driven:
        return StateOfResult("unknown effect", {})
    if not effects.determines(after):
        return _undetermined(after)
    forces = ",".join(after.force.values.tolist())
    shapes = ",".join(f"{name}={value:.6g}" for name, value in shape_values_of(after).items())
    options = {"forces": forces} | ({"set": shapes} if shapes else {})
    if tree["steps"].attrs["count"]:
        return StateOfResult("named", options)
    if unexplained:
        return StateOfResult("unknown effect of a driven record", {})
    return StateOfResult("nothing missing of a driven record" if driven else "nothing missing", options)


def alternatives(tree: xr.DataTree, given: RecordOptions) -> list[str]:
    """Return further, optional commands, each with its condition."""
    made = list[tuple[str, str, Mapping[str, str | None]]]()
    if kind_of(tree) == "discover":
        if tied := _tied(tree):
            when = f"With the record that separates {' and '.join(tied[:2])} (see above)"
            made.append((when, "discover", {"records": SECOND_RECORD}))
        outstanding = bool(tree["ranking"].significant.isel(selection_step=-1).any())
        most = tree.attrs["max_effects"]
        if outstanding and tree["steps"].attrs["count"] >= most > 0:
            made.append(("For further effects", "discover", {"max_effects": str(most + MORE_EFFECTS)}))
        if judged.held_out_excess(tree) and not tree["holdout_given"]:
            made.append(("To fit the same forces to the whole record", "discover", {"refit": ""}))
    elif kind_of(tree) == "laws":
        # A search that finds no name leads to the laws: they do not lead back to it.
        # A simulated record has no rig to make another one.
        tested = isinstance(given, MeasuredOptions) and given.test is not None
        if not tested and tree[record_groups(tree)[0]].attrs.get("record_checksum"):
            when = "To see whether another record of the rig follows these laws"
            made.append((when, "laws", {"test": SECOND_RECORD}))
    elif scale := _scale_error(tree, given):
        when = "If the scale of the film or encoder is wrong, as the frequency at large amplitudes suggests"
        made.append((when, "identify", {"scale": scale}))
    return [f"{when}: {command_after(command, options, given)}" for when, command, options in made]


def _scale_error(tree: xr.DataTree, given: RecordOptions) -> str:
    """Return the scale factor that would correct a pendulum's frequency; empty if none is needed."""
    unexplained = kind_of(tree) == "cross_check" and not judged.is_explained(tree)
    groups = record_groups(tree)
    if given.system != PENDULUM or given.changed(["scale"]) or len(groups) > 1 or not unexplained:
        return ""
    pointed = pointers(tree[groups[0]].to_dataset())
    return pointed["points_to_scale"] if pointed["points_to_system"] == PENDULUM else ""


def _tied(tree: xr.DataTree) -> list[str]:
    """Return an effect and its competing effects; nothing if every name is certain.

    Also nothing for a record that is not a file, because no other record could be given with it.
    """
    if not all(tree[group].attrs.get("record_checksum") for group in record_groups(tree)):
        return []
    offered = effects.candidates_of(tree).symbols
    sets = (list(effects.credible_set(step)) for step in effects.steps_taken(tree))
    tied: list[str] = next((credible for credible in sets if len(credible) > 1), [])
    return [symbol for symbol in tied if symbol in offered]


def _swings_unexplained(tree: xr.DataTree) -> bool:
    """Return true if a model does not explain records of pendulums."""
    if kind_of(tree) == "discover":
        unexplained = judged.has_unknown_effect(tree)
    else:
        unexplained = kind_of(tree) == "cross_check" and not judged.is_explained(tree)
    records = (tree[group].to_dataset() for group in record_groups(tree))
    return unexplained and all(pointers(record)["points_to_system"] == PENDULUM for record in records)


# Path for a result to be saved.
KEPT = "result.nc"


def _after_driven(tree: xr.DataTree, given: RecordOptions) -> NextStep | str | None:
    """Return the step after a driven identification, or the whole command; None: use the general rule.

    If the model explains the record, the result is saved first and then shown. No search is suggested for a
    body without a restoring force.
    """
    if not (_moves_freely(tree) or judged.is_explained(tree)):
        return None
    if isinstance(given, FileOptions) and given.output is not None:
        page = given.output.with_suffix(".html")
        words = ["sysid-trib", "report", str(given.output), "-o", str(page)]
        return f"{readable(shlex.join(words))} # figures and tables on one page"
    taken = dict[str, str | None]()
    if isinstance(given, MeasuredOptions) and given.test:
        taken["test"] = str(given.test)
    if isinstance(given, MeasuredOptions) and given.warm_up:
        taken["warm_up"] = f"{given.warm_up:g}"
    if isinstance(given, IdentifyOptions) and given.changed(["starts"]):
        taken["starts"] = given.starts
    return NextStep("identify", "keeps the result, for report and response", {**taken, "output": KEPT})


def _moves_freely(tree: xr.DataTree) -> bool:
    """Return true if the body of a driven record lacks the restoring force that a search needs."""
    result = judged.main_result(tree)
    if result is None or not kinds.is_of_driven(tree):
        return False
    held = {
        symbol: result.coefficient.sel(force=symbol).item()
        for symbol in result.force.values.tolist()
        if result.standard_error.sel(force=symbol).item() == 0.0
    }
    return is_free_to_move(library_of(result), held)


def keep_next(tree: xr.DataTree, given: RecordOptions) -> None:
    """Store the next command in the attribute `next` of a result, and other commands in `alternatives`.

    Parameters
    ----------
    tree : DataTree
        Result of a command.
    given : RecordOptions
        Options of the command; the next command takes over those that it also has.
    """
    step = next_step(tree)
    if kind_of(tree) == "driven" and (after := _after_driven(tree, given)) is not None:
        if isinstance(after, str):
            tree.attrs["next"] = after
            return
        step = after
    elif step and step.command == "discover" and _moves_freely(tree):
        step = NextStep("identify", "keeps the result, for report and response", {"output": KEPT})
    if step and step.command in ("discover", "laws") and given.system is None and _swings_unexplained(tree):
        step = NextStep(*NEXT_COMMANDS["not explained, swings as a pendulum"], {"system": PENDULUM})
    if step:
        tree.attrs["next"] = f"{command_after(step.command, step.options, given)} # {step.reason}"
    if others := alternatives(tree, given):
        tree.attrs["alternatives"] = "\n".join(others)


def pointed_options(tree: xr.DataTree, system: str | None) -> dict[str, str]:
    """Return options of `identify` that follow from the backbones and that all decays can determine.

    Parameters
    ----------
    tree : DataTree
        Result of `look`.
    system : str or None
        Name of the system, if the user has given it.
    """
    of_record, forces = suggested(tree, system)
    stated = {"system": of_record} if of_record and system is None else {}
    if forces == load_system(system or of_record or None).usual:
        return stated
    return {"forces": ",".join(forces)} | stated


# A model does not follow the motion if its residual exceeds this fraction of it.
FOLLOWING_PART = 0.3


def fitting_options(models: xr.Dataset, system: str | None) -> dict[str, str | None]:
    """Return the options of `identify` for the model that fits driven records best; none for a given system.

    Parameters
    ----------
    models : Dataset
        Result of `fitting_models`.
    system : str or None
        Moving body, if the user has given it.
    """
    best = models.isel(model=0)
    if system is not None or not best.residual_over_motion.item() < FOLLOWING_PART:
        return {}
    name = best.system.item()
    return {"system": name} if name else {"forces": best.forces.item()}
