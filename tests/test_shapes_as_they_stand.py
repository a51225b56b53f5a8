"""A fit tells what its shapes as they stand reach, not what a step along their tangents promises."""

import numpy as np
import pytest
from discovery import EVERY, WHITE, exact, model_of
from helpers import NOISE, W, decay, rms

from sysid_trib.discovery.free_motion import free_motions
from sysid_trib.likelihood.model_fit import fit_model
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
@pytest.mark.parametrize("seed", range(2))
def test_a_model_moves_as_its_path_does_where_a_shape_hardly_matters(other, seed):
    """A step of the logarithm's speed goes with other coefficients: with them alone it is no motion of it."""
    model = fitted(other, seed)
    (motion,) = free_motions(model)
    assert model.settled
    assert rms(motion.residual) < 1.1 * NOISE
