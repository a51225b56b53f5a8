from ..averaging.envelope_prediction import predict_envelope as predict_envelope
from ..results.contactless import with_contactless_frequency as with_contactless_frequency
from ..results.schema import model_of as model_of
from .contact import contact_stiffness as contact_stiffness, sphere_stiffness as sphere_stiffness
from .crossing import crossovers as crossovers
from .energy import arrest_time as arrest_time, dissipated_energy as dissipated_energy
from .fingerprint import slip_fingerprint as slip_fingerprint
from .force_weights import weights as weights
from .input_units import per_input as per_input
from .sliding import sliding_coefficients as sliding_coefficients
from .units import inertia_with_mass as inertia_with_mass, physical_units as physical_units
