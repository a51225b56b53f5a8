"""Figures from results only: one function a figure or panel; a panel takes an optional `ax`."""

import warnings
from typing import Any

from sysid_trib._lazy import public_names

# Figures that are part of another now.
_MERGED = {
    "against_conditions": "against_condition",
    "averaged_decay": "motions",
    "contour": "profile",
    "disagreement": "story",
    "disagreement_map": "story",
    "discovery": "story",
    "driven": "overview",
    "forecast": "ranking",
    "forecasts": "ranking",
    "half_periods": "overview",
    "half_sines": "motions",
    "identification": "overview",
    "prediction_bands": "innovations",
    "random_force": "innovations",
    "rankings": "ranking",
    "residual_surface": "overview",
}

_public, __dir__, __all__ = public_names(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name not in _MERGED:
        return _public(name)
    message = f"sysid_trib.plots.{name} is part of sysid_trib.plots.{_MERGED[name]} now."
    warnings.warn(message, DeprecationWarning, stacklevel=2)
    return _public(_MERGED[name])
