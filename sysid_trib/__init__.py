"""Which forces act in an oscillator, learned from its free decay.

The public names are listed here; each is imported when it is first used, so that the command line starts
quickly.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from sysid_trib._version import __version__ as __version__

if TYPE_CHECKING:
    from sysid_trib import methods, plots
    from sysid_trib.averaging.envelope_prediction import predict_envelope
    from sysid_trib.averaging.identifiability import indistinguishable
    from sysid_trib.averaging.signatures import signature
    from sysid_trib.decays.free_decay import free_decay
    from sysid_trib.decays.half_sines import envelope
    from sysid_trib.discrepancy.discover import discover
    from sysid_trib.forces.force import Force, ForceLibrary
    from sysid_trib.forces.library import load_library
    from sysid_trib.physics.contact import contact_stiffness, sphere_stiffness
    from sysid_trib.physics.crossing import crossovers
    from sysid_trib.physics.energy import arrest_time, dissipated_energy
    from sysid_trib.physics.fingerprint import slip_fingerprint
    from sysid_trib.physics.force_weights import weights
    from sysid_trib.physics.linear_systems import damp, linearise, to_nonlinear_system
    from sysid_trib.physics.sliding import sliding_coefficients
    from sysid_trib.physics.units import inertia_with_mass, physical_units
    from sysid_trib.records.read import read_record, scale_translation
    from sysid_trib.regression.pysindy_features import ForceFeatures
    from sysid_trib.reporting.page import report
    from sysid_trib.results.contactless import with_contactless_frequency
    from sysid_trib.results.files import load, save
    from sysid_trib.results.schema import model_of
    from sysid_trib.simulation.example import paper_twin
    from sysid_trib.simulation.model import Model
    from sysid_trib.simulation.simulate import simulate
    from sysid_trib.trajectory_fit.cramer_rao import cramer_rao_bound
    from sysid_trib.validation.compare import compare
    from sysid_trib.validation.cross_check import cross_check, identify
    from sysid_trib.validation.homogeneity import difference, run_agreement

_HOME = {
    "Force": "forces.force",
    "ForceFeatures": "regression.pysindy_features",
    "ForceLibrary": "forces.force",
    "Model": "simulation.model",
    "arrest_time": "physics.energy",
    "compare": "validation.compare",
    "contact_stiffness": "physics.contact",
    "cramer_rao_bound": "trajectory_fit.cramer_rao",
    "cross_check": "validation.cross_check",
    "crossovers": "physics.crossing",
    "damp": "physics.linear_systems",
    "difference": "validation.homogeneity",
    "discover": "discrepancy.discover",
    "dissipated_energy": "physics.energy",
    "envelope": "decays.half_sines",
    "free_decay": "decays.free_decay",
    "identify": "validation.cross_check",
    "indistinguishable": "averaging.identifiability",
    "inertia_with_mass": "physics.units",
    "linearise": "physics.linear_systems",
    "load": "results.files",
    "load_library": "forces.library",
    "methods": "",
    "model_of": "results.schema",
    "paper_twin": "simulation.example",
    "physical_units": "physics.units",
    "plots": "",
    "predict_envelope": "averaging.envelope_prediction",
    "read_record": "records.read",
    "report": "reporting.page",
    "run_agreement": "validation.homogeneity",
    "save": "results.files",
    "scale_translation": "records.read",
    "signature": "averaging.signatures",
    "simulate": "simulation.simulate",
    "sliding_coefficients": "physics.sliding",
    "slip_fingerprint": "physics.fingerprint",
    "sphere_stiffness": "physics.contact",
    "to_nonlinear_system": "physics.linear_systems",
    "weights": "physics.force_weights",
    "with_contactless_frequency": "results.contactless",
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
