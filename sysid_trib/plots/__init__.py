"""Figures from results only: one function a panel, each taking an optional `ax`."""

from sysid_trib._lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
