"""Which forces act in an oscillator, learned from its free decay.

The public names are listed in `__init__.pyi`; each is imported when it is first used, so that the
command line starts quickly.
"""

import lazy_loader

from sysid_trib._version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
