"""Labels of methods: unique names by their options."""

from collections.abc import Sequence
from dataclasses import Field, fields, is_dataclass
from typing import Any

from sysid_trib.methods.scope import Method, scope_of


def by_unique_label(pairs: Sequence[tuple[str, Method]], reserved: Sequence[str]) -> dict[str, Method]:
    """Return methods by a unique label that is also valid as the name of a netCDF group.

    Parameters
    ----------
    pairs : sequence of (str, Method)
        Each method with its name; for an empty name, the label is made from its scope and its options.
    reserved : sequence of str
        Names of other groups.
    """
    by_label: dict[str, Method] = {}
    for name, method in pairs:
        same = [other for _, other in pairs if type(other) is type(method)]
        label = " ".join(str(name).replace("/", "-").split()) or _label(method, same)
        label = f"{label} (method)".strip() if label in reserved else label
        number, unique = 1, label
        while unique in by_label:
            number += 1
            unique = f"{label} {number}"
        by_label[unique] = method
    return by_label


def _label(method: Method, same: Sequence[Method]) -> str:
    """Return a method's label, with the options in which it differs from similar methods and the default."""
    options = []
    all_options: tuple[Field[Any], ...] = fields(method) if is_dataclass(method) else ()
    for option in all_options:
        value = getattr(method, option.name)
        default = option.default_factory() if callable(option.default_factory) else option.default
        alike = all(repr(getattr(other, option.name)) == repr(value) for other in same)
        if not alike and repr(value) != repr(default):
            options.append(_option(option.name.replace("_", " "), value))
    label = scope_of(method).label
    return f"{label} ({', '.join(options)})".replace("/", "-") if options else label


def _option(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return name if value else f"not {name}"
    return f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
