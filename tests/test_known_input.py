"""Known inputs: simulated against scipy, identified beside a random force, refused where none is taken."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import xarray as xr
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import sysid_trib as st
from sysid_trib.errors import UsageError
from sysid_trib.motion_fit.steps import expected_steps
from sysid_trib.records.inputs import KnownInput

W = 9.9
TRUTH = {"lambda": 1e-3, "zeta": 0.01, "epsilon": -0.1}
LIBRARY = st.load_library("contact_forces").select(TRUTH)
MODEL = st.Model(LIBRARY, TRUTH, W)
METHODS = {
    "direct": st.methods.Direct(),
    "direct beside a random force": st.methods.Direct(random_force="estimated"),
    "trajectory": st.methods.Trajectory(),
    "trajectory beside a random force": st.methods.Trajectory(random_force="estimated"),
}


def times(periods: int = 12, per_period: int = 40) -> np.ndarray:
    return np.arange(periods * per_period) * 2.0 * np.pi / W / per_period


def drive(time: np.ndarray, seed: int = 0) -> np.ndarray:
    """A tone beside the resonance, and steps at random."""
    steps = np.random.default_rng([seed, 9]).standard_normal(len(time) // 4 + 1).repeat(4)[: len(time)]
    return 3.0 * np.sin(7.3 * time) + 1.5 * steps


def driven_record(seed: int, random_force: float = 0.0, **sampling: int) -> xr.Dataset:
    time = times(**sampling)
    record = st.simulate(
        MODEL, time, 0.1, known_input=drive(time, seed), random_force=random_force, seed=seed
    )
    noise = 2e-4 * np.random.default_rng(seed).standard_normal(len(time))
    return record.assign(angle=record.angle + noise).assign_attrs(source="synthetic")


def test_constant_input_shifts_the_equilibrium() -> None:
    time = times(30)
    damped = st.Model(st.load_library("contact_forces").select(["zeta"]), {"zeta": 0.1}, W)
    pushed = st.simulate(damped, time, 0.1, known_input=np.full(len(time), 2.0))
    assert pushed.angle.values[-1] == pytest.approx(2.0 / W**2, abs=1e-9)


def test_friction_holds_until_the_input_overcomes_it() -> None:
    stuck = st.Model(LIBRARY.select(["lambda"]), {"lambda": 0.05}, W)
    time = times(4)
    push = 0.1 * W**2 * time / time[-1]
    angle = st.simulate(stuck, time, 0.0, known_input=push).angle.values
    assert np.all(angle[push < 0.05 * W**2] == 0.0)
    assert np.all(angle[push > 0.051 * W**2] > 0.0)


@pytest.mark.parametrize("name", METHODS)
def test_forces_of_a_driven_record(name: str) -> None:
    record = driven_record(1)
    result = st.identify(record, LIBRARY, METHODS[name])
    z = (result.coefficient.values - list(TRUTH.values())) / result.standard_error.values
    assert np.max(np.abs(z)) < 3.5
    assert abs(result.reference_frequency - W) < 3.5 * result.reference_frequency_standard_error
    assert float(result.standard_error.sel(force="zeta")) < 2e-4


def test_without_its_input_a_drive_is_taken_for_something_else() -> None:
    record = driven_record(1)
    without = st.identify(record.drop_vars("input"), LIBRARY, METHODS["direct"])
    known = st.identify(record, LIBRARY, METHODS["direct"])
    wrong = np.abs(without.coefficient.values - list(TRUTH.values())) / known.standard_error.values
    assert np.max(wrong) > 20.0


def test_innovations_and_bands_know_the_input() -> None:
    record = driven_record(3, 1e-4, periods=20)
    result = st.identify(record, LIBRARY, METHODS["direct beside a random force"])
    assert float(st.validation.innovations(record, result).ljung_box_p_value) > 1e-3
    bands = st.validation.prediction_bands(record, result)
    z = (bands.measured - bands.predicted) / bands.predicted_standard_error
    assert np.nanmax(np.abs(z)) < 4.0


@pytest.mark.parametrize("between", ["linear", "held", "cubic"])
def test_what_is_between_samples_is_what_acts(between: str) -> None:
    """Against scipy's motion, restarted at each sample; the steps of a filter are of the same motion."""
    time = np.linspace(0.0, 4.0, 41)
    known = KnownInput(time, drive(time), between)
    model = replace(MODEL, coefficients={"zeta": 0.01, "epsilon": 0.4})
    run = st.simulate(model, time, 0.1, 0.2, known_input=known)
    spline, y = CubicSpline(time, known.values), [np.array([0.1, 0.2])]
    for i, (low, high) in enumerate(pairwise(time)):
        u0, u1 = known.values[i : i + 2]

        def rates(t: float, y: np.ndarray, u0: float = u0, u1: float = u1, low: float = low) -> list[float]:
            u = {"linear": u0 + (u1 - u0) * (t - low) / 0.1, "held": u0, "cubic": float(spline(t))}[between]
            return [y[1], u - W**2 * (y[0] + 0.02 * y[1] / W + 0.4 * y[0] ** 3)]

        y.append(solve_ivp(rates, (low, high), y[-1], rtol=1e-11, atol=1e-12, method="DOP853").y[:, -1])
    np.testing.assert_allclose(run.angle, np.array(y)[:, 0], atol=1e-9)
    states = np.stack([run.angle, run.rate / W], axis=1)
    steps = expected_steps(replace(model, inputs={"input": known}), time, states, 0.0)
    np.testing.assert_allclose(steps.end, states[1:], atol=1e-9)
    assert run.input.attrs["between"] == between


@pytest.mark.parametrize("units", [None, "V", "N m"])
def test_an_input_that_is_no_acceleration_is_refused(units: str | None) -> None:
    record = driven_record(1)
    record.input.attrs = {} if units is None else {"units": units}
    with pytest.raises(UsageError, match=r"rad/s\^2"):
        st.identify(record, LIBRARY, METHODS["direct"])


@pytest.mark.parametrize(
    "method", [st.methods.Averaging(), st.methods.Direct(form="strong"), st.methods.LogarithmicDecrement()]
)
def test_methods_of_free_motions_refuse_an_input(method: object) -> None:
    with pytest.raises(UsageError, match="known input"):
        st.identify(driven_record(1), LIBRARY, method)
