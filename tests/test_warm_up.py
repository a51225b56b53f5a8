"""Fits of driven records whose states began before the record: a warm-up that does not count."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import sysid_trib as st
from sysid_trib.errors import UsageError
from sysid_trib.records.inputs import KnownInput

W, NOISE, WARM_UP = 9.9, 1e-4, 6.0
HYSTERESIS = st.load_library("hysteresis")
LIBRARY = replace(
    HYSTERESIS,
    forces=(
        *st.load_library("inputs").select(["gain"]),
        *st.load_library("contact_forces").select(["zeta"]),
        *HYSTERESIS,
    ),
)
TRUTH = {"gain": 0.05, "zeta": 0.02, "bouc_wen_n": 0.5}
SHAPES = {"bouc_wen_n.s": 0.05, "bouc_wen_n.g": -0.3, "bouc_wen_n.n": 1.0}


def record(scale: float = 1.0) -> xr.Dataset:
    """Under a multisine, from where the body has moved for a while; in units of a displacement if scaled."""
    rng, time = np.random.default_rng(2), np.arange(0.0, 40.0, 0.03)
    tones = np.outer(time, W * np.linspace(0.1, 2.0, 40)) + rng.uniform(0.0, 6.28, 40)
    force = KnownInput(time, np.cos(tones).sum(axis=1) / 2.0, "smooth")
    motion = st.simulate(st.Model(LIBRARY, TRUTH, W, SHAPES), time, 0.0, inputs={"u": force})
    angle = scale * (motion.angle.values + NOISE * rng.standard_normal(len(time)))
    data = {
        "angle": ("time", angle, {"units": "rad" if scale == 1.0 else "m"}),
        "u": ("time", force.values, {"units": "N", "role": "input", "between": "smooth"}),
    }
    return xr.Dataset(data, {"time": time}).isel(time=slice(300, None))


def fitted(run: xr.Dataset, warm_up: float, scale: float = 1.0) -> xr.Dataset:
    """From a model that is off by a tenth."""
    shapes = SHAPES | {"bouc_wen_n.s": 0.055 * scale}
    near = {"gain": 0.055 * scale, "zeta": 0.02, "bouc_wen_n": 0.45}
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
    found, error = result.sel(shape_parameter=["bouc_wen_n.s", "bouc_wen_n.g"]), 5.0
    off = np.abs(found["shape"].values - [0.05, -0.3])
    assert np.all(off < error * found.shape_standard_error.values)
    for symbol, true in TRUTH.items():
        one = result.sel(force=symbol)
        assert abs(one.coefficient.item() - true) < error * one.standard_error.item()
    assert fitted(run, 0.0).residual_rms.item() > 1.05 * result.residual_rms.item()


@pytest.mark.slow
def test_a_start_is_in_the_unit_of_the_record():
    result = fitted(record(1e-3), WARM_UP, 1e-3)
    assert result.residual_rms.item() == pytest.approx(1e-3 * NOISE, rel=0.08)
    assert result.coefficient.sel(force="bouc_wen_n").item() == pytest.approx(0.5, rel=0.05)


@pytest.mark.parametrize(("warm_up", "words"), [(-1.0, "is no time"), (30.9, "give a shorter one")])
def test_a_warm_up_that_cannot_be_is_refused(warm_up, words):
    with pytest.raises(UsageError, match=words):
        fitted(record(), warm_up)
