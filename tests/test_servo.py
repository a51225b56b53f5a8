"""A joint with a control loop: expressions, coefficients in formulas, known constants, a friction law."""

import json
import tomllib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from command_line import run

import sysid_trib as st
from benchmarks import servo
from sysid_trib.errors import LibraryError, UsageError
from sysid_trib.forces.library import library_of_text
from sysid_trib.motion_fit.least_squares import Fit
from sysid_trib.motion_fit.problem import FitProblem, WhitenedRecord
from sysid_trib.questions.difference import held_against
from sysid_trib.records.driven_parts import driven_parts
from sysid_trib.records.inputs import KnownInput, inputs_of
from sysid_trib.records.roles import constants_of
from sysid_trib.results.files import save
from sysid_trib.simulation.trajectory import trajectory

FORCES = ("gravity", "motor", "back_emf", "lambda", "zeta", "load_friction")
TRUTH = {"gravity": 1.0, "motor": 1.5, "back_emf": 0.6, "lambda": 0.02, "zeta": 0.06, "load_friction": 0.25}
W, NOISE = 8.4, 5e-4
TIME = np.arange(0.0, 6.0, 0.02)
GOALS = {"sweep": np.sin(TIME**2 / 1.5), "lift": 1.2 * np.clip(TIME / 2.0, 0.0, 1.0)}
COLUMNS = {"goal": "goal position", "on": "torque on"}
HELD = {"gravity": 1.0}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("servo")
    (place / "servo.toml").write_text(servo.library_text(0.003), encoding="utf-8")
    forces = st.load_library(place / "servo.toml").select(FORCES)
    for kp, motion in ((kp, motion) for kp in (100, 400) for motion in GOALS):
        moved = stored(forces, kp, motion, {})
        position, on = moved.angle.values, moved["on"].values
        columns = np.column_stack([TIME, position, GOALS[motion], np.full_like(TIME, kp), on])
        header = "time (s),position (rad),goal position (rad),kp,torque on"
        file = place / f"kp{kp}_{motion}.csv"
        np.savetxt(file, columns, delimiter=",", header=header, comments="", fmt="%.6f")
    return place


@pytest.fixture(scope="module")
def joint(folder):
    return st.load_library(folder / "servo.toml")


def record_of(folder: Path, name: str, **how) -> xr.Dataset:
    given = {"input": COLUMNS, "constants": {"kp": "kp"}} | how
    record = st.read_record(folder / f"{name}.csv", angle="position (rad)", **given)
    record["goal"].attrs["between"] = "linear"
    return record


@pytest.fixture(scope="module")
def runs(folder):
    return [record_of(folder, f"kp{kp}_{motion}") for kp in (100, 400) for motion in GOALS]


def test_a_library_with_expressions_reads_back_as_it_was_written(joint):
    assert joint["load_friction"].uses == ("back_emf", "motor", "motor_saturation", "tilt")
    assert joint["load_friction"].inputs == ("goal", "kp", "on")
    again = library_of_text(joint.to_toml(), "again")
    assert again.forces == joint.forces
    # Also if the library lacks the force whose coefficient is in the formula.
    alone = joint.select(["load_friction"])
    assert library_of_text(alone.to_toml(), "alone").forces == alone.forces


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ('[expressions]\na = "a"\n[[force]]\nsymbol = "f"\nformula = "a"', "'a' contains itself"),
        ('[expressions]\na = "b"\nb = "a"\n[[force]]\nsymbol = "f"\nformula = "a"', "are circular"),
        ('[expressions]\nsin = "x"\n[[force]]\nsymbol = "f"\nformula = "x"', "cannot name an expression"),
        ('[expressions]\na = 1\n[[force]]\nsymbol = "f"\nformula = "a"', "must be a formula in quotes"),
        ('include = ["no_such"]\n[[force]]\nsymbol = "f"\nformula = "x"', "no library 'no_such'"),
        ('[expressions]\na = "import"\n[[force]]\nsymbol = "f"\nformula = "a"', "is not a formula"),
    ],
)
def test_a_bad_expression_is_refused(text, reason):
    with pytest.raises(LibraryError, match=reason):
        library_of_text(text, "bad")


