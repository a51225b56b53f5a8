# The figures and where each lives: the one list, read by type checkers and by the package itself.
from sysid_trib.plots.compared import against_condition as against_condition, comparison as comparison
from sysid_trib.plots.contrasted_laws import law_difference as law_difference
from sysid_trib.plots.looked import backbone as backbone, look as look
from sysid_trib.plots.named_effects import ranking as ranking, story as story
from sysid_trib.plots.si_laws import friction_coefficient as friction_coefficient
from sysid_trib.plots.sureness import difference as difference, profile as profile, sensitivity as sensitivity

from .at_a_glance import overview as overview
from .interaction_map import interaction as interaction
from .law_curves import laws as laws, own_laws as own_laws
from .over_time import frequency_shift as frequency_shift, motions as motions, weights as weights
from .predicted import innovations as innovations, plan as plan, response as response
