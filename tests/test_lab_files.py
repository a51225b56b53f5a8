"""Files as laboratories write them, drawn anew: kinds that were once read wrongly, and all of them (slow)."""

import pytest

from benchmarks.contact.kinds import KINDS, drawn
from sysid_trib.records.units import signal_unit

ONCE_WRONG = """
tracker_polar arduino_log arduino_plotter lvm lvm_no_times clock_times comment_rate quoted_commas frames
run_pairs sentinels wrapped_counts drifting_zero beats json_lines fortran bars scope_tek
phyphox_absolute numbered_runs typographer units_in_cells ruled driven
scope_keysight physics_toolbox repeated_header hum excel.xlsx excel_times.xlsx two_tables.xlsx groups.h5
tdms_text run_headings units_odd_marks unit_factors identical_columns nan_column struct_array.mat
channels.json quantities.nc one.zip several.zip archive.tar.gz row_per_run time_row_angle_row long_format
sheet_per_run.xlsx sec_and_usec graphtec benchlink rigol serial_noise excel_formulas hexadecimal hours
time_named_with_unit uff58 sound.wav book.ods protocol.docx protocol.pdf kinovea
percent_signs date_time_columns_ms utf16_iso timer_of_16_bits timer_of_32_bits half_full_of_nothing
sensors_in_turn_blank plotly.json
"""


@pytest.mark.parametrize(
    "name", [pytest.param(k, marks=[pytest.mark.slow] * (k not in ONCE_WRONG.split())) for k in KINDS]
)
def test_every_kind_is_read_as_what_it_is(name, tmp_path):
    assert drawn(name, tmp_path, seed=1, number=0)[1] == ""


def test_a_motion_before_the_drive_is_switched_off_is_no_decay(tmp_path):
    assert drawn("drive_switched_off", tmp_path, seed=11, number=0)[1] == ""


# Pushed up over several periods, twice, a swing comes out as one decay at times: draw 1 of this seed.
PUMPED = pytest.param("pumped", marks=pytest.mark.xfail(strict=True, reason="one decay is found, not two"))


@pytest.mark.in_full
@pytest.mark.parametrize("name", [PUMPED if name == "pumped" else name for name in KINDS])
def test_every_kind_in_further_draws(name, tmp_path):
    assert [drawn(name, tmp_path, seed=11, number=number)[1] for number in range(2)] == ["", ""]


@pytest.mark.parametrize(
    ("text", "unit"),
    [
        *(
            (text, "m/s^2")
            for text in ("m/s²", "m s^-2", "m·s⁻²", "m/s/s", "ms⁻²", "m.s-2", "m/(s*s)", "m/s^{2}")
        ),
        *((text, "rad/s") for text in ("rad s^-1", "rad·s⁻¹", "rad/sec", "rad per s", "rad.s^-1")),
        *((text, "deg/s") for text in ("°/s", "dps", "deg s⁻¹", "degrees/s")),
        *((text, "deg") for text in ("°", "degrees", "Grad", "grados", "degrés", "deg.")),
        *((text, text) for text in ("gon", "arcmin", "arcsec", "µrad", "mrad", "mm", "px")),
        ("Volt", "V"),
        ("a.u.", "au"),
        ("mT", "mT"),
        ("centimeters", "cm"),
    ],
)
def test_units_in_every_spelling(text, unit):
    assert signal_unit(text).text == unit