def test_derivatives_by_a_coefficient_that_another_formula_holds_are_those_of_differences(joint, runs):
    forces = joint.select(FORCES)
    known = inputs_of(runs[2])

    def angle(**changed: float) -> np.ndarray:
        model = st.Model(forces, TRUTH | changed, W, inputs=known)
        return trajectory(model, TIME, 0.01, 0.0).angle

    step = 1e-6
    by = ("motor", "back_emf", "load_friction")
    exact = trajectory(st.Model(forces, TRUTH, W, inputs=known), TIME, 0.01, 0.0, by=by).derivatives["angle"]
    for at, symbol in enumerate(by):
        ends = [angle(**{symbol: TRUTH[symbol] + side * step}) for side in (-1.0, 1.0)]
        difference = (ends[1] - ends[0]) / (2.0 * step)
        assert np.median(np.abs(exact[:, at] - difference)) < 1e-6 * np.abs(difference).max()


def test_both_methods_find_the_friction_law_of_the_joint(joint, runs):
    forces, w = joint.select(FORCES), []
    direct = st.methods.Direct(random_force="off", constraints=HELD)
    motion = st.methods.Trajectory(random_force="off", constraints=HELD, starts="measured")
    for method in (direct, motion):
        result = st.identify(runs, forces, method)
        for symbol in FORCES[1:]:
            assert result.coefficient.sel(force=symbol).item() == pytest.approx(TRUTH[symbol], rel=0.05)
        w.append(result.reference_frequency.item())
    assert w == pytest.approx([W, W], rel=2e-3)


@pytest.mark.parametrize("method", ["direct", "fitted", "measured"])
def test_delay_gain_and_zero_of_the_sensor_are_found_with_the_forces(joint, method):
    # The control loop sees the true angle: the terms belong to the recorder.
    sensor = {"sensor_delay": 0.05, "sensor_gain": 0.03, "sensor_bias": 0.02}
    forces = joint.select((*FORCES, *sensor))
    recorded = [stored(forces, kp, motion, sensor) for kp in (100, 400) for motion in GOALS]
    how = {"random_force": "off", "constraints": HELD}
    direct = st.methods.Direct(**how)
    chosen = direct if method == "direct" else st.methods.Trajectory(**how, starts=method)
    result = st.identify(recorded, forces, chosen)
    for symbol, value in sensor.items():
        assert result.coefficient.sel(force=symbol).item() == pytest.approx(value, rel=0.15)
        assert 0.0 < result.standard_error.sel(force=symbol).item() < 0.2 * value
    assert result.coefficient.sel(force="lambda").item() == pytest.approx(TRUTH["lambda"], rel=0.05)
    # With a common zero for all runs, no run has a separate zero.
    assert not np.any(result.offset.values)


def test_a_control_loop_may_see_the_zero_of_its_sensor(folder):
    text = servo.library_text(0.003, seen="x + sensor_bias")
    biased = library_of_text(text, "biased").select((*FORCES, "sensor_bias"))
    runs = [stored(biased, kp, motion, {"sensor_bias": 0.03}) for kp in (100, 400) for motion in GOALS]
    method = st.methods.Trajectory(random_force="off", constraints=HELD, starts="measured")
    result = st.identify(runs, biased, method)
    assert result.coefficient.sel(force="sensor_bias").item() == pytest.approx(0.03, rel=0.02)
    assert result.coefficient.sel(force="motor").item() == pytest.approx(TRUTH["motor"], rel=0.02)


def test_a_measured_start_is_the_value_of_the_sensor(joint):
    forces, sensor = joint.select((*FORCES, "sensor_bias")), {"sensor_bias": 0.05}
    run = stored(forces, 400, "lift", sensor)
    method = st.methods.Trajectory(random_force="off", constraints=HELD | sensor, starts="measured")
    result = st.identify([run, stored(forces, 100, "lift", sensor)], forces, method)
    np.testing.assert_allclose(result.start_angle.values, 0.0, atol=3.0 * NOISE)
    predicted = st.predict(result, run, starts="measured")
    assert abs(predicted.residual.values[:50].mean()) < NOISE


