# The figures and where each lives: the one list, read by type checkers and by the package itself.
from .at_a_glance import overview as overview
from .compared import comparison as comparison
from .conditions import against_condition as against_condition
from .curves import backbone as backbone
from .driven_record import driven as driven
from .force_map import disagreement as disagreement
from .looked import look as look
from .motion_panels import half_periods as half_periods
from .named_effects import story as story
from .paper import (
    frequency_shift as frequency_shift,
    half_sines as half_sines,
    motions as motions,
    signatures as signatures,
    weights as weights,
)
from .random_force_figures import innovations as innovations, prediction_bands as prediction_bands
from .scored import forecast as forecast, ranking as ranking
from .studied import precision as precision
