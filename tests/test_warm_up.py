"""Starts of predictions: fitted to the warm-up alone, and until the fit has converged."""

import numpy as np
import pytest
import xarray as xr
from helpers import emps_record, library_of_formulas
from hypothesis import given, settings, strategies

import sysid_trib as st
from sysid_trib.forces.library import parse_library
from sysid_trib.printing.driven import prediction_block
from sysid_trib.records.own_quantity import with_own_quantity
from sysid_trib.validation.start_search import fit_start_of_several

STEP = 0.01
TIME = STEP * np.arange(900)
NOISE = 1e-5
# A pendulum that is pushed, and a carriage without a spring, which sticks.
PENDULUM = library_of_formulas(gain="-u", zeta="2*v", epsilon="x**3")
SWINGS = st.Model(PENDULUM, {"gain": 0.02, "zeta": 0.02, "epsilon": 0.2}, 9.0)
CARRIAGE = library_of_formulas(free_axis="-x", gain="-u", zeta="2*v", **{"lambda": "sign(v)"})
ROLLS = st.Model(CARRIAGE, {"free_axis": 1.0, "gain": 0.0125, "zeta": 0.1, "lambda": 0.006}, 6.0)
FREE = {"free_axis": 1.0}
WARM_UP = 20 * STEP - 0.5 * STEP


def driven(model: st.Model, unit: str, seed: int, angle: float = 0.1) -> xr.Dataset:
    push = np.random.default_rng(seed).standard_normal(31)
    u = 4.0 * np.interp(TIME, np.linspace(0.0, TIME[-1], 31), push)
    record = st.simulate(model, TIME, angle, 0.3, inputs={"u": u})
    noise = NOISE * np.random.default_rng([seed, 1]).standard_normal(TIME.size)
    return record.assign(angle=(record.angle + noise).assign_attrs(units=unit))


def plain(record: xr.Dataset) -> xr.Dataset:
    return record.drop_vars(["rate", "stop_time"])


def of_rate(record: xr.Dataset) -> xr.Dataset:
    """The same record by a gyroscope."""
    attrs = {"measured": "rate", "integrations": 1}
    rate = record.rate + 10.0 * NOISE * np.random.default_rng(9).standard_normal(TIME.size)
    rate = rate.assign_attrs(units="rad/s")
    return with_own_quantity(record.drop_vars("stop_time").assign(rate=rate).assign_attrs(attrs))


def with_sensor(record: xr.Dataset) -> xr.Dataset:
    return plain(record.assign(angle=record.angle + 0.05 * record.angle**2))


@pytest.fixture(scope="module")
def cases() -> dict[str, tuple[xr.Dataset, xr.Dataset]]:
    """Results, and other records to predict."""
    direct, held = (
        st.methods.Direct(random_force="off"),
        st.methods.Direct(random_force="off", constraints=FREE),
    )
    curve = {"symbol": "sensor_curve", "formula": "x**2", "kind": "sensor"}
    sensor = st.forces.ForceLibrary("", (*PENDULUM, *parse_library({"force": [curve]}, "test")))
    swings = [driven(SWINGS, "rad", seed) for seed in (1, 2)]
    rolls = [plain(driven(ROLLS, "m", seed, 0.0)) for seed in (3, 4)]
    found = direct.identify(plain(swings[0]), PENDULUM)
    return {
        "pendulum": (found, plain(swings[1])),
        "carriage": (held.identify(rolls[0], CARRIAGE), rolls[1]),
        "gyroscope": (found, of_rate(swings[1])),
        "sensor": (direct.identify(with_sensor(swings[0]), sensor), with_sensor(swings[1])),
        "missing samples": (found, plain(swings[1]).isel(time=np.setdiff1d(np.arange(900), [7, 8, 19, 400]))),
    }


# s; some samples are missing in the warm-up.
LONGER = {"missing samples": 39.5 * STEP}
NAMES = ("pendulum", "carriage", "gyroscope", "sensor", "missing samples")


def later_replaced(record: xr.Dataset, warm_up: float, garbage: np.ndarray) -> xr.Dataset:
    """The record with other samples after the warm-up, inputs unchanged."""
    changed = record.copy(deep=True)
    for name in ("angle", "measured"):
        if name in changed:
            (axis,) = changed[name].dims
            later = changed[axis].values >= warm_up
            changed[name].values[later] = garbage[-np.count_nonzero(later) :]
    return changed


RANDOM = np.random.default_rng(0).standard_normal(TIME.size)
GARBAGE = {
    "noise": RANDOM,
    "huge": 1e6 * RANDOM,
    "tiny": 1e-9 * RANDOM,
    "constant": np.full(TIME.size, 0.7),
    "spikes": np.where(RANDOM > 1.5, 30.0, 0.0),
    "spike at the end": np.where(np.arange(TIME.size) == TIME.size - 2, 50.0, np.sin(3.0 * TIME)),
    "step": np.where(TIME > 5.0, 4.0, -4.0),
}


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("garbage", GARBAGE)
def test_what_follows_the_warm_up_does_not_change_the_prediction(cases, name, garbage):
    result, record = cases[name]
    warm_up = LONGER.get(name, WARM_UP)
    before = st.predict(result, record, warm_up=warm_up)
    after = st.predict(result, later_replaced(record, warm_up, GARBAGE[garbage]), warm_up=warm_up)
    np.testing.assert_array_equal(after.predicted_angle.values, before.predicted_angle.values)