def test_errors_of_an_incomplete_law_are_those_between_runs():
    """In a linear model the covariance is that of leaving out one run at a time."""
    random = np.random.default_rng(5)
    time = np.arange(30.0)
    design, target = random.standard_normal((8 * len(time), 2)), random.standard_normal(8 * len(time))
    values, *_ = np.linalg.lstsq(design, target, rcond=None)
    record = WhitenedRecord(time, time)
    problem = FitProblem(_TwoParameters(), (record,) * 8, [], None)
    fit = Fit(problem, values, design @ values - target, design)
    without = []
    for left_out in np.array_split(np.arange(len(target)), 8):
        kept = np.setdiff1d(np.arange(len(target)), left_out)
        without.append(np.linalg.lstsq(design[kept], target[kept], rcond=None)[0] - values)
    jackknife = 7.0 / 8.0 * np.transpose(without) @ without
    own = fit._covariance_between(fit._ends(1))
    np.testing.assert_allclose(own, jackknife, rtol=1e-9)
    assert np.all(np.diag(fit.clustered_covariance) >= np.diag(own) * (1.0 - 1e-9))


class _TwoParameters:
    """Two free parameters."""

    free = np.arange(2)

    @staticmethod
    def jacobian(values):
        return np.eye(len(values))


def test_a_switch_has_no_unit(joint, runs):
    result = st.identify(runs, joint.select(FORCES), st.methods.Direct(random_force="off", constraints=HELD))
    assert result.unit.sel(force=["motor", "back_emf"]).values.tolist() == ["1", "1"]


def test_a_run_without_a_half_period_is_no_obstacle_where_the_motion_is_driven(joint, runs):
    slow = runs[3].isel(time=slice(0, 150))
    result = st.identify(
        [slow],
        joint.select(("gravity", "motor", "lambda")),
        st.methods.Direct(random_force="off", constraints=HELD),
    )
    assert np.isfinite(result.coefficient.values).all()


def test_runs_with_the_torque_always_on_do_not_separate_back_emf_from_viscous_friction(joint, runs):
    forces = joint.select(FORCES)
    told = st.validation.identifiability([runs[0], runs[2]], forces, constraints=HELD)
    assert told.attrs["sentences"] == (
        "These runs do not separate back_emf and zeta; a run in which on is 0 does."
    )
    assert told.inflation.sel(parameter="motor").item() < 5.0
    assert st.validation.identifiability(runs, forces, constraints=HELD).attrs["sentences"] == ""


def test_the_command_states_the_motion_that_separates_forces(folder):
    ending = command(folder, ["kp100_sweep.csv"], FORCES)
    assert ending.status == 1
    assert "the same force" in ending.err
    assert "a run in which on is 0 does" in ending.err


def command(folder, names, forces, *further, constant="kp=kp", inputs="goal=goal position,on=torque on"):
    files = [str(folder / name) for name in names]
    how = ["--angle", "position (rad)", "--input", inputs, "--between", "linear", "--constant", constant]
    how += ["--library", str(folder / "servo.toml"), "--forces", ",".join(forces), "--fix", "gravity=1"]
    return run("identify", *files, *how, *further)


@pytest.mark.slow
def test_known_constants_stand_with_the_runs(folder):
    names = [f"kp{kp}_{motion}.csv" for kp in (100, 400) for motion in GOALS]
    ending = command(folder, names, FORCES, "--starts", "measured")
    assert ending.status == 0, ending.err
    assert "Known constants of the runs:" in ending.out
    rows = [line.split() for line in ending.out.splitlines() if line.startswith("kp") and ".csv" in line]
    assert rows == [[name, name[2:5]] for name in names]


