"""A fitted model written with its own frequency as the reference."""

from collections.abc import Sequence

import numpy as np

from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.likelihood_fit.model_fit import fit_model, fitted_along
from sysid_trib.likelihood_fit.paths import RecordPath
from sysid_trib.likelihood_fit.trials import reference_power

# Part of its standard error by which a frequency may differ from the reference, and rounds to get there.
SAME_REFERENCE, RESCALINGS = 0.02, 4
# Factor by which the reference changes at most in each. A model whose own frequency is lower than by that, or
# none at all since forces of the motion hold it up, keeps the reference.
MOST_RESCALED = 2.0


def refitted(model: FittedModel, paths: Sequence[RecordPath] | None = None) -> FittedModel:
    """The model fitted again, with its frequency as the reference.

    `paths` : of the same frequency as the model's; by default the model's.
    """
    near = [rows.path for rows in model.rows] if paths is None else paths
    for _ in range(RESCALINGS):
        squared = 1.0 + model.stiffness
        oscillates = squared >= 1.0 / MOST_RESCALED**2
        factor = min(float(np.sqrt(squared)), MOST_RESCALED) if oscillates else 1.0
        # The same forces, or a narrow resonance would no longer be where it was.
        powers = np.array([reference_power(trial.force) for trial in model.trials])
        first = np.append(model.coefficients * factor**powers, 0.0 if oscillates else model.stiffness)
        rescaled = [path.rescaled(path.frequency * factor) for path in near]
        trials, free = [trial.referred(factor) for trial in model.trials], model.frequency_free
        after = fit_model(rescaled, trials, frequency_free=free, first=first)
        if paths is None and after.likelihood.deviance > model.likelihood.deviance + model.settings.far:
            # Shapes that hardly matter may lead astray: along the path where they were found, then.
            after = fitted_along(rescaled, trials, first, free)
        model = after
        same = model.settled and abs(model.stiffness) <= SAME_REFERENCE * model.stiffness_error
        if same or not oscillates:
            break
        near = [rows.path for rows in model.rows]
    return model