@given(
    size=strategies.floats(1e-6, 1e4),
    seed=strategies.integers(0, 2**16),
    samples=strategies.integers(20, 300),
)
@settings(max_examples=25, deadline=None, derandomize=True)
def test_no_size_of_garbage_changes_a_prediction(cases, size, seed, samples):
    result, record = cases["pendulum"]
    warm_up = (samples - 0.5) * STEP
    garbage = size * np.random.default_rng(seed).standard_normal(TIME.size)
    changed = record.assign(angle=record.angle.copy(data=np.where(warm_up > TIME, record.angle, garbage)))
    before, after = (st.predict(result, of, warm_up=warm_up) for of in (record, changed))
    np.testing.assert_array_equal(after.predicted_angle.values, before.predicted_angle.values)


@pytest.mark.parametrize("name", ["carriage", "gyroscope"])
def test_a_warm_up_of_twenty_samples_is_enough(cases, name):
    result, record = cases[name]
    predicted = st.predict(result, record, warm_up=WARM_UP)
    assert predicted.residual_over_motion.item() < 0.02


@pytest.mark.parametrize("zero", [0.0, -0.2])
def test_the_zero_of_the_sensor_is_stated(cases, zero):
    result, record = cases["pendulum"]
    shifted = record.assign(angle=record.angle.copy(data=record.angle.values + zero))
    predicted = st.predict(result, shifted, warm_up=1.0)
    assert predicted.offset.item() == pytest.approx(zero, abs=10.0 * NOISE)
    assert st.predict(*cases["carriage"], warm_up=1.0).offset.attrs["units"] == "m"


@pytest.mark.parametrize("first", [(0.0, 0.0), (1e-4, 0.05), (0.003, -1.0)])
@pytest.mark.parametrize("samples", [20, 60, 200])
def test_a_start_is_found_in_a_small_part_of_the_motion_from_a_wrong_guess(first, samples):
    """The record begins in the middle of a fast motion, so that its samples are small and its rate is not."""
    time = 1e-3 * np.arange(samples)
    exact = st.simulate(ROLLS, time, 1e-3, 0.25, inputs={"u": np.cos(time)})
    model = st.Model(CARRIAGE, ROLLS.coefficients, 6.0, inputs=st.records.inputs.inputs_of(exact))
    found = fit_start_of_several(model, time, exact.angle.values, first, offset=None)
    assert found.angle == pytest.approx(1e-3, abs=1e-8)
    assert found.rate == pytest.approx(0.25, rel=1e-5)


@pytest.mark.parametrize("warm_up", [None, 2.0])
@pytest.mark.parametrize("level", [0.0, 0.1])
def test_a_record_at_rest_is_predicted_and_its_ratio_is_infinite(level, warm_up):
    result = st.identify(st.records.paper_twin(seed=1), method="direct")
    predicted = st.predict(result, (TIME, np.full(TIME.size, level)), warm_up=warm_up)
    assert predicted.predicted_angle.values == pytest.approx(level, abs=1e-2)
    assert predicted.residual_rms.item() < 2e-3
    assert predicted.residual_over_motion.item() == float("inf")
    said = " ".join(prediction_block([predicted]).sentences)
    assert "does not move where it is predicted" in said
    assert "inf" not in said


def test_a_carriage_at_rest_in_its_warm_up_is_predicted(cases):
    result, record = cases["carriage"]
    u = np.where(TIME < 1.0, 0.0, record.u.values)
    rests = plain(st.simulate(ROLLS, TIME, 0.0, 0.0, inputs={"u": u}))
    rests["angle"] = rests.angle.assign_attrs(units="m")
    assert np.ptp(rests.angle.values[:20]) == 0.0
    predicted = st.predict(result, rests, warm_up=WARM_UP)
    assert predicted.residual_over_motion.item() < 0.02


@pytest.mark.slow
def test_the_motor_axis_needs_twenty_samples_for_its_start(data_folder):
    """EMPS, last quarter: the start by twenty samples is as good as the best start by the whole part."""
    record = emps_record(data_folder, "35.15065*vir")
    end = 3 * record.sizes["time"] // 4
    forces = st.forces.ForceLibrary("", (*CARRIAGE, *library_of_formulas(bias="1", even_speed="abs(v)")))
    method = st.methods.Direct(random_force="off", constraints=FREE)
    result = method.identify(record.isel(time=slice(end)), forces)
    last = record.isel(time=slice(end, None))
    short = st.predict(result, last, warm_up=19.5e-3)
    whole = st.predict(result, last)
    assert np.abs(short.residual.values[:20]).max() < 5e-6
    assert short.residual_rms.item() < 1.1 * whole.residual_rms.item()
