"""Which forces act in an oscillator, learned from its free decay.

The public names are listed here; each is imported when it is first used, so that the command line starts
quickly.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sysid_trib import methods, plots
    from sysid_trib.bounds import cramer_rao_bound
    from sysid_trib.comparing import compare
    from sysid_trib.control_systems import damp, linearise, to_nonlinear_system
    from sysid_trib.decays.free_decay import free_decay
    from sysid_trib.decays.half_sines import envelope
    from sysid_trib.differences import difference, run_agreement
    from sysid_trib.discrepancy.discover import discover
    from sysid_trib.example import paper_twin
    from sysid_trib.feature_library import ForceFeatures
    from sysid_trib.forces import Force, ForceLibrary
    from sysid_trib.identification import cross_check, identify
    from sysid_trib.library_files import load_library
    from sysid_trib.model import Model
    from sysid_trib.physics.contact import contact_stiffness, sphere_stiffness
    from sysid_trib.physics.crossing import crossovers
    from sysid_trib.physics.energy import arrest_time, dissipated_energy
    from sysid_trib.physics.fingerprint import slip_fingerprint
    from sysid_trib.physics.force_weights import weights
    from sysid_trib.physics.sliding import sliding_coefficients
    from sysid_trib.physics.units import inertia_with_mass, physical_units
    from sysid_trib.prediction import predict_envelope
    from sysid_trib.records import read_record, scale_translation
    from sysid_trib.reporting.page import report
    from sysid_trib.result_files import load, save
    from sysid_trib.results import model_of, with_contactless_frequency
    from sysid_trib.signatures import signature
    from sysid_trib.simulation import simulate
    from sysid_trib.ties import indistinguishable

__version__ = "0.1.0"

_HOME = {
    "Force": "forces",
    "ForceFeatures": "feature_library",
    "ForceLibrary": "forces",
    "Model": "model",
    "arrest_time": "physics.energy",
    "compare": "comparing",
    "contact_stiffness": "physics.contact",
    "cramer_rao_bound": "bounds",
    "cross_check": "identification",
    "crossovers": "physics.crossing",
    "damp": "control_systems",
    "difference": "differences",
    "discover": "discrepancy.discover",
    "dissipated_energy": "physics.energy",
    "envelope": "decays.half_sines",
    "free_decay": "decays.free_decay",
    "identify": "identification",
    "indistinguishable": "ties",
    "inertia_with_mass": "physics.units",
    "linearise": "control_systems",
    "load": "result_files",
    "load_library": "library_files",
    "methods": "",
    "model_of": "results",
    "paper_twin": "example",
    "physical_units": "physics.units",
    "plots": "",
    "predict_envelope": "prediction",
    "read_record": "records",
    "report": "reporting.page",
    "run_agreement": "differences",
    "save": "result_files",
    "scale_translation": "records",
    "signature": "signatures",
    "simulate": "simulation",
    "sliding_coefficients": "physics.sliding",
    "slip_fingerprint": "physics.fingerprint",
    "sphere_stiffness": "physics.contact",
    "to_nonlinear_system": "control_systems",
    "weights": "physics.force_weights",
    "with_contactless_frequency": "results",
}

__all__ = [
    "Force",
    "ForceFeatures",
    "ForceLibrary",
    "Model",
    "arrest_time",
    "compare",
    "contact_stiffness",
    "cramer_rao_bound",
    "cross_check",
    "crossovers",
    "damp",
    "difference",
    "discover",
    "dissipated_energy",
    "envelope",
    "free_decay",
    "identify",
    "indistinguishable",
    "inertia_with_mass",
    "linearise",
    "load",
    "load_library",
    "methods",
    "model_of",
    "paper_twin",
    "physical_units",
    "plots",
    "predict_envelope",
    "read_record",
    "report",
    "run_agreement",
    "save",
    "scale_translation",
    "signature",
    "simulate",
    "sliding_coefficients",
    "slip_fingerprint",
    "sphere_stiffness",
    "to_nonlinear_system",
    "weights",
    "with_contactless_frequency",
]


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'sysid_trib' has no attribute '{name}'")
    home = _HOME[name]
    # A module (methods, plots) is itself the name; anything else lives in one.
    found = (
        getattr(import_module(f"sysid_trib.{home}"), name) if home else import_module(f"sysid_trib.{name}")
    )
    globals()[name] = found
    return found


def __dir__() -> list[str]:
    return sorted(__all__)
