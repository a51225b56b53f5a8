from sysid_trib.cycles.signatures import signature as signature
from sysid_trib.cycles.suggested import suggested as suggested
from sysid_trib.likelihood.pysindy_features import (
    ForceFeatures as ForceFeatures,
    WhitenedLeastSquares as WhitenedLeastSquares,
)
from sysid_trib.validation.separability import indistinguishable as indistinguishable

from .force import Force as Force, ForceLibrary as ForceLibrary
from .from_python import as_library as as_library
from .library import load_library as load_library
from .systems import load_system as load_system, load_systems as load_systems
