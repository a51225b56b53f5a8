# The figures and where each lives: the one list, read by type checkers and by the package itself.
from .averaged import signatures as signatures
from .backbone import backbone as backbone
from .compared import coefficients as coefficients, comparison as comparison, prediction as prediction
from .conditions import against_condition as against_condition, against_conditions as against_conditions
from .discovery_story import story as story
from .force_map import disagreement as disagreement, disagreement_map as disagreement_map
from .looked import look as look
from .motion_figures import (
    discovery as discovery,
    envelope as envelope,
    frequency as frequency,
    identification as identification,
    record as record,
    residual as residual,
)
from .overview import overview as overview, residual_surface as residual_surface
from .paper import (
    averaged_decay as averaged_decay,
    frequency_shift as frequency_shift,
    half_sines as half_sines,
    motions as motions,
    weights as weights,
)
from .planned import distinction as distinction
from .random_force_figures import (
    innovations as innovations,
    prediction_bands as prediction_bands,
    random_force as random_force,
)
from .scored import forecast as forecast, forecasts as forecasts, ranking as ranking, rankings as rankings
from .studied import precision as precision, precisions as precisions
