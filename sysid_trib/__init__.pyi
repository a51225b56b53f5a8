# The public names and where each lives: the one list, read by type checkers and by the package itself.
from sysid_trib.cycles.backbone import backbone as backbone
from sysid_trib.cycles.look import look as look
from sysid_trib.cycles.signatures import signature as signature
from sysid_trib.discovery.discover import discover as discover
from sysid_trib.likelihood.pysindy_features import ForceFeatures as ForceFeatures
from sysid_trib.motion_fit.least_squares import cramer_rao_bound as cramer_rao_bound
from sysid_trib.printing.numbers import summary as summary
from sysid_trib.questions.averaged_motion import predict_envelope as predict_envelope
from sysid_trib.questions.difference import difference as difference
from sysid_trib.questions.modal_response import response_of_mode as response_of_mode
from sysid_trib.questions.next_run import plan as plan
from sysid_trib.questions.steady_response import forced_response as forced_response
from sysid_trib.records.free_decay import free_decay as free_decay
from sysid_trib.records.half_sines import envelope as envelope
from sysid_trib.records.mode_list import modes as modes
from sysid_trib.records.one_mode import one_mode as one_mode
from sysid_trib.records.read import read_record as read_record
from sysid_trib.records.sensors import read_sensors as read_sensors
from sysid_trib.reporting.page import report as report
from sysid_trib.reporting.shown import show as show
from sysid_trib.results.files import load as load, save as save
from sysid_trib.results.judged import best as best
from sysid_trib.simulation.simulate import simulate as simulate
from sysid_trib.smooth_laws.laws import laws as laws
from sysid_trib.validation.cross_check import cross_check as cross_check

from . import (
    campaigns as campaigns,
    control as control,
    datasets as datasets,
    errors as errors,
    forces as forces,
    methods as methods,
    physics as physics,
    plots as plots,
    records as records,
    validation as validation,
)
from .campaigns.campaign import campaign as campaign
from .forces.from_python import library as library
from .forces.library import load_library as load_library
from .forces.systems import system as system
from .simulation.model import Model as Model
from .validation.compare import compare as compare
from .validation.driven import predict as predict
from .validation.identify import identify as identify

__version__: str

# The names for newcomers; the other names above are public, too.
__all__ = [
    "Model",
    "backbone",
    "best",
    "campaign",
    "compare",
    "discover",
    "free_decay",
    "identify",
    "laws",
    "library",
    "load",
    "load_library",
    "methods",
    "plots",
    "read_record",
    "report",
    "save",
    "show",
    "simulate",
    "summary",
]
