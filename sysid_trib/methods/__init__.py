"""Identification methods: small frozen objects with one job, `identify(decay, library) -> Dataset`."""

from sysid_trib.decays.windowed_modes import windowed_modes
from sysid_trib.methods.averaging import Averaging
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.energy_decay import EnergyDecay
from sysid_trib.methods.feeny_liang import FeenyLiang, feeny_liang_decrement
from sysid_trib.methods.frequency_shift import FrequencyShift
from sysid_trib.methods.linear_decrement import LinearDecrement
from sysid_trib.methods.logarithmic_decrement import LogarithmicDecrement
from sysid_trib.methods.quadratic_decay import QuadraticDecay
from sysid_trib.methods.trajectory import Trajectory
from sysid_trib.methods.windowed_era import WindowedERA
from sysid_trib.methods.wu_decrement import WuDecrement

__all__ = [
    "Averaging",
    "Direct",
    "EnergyDecay",
    "FeenyLiang",
    "FrequencyShift",
    "LinearDecrement",
    "LogarithmicDecrement",
    "QuadraticDecay",
    "Trajectory",
    "WindowedERA",
    "WuDecrement",
    "feeny_liang_decrement",
    "windowed_modes",
]
