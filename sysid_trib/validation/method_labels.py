"""Labels of methods that are told apart by them, in words."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from sysid_trib.errors import UsageError
from sysid_trib.validation.cross_check import Method

RESERVED = ("", ".", "..", "record", "envelope", "comparison")
Methods = Sequence[Method] | Mapping[str, Method]


def labelled(methods: Methods) -> dict[str, Method]:
    """Methods by a unique label that may be the name of a group in a netCDF file.

    Raises
    ------
    UsageError
        None is given, or something that is no method.
    """
    pairs = list(methods.items()) if isinstance(methods, Mapping) else [("", each) for each in methods]
    if not pairs:
        raise UsageError("compare wants at least one method, such as methods.Direct().")
    for _, method in pairs:
        if isinstance(method, type) or not hasattr(method, "identify"):
            raise UsageError(f"compare wants methods such as methods.Direct(), not {method!r}.")
    found: dict[str, Method] = {}
    for name, method in pairs:
        same = [other for _, other in pairs if type(other) is type(method)]
        label = " ".join(str(name).replace("/", "-").split()) or _label(method, same)
        label = f"{label} (method)".strip() if label in RESERVED else label
        number, unique = 1, label
        while unique in found:
            number += 1
            unique = f"{label} {number}"
        found[unique] = method
    return found


def _label(method: Method, same: Sequence[Method]) -> str:
    """Class in words, and the options in which a method differs from others of it and from the default."""
    words = re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z0-9]+", type(method).__name__)
    name = " ".join(word if word.isupper() and len(word) > 1 else word.lower() for word in words)
    told = []
    for option in fields(method) if hasattr(method, "__dataclass_fields__") else ():  # type: ignore[arg-type]
        value = getattr(method, option.name)
        if all(repr(getattr(other, option.name)) == repr(value) for other in same):
            continue
        default = option.default_factory() if callable(option.default_factory) else option.default
        if repr(value) != repr(default):
            told.append(_option(option.name.replace("_", " "), value))
    return f"{name} ({', '.join(told)})".replace("/", "-") if told else name


def _option(name: str, value: Any) -> str:
    if isinstance(value, bool):
        return name if value else f"not {name}"
    return f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
