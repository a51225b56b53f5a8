"""The units of inputs, and of the coefficients of their forces."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import sysid_trib as st

TIME = np.arange(0.0, 12.0, 0.02)
PUSH = np.cos(np.outer(TIME, np.linspace(1.0, 18.0, 30)) + np.arange(30.0) ** 2).sum(axis=1) / 4.0
INPUTS = st.load_library("inputs")


def library(*symbols: str):
    contact = st.load_library("contact_forces")
    known = {force.symbol: force for force in (*contact, *INPUTS)}
    return replace(INPUTS, forces=tuple(known[symbol] for symbol in symbols))


def written(path: Path, header: str, *columns: np.ndarray) -> Path:
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")
    return path


@pytest.fixture
def record_file(tmp_path: Path) -> Path:
    model = st.Model(library("gain", "zeta"), {"gain": 0.05, "zeta": 0.02}, 9.9)
    angle = st.simulate(model, TIME, 0.1, inputs={"u": PUSH}).angle.values
    angle = angle + 1e-4 * np.random.default_rng(0).standard_normal(len(TIME))
    return written(tmp_path / "run.csv", "time (s),torque (N*m),angle (rad)", TIME, PUSH, angle)


def test_a_unit_keeps_its_capitals_and_the_coefficient_is_over_all_of_it(record_file: Path) -> None:
    record = st.read_record(record_file, input="torque", between="linear")
    assert record.u.attrs["units"] == "N*m"
    result = st.methods.Direct().identify(record, library("gain", "zeta"))
    gain = result.sel(force="gain")
    assert gain.unit.item() == "1/(N*m)"
    assert abs(gain.coefficient.item() - 0.05) < 4.0 * gain.standard_error.item()


@pytest.mark.parametrize(
    ("header", "unit"), [("u (v)", "V"), ("base (MM)", "mm"), ("F [N]", "N"), ("u", None)]
)
def test_a_known_unit_is_written_as_it_should_be(tmp_path: Path, header: str, unit: str | None) -> None:
    path = written(tmp_path / "run.csv", f"time (s),{header},angle (rad)", TIME, PUSH, 0.1 * PUSH)
    name = header.partition(" ")[0]
    assert st.read_record(path, input=name).u.attrs.get("units") == unit


def test_a_formula_of_columns_is_an_input(record_file: Path) -> None:
    record = st.read_record(record_file, input="35.15*torque")
    np.testing.assert_allclose(record.u, 35.15 * PUSH)
    assert "units" not in record.u.attrs
