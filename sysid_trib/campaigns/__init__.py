"""Many records with one task: on the cores of a machine or of a cluster, into one store."""

from sysid_trib._lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
