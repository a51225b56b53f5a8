"""Figures from results only: one function a panel, each taking an optional `ax`."""

from sysid_trib.plots.averaged import signatures
from sysid_trib.plots.compared import coefficients, comparison, prediction
from sysid_trib.plots.force_map import disagreement, disagreement_map
from sysid_trib.plots.motion_figures import (
    discovery,
    envelope,
    frequency,
    identification,
    record,
    residual,
)
from sysid_trib.plots.paper import averaged_decay, frequency_shift, half_sines, motions, weights
from sysid_trib.plots.planned import distinction
from sysid_trib.plots.scored import forecast, forecasts, ranking, rankings
from sysid_trib.plots.story import story
from sysid_trib.plots.studied import precision, precisions

__all__ = [
    "averaged_decay",
    "coefficients",
    "comparison",
    "disagreement",
    "disagreement_map",
    "discovery",
    "distinction",
    "envelope",
    "forecast",
    "forecasts",
    "frequency",
    "frequency_shift",
    "half_sines",
    "identification",
    "motions",
    "precision",
    "precisions",
    "prediction",
    "ranking",
    "rankings",
    "record",
    "residual",
    "signatures",
    "story",
    "weights",
]
