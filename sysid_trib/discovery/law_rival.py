"""Smooth laws as an alternative to names: their prediction of the held-out part."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.arrays import root_mean_square
from sysid_trib.discovery.unseen import RecordPart
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.constraints import ConstraintTable
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods import Averaging, Direct
from sysid_trib.smooth_laws.fits import LawFit, fitted
from sysid_trib.smooth_laws.model import LawModel, with_jump
from sysid_trib.validation.holdout import carried_on
from sysid_trib.validation.residuals import fitted_motion


def held_out_by_laws(
    named: ForceLibrary,
    constraints: ConstraintTable,
    learnt: Sequence[RecordPart],
    later: Sequence[RecordPart],
) -> float:
    """Return the RMS residual (rad) of the held-out part, predicted by smooth laws.

    Parameters
    ----------
    named : ForceLibrary
        The forces of the start model, which stay outside of the penalty.
    constraints : mapping
        Constraints of their coefficients.
    learnt, later : sequence of RecordPart
        Parts from which the laws are identified, and parts that they predict.

    Returns
    -------
    float
        Residual of the better of Direct and averaging; infinite if neither predicts a motion.
    """
    forces = named.select(force.symbol for force in named if force.kind == "force")
    model = LawModel(with_jump(forces, forces), constraints)
    runs = [part.record for part in learnt]
    kept: list[float] = []
    for method in (
        Direct(random_force="off", constraints=constraints),
        Averaging(random_force="off", constraints=constraints),
    ):
        try:
            fit = fitted(runs, method, model)
        except (SysidTribError, np.linalg.LinAlgError):
            continue
        kept.append(root_mean_square([_missed(fit, part) for part in later]))
    finite = [rms for rms in kept if np.isfinite(rms)]
    return min(finite, default=float("inf"))


def _missed(fit: LawFit, part: RecordPart) -> float:
    """Return the RMS residual (rad) of one part, start and zero fitted; infinite without a motion."""
    result: xr.Dataset = fit.followed.result.drop_vars(["start_angle", "start_rate"], errors="ignore")
    if part.before is not None:
        result = carried_on(result, fit.library, part.before)
    motion = fitted_motion(part.record, result)
    if motion is None:
        return float("inf")
    return root_mean_square(part.record.angle.values - motion.offset - motion.x)
