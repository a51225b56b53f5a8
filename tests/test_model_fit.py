"""Rows about a motion, and exact fits along smoothed motions: laws, recovered truths, errors."""

import numpy as np
import pytest
from discovery import EVERY, deviations, library, start_model, with_effect


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effects", "shapes"),
    [
        ({"power_damping": 0.02}, {"power_damping.p": 1.4}),
        ({"dahl": 4e-3}, {"dahl.s": 0.06}),
        ({"sensor_curve": 0.01}, {}),
    ],
    ids=lambda value: " ".join(value),
)
def test_forces_sensor_terms_and_shape_parameters_are_fitted(effects, shapes):
    base = {"zeta": 5e-3, "epsilon": 0.2}
    run = with_effect(effects, seed=2, base=base, shapes=shapes)
    model = start_model([run], library(*base, *effects))
    assert model.settled
    assert np.all(np.abs(deviations(model, base | effects)) < 4.5)
    found = {name: value for trial in model.trials for name, value in trial.shapes.items()}
    for name, true in shapes.items():
        assert abs(found[name] - true) < 4.5 * model.shape_errors()[name]
        # The start values differ from the truth.
        symbol, _, key = name.partition(".")
        assert abs(EVERY[symbol].shape[key].default - true) > 5.0 * model.shape_errors()[name]


@pytest.mark.parametrize("curve", [-1.2, 1.2])
def test_strong_errors_of_the_sensor_are_fitted(curve):
    """The record rises by a quarter of the angle on one side, nearly twice as fast as it on the other."""
    base = {"zeta": 4e-3, "epsilon": 0.2}
    run = with_effect({"sensor_curve": curve}, seed=2, base=base)
    model = start_model([run], library(*base, "sensor_curve"))
    assert model.settled
    assert np.all(np.abs(deviations(model, base | {"sensor_curve": curve})) < 4.5)
