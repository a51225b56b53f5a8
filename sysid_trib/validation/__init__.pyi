from sysid_trib.motion_fit.bands import prediction_bands as prediction_bands
from sysid_trib.motion_fit.innovations import innovations as innovations
from sysid_trib.motion_fit.least_squares import cramer_rao_bound as cramer_rao_bound
from sysid_trib.questions.difference import difference as difference
from sysid_trib.questions.model_bands import curve_bands as curve_bands
from sysid_trib.questions.next_run import plan as plan
from sysid_trib.questions.profiles import log_likelihood as log_likelihood, profile as profile
from sysid_trib.questions.steady_response import forced_response as forced_response
from sysid_trib.validation.collinearity import identifiability as identifiability
from sysid_trib.validation.identify import run_agreement as run_agreement
from sysid_trib.validation.random_force_test import random_force_dependence as random_force_dependence
from sysid_trib.validation.refits import sensitivity as sensitivity

from .driven import predict as predict
