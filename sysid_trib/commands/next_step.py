"""What to do after a result: the next command, and why."""

from collections.abc import Mapping

import xarray as xr

from sysid_trib.commands.app import Asked, command_after
from sysid_trib.cycles.look import PENDULUM, pointers
from sysid_trib.printing.comparison import ratio_of_best
from sysid_trib.results import effects, files
from sysid_trib.results.files import identifications_of, kind_of
from sysid_trib.results.schema import library_of, shape_values_of
from sysid_trib.results.variables import record_groups
from sysid_trib.validation import findings

# A file that the user is to measure first.
SECOND_RECORD = "SECOND_RECORD.csv"
# More effects than were asked for, where candidates still stand out.
MORE_EFFECTS = 2


# A command, what it is for in a few words, and options that replace those of the command that has run: a
# switch has an empty value, what is left out has None; `records` is one more.
NextStep = tuple[str, str, Mapping[str, str | None]]


def next_step(tree: xr.DataTree) -> NextStep:
    """The command that follows from a result of `cross_check`, `laws`, `compare` or `discover`."""
    after = {"discover": _after_discovery, "compare": _after_comparison, "laws": _after_laws}
    return after.get(kind_of(tree), _after_identification)(tree)


def _after_identification(tree: xr.DataTree) -> NextStep:
    if findings.verdict_of(tree) == "undetermined":
        return _after_nothing(findings.second_of(tree))
    if not findings.verdict_of(tree).startswith("explained"):
        return _search(tree, "names what is missing")
    if fewer := findings.fewer_forces(tree):
        return "identify", "the fewest forces that suffice", {"forces": ",".join(fewer[0])}
    return "compare", "every method, and how it predicts a part that is held out", {}


# After laws that a second record has tested, or where there can be none.
BY_NAME: NextStep = (
    "compare",
    "named forces by every method, and how they predict a part that is held out",
    {},
)


def _after_laws(tree: xr.DataTree) -> NextStep:
    if findings.verdict_of(tree) == "explained":
        if tree["comparison"].attrs["reason"]:
            return "identify", "coefficients of named forces: the record decides no curve", {}
        if not tree[record_groups(tree)[0]].attrs.get("record_checksum"):
            return BY_NAME
        return "laws", f"whether {SECOND_RECORD} follows these laws", {"test": SECOND_RECORD}
    return "discover", "tests for what is not a function of speed or displacement alone", {}


def _after_nothing(result: xr.Dataset) -> NextStep:
    """After a record that decides none of its forces: with fewer of them."""
    viscous = [*library_of(result, whole=True).damping_factors][:1]
    if viscous and result.force.values.tolist() != viscous:
        options = {"forces": viscous[0], "window": None}
        return "identify", "fewer forces, and all of the record", options
    reason = f"{SECOND_RECORD}: a longer motion, from a larger amplitude"
    return "identify", reason, {"records": SECOND_RECORD, "window": None}


def _after_comparison(tree: xr.DataTree) -> NextStep:
    table = tree["comparison"].to_dataset()
    reason = "tests further effects" if ratio_of_best(table) <= findings.LARGE else "names what is missing"
    return _search(tree, reason)


def _search(tree: xr.DataTree, reason: str) -> NextStep:
    """What is missing beside the forces that were given; terms of the sensor are candidates alone."""
    # Methods for two forces hold no others.
    library = library_of(max(identifications_of(tree).values(), key=lambda result: result.sizes["force"]))
    forces = [force.symbol for force in library if force.kind != "sensor"]
    return "discover", reason, {"forces": ",".join(forces)} if len(forces) < len(library) else {}


def _after_discovery(tree: xr.DataTree) -> NextStep:
    if tree.attrs.get("out_of_time"):
        return "discover", "the same to its end", {"time_limit": None}
    if tied := _tied(tree):
        reason = f"{SECOND_RECORD}: the measurement that separates {' and '.join(tied[:2])}, see above"
        return "discover", reason, {"records": SECOND_RECORD}
    after = tree["after"].to_dataset()
    if tree.attrs["verdict"] == "unknown effect":
        outstanding = bool(tree["ranking"].significant.isel(selection_step=-1).any())
        most = tree.attrs["max_effects"]
        if outstanding and tree["steps"].attrs["count"] >= most:
            return "discover", "adds further effects", {"max_effects": str(most + MORE_EFFECTS)}
        return "discover", "story shows the force that no candidate names", {"plot": "figures"}
    if not effects.determines(after):
        return _after_nothing(after)
    if findings.held_out_excess(tree) and tree.attrs["held_out"].startswith(findings.LAST_THIRD):
        return "discover", "fits the same forces to the whole record", {"refit": ""}
    forces = ",".join(after.force.values.tolist())
    shapes = ",".join(f"{name}={value:.6g}" for name, value in shape_values_of(after).items())
    options = {"forces": forces} | ({"set": shapes} if shapes else {})
    if not tree["steps"].attrs["count"] and not files.is_of_driven(tree):
        return "plan", "which further run makes the errors smaller", options
    return "identify", "two methods, held against each other", options


def _tied(tree: xr.DataTree) -> list[str]:
    """An effect and those that it cannot be separated from; nothing where every name is certain.

    Nothing for a record that is no file, beside which another could be given.
    """
    if not all(tree[group].attrs.get("record_checksum") for group in record_groups(tree)):
        return []
    offered = effects.candidates_of(tree).symbols
    sets = (list(effects.credible_set(step)) for step in effects.steps_taken(tree))
    tied: list[str] = next((credible for credible in sets if len(credible) > 1), [])
    return [symbol for symbol in tied if symbol in offered]


def _swings_unexplained(tree: xr.DataTree) -> bool:
    """True if a model does not explain records whose backbones are those of a pendulum."""
    if kind_of(tree) == "discover":
        unexplained = tree.attrs["verdict"] == "unknown effect"
    else:
        unexplained = kind_of(tree) == "cross_check" and not findings.verdict_of(tree).startswith("explained")
    records = (tree[group].to_dataset() for group in record_groups(tree))
    return unexplained and all(pointers(record)["points_to_system"] == PENDULUM for record in records)


def keep_next(tree: xr.DataTree, given: Asked) -> None:
    """Keep the command that follows from a result as its attribute `next`.

    Parameters
    ----------
    tree : DataTree
        Result of a command.
    given : Asked
        What the command was given; the next command takes over the options that it knows.
    """
    command, reason, options = next_step(tree)
    if command == "discover" and given.system is None and _swings_unexplained(tree):
        options = {"system": PENDULUM}
        reason = "amplitude and frequency are those of a pendulum under gravity"
    if command == "laws" and given.test is not None:
        command, reason, options = BY_NAME
    tree.attrs["next"] = f"{command_after(command, options, given)} # {reason}"
