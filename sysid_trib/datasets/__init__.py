"""Records to play with: published measurements, and certified decays with exact truth."""

from sysid_trib._lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
