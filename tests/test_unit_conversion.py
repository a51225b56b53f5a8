"""Units that are compared: of records that are predicted, of inputs, of inertias, of columns without any."""

import numpy as np
import pytest
import xarray as xr
from command_line import run, write_table

import sysid_trib as st
from sysid_trib.errors import UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.records.conversion import factor_between
from sysid_trib.records.read import read_record

W = 9.0
TIME = np.arange(0.0, 10.0, 0.02)
FORCES = parse_library(
    {"force": [{"symbol": "gain", "formula": "-u"}, {"symbol": "zeta", "formula": "2*v"}]}, "driven"
)
DIRECT = st.methods.Direct(random_force="off")
PUSH = np.cos(np.outer(TIME, np.linspace(1.0, 17.0, 25)) + np.arange(25.0) ** 2).sum(axis=1)


@pytest.mark.parametrize(
    ("given", "wanted", "factor"),
    [
        ("m", "mm", 1e3),
        ("kN", "N", 1e3),
        ("mN*m", "N m", 1e-3),
        ("Nm", "N-m", 1.0),
        ("Ncm", "N*m", 1e-2),
        ("kg*m/s^2", "N", 1.0),
        ("g", "m/s²", 9.80665),
        ("deg/s", "rad/s", np.pi / 180.0),
        ("Volts", "mV", 1e3),
        ("MPa", "mPa", 1e9),
        ("px", "px", 1.0),
        ("px", "mm", None),
        ("V", "N", None),
        ("rad", "mm", None),
        ("counts", "V", None),
    ],
)
def test_units_of_one_kind_have_a_factor(given: str, wanted: str, factor: float | None) -> None:
    assert factor_between(given, wanted) == (None if factor is None else pytest.approx(factor))


@pytest.fixture(scope="module")
def angle() -> np.ndarray:
    model = st.Model(FORCES, {"gain": 0.01, "zeta": 0.02}, W)
    clean = st.simulate(model, TIME, 0.1, inputs={"u": PUSH}).angle.values
    return clean + 1e-4 * np.random.default_rng(0).standard_normal(TIME.size)


def record(angle: np.ndarray, unit: str, size: float, unit_of_u: str | None, size_of_u: float) -> xr.Dataset:
    attrs = {"role": "input"} | ({"units": unit_of_u} if unit_of_u else {})
    return xr.Dataset(
        {"angle": ("time", size * angle, {"units": unit}), "u": ("time", size_of_u * PUSH, attrs)},
        {"time": ("time", TIME, {"units": "s"})},
    )


@pytest.fixture(scope="module")
def result(angle: np.ndarray) -> xr.Dataset:
    return st.identify(record(angle, "mm", 40.0, "N", 1.0), FORCES, DIRECT)


@pytest.mark.parametrize(
    "other",
    [("mm", 40.0, "N", 1.0), ("m", 0.04, "kN", 1e-3), ("µm", 4e4, "mN", 1e3), ("mm", 40.0, None, 1.0)],
)
def test_a_record_in_other_units_is_predicted_as_well(angle, result, other) -> None:
    predicted = st.predict(result, record(angle, *other))
    assert predicted.residual_rms == pytest.approx(40e-4, rel=0.2)
    assert predicted.residual_rms.attrs["units"] == predicted.angle.attrs["units"] == "mm"


@pytest.mark.parametrize(
    ("other", "said"),
    [
        (("rad", 1.0, "N", 1.0), "signal of the record is in the unit rad, and .* identified in mm"),
        (("px", 9.0, "N", 1.0), "in the unit px"),
        (("mm", 40.0, "V", 1.0), "input u is in the unit V, and the model was identified in N"),
    ],
)
def test_a_record_in_units_of_another_kind_is_refused(angle, result, other, said) -> None:
    with pytest.raises(UsageError, match=said):
        st.predict(result, record(angle, *other))


def test_runs_in_different_units_are_refused(angle) -> None:
    runs = [record(angle, "mm", 40.0, "N", 1.0), record(angle, "m", 0.04, "N", 1.0)]
    with pytest.raises(UsageError, match=r"different units \(m, mm\)"):
        st.identify(runs, FORCES, DIRECT)
    runs = [record(angle, "mm", 40.0, "N", 1.0), record(angle, "mm", 40.0, "kN", 1e-3)]
    with pytest.raises(UsageError, match=r"input u is in different units \(N, kN\)"):
        st.identify(runs, FORCES, DIRECT)


def test_the_command_tests_a_file_in_other_units(angle, tmp_path) -> None:
    first = write_table(tmp_path / "a.csv", "time (s),push (N),x (mm)", TIME, PUSH, 40.0 * angle)
    other = write_table(tmp_path / "b.csv", "time (s),push (kN),x (m)", TIME, 1e-3 * PUSH, 0.04 * angle)
    asked = ("--angle", "x", "--input", "push", "--forces", "gain,zeta")
    ending = run("identify", first, *asked, "--test", other)
    assert ending.status == 0, ending.err
    assert " mm (RMS), 0.0" in ending.out


def test_an_inertia_is_of_an_angle(result) -> None:
    with pytest.raises(UsageError, match="this record is in mm"):
        st.physics.in_si_units(result, inertia=(2.0, 0.0))
    with pytest.raises(UsageError, match="this record is in mm"):
        st.physics.physical_units(result, 2.0)
    with pytest.raises(UsageError, match="this record is in mm"):
        st.physics.dissipated_energy(result, 0.1, 2.0)


def swinging(amplitude: float) -> np.ndarray:
    time = np.arange(0.0, 60.0, 0.02)
    return np.c_[time, amplitude * np.exp(-0.012 * time) * np.cos(3.5 * time)].T


@pytest.mark.parametrize(
    ("system", "amplitude", "said"),
    [
        ("torsion", 1.78, "angle in rad from column phi"),
        ("tribometer", 1.78, "angle in rad"),
        ("pendulum", 1.78, "angle in deg"),
        (None, 1.78, "angle in deg"),
        ("torsion", 5.0, "give --units rad or deg"),
        ("torsion", 40.0, "angle in deg"),
    ],
)
def test_gravity_determines_the_unit_only_for_a_pendulum(tmp_path, system, amplitude, said) -> None:
    file = write_table(tmp_path / "swing.csv", "t,phi", *swinging(amplitude))
    ending = run("look", file, *(("--system", system) if system else ()))
    assert said in ending.out + ending.err


@pytest.mark.parametrize(
    ("header", "quantity", "unit"),
    [
        ("V2", "displacement", "au"),
        ("A0", "displacement", "au"),
        ("v_1", "displacement", "au"),
        ("V2 (V)", "displacement", "V"),
        ("v", "rate", "rad/s"),
        ("omega2", "rate", "rad/s"),
    ],
)
def test_a_numbered_channel_is_no_rate(tmp_path, header, quantity, unit) -> None:
    file = write_table(tmp_path / "circuit.csv", f"time,{header}", *swinging(2.0))
    record = read_record(file, angle=header)
    assert (record.attrs["signal"], record.attrs["angle_unit_in_file"]) == (quantity, unit)