def test_parameters_leave_with_their_covariance_as_toml_and_json(joint, runs, tmp_path):
    result = st.identify(runs, joint.select(FORCES), st.methods.Direct(random_force="off", constraints=HELD))
    save(result, tmp_path / "joint.nc")
    data = {}
    for language, read in (("toml", tomllib.loads), ("json", json.loads)):
        out = tmp_path / f"joint.{language}"
        assert run("export", str(tmp_path / "joint.nc"), "--as", language, "-o", str(out)).status == 0
        data[language] = read(out.read_text(encoding="utf-8"))
    assert data["toml"] == data["json"]
    forces = {force["symbol"]: force for force in data["toml"]["forces"]}
    assert forces["load_friction"]["value"] == pytest.approx(0.25, rel=0.05)
    assert forces["load_friction"]["uses"] == ["back_emf", "motor", "motor_saturation", "tilt"]
    variances = np.diag(data["toml"]["covariance"]["values"])
    errors = [force["standard_error"] for force in data["toml"]["forces"]]
    np.testing.assert_allclose(np.sqrt(variances[:-1]), errors, rtol=1e-9)


@pytest.mark.parametrize(
    ("given", "inputs", "said"),
    [
        ("kp=torque on", "goal=goal position,on=torque on", "the constant kp changes within the run"),
        ("kp=gain", "goal=goal position,on=torque on", "the constant kp is not known"),
        ("kp=1,2,3", "goal=goal position,on=torque on", "contains 3 values for 1 records"),
        ("kp=nan", "goal=goal position,on=torque on", "the constant kp is nan, which is no finite number"),
        ("kp=1e400", "goal=goal position,on=torque on", "the constant kp is inf, which is no finite number"),
        ("kp=kp", "goal=wanted,on=torque on", "there is no single column 'wanted'"),
        ("kp=kp", "on=torque on", "contains the input goal, which this record lacks"),
        ("kp=kp", "kp=kp,goal=goal position", "given as an input and as a constant"),
    ],
)
def test_a_constant_that_is_none_is_refused_in_a_sentence(folder, given, inputs, said):
    ending = command(folder, ["kp100_lift.csv"], FORCES, constant=given, inputs=inputs)
    assert ending.status in (1, 2)
    assert said in ending.err
    assert ending.err.count("\n") == 1


@pytest.mark.parametrize("asked", ["", " , "])
@pytest.mark.parametrize("of", ["identify", "laws"])
def test_an_empty_name_is_no_coefficient_of_each_run(folder, asked, of):
    files = [str(folder / f"kp{kp}_lift.csv") for kp in (100, 400)]
    ending = run(of, *files, "--angle", "position (rad)", "--input", "goal position", "--own", asked)
    assert ending.status == 2
    assert ending.err.startswith(f"sysid-trib: --own '{asked}' names nothing; ")
    assert ending.err.count("\n") == 1


def test_constants_of_a_table_go_to_their_records(folder, tmp_path):
    table = tmp_path / "runs.csv"
    table.write_text("record,kp\nkp400_lift.csv,400\nkp100_lift.csv,100\n", encoding="utf-8")
    ending = command(
        folder,
        ["kp100_lift.csv", "kp400_lift.csv"],
        ("gravity", "motor", "lambda"),
        constant=f"kp={table}:kp",
    )
    rows = [line.split() for line in ending.out.splitlines() if line.startswith("kp") and ".csv" in line]
    assert rows == [["kp100_lift.csv", "100"], ["kp400_lift.csv", "400"]]
    table.write_text("record,kp\nkp400_lift.csv,400\n", encoding="utf-8")
    ending = command(folder, ["kp100_lift.csv"], FORCES, constant=f"kp={table}:kp")
    assert "has no row for record 'kp100_lift.csv'" in ending.err


def test_a_constant_may_stand_in_the_head_of_a_file(folder, tmp_path):
    file = tmp_path / "noted.csv"
    text = (folder / "kp400_lift.csv").read_text(encoding="utf-8")
    file.write_text(f"# load = 2.5\n{text}", encoding="utf-8")
    record = st.read_record(
        file, angle="position (rad)", input=COLUMNS, constants={"load": "load", "m": 0.49}
    )
    assert constants_of(record) == {"load": 2.5, "m": 0.49}


