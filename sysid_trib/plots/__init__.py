"""Figures from results only: one function a panel, each taking an optional `ax`."""

from sysid_trib.plots.compared import coefficients, comparison, prediction
from sysid_trib.plots.cross_checked import envelope, frequency, identification, record, residual
from sysid_trib.plots.discovered import disagreement, disagreement_map, discovery
from sysid_trib.plots.scored import forecast, forecasts, ranking, rankings

__all__ = [
    "coefficients",
    "comparison",
    "disagreement",
    "disagreement_map",
    "discovery",
    "envelope",
    "forecast",
    "forecasts",
    "frequency",
    "identification",
    "prediction",
    "ranking",
    "rankings",
    "record",
    "residual",
]
