"""Consequences of an identification: weights, crossovers, energies, SI units, slip."""

from sysid_trib._lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
