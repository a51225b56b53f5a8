"""Identification of the forces of an oscillator from its free decay.

The public names are listed in `__init__.pyi`; each is imported when it is first used, so that the
command line starts quickly.
"""

import warnings
from typing import Any

from sysid_trib._lazy import public_names
from sysid_trib._version import __version__ as __version__

# Names that stood here before 0.2, by the namespace where they are now.
_MOVED = {
    "campaigns": ("Task", "between_runs", "open_store"),
    "control": ("damp", "linearise", "to_nonlinear_system"),
    "forces": ("Force", "ForceLibrary", "indistinguishable"),
    "physics": (
        "arrest_time",
        "contact_stiffness",
        "crossovers",
        "dissipated_energy",
        "inertia_with_mass",
        "model_of",
        "physical_units",
        "slip_fingerprint",
        "sphere_stiffness",
        "weights",
        "with_contactless_frequency",
    ),
    "records": ("Reading", "free_decays", "paper_twin", "read_records", "scale_translation"),
    "validation": ("innovations", "prediction_bands", "random_force_dependence", "run_agreement"),
}

_public, __dir__, __all__ = public_names(__name__, __file__)


def __getattr__(name: str) -> Any:
    for namespace, names in _MOVED.items():
        if name in names:
            place = f"sysid_trib.{namespace}.{name}"
            warnings.warn(f"sysid_trib.{name} is now {place}.", DeprecationWarning, stacklevel=2)
            return getattr(_public(namespace), name)
    return _public(name)
