from ..state_space.bands import prediction_bands as prediction_bands
from ..state_space.innovations import innovations as innovations
from ..trajectory_fit.cramer_rao import cramer_rao_bound as cramer_rao_bound
from .homogeneity import difference as difference, run_agreement as run_agreement
from .prediction import predict as predict
from .random_force import random_force_dependence as random_force_dependence
