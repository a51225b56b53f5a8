"""Numbers that hold: what a good verdict stands on, on records of kinds that once gave wrong ones."""

import numpy as np
import pytest
import xarray as xr

import sysid_trib as st
from sysid_trib.methods import Direct

SIX = st.load_library("contact_forces")


def noisy(model, time, start, noise, seed=0):
    """A simulated decay in white noise, time in s."""
    angle = st.simulate(model, time, start).angle.values
    angle = angle + noise * np.random.default_rng(seed).standard_normal(len(time))
    return st.free_decay(xr.Dataset({"angle": ("time", angle)}, {"time": time}))


@pytest.mark.parametrize("start, held", [(2.0, {"epsilon": 0.3}), (1.5, {"epsilon": -0.12, "nu": 0.2})])
def test_a_strong_held_elastic_force_beside_a_random_force(start, held):
    library = SIX.select(["lambda", "zeta", *held])
    true = {"lambda": 2e-3, "zeta": 0.01, **held}
    decay = noisy(st.Model(library, true, 6.0), np.arange(0.0, 30.0, 0.02), start, 1e-3)
    result = st.identify(decay, library, Direct(random_force="auto", fix=held))
    free = result.sel(force=["lambda", "zeta"])
    assert np.all(np.abs(free.coefficient - [2e-3, 0.01]) < 3.5 * free.standard_error)
    assert abs(result.reference_frequency - 6.0) < 3.5 * result.reference_frequency_standard_error


@pytest.mark.parametrize("per_period", [15.0, 20.0, 19.7])
@pytest.mark.parametrize("random_force", ["off", "auto"])
def test_errors_are_those_of_the_bound_however_many_samples_a_period(per_period, random_force):
    true = {"lambda": 6e-4, "zeta": 0.005, "delta": 0.02, "epsilon": 0.15}
    model, noise = st.Model(SIX.select(list(true)), true, 9.0), 2e-4
    time = np.arange(0.0, 15.0, 2.0 * np.pi / 9.0 / per_period)
    angle = st.simulate(model, time, 0.35).angle.values
    decay = xr.Dataset(
        {"angle": ("time", angle + noise * np.random.default_rng(1).standard_normal(len(time)))},
        {"time": time},
    )
    result = st.identify(decay, model.library, Direct(random_force=random_force))
    bound = st.cramer_rao_bound(model, time, 0.35, 0.0, noise, free=True).standard_error
    # By the noise that these few samples happen to have.
    ratio = (result.standard_error / bound).values * noise / (result.birge_ratio * result.noise).item()
    # With a random force that the record leaves open errors are larger; never are they smaller.
    assert np.all(ratio > 0.95)
    assert random_force == "auto" or np.all(ratio < 1.1)
