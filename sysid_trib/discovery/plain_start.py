"""The start model of a search as `identify` fits it, with the sensor's noise alone."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr

from sysid_trib.arrays import root_mean_square
from sysid_trib.discovery.engine.fitted_model import FittedModel
from sysid_trib.discovery.free_motion import FreeMotion, free_motion
from sysid_trib.errors import SysidTribError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.methods import Averaging, Direct, method_of
from sysid_trib.records.inputs import inputs_of
from sysid_trib.records.runs import one_or_all
from sysid_trib.results.schema import model_of
from sysid_trib.validation.residuals import FollowedRuns
from sysid_trib.validation.verdict import with_model_in_errors


@dataclass(frozen=True)
class PlainStart:
    """The start model fitted without a random force.

    Attributes
    ----------
    result : Dataset
        The identification from the fitted parts.
    motions : list of FreeMotion
        Motion of this model in each run.
    """

    result: xr.Dataset
    motions: list[FreeMotion]

    @property
    def residual(self) -> float:
        """RMS of the records minus the motions, rad."""
        return residual_of_motions(self.motions)


def residual_of_motions(motions: Sequence[FreeMotion]) -> float:
    """Return the RMS of records minus motions, rad; infinite if a value is not finite."""
    rms = root_mean_square(np.concatenate([motion.residual for motion in motions]))
    return rms if np.isfinite(rms) else float("inf")


def plain_start(
    seen: Sequence[xr.Dataset],
    library: ForceLibrary,
    constraints: Mapping[str, float],
    reference_frequency: float | None,
    start: FittedModel,
) -> PlainStart | None:
    """Return the better fit of the start model by `identify`; None if there is none.

    A fit with a random force follows a record even if forces are missing. Its coefficients satisfy the
    balance of forces, but its free motion may lose the phase of the record.

    Parameters
    ----------
    seen : sequence of Dataset
        Records to which the models are fitted.
    library : ForceLibrary
        The forces of the start model.
    constraints : mapping of str to float
        Coefficients that are fixed.
    reference_frequency : float or None, rad/s
        Reference frequency w, if it is fixed.
    start : FittedModel
        The start model of the search, whose paths contain the records.
    """
    # A driven motion keeps its phase, and a spline does not give the noise of its record.
    if any(map(inputs_of, seen)):
        return None
    starts, runs = list[PlainStart](), dict(enumerate(seen))
    options: dict[str, Any] = {"reference_frequency": reference_frequency, "random_force": "off"}
    options["constraints"] = dict(constraints)
    for method in (Direct(**options), Averaging(**options)):
        try:
            result = method.identify(one_or_all(list(seen)), library)
            model = model_of(result)
            motions = [free_motion(model, rows.path, start.sensor(at)) for at, rows in enumerate(start.rows)]
        except (SysidTribError, np.linalg.LinAlgError):
            continue
        starts.append(PlainStart(result, motions))
    nearest = min(starts, key=lambda of: of.residual, default=None)
    if nearest is None:
        return None
    followed = FollowedRuns(runs, nearest.result)
    return replace(nearest, result=with_model_in_errors(followed, method_of(nearest.result), library).result)
