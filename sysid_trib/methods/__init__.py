"""Identification methods: small frozen objects with one job, `identify(decay, library) -> Dataset`.

`METHODS` has those of `__all__` in its order. What a method assumes, observes and identifies is its
attribute `scope`.
"""

import json
from typing import Any

import xarray as xr

from sysid_trib.errors import UsageError
from sysid_trib.forces.constraints import Constraints
from sysid_trib.methods.averaging import Averaging
from sysid_trib.methods.classical import FrequencyShift
from sysid_trib.methods.decrements import (
    EnergyDecay,
    FeenyLiang,
    LinearDecrement,
    LogarithmicDecrement,
    QuadraticDecay,
    WuDecrement,
    feeny_liang_decrement,
)
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.scope import MethodScope
from sysid_trib.methods.trajectory import Trajectory
from sysid_trib.methods.windowed_era import WindowedERA, windowed_modes
from sysid_trib.results.schema import NOT_KEPT

# In the order of tables and figures.
__all__ = [  # noqa: RUF022
    "Trajectory",
    "Direct",
    "Averaging",
    "FrequencyShift",
    "WuDecrement",
    "FeenyLiang",
    "EnergyDecay",
    "LogarithmicDecrement",
    "LinearDecrement",
    "QuadraticDecay",
    "WindowedERA",
    "MethodScope",
    "feeny_liang_decrement",
    "windowed_modes",
]
_PUBLIC = [globals()[name] for name in __all__]
METHODS: tuple[type[Any], ...] = tuple(kind for kind in _PUBLIC if hasattr(kind, "scope"))


def method_of(result: xr.Dataset) -> Any:
    """The method of an identification, with the options it was made with.

    Parameters
    ----------
    result : Dataset
        An identification.

    Raises
    ------
    UsageError
        The method is none of `METHODS`.
    """
    kinds = {kind.__name__.lower(): kind for kind in METHODS}
    name = result.attrs["method"]
    if name not in kinds:
        raise UsageError(f"'{name}' is no method of this package; run it yourself on the record.")
    options = json.loads(result.attrs["options"])
    # As results before 0.2 have them.
    old = [options.pop(name, None) for name in ("fix", "bounds", "tie")]
    if any(old):
        options["constraints"] = Constraints.merged(*old).table
    # An optimiser or a start model is not kept in a result: the method goes without it.
    kept = {k: v for k, v in options.items() if not (isinstance(v, dict) and NOT_KEPT in v)}
    # JSON knows lists but no tuples.
    return kinds[name](**{k: tuple(v) if isinstance(v, list) else v for k, v in kept.items()})
