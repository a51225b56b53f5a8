"""The start of a search: the model that is given, fitted beside both noises."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from sysid_trib.discrepancy.model_fit import FittedModel, fit_model, refitted
from sysid_trib.discrepancy.paths import RecordPath, path_of
from sysid_trib.discrepancy.settings import DEFAULTS, Settings
from sysid_trib.discrepancy.trials import TrialEffect
from sysid_trib.forces.force import Force
from sysid_trib.noise.colour import colour_above
from sysid_trib.noise.level import swing_frequency
from sysid_trib.noise.smoothing import KNOTS_PER_PERIOD, smooth

# Harmonics that the spline of a path follows, at least in part.
ABOVE = 0.5 * KNOTS_PER_PERIOD + 2.0


def fit_start_model(
    runs: Sequence[xr.Dataset],
    forces: Sequence[Force],
    frequency: float | None,
    settings: Settings = DEFAULTS,
) -> FittedModel:
    """Fit the start model beside both noises of each run.

    Parameters
    ----------
    runs : sequence of Dataset
        With `angle(time)`.
    forces : sequence of Force
    frequency : float or None, rad/s
        The reference frequency, held; None has it fitted.
    settings : Settings
    """
    nominal = frequency or float(np.median([swing_frequency(run) for run in runs]))
    paths = [_first_path(run, nominal, settings) for run in runs]
    trials = [TrialEffect(force, default_shapes(force)) for force in forces]
    return refitted(fit_model(paths, trials, frequency_free=frequency is None))


def _first_path(run: xr.Dataset, frequency: float, settings: Settings) -> RecordPath:
    """A run as a path, with the noise of its sensor: by the spectrum above what the path follows."""
    time, angle = run.time.values.astype(float), run.angle.values.astype(float)
    tau = frequency * (time - time[0])
    sensor = colour_above(angle - smooth(tau, angle).x, tau, ABOVE)
    return path_of(time, angle, frequency, sensor, settings=settings)


def default_shapes(force: Force) -> dict[str, float]:
    """Shape parameters of a force by their names, `dahl.s`."""
    return {f"{force.symbol}.{name}": shape.default for name, shape in force.shape.items()}
