"""Inputs as symbols of formulas: laws of driven motions, units, warm-ups, and errors."""

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import scipy
import xarray as xr
from command_line import run, write_table
from helpers import decay, emps_record, scores
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import sysid_trib as st
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.library import parse_library
from sysid_trib.physics.si_units import per_input
from sysid_trib.records.inputs import KnownInput, inputs_of
from sysid_trib.simulation.steps import expected_steps
from sysid_trib.validation.driven import identified_driven

W = 9.0
TIME = np.linspace(0.0, 12.0, 1201)
INPUTS = st.load_library("inputs")
DRIVEN = parse_library(
    {
        "force": [
            {"symbol": "gain", "formula": "-u"},
            {"symbol": "zeta", "formula": "2*v"},
            {"symbol": "epsilon", "formula": "x**3"},
            {"symbol": "lambda", "formula": "sign(v)"},
        ]
    },
    "driven",
)
TRUTH = {"gain": 0.02, "zeta": 0.02, "epsilon": 0.3, "lambda": 0.005}


def library(inputs: object = (), **formulas: str) -> st.forces.ForceLibrary:
    forces = [{"symbol": symbol, "formula": formula} for symbol, formula in formulas.items()]
    return parse_library({"inputs": inputs, "force": forces} if inputs else {"force": forces}, "test")


def tones(time: np.ndarray, order: int = 0) -> np.ndarray:
    """Two tones, or their derivative by time."""
    parts = [(0.3, 5.0, 0.0), (0.1, 13.0, 1.0)]
    return sum(a * w**order * np.sin(w * time + p + 0.5 * np.pi * order) for a, w, p in parts)


def broadband(seed: int, time: np.ndarray = TIME) -> np.ndarray:
    knots = np.linspace(time[0], time[-1], len(time) // 20)
    return 5.0 * np.interp(time, knots, np.random.default_rng(seed).standard_normal(len(knots)))


def driven_record(seed: int, truth: dict[str, float] = TRUTH, noise: float = 1e-4, **simulated) -> xr.Dataset:
    model = st.Model(DRIVEN, truth, W)
    record = st.simulate(model, TIME, 0.1, 0.0, inputs={"u": broadband(seed)}, **simulated)
    record["angle"] = record.angle + noise * np.random.default_rng([seed, 1]).standard_normal(len(TIME))
    record.angle.attrs["units"], record.u.attrs["units"] = "rad", "V"
    return record.drop_vars(["rate", "stop_time"])


def test_a_driven_motion_is_scipys() -> None:
    model = st.Model(
        library(gain="-u", damper="2*(v - du)", drive="0.5*u*x"),
        {"gain": 1.0, "damper": 0.02, "drive": 0.3},
        W,
    )
    found = st.simulate(model, TIME, 0.1, 0.0, inputs={"u": KnownInput(TIME, tones(TIME), "smooth")})

    def rates(t: float, y: np.ndarray) -> list[float]:
        u, du = tones(t), tones(t, 1) / W
        return [y[1], -(W**2) * (y[0] - u + 0.04 * (y[1] / W - du) + 0.15 * u * y[0])]

    exact = solve_ivp(
        rates, (0.0, TIME[-1]), [0.1, 0.0], t_eval=TIME, rtol=1e-11, atol=1e-13, method="DOP853"
    )
    np.testing.assert_allclose(found.angle, exact.y[0], atol=2e-9)


def test_a_moving_base_is_an_inertia_for_who_moves_with_it() -> None:
    """x = base + r: springs and dampers to the base are those at rest in r, driven by its acceleration."""
    base, acceleration = KnownInput(TIME, tones(TIME), "smooth"), KnownInput(TIME, tones(TIME, 2), "smooth")
    absolute = INPUTS.select(["base_spring", "base_damping"])
    seen = st.simulate(
        st.Model(absolute, {"base_spring": 1.0, "base_damping": 0.03}, W),
        TIME,
        0.2,
        0.5,
        inputs={"base": base},
    )
    relative = st.forces.ForceLibrary("", (*INPUTS.select(["base_inertia"]), *DRIVEN.select(["zeta"])))
    start = 0.2 - tones(0.0), 0.5 - tones(0.0, 1)
    moved = st.simulate(
        st.Model(relative, {"base_inertia": 1.0, "zeta": 0.03}, W),
        TIME,
        *start,
        inputs={"base_acceleration": acceleration},
    )
    np.testing.assert_allclose(seen.angle, moved.angle + tones(TIME), atol=1e-8)


@pytest.mark.parametrize(
    "method", [st.methods.Direct(random_force="off"), st.methods.Trajectory(random_force="off")]
)
def test_a_driven_record_gives_its_coefficients_with_their_units(method: object) -> None:
    result = st.identify(driven_record(3), DRIVEN, method)
    assert np.abs(scores(result, TRUTH)).max() < 4.0
    assert (result.standard_error / result.coefficient).max() < 0.01
    assert result.unit.sel(force="gain").item() == "1/V"
    in_mm = driven_record(3)
    in_mm["angle"] = (40.0 * in_mm.angle).assign_attrs(units="mm")
    scaled = st.identify(in_mm, DRIVEN, method)
    assert scaled.unit.values.tolist() == ["mm/V", "1", "mm^-2", "mm"]
    factors = np.array([40.0, 1.0, 40.0**-2, 40.0])
    np.testing.assert_allclose(scaled.coefficient, result.coefficient * factors, rtol=1e-5)


def test_a_record_that_begins_driven_and_ends_free_gives_the_forces_of_both_parts() -> None:
    drive = KnownInput(TIME, np.where(TIME < 5.0, broadband(3), 0.0))
    motion = st.simulate(st.Model(DRIVEN, TRUTH, W), TIME, 0.1, inputs={"u": drive})
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(TIME))
    record = motion.assign(angle=("time", motion.angle.values + noise, {"units": "rad"}))
    method = st.methods.Direct(random_force="off")
    both, part = (st.identify(r, DRIVEN, method) for r in (record, record.sel(time=slice(0.0, 4.99))))
    assert np.abs(scores(both, TRUTH)).max() < 4.0
    assert (both.standard_error < 0.8 * part.standard_error).all()


