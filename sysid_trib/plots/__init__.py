"""Figures of results: one function per figure or panel; a panel takes an optional `ax`."""

from sysid_trib._lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
