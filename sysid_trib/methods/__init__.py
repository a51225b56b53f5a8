"""Identification methods: small frozen objects with one job, `identify(decay, library) -> Dataset`."""

from sysid_trib.methods.averaging import Averaging
from sysid_trib.methods.direct import Direct
from sysid_trib.methods.trajectory import Trajectory

__all__ = ["Averaging", "Direct", "Trajectory"]