def test_stated_errors_tell_the_scatter() -> None:
    method = st.methods.Trajectory(random_force="off")
    z = [scores(st.identify(driven_record(seed), DRIVEN, method), TRUTH) for seed in range(6)]
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.35


def test_runs_have_common_and_separate_coefficients() -> None:
    runs = [driven_record(seed, TRUTH | {"lambda": friction}) for seed, friction in ((1, 0.004), (2, 0.008))]
    options = {"own": ("lambda",), "constraints": {"lambda": (0.0, None)}}
    methods = [kind(**options) for kind in (st.methods.Direct, st.methods.Trajectory)]
    tree = identified_driven(runs, DRIVEN, *methods)
    for method in ("direct", "trajectory"):
        result = tree[method].to_dataset()
        assert result.force.values.tolist() == ["gain", "zeta", "epsilon", "lambda_1", "lambda_2"]
        truth = {s: TRUTH[s] for s in ("gain", "zeta", "epsilon")} | {"lambda_1": 0.004, "lambda_2": 0.008}
        assert np.abs(scores(result, truth)).max() < 4.5
    assert tree["judged"].attrs["verdict"] == "explained"
    predicted = st.predict(tree["trajectory"].to_dataset(), runs[1], run=1)
    assert predicted.residual_rms == pytest.approx(1e-4, rel=0.1)
    wrong = st.predict(tree["trajectory"].to_dataset(), runs[1], run=0)
    assert wrong.residual_rms > 3.0 * predicted.residual_rms


def test_an_unseen_record_is_predicted_from_its_start() -> None:
    result = st.identify(driven_record(1), DRIVEN, st.methods.Direct())
    other = driven_record(2)
    whole, begun = st.predict(result, other), st.predict(result, other, warm_up=1.5)
    assert whole.residual_rms == pytest.approx(1e-4, rel=0.1)
    assert begun.residual_rms < 2e-4
    assert begun.attrs["warm_up"] == 1.5
    with pytest.raises(UsageError, match="warm-up of 90 s contains"):
        st.predict(result, other, warm_up=90.0)
    with pytest.raises(UsageError, match="contains the input u, which this record lacks"):
        st.predict(result, other.drop_vars("u"))


