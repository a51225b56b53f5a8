"""Figures from results only: one function a panel, each taking an optional `ax`."""

from sysid_trib.plots.compared import coefficients, comparison, prediction
from sysid_trib.plots.cross_checked import envelope, frequency, identification, record, residual

__all__ = [
    "coefficients",
    "comparison",
    "envelope",
    "frequency",
    "identification",
    "prediction",
    "record",
    "residual",
]
