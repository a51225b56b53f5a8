"""What an identified model predicts of a record: its motion, the start alone fitted there."""

from dataclasses import replace

import numpy as np
import xarray as xr

from sysid_trib.errors import DecayError, SimulationError, UsageError
from sysid_trib.records.decay import as_runs
from sysid_trib.records.inputs import inputs_for
from sysid_trib.records.signal import unit_of_signal
from sysid_trib.results.schema import library_of, model_of
from sysid_trib.results.signal_scale import in_units_of_the_motion
from sysid_trib.results.variables import variable
from sysid_trib.simulation.initial_conditions import first_guess, first_zero, fit_start
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory

# Samples by which a start can be fitted.
FEWEST_FITTED = 20


@in_units_of_the_motion
def predict(
    result: xr.Dataset, record: xr.Dataset, *, warm_up: float | None = None, run: int = 0
) -> xr.Dataset:
    """Predict a record by an identified model: its free run under the record's inputs.

    Parameters
    ----------
    result : Dataset
        An identification, of this record or of another one.
    record : Dataset
        `angle(time)`, and the inputs that the model's forces hold.
    warm_up : float, s, optional
        The start is fitted to so much of the beginning, which does not count for the residual; to all of the
        record where left out, and all of it counts.
    run : int
        Of the result's runs, from 0, the one whose own coefficients are taken.

    Returns
    -------
    Dataset
        `angle(time)`, `predicted_angle(time)` as the sensor shows it, `residual(time)`; scalars
        `residual_rms`, `residual_over_motion` (1, of the RMS about the mean); attrs `warm_up` (s).

    Raises
    ------
    DecayError
        The motion of the model cannot be computed here, or the warm-up leaves nothing.
    UsageError
        The record lacks an input of the model.
    """
    (record,) = as_runs(record, driven=True)
    library = library_of(result).in_run(run + 1)
    model = replace(model_of(result, run), inputs=inputs_for(record, library))
    time = record.time.values.astype(float)
    counted = time >= time[0] + (warm_up or 0.0)
    if warm_up is not None and not FEWEST_FITTED <= np.count_nonzero(~counted) < len(time):
        raise UsageError(
            f"A warm-up of {warm_up:g} s holds {np.count_nonzero(~counted)} of {len(time)} samples; it takes "
            f"{FEWEST_FITTED} or more, and not all."
        )
    angle = record.angle.values.astype(float)
    try:
        shown = _shown(model, time, angle, ~counted if warm_up is not None else counted)
    except SimulationError as error:
        raise DecayError(f"The model has no motion on this record: {error}") from None
    residual, unit = angle - shown, unit_of_signal(record)
    rms = float(np.sqrt(np.mean(residual[counted] ** 2)))
    data = {
        "predicted_angle": variable("time", shown, "prediction", unit),
        "residual": variable("time", residual, "record minus prediction", unit),
        "residual_rms": variable((), rms, "RMS of record minus prediction", unit),
        "residual_over_motion": variable(
            (), rms / float(np.std(angle[counted])), "RMS of the residual over that of the record", "1"
        ),
    }
    return record.assign(data).assign_attrs(warm_up=warm_up or 0.0)


def _shown(model: Model, time: np.ndarray, angle: np.ndarray, fitted: np.ndarray) -> np.ndarray:
    """What the sensor shows of the motion whose start fits these samples best, (sample,)."""
    start = first_guess(time, angle, model.reference_frequency)
    motion = fit_start(model, time[fitted], angle[fitted], start, offset=first_zero(model))
    if fitted.all():
        return np.asarray(motion.x + motion.offset)
    return np.asarray(trajectory(model, time, motion.angle, motion.rate).angle + motion.offset)