def test_a_body_without_a_restoring_force_has_its_mass_and_friction_in_the_input_s_unit() -> None:
    """M x'' = u - C x' - F sign(x') - F0 of an axis; synthetic."""
    mass, viscous, dry, bias, w = 2.0, 3.0, 0.5, 0.1, 6.0
    forces = INPUTS.select(["gain", "free_axis", "bias"])
    forces = st.forces.ForceLibrary("", (*forces, *DRIVEN.select(["zeta", "lambda"])))
    stiffness = mass * w**2
    truth = {
        "gain": 1.0 / stiffness,
        "free_axis": 1.0,
        "bias": bias / stiffness,
        "zeta": 0.5 * viscous * w / stiffness,
        "lambda": dry / stiffness,
    }
    push = 4.0 * np.sign(np.sin(2.0 * np.pi * 0.4 * TIME)) + np.sin(5.0 * TIME)
    record = st.simulate(st.Model(forces, truth, w), TIME, 0.0, 0.0, inputs={"u": push})
    noise = 1e-4 * np.random.default_rng(2).standard_normal(len(TIME))
    record["angle"] = (record.angle + noise).assign_attrs(units="m")
    held = {"free_axis": 1.0}
    tree = identified_driven(
        record, forces, st.methods.Direct(constraints=held), st.methods.Trajectory(constraints=held)
    )
    found = per_input(tree["trajectory"].to_dataset())
    wanted = {"mass": mass, "zeta": viscous, "lambda": dry, "bias": bias}
    for name, value in wanted.items():
        row = found.sel(quantity=name)
        assert abs(row.value - value) < 4.0 * row.standard_error
        assert row.standard_error < 0.02 * abs(value) + 0.01 * dry
    assert "stiffness" not in found.quantity


@pytest.fixture
def table(tmp_path):
    time, u = TIME[::2], broadband(4, TIME[::2])
    record = st.simulate(st.Model(DRIVEN, TRUTH, W), time, 0.1, inputs={"u": u})
    return write_table(
        tmp_path / "driven.csv", "time (s),drive (V),angle (rad)", time, u, record.angle.values
    )


def test_inputs_are_read_with_the_record_or_from_another_file(table, tmp_path) -> None:
    same = st.read_record(table, input="drive", angle="angle")
    assert same.u.attrs["units"] == "V"
    assert same.u.attrs["between"] == "smooth"
    formula = st.read_record(table, input={"u": "2*drive"}, angle="angle", between="held")
    np.testing.assert_allclose(formula.u, 2.0 * same.u)
    time = np.arange(-1.0, 14.0, 0.004)
    other = write_table(tmp_path / "drive.csv", "time (s),b (V)", time, np.sin(time))
    apart = st.read_record(table, input=f"{other}:b", angle="angle")
    assert apart.u.dims == ("u_time",)
    assert apart.sizes["u_time"] == len(time)
    result = st.identify(same, DRIVEN, st.methods.Direct())
    assert result.coefficient.sel(force="gain").item() == pytest.approx(0.02, rel=1e-3)


def test_the_input_of_each_run_is_that_of_the_file_most_like_it(tmp_path) -> None:
    for load in ("250g", "350g"):
        for column in "xy":
            values = np.sin(TIME * (1.0 + (load == "350g"))) * (1.0 + (column == "y"))
            write_table(tmp_path / f"s_{load}_{column}.csv", f"time (s),{column} (mm)", TIME, values)
    read = [st.read_record(tmp_path / f"s_{load}_x.csv", input="*_y.csv:y") for load in ("250g", "350g")]
    for record in read:
        np.testing.assert_allclose(record.u, 2.0 * record.angle, atol=1e-12)
    with pytest.raises(UsageError, match="must fit one file"):
        st.read_record(tmp_path / "s_250g_x.csv", input="*_z.csv:y")


