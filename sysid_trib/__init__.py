"""Which forces act in an oscillator, learned from its free decay."""

from sysid_trib.forces import Force, ForceLibrary
from sysid_trib.library_files import load_library
from sysid_trib.model import Model

__version__ = "0.1.0"
__all__ = ["Force", "ForceLibrary", "Model", "load_library"]
