"""Starts: predictions try several, and discover begins with the result of identify."""

import numpy as np
import pytest
from helpers import decay, library_of_formulas

import sysid_trib as st
from sysid_trib.methods import Direct

W, TIME = 6.13, np.arange(0.0, 70.0, 0.05)
FORCES = library_of_formulas(zeta="2*v", delta="v*abs(v)", gravity="sin(x) - x")


def swing(amplitude, w, zeta, delta=0.0, seed=0):
    model = st.Model(FORCES, {"zeta": zeta, "delta": delta, "gravity": 1.0}, w)
    angle = st.simulate(model, TIME, angle=amplitude).angle.values
    return st.free_decay(decay(TIME, angle + 0.004 * np.random.default_rng(seed).standard_normal(TIME.size)))


def test_a_prediction_whose_phase_slips_is_better_than_no_motion():
    # Damped too little, the model swings on with too low a frequency.
    first = swing(0.32, W * 1.001, 2e-4)
    held = Direct(random_force="off", constraints={"gravity": 1.0, "delta": 0.0})
    predicted = st.predict(held.identify(first, FORCES), swing(0.85, W, 2.4e-3, 2e-3, seed=1))
    assert predicted.residual_over_motion.item() < 1.0
    assert predicted.attrs["note"] == ""


def test_a_prediction_worse_than_no_motion_is_reported():
    wrong = Direct(8.0, random_force="off").identify(swing(0.3, 8.0, 1e-3), library_of_formulas(zeta="2*v"))
    other = swing(0.3, W, 1e-3)
    predicted = st.predict(wrong, other, warm_up=2.0)
    assert (predicted.residual_over_motion.item() >= 1.0) == bool(predicted.attrs["note"])


@pytest.mark.slow
def test_discover_begins_with_the_fit_of_identify():
    lacking = library_of_formulas(zeta="2*v", gravity="sin(x) - x")
    record = swing(0.8, W, 1e-3, 0.02)
    tree = st.discover(record, lacking, FORCES.select(["delta"]), constraints={"gravity": 1.0})
    seen = tree["record"].to_dataset()
    plain = Direct(random_force="off", constraints={"gravity": 1.0}).identify(seen[["angle"]], lacking)
    left = st.predict(plain, seen[["angle"]]).residual_rms.item()
    steps = tree["steps"].to_dataset()
    assert steps.residual_before.values[0] <= 1.1 * left
    assert steps.symbol.values.tolist() == ["delta"]
