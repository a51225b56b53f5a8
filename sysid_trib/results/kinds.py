"""Which function made a result, and the identifications in it."""

import xarray as xr


def kind_of(tree: xr.DataTree) -> str:
    """What made a result: identify, cross_check, driven, compare or discover; empty if none did."""
    if "coefficient" in tree.ds and "method" in tree.attrs:
        return "identify"
    if {"record", "record_1"}.isdisjoint(tree.children):
        return ""
    if {"steps", "ranking"} <= set(tree.children):
        return "discover"
    if "comparison" not in tree.children:
        return ""
    checked = tree["comparison"]
    if "driven" in checked.attrs:
        return "driven"
    return "compare" if "best" in checked.attrs else "cross_check" if "first" in checked.attrs else ""


def identifications_of(tree: xr.DataTree) -> dict[str, xr.Dataset]:
    """The identifications of a result by name."""
    if kind_of(tree) == "identify":
        return {tree.attrs["method"]: tree.to_dataset()}
    return {name: node.to_dataset() for name, node in tree.children.items() if "covariance" in node.ds}