def test_the_command_identifies_predicts_and_draws(table, tmp_path) -> None:
    read = ("--angle", "angle", "--input", "drive")
    asked = ("identify", table, *read, "--forces", "gain,zeta,epsilon,lambda")
    drawn = ("--json", "--plot", tmp_path / "figures")
    ending = run(*asked, "--test", table, *drawn)
    assert ending.status == 0, ending.err
    said = json.loads(ending.out)
    assert said["answer"] in said["methods"]
    for method in said["methods"].values():
        assert method["coefficients"]["gain"]["value"] == pytest.approx(0.02, rel=1e-3)
    assert said["per_input"]["mass"]["value"] == pytest.approx(1.0 / (0.02 * W**2), rel=1e-3)
    assert said["test"][0]["residual_over_motion"] < 1e-3
    assert (tmp_path / "figures" / "overview.pdf").exists()
    kept, page = tmp_path / "driven.nc", tmp_path / "driven.html"
    text = run(*asked, "--warm-up", "1.5", "-o", kept).out
    assert "In the unit of the input u: mass" in text
    assert run("report", kept, "-o", page).status == 0
    written = page.read_text(encoding="utf-8")
    assert "Forces of a driven record" in written
    assert "input={" in written
    assert "st.methods.Trajectory" in written
    assert "warm_up=1.5" in written


def test_an_input_of_another_length_or_kind_is_refused() -> None:
    record = driven_record(1)
    short = record.drop_vars("u").assign(u=("u_time", record.u.values[:600], record.u.attrs))
    short = short.assign_coords(u_time=("u_time", TIME[:600]))
    with pytest.raises(DecayError, match="covers 0 to"):
        st.identify(short, DRIVEN, st.methods.Direct())
    holed = record.copy(deep=True)
    holed.u[7] = np.nan
    with pytest.raises(DecayError, match=r"u at .* s is not a finite number"):
        st.identify(holed, DRIVEN, st.methods.Direct())
    with pytest.raises(UsageError, match="is in V, and these forces take it as displacement in rad"):
        st.identify(record, library({"u": "displacement"}, spring="-u", zeta="2*v"), st.methods.Direct())
    of_free_motions = st.methods.Averaging(), st.methods.Direct(form="strong"), st.methods.LinearDecrement()
    for method in of_free_motions:
        with pytest.raises(UsageError, match="known input"):
            st.identify(record, DRIVEN.select(["zeta"]), method)
    with pytest.raises(UsageError, match="No force contains the input q"):
        st.simulate(st.Model(DRIVEN, TRUTH, W), TIME, inputs={"q": TIME})


@pytest.mark.slow
def test_the_friction_of_a_measured_axis_is_that_of_its_publication(data_folder) -> None:
    record = emps_record(data_folder, "gtau*vir")
    forces = st.forces.ForceLibrary(
        "", (*INPUTS.select(["gain", "free_axis", "bias"]), *DRIVEN.select(["zeta", "lambda"]))
    )
    direct = st.methods.Direct(
        reference_frequency=10.0, constraints={"free_axis": 1.0}, random_force="estimated"
    )
    found = per_input(st.identify(record, forces, direct)).value
    published = {"mass": 95.11, "zeta": 203.5, "lambda": 20.39, "bias": -3.16}
    for name, value in published.items():
        assert found.sel(quantity=name).item() == pytest.approx(value, rel=0.01)


def test_rounding_does_not_decide_whether_a_motion_is_found(data_folder) -> None:
    """A frame that slips one way at first: friction and the sensor's zero are one there."""
    folder = data_folder / "friction_frame"
    run = st.read_record(
        folder / "s_b_550g_x.mat", time="t", units="mm", input={"base": f"{folder / 's_b_550g_y.mat'}:y"}
    ).isel(time=slice(1250))
    forces = (*INPUTS.select(["base_spring", "base_damping"]), *st.load_library().select(["lambda"]))
    method = st.methods.Trajectory(constraints={"base_spring": 1.0}, random_force="off")
    results = []
    for seed in range(2):
        rounding = np.random.default_rng(seed).normal(1.0, 1e-12, run.sizes["time"])
        result = method.identify(run.assign(angle=run.angle * rounding), replace(INPUTS, forces=forces))
        assert result.noise < 0.1 * run.angle.std()
        results.append(result.coefficient)
    np.testing.assert_allclose(*results, rtol=1e-6)


