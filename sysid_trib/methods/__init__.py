"""Identification methods: small frozen objects with one job, `identify(decay, library) -> Dataset`.

What a method assumes, observes and identifies is its attribute `scope`.
"""

import json
from importlib.metadata import EntryPoint
from typing import Any

import xarray as xr

from sysid_trib import plugins
from sysid_trib.errors import UsageError, did_you_mean
from sysid_trib.methods.classical import feeny_liang_decrement as feeny_liang_decrement
from sysid_trib.methods.scope import MethodScope as MethodScope
from sysid_trib.results.schema import NOT_KEPT

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
    return sorted([*__all__, *plugins.installed(plugins.METHODS)])


def __getattr__(name: str) -> Any:
    entry = plugins.installed(plugins.METHODS).get(name)
    if entry is None:
        nearest = did_you_mean(name, __dir__())
        raise AttributeError(f"There is no method {name}; there are {', '.join(__dir__())}.{nearest}")
    return _of_package(entry)


def every_kind() -> tuple[type[Any], ...]:
    """Return the methods of this package, and those that other packages declare (`sysid_trib.methods`)."""
    return (*METHODS, *(_of_package(entry) for entry in plugins.installed(plugins.METHODS).values()))


def _of_package(entry: EntryPoint) -> type[Any]:
    """Return the method that another package declares.

    Raises
    ------
    UsageError
        It is no class with a method `identify`, or cannot be loaded.
    """
    kind = plugins.loaded(entry)
    if isinstance(kind, type) and hasattr(kind, "identify"):
        return kind
    raise UsageError(
        f"The entry point '{entry.name}' of {plugins.METHODS} is no method: it must be a class with "
        "identify(decay, library)."
    )


def method_of(result: xr.Dataset) -> Any:
    """The method of an identification, with the options it was made with.

    Parameters
    ----------
    result : Dataset
        An identification.

    Raises
    ------
    UsageError
        The method is none of this package, nor of another that is installed.
    """
    kinds = {kind.__name__.lower(): kind for kind in every_kind()}
    name = result.attrs["method"]
    if name not in kinds:
        raise UsageError(f"'{name}' is no method that is installed; run it yourself on the record.")
    options = json.loads(result.attrs["options"])
    # An optimiser or a start model is not kept in a result: the method goes without it.
    kept = {k: v for k, v in options.items() if not (isinstance(v, dict) and NOT_KEPT in v)}
    # JSON knows lists but no tuples.
    return kinds[name](**{k: tuple(v) if isinstance(v, list) else v for k, v in kept.items()})
