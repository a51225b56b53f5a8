"""What physics allows a force: its sign where it only takes energy, and how strong it may be."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, Mask
from sysid_trib.forces.force import Force
from sysid_trib.likelihood_fit.fitted_model import FittedModel
from sysid_trib.likelihood_fit.trials import TrialEffect


def is_physical(force: Force, coefficient: ArrayLike, relative_force: float, strongest: float) -> Mask:
    """Whether a force may have these coefficients: one that only takes energy is not negative.

    `relative_force` : of the force of coefficient 1, over the restoring force; `strongest` one may be.
    """
    drives = np.logical_and(force.passive, np.less(coefficient, 0.0))
    weak = np.abs(coefficient) * relative_force < strongest
    return np.logical_and(~drives, np.logical_or(force.kind == "sensor", weak))


def are_physical(
    trials: Sequence[TrialEffect], coefficients: Array, relative_force: Array, strongest: float
) -> Mask:
    """The same of several trials and the coefficient of each, (trial,)."""
    forces = zip(trials, coefficients, relative_force, strict=True)
    return np.array([is_physical(trial.force, c, size, strongest) for trial, c, size in forces], dtype=bool)


def strengths(model: FittedModel, columns: Sequence[Array]) -> Array:
    """RMS of each trial's column over that of the restoring force, (trial,)."""
    squares = np.sum([np.sum(column**2, axis=0) for column in columns], axis=0)
    return np.sqrt(squares / np.sum([np.sum(rows.path.stiffness_column**2) for rows in model.rows]))
