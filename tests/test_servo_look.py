"""What `look`, `laws` and the messages on inputs say of a servo's file, whose motion is driven."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from command_line import run

import sysid_trib as st
from benchmarks import servo
from sysid_trib.commands import next_step as steps
from sysid_trib.commands.options import LawsOptions
from sysid_trib.errors import UsageError
from sysid_trib.forces.offered import with_inputs_acting
from sysid_trib.smooth_laws.curves import ranges

HEADER = "time (s),position (rad),goal position (rad),kp,torque on"


def written(folder: Path, record: xr.Dataset, name: str = "run.csv") -> Path:
    table = np.column_stack([record.time, record.angle, record.goal, record.kp, record.on])
    np.savetxt(folder / name, table, delimiter=",", header=HEADER, comments="", fmt="%.6f")
    return folder / name


@pytest.fixture(scope="module")
def runs():
    return servo.rig_runs({}, 0)


@pytest.mark.parametrize("at", [1, 3])
def test_look_and_its_next_line_agree_on_what_is_between_samples(runs, at, tmp_path):
    file = written(tmp_path, runs[at])
    ending = run("look", str(file), "--angle", "position (rad)", "--input", "goal=goal position,on=torque on")
    assert ending.status == 0, ending.err
    assert "goal smooth; on held between" in ending.out or "smooth between samples" in ending.out
    assert "--between smooth" in ending.out
    assert "--between held" not in ending.out


def test_a_switch_beside_other_inputs_is_held_whatever_is_between_their_samples(runs, tmp_path):
    file, columns = written(tmp_path, runs[3]), {"goal": "goal position", "on": "torque on"}
    record = st.read_record(file, angle="position (rad)", input=columns, between="linear")
    assert record.goal.attrs["between"] == "linear"
    assert record.on.attrs["between"] == "held"
    # Asked for by itself it is what is asked for.
    record = st.read_record(file, angle="position (rad)", input="torque on", between="linear")
    assert record.u.attrs["between"] == "linear"


def test_a_single_input_is_named_by_its_column(runs, tmp_path):
    file = written(tmp_path, runs[1])
    ending = run("look", str(file), "--angle", "position (rad)", "--input", "goal position")
    assert "inputs goal position (u in formulas, rad), smooth between samples" in ending.out
    assert "Driven: input goal position (u in formulas) ranges from" in ending.out
    ending = run("identify", str(file), "--angle", "position (rad)", "--input", "kp", "--forces", "zeta,gain")
    assert "The input kp (u in formulas) is 100 throughout and drives nothing" in ending.err


def test_a_goal_that_is_larger_than_all_else_is_not_taken_for_the_signal(tmp_path):
    time = np.arange(0.0, 20.0, 0.01)
    goal = np.cos(time) * np.exp(-0.02 * time)
    position = 0.3 * np.sin(time**2 / 10.0)
    table = np.column_stack([time, position, goal])
    header = "time (s),position (rad),goal position (rad)"
    np.savetxt(tmp_path / "run.csv", table, delimiter=",", header=header, comments="", fmt="%.6f")
    ending = run("look", str(tmp_path / "run.csv"))
    assert "column goal position" not in ending.out


def test_a_force_that_swings_farther_than_wanted_and_measured_motion_is_asked_about(tmp_path):
    time = np.arange(0.0, 20.0, 0.01)
    wanted = 0.1 - 0.1 * np.cos(1.3 * time)
    measured = np.interp(time - 0.01, time, wanted)
    force = 4.0 * np.sign(np.sin(1.3 * time)) + np.cos(1.3 * time)
    table = np.column_stack([time, wanted, measured, force])
    np.savetxt(tmp_path / "axis.csv", table, delimiter=",", header="t,qg,qm,vir", comments="", fmt="%.9f")
    with pytest.raises(UsageError, match='such as --angle "qm" --input "vir"'):
        st.read_record(tmp_path / "axis.csv")


def test_the_force_of_an_axis_is_not_taken_for_an_angle(data_folder):
    file = data_folder / "emps" / "DATA_EMPS.mat"
    if not file.is_file():
        pytest.skip("no measured axis")
    with pytest.raises(UsageError, match='such as --angle "qm" --input "vir"'):
        st.read_record(file)


def test_an_input_acts_by_the_first_force_of_one_s_own_library_that_holds_it():
    joint = servo.library()
    taken = with_inputs_acting(joint.select(["gravity"]), ["goal", "kp", "on"], joint)
    assert taken.symbols == ("gravity", "motor")
    # Nothing is added where a named force holds the inputs.
    assert with_inputs_acting(taken, ["goal", "kp", "on"], joint) is taken


def test_a_driven_run_without_a_half_period_has_a_range(runs):
    lifted = runs[2].isel(time=slice(0, 100))
    largest = ranges([lifted])
    assert largest["x"] == pytest.approx(float(np.abs(lifted.angle).max()), rel=0.05)


def test_laws_do_not_lead_back_to_the_search_that_led_to_them(monkeypatch):
    tree = xr.DataTree.from_dict({"record": xr.Dataset(attrs={"record_checksum": "1"})})
    monkeypatch.setattr(steps, "kind_of", lambda tree: "laws")
    monkeypatch.setattr(steps.judged, "verdict_of", lambda tree: "approximate")
    others = steps.alternatives(tree, LawsOptions(records=[Path("a.csv")]))
    assert others
    assert not any("sysid-trib discover" in line for line in others)
    commands = {state: command for state, (command, _) in steps.NEXT_COMMANDS.items()}
    assert commands["unknown effect"] == "laws"
    assert commands["laws do not explain"] == ""