def test_a_switch_that_is_thrown_once_is_held_between_its_samples(folder):
    record = record_of(folder, "kp100_lift")
    assert record["on"].attrs["between"] == "held"


def test_a_start_as_measured_fits_nothing_to_the_record(joint, runs):
    forces = joint.select(FORCES)
    method = st.methods.Trajectory(random_force="off", constraints=HELD, starts="measured")
    result = st.identify(runs[:3], forces, method)
    predicted = st.predict(result, runs[3], starts="measured")
    assert predicted.residual_rms.item() < 3.0 * NOISE
    with pytest.raises(UsageError, match="no warm-up"):
        st.predict(result, runs[3], starts="measured", warm_up=1.0)


def test_two_motors_are_distinguished_by_all_of_their_runs(joint):
    forces = joint.select(FORCES)
    other = [stored(forces, kp, motion, {"load_friction": 0.4}) for kp in (100, 400) for motion in GOALS]
    first = [stored(forces, kp, motion, {}) for kp in (100, 400) for motion in GOALS]
    method = st.methods.Trajectory(random_force="off", starts="measured")
    tree = held_against(first, other, forces, method, constraints=HELD)
    differs = dict(zip(tree.force.values.tolist(), tree.differs.values.tolist(), strict=True))
    assert differs.pop("load_friction")
    assert not any(differs.values())
    assert tree.difference.sel(force="load_friction").item() == pytest.approx(-0.15, abs=0.01)


def stored(forces, kp, motion, changed) -> xr.Dataset:
    """A run of a motor in memory."""
    on = np.where((motion == "lift") & (TIME > 3.5), 0.0, 1.0)
    known = {
        "goal": KnownInput(TIME, GOALS[motion], "linear"),
        "kp": KnownInput(TIME, np.full_like(TIME, kp), "held"),
        "on": KnownInput(TIME, on, "held"),
    }
    moved = st.simulate(st.Model(forces, TRUTH | changed, W), TIME, 0.0, inputs=known)
    noise = np.random.default_rng([kp, len(motion), len(changed)]).standard_normal(len(TIME))
    return moved.assign(angle=moved.angle + NOISE * noise)


@pytest.mark.slow
@pytest.mark.skipif(not servo.FOLDER.is_dir(), reason="no measured servo")
def test_load_dependent_friction_predicts_a_gain_that_was_kept_back():
    training = servo.runs_of([100, 800])
    others = servo.runs_of([400])
    errors = {}
    for law in ("Coulomb and viscous", servo.CHOSEN):
        result, _ = servo.fitted(training, law)
        errors[law] = float(np.mean(servo.absolute_error(result, others)))
    first, second = errors.values()
    assert second < 0.75 * first
    assert all(first >= second for first, second in pairwise(errors.values()))


def test_a_sensor_at_the_end_of_its_range_is_refused_in_a_sentence(folder, tmp_path):
    lines = (folder / "kp400_sweep.csv").read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in lines[1:]]
    cut = [",".join([row[0], f"{min(float(row[1]), 0.5):.6f}", *row[2:]]) for row in rows]
    (tmp_path / "cut.csv").write_text("\n".join([lines[0], *cut]), encoding="utf-8")
    (tmp_path / "servo.toml").write_text(servo.library_text(0.003), encoding="utf-8")
    ending = command(tmp_path, ["cut.csv"], ("gravity", "motor", "lambda"))
    assert ending.status == 1
    assert "The sensor saturates: the angle is cut off at 0.5 rad" in ending.err
    assert ending.err.count("\n") == 1


@pytest.mark.skipif(not servo.FOLDER.is_dir(), reason="no measured servo")
def test_an_arm_that_rests_at_its_largest_angle_is_no_sensor_that_saturates():
    for gain, motion in ((100, "lift_and_drop"), (400, "up_and_down")):
        (part,) = driven_parts(servo.run_of(gain, motion))
        assert part.sizes["time"] > 1000
