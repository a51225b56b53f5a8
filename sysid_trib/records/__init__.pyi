from sysid_trib.records.drawn import drawn_samples as drawn_samples
from sysid_trib.records.free_decay import free_decays as free_decays
from sysid_trib.records.half_sines import envelope as envelope
from sysid_trib.records.in_memory import as_decays as as_decays, one_record as one_record
from sysid_trib.records.read import (
    read_records as read_records,
    reading_text as reading_text,
    scale_translation as scale_translation,
)
from sysid_trib.records.reading import Reading as Reading
from sysid_trib.simulation.simulate import paper_twin as paper_twin
