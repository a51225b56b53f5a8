from sysid_trib.physics.contact import (
    contact_stiffness as contact_stiffness,
    inertia_with_mass as inertia_with_mass,
    slip_fingerprint as slip_fingerprint,
    sphere_stiffness as sphere_stiffness,
)
from sysid_trib.physics.force_weights import (
    crossovers as crossovers,
    dissipated_energy as dissipated_energy,
    weights as weights,
)
from sysid_trib.physics.model_estimate import arrest_time as arrest_time
from sysid_trib.physics.si_laws import law_table as law_table, laws_in_si as laws_in_si
from sysid_trib.physics.si_units import (
    in_si_units as in_si_units,
    per_input as per_input,
    physical_units as physical_units,
)
from sysid_trib.questions.averaged_motion import predict_envelope as predict_envelope
from sysid_trib.questions.law_difference import law_difference as law_difference
from sysid_trib.results.references import with_contactless_frequency as with_contactless_frequency
from sysid_trib.smooth_laws.calibration import with_scale_error as with_scale_error
from sysid_trib.smooth_laws.formulas import law_formulas as law_formulas
from sysid_trib.smooth_laws.method import law_methods as law_methods

from ..results.schema import model_of as model_of
