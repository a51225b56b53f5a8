from ..decays.free_decay import free_decays as free_decays
from ..decays.half_sines import envelope as envelope
from ..simulation.example import paper_twin as paper_twin
from .read import read_records as read_records
from .reading import Reading as Reading
from .translation import scale_translation as scale_translation
