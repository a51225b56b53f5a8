"""Smooth laws as an alternative to names: their prediction of the held-out part."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array, root_mean_square
from sysid_trib.discovery.unseen import RecordPart
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.constraints import ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods import Averaging, Direct
from sysid_trib.smooth_laws.fits import LawFit, fitted
from sysid_trib.smooth_laws.model import LawModel, with_jump
from sysid_trib.validation.holdout import carried_on
from sysid_trib.validation.residuals import fitted_motion


class LawPrediction(NamedTuple):
    """Prediction of the held-out parts by smooth laws.

    Attributes
    ----------
    residuals : sequence of (sample,) array of float, rad
        Residual of each part, with fitted start and sensor's zero; empty if the laws predict no motion.
    """

    residuals: Sequence[Array] = ()

    @property
    def rms(self) -> float:
        """RMS residual of all parts, rad; infinite if the laws predict no motion."""
        if not self.residuals:
            return float("inf")
        return root_mean_square([root_mean_square(residual) for residual in self.residuals])


def held_out_by_laws(
    named: ForceLibrary,
    constraints: ConstraintTable,
    learnt: Sequence[RecordPart],
    later: Sequence[RecordPart],
) -> LawPrediction:
    """Return the prediction of the held-out parts by smooth laws, the better of Direct and averaging.

    Parameters
    ----------
    named : ForceLibrary
        Forces of the start model, which are not penalised.
    constraints : mapping
        Constraints of their coefficients.
    learnt, later : sequence of RecordPart
        Parts from which the laws are identified, and parts that they predict.
    """
    forces = named.select(force.symbol for force in named if force.kind == "force")
    model = LawModel(with_jump(forces, forces), constraints)
    runs = [part.record for part in learnt]
    best = LawPrediction()
    for method in (
        Direct(random_force="off", constraints=constraints),
        Averaging(random_force="off", constraints=constraints),
    ):
        try:
            fit = fitted(runs, method, model)
        except (SysidTribError, np.linalg.LinAlgError):
            continue
        prediction = LawPrediction([_residual(fit, part) for part in later])
        # Without a motion the RMS is nan, which is never smaller.
        if prediction.rms < best.rms:
            best = prediction
    return best


def _residual(fit: LawFit, part: RecordPart) -> Array:
    """Return the residual (rad) of one part, with fitted start and zero; nan without a motion."""
    result: xr.Dataset = fit.followed.result.drop_vars(["start_angle", "start_rate"], errors="ignore")
    if part.before is not None:
        result = carried_on(result, fit.library, part.before)
    motion = fitted_motion(part.record, result)
    if motion is None:
        return np.full(part.record.sizes["time"], np.nan)
    return np.asarray(part.record.angle.values - motion.offset - motion.x)
