"""An identified model in python-control: linear about an amplitude, or whole."""

from sysid_trib._lazy import public_names

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
