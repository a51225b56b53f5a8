"""Figures from results only: one function a figure or panel; a panel takes an optional `ax`."""

import warnings
from typing import Any

from sysid_trib._lazy import public_names

# Figures that are part of another now, by its name.
_MERGED = {
    "against_condition": ("against_conditions",),
    "innovations": ("prediction_bands", "random_force"),
    "motions": ("averaged_decay", "half_sines"),
    "overview": ("driven", "half_periods", "identification", "residual_surface"),
    "ranking": ("forecast", "forecasts", "rankings"),
    "story": ("disagreement", "disagreement_map", "discovery"),
}

_public, __dir__, __all__ = public_names(__name__, __file__)


def __getattr__(name: str) -> Any:
    for merged, names in _MERGED.items():
        if name in names:
            message = f"sysid_trib.plots.{name} is part of sysid_trib.plots.{merged} now."
            warnings.warn(message, DeprecationWarning, stacklevel=2)
            return _public(merged)
    return _public(name)
