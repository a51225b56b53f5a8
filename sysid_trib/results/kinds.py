"""Kinds of results: the function that made a result, and the identifications in it."""

import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.records.roles import input_names
from sysid_trib.results.variables import record_groups

# Preferred model in SI units, with the measured values used, and its coefficient of friction.
SI, GIVEN = "si_units", ("inertia", "mass", "load", "radius")
MU = "friction_coefficient"
CONSEQUENCES = "consequences"
# Mass, stiffness and forces of a driven record in units of its input; the first two of these.
PER_INPUT = "per_input"
MASS = "mass"
STIFFNESS = "stiffness"
# Attribute of a prediction: the sensor terms that were fitted to its record.
REFITTED_SENSORS = "refitted_sensors"
# Samples of a difference.
SIDES = ("first", "second")


def si_of(tree: xr.DataTree) -> xr.Dataset | None:
    """Return the preferred model of a result in SI units, if the result contains it."""
    return tree[SI].to_dataset() if SI in tree.children else None


def check_is_model(tree: xr.DataTree, source: str = "This") -> None:
    """Raise an error for a comparison of samples where a model is needed.

    Parameters
    ----------
    tree : DataTree
        Any result.
    source : str
        Description of the object, which begins the sentence: its file, for example.

    Raises
    ------
    UsageError
        It compares samples.
    """
    if kind_of(tree) == "difference":
        raise UsageError(f"{source} is a comparison of samples, not a model; give a result of identify.")


def kind_of(tree: xr.DataTree) -> str:
    """Return the kind of a result: identify, cross_check, laws, driven, compare, difference or discover.

    Return an empty text if it is of none of these kinds.
    """
    if "stiffness_difference" in tree.ds:
        return "difference"
    if "coefficient" in tree.ds and "method" in tree.attrs:
        return "identify"
    if {"record", "record_1"}.isdisjoint(tree.children):
        return ""
    if {"steps", "ranking"} <= set(tree.children):
        return "discover"
    made_by = tree["judged"].attrs.get("made_by", "") if "judged" in tree.children else ""
    return "cross_check" if made_by == "identify" else str(made_by)


def contents_text(result: object) -> str:
    """Describe in a few words an object that is not a result of the wanted kind."""
    if not isinstance(result, xr.DataTree | xr.Dataset):
        return f"an object of type {type(result).__name__}"
    names = [*map(str, getattr(result, "children", ())), *sorted(map(str, result.data_vars))]
    return f"data with {', '.join(names[:6]) or 'nothing in it'}"


def is_of_driven(tree: xr.DataTree) -> bool:
    """Return true if the records of a result are driven; a single identification contains none."""
    kept = (tree[group].to_dataset() for group in record_groups(tree) if group in tree.children)
    return any(map(has_input, kept))


def has_input(record: xr.Dataset) -> bool:
    """Return true if an input that drives the motion was recorded with it."""
    return bool(input_names(record))


def identifications_of(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """Return the identifications of a result by name."""
    if kind_of(tree) == "identify":
        return {tree.attrs["method"]: tree.to_dataset()}
    return {name: node.to_dataset() for name, node in tree.children.items() if "covariance" in node.ds}
