"""Identification methods: small frozen objects with one job, `identify(decay, library) -> Dataset`.

The attribute `scope` of a method states its assumptions, observed quantities and identified forces.
"""

import json
from importlib.metadata import EntryPoint
from typing import Any

import xarray as xr

from sysid_trib import plugins
from sysid_trib.errors import UsageError, did_you_mean
from sysid_trib.methods.classical import feeny_liang_decrement as feeny_liang_decrement
from sysid_trib.methods.scope import MethodScope as MethodScope
from sysid_trib.results.models import NOT_KEPT

# The methods, in the order of tables and figures.
# isort: off
from sysid_trib.methods.trajectory import Trajectory as Trajectory
from sysid_trib.methods.direct import Direct as Direct
from sysid_trib.methods.averaging import Averaging as Averaging
from sysid_trib.methods.averaging import FrequencyShift as FrequencyShift
from sysid_trib.methods.classical import WuDecrement as WuDecrement
from sysid_trib.methods.classical import FeenyLiang as FeenyLiang
from sysid_trib.methods.classical import EnergyDecay as EnergyDecay
from sysid_trib.methods.classical import LogarithmicDecrement as LogarithmicDecrement
from sysid_trib.methods.classical import LinearDecrement as LinearDecrement
from sysid_trib.methods.classical import QuadraticDecay as QuadraticDecay
# isort: on

METHODS: tuple[type[Any], ...] = tuple(kind for kind in list(globals().values()) if hasattr(kind, "scope"))
__all__ = [*(kind.__name__ for kind in METHODS), "MethodScope", "feeny_liang_decrement"]


def __dir__() -> list[str]:
    return sorted([*__all__, *plugins.installed(plugins.METHOD_PLUGINS)])


def __getattr__(name: str) -> Any:
    entry = plugins.installed(plugins.METHOD_PLUGINS).get(name)
    if entry is None:
        nearest = did_you_mean(name, __dir__())
        raise AttributeError(f"There is no method {name}; there are {', '.join(__dir__())}.{nearest}")
    return _of_package(entry)


def every_kind() -> tuple[type[Any], ...]:
    """Return the methods of this package, and those that other packages declare (`sysid_trib.methods`)."""
    return (*METHODS, *(_of_package(entry) for entry in plugins.installed(plugins.METHOD_PLUGINS).values()))


def as_method(given: Any, function: str) -> Any:
    """Return a method that is given as an object or by its name: `direct`, or `Direct`.

    Parameters
    ----------
    given : Method or str
    function : str
        Name of the calling function, for the message.

    Raises
    ------
    UsageError
        There is no such method, or a class was given in place of an object.
    """
    if isinstance(given, str):
        kinds = {name: kind for kind in every_kind() for name in (kind.__name__.lower(), _label_of(kind))}
        if given.lower() not in kinds:
            known = ", ".join(kind.__name__ for kind in every_kind())
            nearest = did_you_mean(given, kinds)
            raise UsageError(f"{function}: there is no method '{given}'; there are {known}.{nearest}")
        return kinds[given.lower()]()
    if isinstance(given, type) and hasattr(given, "identify"):
        raise UsageError(f"{function} needs a method such as methods.{given.__name__}(), not its class.")
    if not hasattr(given, "identify"):
        raise UsageError(f"{function} needs a method such as methods.Direct(), not {given!r}.")
    return given


def _label_of(kind: type[Any]) -> str:
    """Return the name of a method in tables, in small letters."""
    scope = kind().scope if hasattr(kind, "scope") else None
    return scope.label.lower() if isinstance(scope, MethodScope) else kind.__name__.lower()


def _of_package(entry: EntryPoint) -> type[Any]:
    """Return the method that another package declares.

    Raises
    ------
    UsageError
        It is not a class with a method `identify`, or it cannot be loaded.
    """
    kind = plugins.loaded(entry)
    if isinstance(kind, type) and hasattr(kind, "identify"):
        return kind
    raise UsageError(
        f"The entry point '{entry.name}' of {plugins.METHOD_PLUGINS} is not a method: it must be a class "
        "with identify(decay, library)."
    )


def method_of(result: xr.Dataset) -> Any:
    """Return the method of an identification, with its options.

    Parameters
    ----------
    result : Dataset
        An identification.

    Raises
    ------
    UsageError
        The method belongs neither to this package nor to an installed plug-in.
    """
    kinds = {kind.__name__.lower(): kind for kind in every_kind()}
    name = result.attrs["method"]
    if name not in kinds:
        raise UsageError(f"'{name}' is not an installed method; run it yourself on the record.")
    options = json.loads(result.attrs["options"])
    # A result does not store an optimiser or a start model: the method is returned without it.
    kept = {k: v for k, v in options.items() if not (isinstance(v, dict) and NOT_KEPT in v)}
    # JSON has lists but no tuples.
    return kinds[name](**{k: tuple(v) if isinstance(v, list) else v for k, v in kept.items()})
