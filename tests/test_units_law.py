"""Results are the same in every unit of signal and time: exactly, where the factor is a power of two."""

from functools import cache

import numpy as np
import pytest
import xarray as xr

import sysid_trib as st

FORCES = st.load_library()
TIME = np.arange(900) / 40.0
# mm and s are the units of `recorded(0, 0)`.
POWERS = [(-40, 20), (20, -40), (7, 10)]


@cache
def measured():
    chosen = FORCES.select(["lambda", "zeta", "delta"])
    model = st.Model(chosen, {"lambda": 1e-3, "zeta": 5e-3, "delta": 0.03}, 8.0)
    noise = 2e-4 * np.random.default_rng(3).standard_normal(TIME.size)
    return st.simulate(model, TIME, angle=0.4).angle.values + noise


def recorded(power, time_power):
    angle = ("time", measured() * 2.0**power, {"units": "mm" if power == 0 else "px"})
    time = ("time", TIME * 2.0**time_power, {"units": "s"})
    return st.free_decay(xr.Dataset({"angle": angle}, {"time": time}, {"source": "run.csv"}))


@cache
def identified(method, option, power, time_power):
    chosen = FORCES.select(["lambda", "zeta", "delta"])
    return getattr(st.methods, method)(random_force=option).identify(recorded(power, time_power), chosen)


@pytest.mark.parametrize(("power", "time_power"), POWERS)
@pytest.mark.parametrize("option", ["off", "estimated"])
@pytest.mark.parametrize("method", ["Direct", "Averaging", "Trajectory"])
def test_an_identification_is_the_same_in_every_unit(method, option, power, time_power):
    one, other = identified(method, option, 0, 0), identified(method, option, power, time_power)
    back = 2.0 ** (-power * np.array([1.0, 0.0, -1.0]))
    error = one.standard_error.values
    assert np.abs(other.coefficient * back - one.coefficient).values / error == pytest.approx(0.0, abs=1e-3)
    assert other.standard_error.values * back / error == pytest.approx(1.0, abs=1e-3)
    apart = other.reference_frequency.item() * 2.0**time_power - one.reference_frequency.item()
    assert apart / one.reference_frequency_standard_error.item() == pytest.approx(0.0, abs=1e-3)
    assert other.noise.item() == pytest.approx(one.noise.item() * 2.0**power, rel=1e-6)


@pytest.mark.parametrize(("power", "time_power"), POWERS)
def test_stored_parts_of_a_record_are_the_same_in_every_unit(power, time_power):
    # Without noise, at rest in its last third, and at times that jitter by a tenth of a step.
    model = st.Model(FORCES.select(["lambda", "zeta"]), {"lambda": 8e-3, "zeta": 5e-3}, 8.0)
    time = TIME + np.random.default_rng(1).uniform(-2.5e-3, 2.5e-3, TIME.size)
    angle = st.simulate(model, time, angle=0.4).angle.values

    def kept(power, time_power):
        values = {"angle": ("time", angle * 2.0**power, {"units": "px"})}
        axis = {"time": ("time", time * 2.0**time_power, {"units": "s"})}
        return st.free_decay(xr.Dataset(values, axis, {"source": "run.csv"}))

    one, other = kept(0, 0), kept(power, time_power)
    assert one.sizes["time"] < 0.9 * TIME.size
    assert np.ptp(np.diff(one.time)) < 1e-9 * 0.025
    assert other.time.values == pytest.approx(one.time.values * 2.0**time_power, rel=1e-12)
    assert other.stop_time.item() == pytest.approx(one.stop_time.item() * 2.0**time_power, rel=1e-12)