PUSH = np.cos(np.outer(TIME, np.linspace(1.0, 18.0, 30)) + np.arange(30.0) ** 2).sum(axis=1) / 4.0


@pytest.fixture
def record_file(tmp_path: Path) -> Path:
    model = st.Model(DRIVEN.select(["gain", "zeta"]), {"gain": 0.05, "zeta": 0.02}, 9.9)
    angle = st.simulate(model, TIME, 0.1, inputs={"u": PUSH}).angle.values
    angle = angle + 1e-4 * np.random.default_rng(0).standard_normal(len(TIME))
    return write_table(tmp_path / "run.csv", "time (s),torque (N*m),angle (rad)", TIME, PUSH, angle)


def test_a_unit_keeps_its_capitals_and_the_coefficient_is_over_all_of_it(record_file: Path) -> None:
    record = st.read_record(record_file, input="torque")
    assert record.u.attrs["units"] == "N*m"
    result = st.methods.Direct().identify(record, DRIVEN.select(["gain", "zeta"]))
    gain = result.sel(force="gain")
    assert gain.unit.item() == "1/(N*m)"
    assert abs(gain.coefficient.item() - 0.05) < 4.0 * gain.standard_error.item()


@pytest.mark.parametrize(
    ("header", "unit"), [("u (v)", "V"), ("base (MM)", "mm"), ("F [N]", "N"), ("u", None)]
)
def test_a_known_unit_is_written_as_it_should_be(tmp_path: Path, header: str, unit: str | None) -> None:
    path = write_table(tmp_path / "run.csv", f"time (s),{header},angle (rad)", TIME, PUSH, 0.1 * PUSH)
    name = header.partition(" ")[0]
    assert st.read_record(path, input=name).u.attrs.get("units") == unit


NOISE, WARM_UP = 1e-4, 6.0
HYSTERESIS = st.load_library("hysteresis")
LIBRARY = replace(
    HYSTERESIS,
    forces=(
        *st.load_library("inputs").select(["gain"]),
        *st.load_library("contact_forces").select(["zeta"]),
        *HYSTERESIS.select(["bouc_wen_n"]),
    ),
)
MOVED = {"gain": 0.05, "zeta": 0.02, "bouc_wen_n": 0.5}
SHAPES = {"bouc_wen_n.s": 0.05, "bouc_wen_n.g": -0.3, "bouc_wen_n.n": 1.0}


def record() -> xr.Dataset:
    """Under a multisine, with a start at which the body is already moving."""
    rng, time = np.random.default_rng(2), np.arange(0.0, 40.0, 0.03)
    tones = np.outer(time, W * np.linspace(0.1, 2.0, 40)) + rng.uniform(0.0, 6.28, 40)
    force = KnownInput(time, np.cos(tones).sum(axis=1) / 2.0, "smooth")
    motion = st.simulate(st.Model(LIBRARY, MOVED, W, SHAPES), time, 0.0, inputs={"u": force})
    angle = motion.angle.values + NOISE * rng.standard_normal(len(time))
    data = {
        "angle": ("time", angle, {"units": "rad"}),
        "u": ("time", force.values, {"units": "N", "role": "input", "between": "smooth"}),
    }
    return xr.Dataset(data, {"time": time}).isel(time=slice(300, None))


def fitted(run: xr.Dataset, warm_up: float) -> xr.Dataset:
    """Fit from a model that is wrong by a tenth."""
    shapes = SHAPES | {"bouc_wen_n.s": 0.055}
    near = {"gain": 0.055, "zeta": 0.02, "bouc_wen_n": 0.45}
    method = st.methods.Trajectory(
        start=st.Model(LIBRARY, near, W, shapes),
        fit_shapes=("bouc_wen_n.s", "bouc_wen_n.g"),
        warm_up=warm_up,
        random_force="off",
    )
    return method.identify(run, LIBRARY)


