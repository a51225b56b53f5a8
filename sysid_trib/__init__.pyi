# The public names and where each lives: the one list, read by type checkers and by the package itself.
from . import methods as methods, plots as plots
from .averaging.backbone import backbone as backbone
from .averaging.envelope_prediction import predict_envelope as predict_envelope
from .averaging.identifiability import indistinguishable as indistinguishable
from .averaging.signatures import signature as signature
from .campaigns.campaign import campaign as campaign
from .campaigns.store import open_store as open_store
from .campaigns.study import Study as Study, load_study as load_study
from .campaigns.task import Task as Task
from .decays.free_decay import free_decay as free_decay, free_decays as free_decays
from .decays.half_sines import envelope as envelope
from .discrepancy.discover import discover as discover
from .forces.force import Force as Force, ForceLibrary as ForceLibrary
from .forces.library import load_library as load_library
from .physics.contact import contact_stiffness as contact_stiffness, sphere_stiffness as sphere_stiffness
from .physics.crossing import crossovers as crossovers
from .physics.energy import arrest_time as arrest_time, dissipated_energy as dissipated_energy
from .physics.fingerprint import slip_fingerprint as slip_fingerprint
from .physics.force_weights import weights as weights
from .physics.linear_systems import (
    damp as damp,
    linearise as linearise,
    to_nonlinear_system as to_nonlinear_system,
)
from .physics.sliding import sliding_coefficients as sliding_coefficients
from .physics.units import inertia_with_mass as inertia_with_mass, physical_units as physical_units
from .records.read import read_record as read_record, read_records as read_records
from .records.reading import Reading as Reading
from .records.translation import scale_translation as scale_translation
from .regression.pysindy_features import ForceFeatures as ForceFeatures
from .reporting.page import report as report
from .results.contactless import with_contactless_frequency as with_contactless_frequency
from .results.files import load as load, save as save
from .results.schema import model_of as model_of
from .simulation.example import paper_twin as paper_twin
from .simulation.model import Model as Model
from .simulation.simulate import simulate as simulate
from .state_space.bands import prediction_bands as prediction_bands
from .state_space.innovations import innovations as innovations
from .trajectory_fit.cramer_rao import cramer_rao_bound as cramer_rao_bound
from .validation.answer import identify as identify
from .validation.between_runs import between_runs as between_runs
from .validation.compare import compare as compare
from .validation.cross_check import cross_check as cross_check
from .validation.homogeneity import difference as difference, run_agreement as run_agreement
from .validation.random_force import random_force_dependence as random_force_dependence

__version__: str
