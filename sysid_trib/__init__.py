"""Identification of the forces of an oscillator from its free decay.

The public names are listed in `__init__.pyi`; each is imported when it is first used, so that the
command line starts quickly.
"""

from sysid_trib._lazy import public_names
from sysid_trib._version import __version__ as __version__

__getattr__, __dir__, __all__ = public_names(__name__, __file__)
