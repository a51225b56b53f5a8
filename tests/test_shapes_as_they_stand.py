"""A fit tells what its shapes as they stand reach, not what a step along their tangents promises."""

from dataclasses import replace

import numpy as np
import pytest
from discovery import EVERY, WHITE, exact, model_of
from helpers import NOISE, W, decay, rms

from sysid_trib.discovery.free_motion import free_motions
from sysid_trib.likelihood.likelihood import likelihood
from sysid_trib.likelihood.model_fit import fit_model, fitted_along
from sysid_trib.likelihood.paths import path_of
from sysid_trib.likelihood.start_model import default_shapes
from sysid_trib.likelihood.trials import TrialEffect

FRICTIONS = model_of({"zeta": 7e-3, "delta": 0.03, "lambda": 5e-4})
TIME = np.arange(0.0, 9.0, 0.01)


def fitted(other: str, seed: int):
    """Viscous and logarithmic friction and another one, where all that acts is viscous, quadratic and dry."""
    run = decay(TIME, exact(FRICTIONS, TIME), seed)
    trials = [TrialEffect(EVERY[s], default_shapes(EVERY[s])) for s in ("zeta", "log_friction", other)]
    return fit_model([path_of(TIME, run.angle.values, W, WHITE)], trials, frequency_free=True)


@pytest.mark.parametrize("other", ["delta", "cubic_damping"])
@pytest.mark.parametrize("seed", range(3))
def test_a_model_moves_as_its_path_does_where_a_shape_hardly_matters(other, seed):
    """A step of the logarithm's speed goes with other coefficients: with them alone it is no motion of it."""
    model = fitted(other, seed)
    (motion,) = free_motions(model)
    assert model.settled
    assert rms(motion.residual) < 1.1 * NOISE


def test_what_is_told_is_the_likelihood_of_the_shapes_as_they_stand():
    model = fitted("delta", 0)
    shape = model.columns_of("log_friction")[1]
    kept = [1 + column for column in range(model.columns) if column != shape]
    products = [rows.products(table) for rows, table in zip(model.rows, model.tables, strict=True)]
    held = likelihood(products, kept)
    assert model.likelihood.deviance == pytest.approx(held.deviance, abs=1e-6)
    np.testing.assert_allclose(model.likelihood.coefficients[:shape], held.coefficients, rtol=1e-6)
    assert model.likelihood.coefficients[shape] == 0.0


def test_coefficients_ahead_of_a_step_are_those_beside_it():
    """Of all of the step that the tangents ask for those that are the most likely with it."""
    near = fitted("delta", 1)
    trials = [replace(t, shapes=dict.fromkeys(t.shapes, 0.001)) for t in near.trials]
    latest = np.append(near.coefficients, near.stiffness)
    model = fitted_along([rows.path for rows in near.rows], trials, latest, True)
    step = model.stepped.coefficients[model.columns_of("log_friction")[1:]]
    changes = model.stepped.coefficients[:4] - model.likelihood.coefficients[:4]
    assert not model.at_ends
    np.testing.assert_allclose(model.ahead(step), changes, rtol=1e-6, atol=1e-6 * np.max(np.abs(changes)))
    np.testing.assert_array_equal(model.ahead(0.0 * step), 0.0)