@pytest.mark.slow
def test_hysteresis_is_fitted_to_the_noise_once_its_beginning_is_forgotten():
    run = record()
    result = fitted(run, WARM_UP)
    assert result.residual_rms.item() == pytest.approx(NOISE, rel=0.08)
    found = result.sel(shape_parameter=["bouc_wen_n.s", "bouc_wen_n.g"])
    off = np.abs(found["shape"].values - [0.05, -0.3])
    assert np.all(off < 5.0 * found.shape_standard_error.values)
    assert np.abs(scores(result, MOVED)).max() < 5.0
    assert fitted(run, 0.0).residual_rms.item() > 1.05 * result.residual_rms.item()


@pytest.mark.parametrize(("warm_up", "words"), [(-1.0, "is not a time"), (30.9, "give a shorter one")])
def test_a_warm_up_that_cannot_be_is_refused(warm_up, words):
    with pytest.raises(UsageError, match=words):
        fitted(record(), warm_up)


PUSHED = {"lambda": 1e-3, "zeta": 0.01, "epsilon": -0.1}
FREE = st.load_library("contact_forces").select(PUSHED)
MODEL = st.Model(FREE, PUSHED, 9.9)
BESIDE = [kind(random_force="estimated") for kind in (st.methods.Direct, st.methods.Trajectory)]


