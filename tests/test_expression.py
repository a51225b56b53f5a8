"""A signal that is computed from columns: its unit is theirs, carried through the formula."""

import numpy as np
import pytest

import sysid_trib as st
from sysid_trib.errors import UsageError

TIME = np.arange(600) * 0.02
SWING = 0.3 * np.exp(-0.1 * TIME) * np.cos(9.9 * TIME)


def written(tmp_path, *headers):
    """A record with a column for each header, each the same swing of 3 units."""
    rows = (
        ",".join([f"{t:.6g}", *[f"{10 * x:.9g}"] * len(headers)]) for t, x in zip(TIME, SWING, strict=True)
    )
    place = tmp_path / "a.csv"
    place.write_text("\n".join([",".join(["time (s)", *headers]), *rows]), encoding="utf-8")
    return place


@pytest.mark.parametrize(
    ("headers", "formula", "unit"),
    [
        (["a (deg)", "b (degrees)"], "-a", "deg"),
        (["a (deg)", "b (degrees)"], "A-0.1", "deg"),
        (["a (deg)", "b (degrees)"], "0.5*(a+b)", "deg"),
        (["a (deg)", "b (degrees)"], "(a)", "deg"),
        (["a (deg)", "b (degrees)"], "2*a", "deg"),
        (["a (deg)", "b (degrees)"], "sqrt(a**2 + b**2)*sign(a)", "deg"),
        (["a (deg)", "b (degrees)"], "a*b/abs(b)", "deg"),
        (["x (mm)"], "min(x, 100)", "mm"),
        (["x (mm)"], "abs(x)", "mm"),
        (["x (mm)", "y (mm)"], "atan2(x - 3.1, 40 - y)", "rad"),
        (["rate (deg/s)"], "-rate", "deg/s"),
        (["theta"], "-theta", "deg"),
    ],
)
def test_the_unit_of_columns_is_that_of_a_formula(tmp_path, headers, formula, unit):
    record = st.read_record(written(tmp_path, *headers), angle=formula)
    assert record.attrs["angle_unit_in_file"] == unit
    assert record.attrs["angle_column"] == formula


def test_a_formula_is_the_column_that_it_computes(tmp_path):
    place = written(tmp_path, "a (deg)", "b (deg)")
    mean = st.read_record(place, angle="0.5*(a+b)")
    np.testing.assert_allclose(mean.angle, st.read_record(place, angle="a").angle)
    assert np.max(np.abs(mean.angle)) == pytest.approx(np.deg2rad(3.0), rel=1e-6)


@pytest.mark.parametrize(
    ("headers", "formula", "said"),
    [
        (["x (mm)", "x (deg)"], "2*x", "no single column 'x'"),
        (["a (deg)", "b (rad)"], "a + b", "does not follow"),
        (["a (deg)", "b (rad)"], "atan2(a, b)", "does not follow"),
        (["a (deg)"], "a*a", "does not follow"),
        (["a (deg)"], "sin(a)", "does not follow"),
        # By hand in rad.
        (["a (deg)"], "a*pi/180", "does not follow"),
        (["a (deg)"], "0.01745*a", "does not follow"),
        (["a (g)"], "9.81*a", "does not follow"),
        (["a (deg)"], "2*c", "Columns that it may hold: time, a"),
    ],
)
def test_a_unit_or_a_column_that_does_not_follow_is_asked_for(tmp_path, headers, formula, said):
    with pytest.raises(UsageError, match=r"a\.csv: ") as refusal:
        st.read_record(written(tmp_path, *headers), angle=formula)
    assert said in str(refusal.value)


@pytest.mark.parametrize("formula", ["a*pi/180", "0.0115*pot - 0.2", "a + 0*b"])
def test_a_unit_that_does_not_follow_may_be_given(tmp_path, formula):
    place = written(tmp_path, "a (deg)", "b (rad)", "pot (V)")
    record = st.read_record(place, angle=formula, units="rad")
    assert record.attrs["angle_unit_in_file"] == "rad"
    with pytest.raises(UsageError, match="says deg"):
        st.read_record(place, angle="-a", units="rad")
