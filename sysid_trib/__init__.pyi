# The public names and where each lives: the one list, read by type checkers and by the package itself.
from . import (
    campaigns as campaigns,
    control as control,
    forces as forces,
    methods as methods,
    physics as physics,
    plots as plots,
    records as records,
    validation as validation,
)
from .averaging.backbone import backbone as backbone
from .averaging.envelope_prediction import predict_envelope as predict_envelope
from .averaging.signatures import signature as signature
from .campaigns.campaign import campaign as campaign
from .decays.free_decay import free_decay as free_decay
from .decays.half_sines import envelope as envelope
from .discrepancy.discover import discover as discover
from .forces.library import load_library as load_library
from .records.read import read_record as read_record
from .regression.pysindy_features import ForceFeatures as ForceFeatures
from .reporting.page import report as report
from .results.files import load as load, save as save
from .simulation.model import Model as Model
from .simulation.simulate import simulate as simulate
from .trajectory_fit.cramer_rao import cramer_rao_bound as cramer_rao_bound
from .validation.compare import compare as compare
from .validation.cross_check import cross_check as cross_check
from .validation.homogeneity import difference as difference
from .validation.identify import identify as identify
from .validation.prediction import predict as predict

__version__: str

# What a newcomer needs. The other names above stay here, as others' programs have them from here.
__all__ = [
    "Model",
    "backbone",
    "campaign",
    "compare",
    "cross_check",
    "discover",
    "free_decay",
    "identify",
    "load",
    "load_library",
    "methods",
    "plots",
    "read_record",
    "report",
    "save",
    "simulate",
]