def accelerated(seed: int, random_force: float = 0.0, periods: int = 12) -> xr.Dataset:
    """A record with a known acceleration: a tone near the resonance, and random steps."""
    time = np.arange(periods * 40) * 2.0 * np.pi / 9.9 / 40
    steps = np.random.default_rng([seed, 9]).standard_normal(len(time) // 4 + 1).repeat(4)[: len(time)]
    known = 3.0 * np.sin(7.3 * time) + 1.5 * steps
    record = st.simulate(MODEL, time, 0.1, known_input=known, random_force=random_force, seed=seed)
    return record.assign(angle=record.angle + decay(time, 0.0 * time, seed, 2e-4).angle.values)


def test_friction_holds_until_the_input_overcomes_it() -> None:
    time = np.linspace(0.0, 2.5, 160)
    push = 0.1 * 9.9**2 * time / time[-1]
    stuck = st.Model(FREE.select(["lambda"]), {"lambda": 0.05}, 9.9)
    angle = st.simulate(stuck, time, 0.0, known_input=push).angle.values
    assert np.all(angle[push < 0.05 * 9.9**2] == 0.0)
    assert np.all(angle[push > 0.051 * 9.9**2] > 0.0)


@pytest.mark.parametrize("method", BESIDE, ids=lambda method: method.scope.label)
def test_forces_with_a_random_force_and_a_known_acceleration(method: object) -> None:
    result = st.identify(accelerated(1), FREE, method)
    assert np.max(np.abs(scores(result, PUSHED))) < 3.5
    assert abs(result.reference_frequency - 9.9) < 3.5 * result.reference_frequency_standard_error
    assert float(result.standard_error.sel(force="zeta")) < 2e-4


def test_without_its_input_a_drive_is_taken_for_something_else() -> None:
    known, unknown = (
        st.identify(record, FREE, st.methods.Direct())
        for record in (accelerated(1), accelerated(1).drop_vars("input"))
    )
    assert np.max(np.abs((unknown.coefficient - known.coefficient) / known.standard_error)) > 20.0


def test_columns_of_a_driven_record_lead_to_the_option_of_the_input(tmp_path: Path) -> None:
    time = np.arange(0.0, 20.0, 0.01)
    draw = np.random.default_rng(0)
    drive = sum(np.sin(2.0 * np.pi * f * time + draw.uniform(0.0, 6.3)) for f in np.linspace(0.6, 2.4, 25))
    system = ([1.0], [1.0 / 9.0**2, 2.0 * 0.02 / 9.0, 1.0])
    _, motion, _ = scipy.signal.lsim(system, drive, time)
    path = write_table(tmp_path / "run.csv", "time (s),V1 (V),V2 (V)", time, drive, motion)
    said = run("look", path).complaint
    assert "--input COLUMN" in said
    assert "one mode" not in said


def test_innovations_and_bands_know_the_input() -> None:
    record = accelerated(3, 1e-4, periods=20)
    result = st.identify(record, FREE, BESIDE[0])
    assert float(st.validation.innovations(record, result).ljung_box_p_value) > 1e-3
    bands = st.validation.prediction_bands(record, result)
    assert np.nanmax(np.abs((bands.measured - bands.predicted) / bands.predicted_standard_error)) < 4.0


@pytest.mark.parametrize("between", ["linear", "held", "cubic"])
def test_the_input_between_samples_acts_on_the_motion(between: str) -> None:
    """Against a motion by scipy, restarted at each sample; steps of a filter agree with the same motion."""
    time = np.linspace(0.0, 4.0, 41)
    known = KnownInput(time, 3.0 * np.sin(7.3 * time) + np.cos(29.0 * time), between)
    model = replace(MODEL, coefficients={"zeta": 0.01, "epsilon": 0.4})
    run = st.simulate(model, time, 0.1, 0.2, known_input=known)
    spline, y = CubicSpline(time, known.values), [np.array([0.1, 0.2])]

    def rates(t: float, y: np.ndarray, u0: float, u1: float, low: float) -> list[float]:
        u = {"linear": u0 + (u1 - u0) * (t - low) / 0.1, "held": u0, "cubic": float(spline(t))}[between]
        return [y[1], u - 9.9**2 * (y[0] + 0.02 * y[1] / 9.9 + 0.4 * y[0] ** 3)]

    for i, (low, high) in enumerate(pairwise(time)):
        within = {"args": (*known.values[i : i + 2], low), "rtol": 1e-11, "atol": 1e-12, "method": "DOP853"}
        y.append(solve_ivp(rates, (low, high), y[-1], **within).y[:, -1])
    np.testing.assert_allclose(run.angle, np.array(y)[:, 0], atol=1e-9)
    states = np.stack([run.angle, run.rate / 9.9], axis=1)
    steps = expected_steps(replace(model, inputs={"input": known}), time, states, 0.0)
    np.testing.assert_allclose(steps.end, states[1:], atol=1e-9)
    assert run.input.attrs["between"] == between


@pytest.mark.parametrize("units", [None, "V", "N m"])
def test_an_input_that_is_no_acceleration_is_refused(units: str | None) -> None:
    record = accelerated(1)
    record.input.attrs = {} if units is None else {"units": units}
    with pytest.raises(UsageError, match=r"rad/s\^2"):
        st.identify(record, FREE, st.methods.Direct())


STEPPED = np.repeat(np.random.default_rng(1).standard_normal(40), 30)


@pytest.mark.parametrize(
    ("name", "values", "between"),
    [
        ("tones", tones(TIME), "smooth"),
        ("coarse step of the sensor", np.round(tones(TIME), 2), "smooth"),
        ("pulse of a hammer", np.where(abs(TIME - 3.0) < 0.05, np.cos(31.4 * (TIME - 3.0)), 0.0), "smooth"),
        ("switch thrown once", np.where(TIME > 2.0, 1.0, 0.0), "held"),
        ("square wave", np.sign(np.sin(3.0 * TIME + 0.1)), "held"),
        ("converter", STEPPED, "held"),
    ],
)
def test_an_input_is_smooth_between_its_samples_unless_it_moves_in_steps(
    name: str, values: np.ndarray, between: str, tmp_path: Path
) -> None:
    """The same holds in memory, in files, and in a simulation."""
    time = TIME[: len(values)]
    record = xr.Dataset({"angle": ("time", tones(time)), "u": ("time", values, {"role": "input"})})
    assert inputs_of(record.assign_coords(time=time))["u"].between == between, name
    path = write_table(tmp_path / "run.csv", "time (s),torque,angle (rad)", time, values, tones(time))
    assert st.read_record(path, input="torque").u.attrs["between"] == between
    assert st.read_record(path, input="torque", between="linear").u.attrs["between"] == "linear"
    moved = st.simulate(st.Model(DRIVEN, {"gain": 0.02}, W), time[:100], 0.1, inputs={"u": values[:100]})
    assert between == "held" or moved.u.attrs["between"] == "smooth"
