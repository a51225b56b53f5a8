"""Rows about a motion, and exact fits along smoothed motions: laws, recovered truths, errors."""

import numpy as np
import pytest
from discovery import (
    EVERY,
    TIME,
    deviations,
    errors_of,
    exact,
    library,
    model_of,
    start_model,
    with_effect,
)
from helpers import FIVE, NOISE, W, decay, rms, rms_range
from kicked_motion import kicked_motion, smooth_forces

from sysid_trib.likelihood.random_force import RandomForce
from sysid_trib.validation import cramer_rao_bound

FRICTION = FIVE | {"lambda": 2e-4}
# Of wander: the angle after the record, over the noise of a sample.
WANDER = 5.0
DENSITY = (WANDER * NOISE * 2.0 * W) ** 2 / TIME[-1]


@pytest.mark.parametrize("coefficients", [FIVE, FRICTION], ids=["smooth", "dry friction"])
def test_errors_are_the_bound_and_cover_the_truth(coefficients):
    seeds, before = 6, exact(model_of(coefficients))
    models = [start_model([decay(TIME, before, seed)]) for seed in range(seeds)]
    z = np.array([deviations(model, coefficients) for model in models])
    low, high = rms_range(seeds)
    assert np.all((rms(z) > low) & (rms(z) < high))
    bound = cramer_rao_bound(model_of(coefficients), TIME, 0.3, 0.0, NOISE, free=True)
    bound = bound.standard_error.sel(force=list(coefficients)).values
    mine = np.median([[errors_of(model)[symbol] for symbol in coefficients] for model in models], axis=0)
    # The zero of the sensor is one unknown more; its level, and a random force, are estimated.
    np.testing.assert_allclose(mine / bound, 1.0, atol=0.1)
    assert np.median([model.sensor(0).standard_deviation for model in models]) == pytest.approx(
        NOISE, rel=0.03
    )


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
def test_forces_sensors_and_shapes_are_fitted_alike(effects, shapes):
    base = {"zeta": 5e-3, "epsilon": 0.2}
    run = with_effect(effects, seed=2, base=base, shapes=shapes)
    model = start_model([run], library(*base, *effects))
    assert model.settled
    assert np.all(np.abs(deviations(model, base | effects)) < 4.5)
    found = {name: value for trial in model.trials for name, value in trial.shapes.items()}
    for name, true in shapes.items():
        assert abs(found[name] - true) < 4.5 * model.shape_errors()[name]
        # What is started from is not the truth.
        symbol, _, key = name.partition(".")
        assert abs(EVERY[symbol].shape[key].default - true) > 5.0 * model.shape_errors()[name]


def kicked(seeds, density=DENSITY):
    """Records in a random force."""
    motions, _ = kicked_motion(TIME, W, smooth_forces(FIVE), 0.0, density, seeds)
    return [decay(TIME, x, seed) for seed, x in zip(seeds, motions, strict=True)]


SMOOTH = {symbol: value for symbol, value in FIVE.items() if symbol != "lambda"}


def test_a_random_force_has_its_density_and_coefficients_their_errors():
    seeds = range(6)
    models = [start_model([run], library(*SMOOTH)) for run in kicked(seeds)]
    density = [
        RandomForce.density_of(
            float(m.likelihood.ratios[0] * m.likelihood.variances[0]), m.rows[0].path.frequency
        )
        for m in models
    ]
    logs = np.log(np.array(density) / DENSITY)
    errors = np.array([model.likelihood.ratio_errors[0] for model in models])
    assert abs(np.mean(logs)) < 4.0 * np.std(logs) / np.sqrt(len(seeds)) + 0.05
    low, high = rms_range(len(seeds))
    assert low < rms(logs / errors) < high
    z = np.array([deviations(model, SMOOTH) for model in models])
    assert np.all((rms(z) > low) & (rms(z) < high))


@pytest.mark.parametrize("curve", [-1.2, 1.2])
def test_strong_errors_of_the_sensor_are_fitted(curve):
    """The record rises by a quarter of the angle on one side, nearly twice as fast as it on the other."""
    base = {"zeta": 4e-3, "epsilon": 0.2}
    run = with_effect({"sensor_curve": curve}, seed=2, base=base)
    model = start_model([run], library(*base, "sensor_curve"))
    assert model.settled
    assert np.all(np.abs(deviations(model, base | {"sensor_curve": curve})) < 4.5)
