"""The start of a motion fitted to a record, and what a sensor shows of the motion."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import SimulationError
from sysid_trib.forces.selection import is_free_to_move
from sysid_trib.records.smoothing import first_of_spline
from sysid_trib.simulation.model import BY_ANGLE, BY_RATE, Model, sensor_error
from sysid_trib.simulation.motions import STEPS_A_PERIOD, SimulatedMotion
from sysid_trib.simulation.simulate import trajectory
from sysid_trib.simulation.stand_in import accuracy_of, has_curves, without_curves

MEASURED, MEASURED_TIME = "measured", "measured_time"


def measured_part(decay: xr.Dataset) -> tuple[tuple[str, float], Array, Array]:
    """Return sensor (see `SimulatedMotion.shown`), times (s) and values of the measurement of a decay.

    Parameters
    ----------
    decay : Dataset
        As `free_decay` returns it. Of a part of one, only what was measured within it counts.
    """
    time = decay["time"].to_numpy().astype(float)
    if MEASURED not in decay:
        return ("angle", 0.0), time, decay["angle"].to_numpy().astype(float)
    inside = decay[MEASURED].sel({MEASURED_TIME: slice(time[0], time[-1])})
    sensor = str(decay.attrs["measured"]), float(decay.attrs.get("distance", 0.0))
    return sensor, inside[MEASURED_TIME].to_numpy().astype(float), inside.to_numpy().astype(float)


MAX_ROUNDS = 8
# A last step of the start, in parts of the swing; of a motion that need only be near the record.
SETTLED_START, NEAR_START = 1e-5, 3e-5
# After a step as long as this part of the swing the derivatives are taken anew.
FAR_START = 1e-2
# And after a step that is not shorter than this part of the one before: if both sides of a rest with friction
# have one slope, the start alternates between them.
NOT_SHORTER = 0.5
BY_START = (BY_ANGLE, BY_RATE)
# A direction is lost in rounding if it moves the motion by this part of the other directions.
SINGULAR = 1e-7
# A motion that does not come near the record in this number of rounds has slipped out of phase.
NEARBY_ROUNDS = 4


@dataclass(frozen=True)
class FittedMotion:
    """A model's motion fitted to a record by its initial conditions alone.

    Attributes
    ----------
    angle : float, rad
        Angle at the first sample.
    rate : float, rad/s
        Rate at the first sample.
    offset : float, rad
        Zero of the sensor.
    x : (sample,) array of float, rad
        theta at the record's times.
    v : (sample,) array of float, rad
        theta'/w at the record's times.
    stop_time : float, s
        When the motion stops; nan if it does not within the record.
    hidden : mapping of str to (sample,) array of float
        States and memory of forces as `dahl.z`.
    sensitivity : (sample, 2) array of float, or None
        Derivative of the angle by that (1) and the rate (s) at the first sample, of a motion nearby; None
        where none was computed.
    """

    angle: float
    rate: float
    offset: float
    x: Array
    v: Array
    stop_time: float
    hidden: Mapping[str, Array]
    sensitivity: Array | None


def first_guess(time: Array, angle: Array, frequency: float) -> tuple[float, float]:
    """Return the angle (rad) and rate (rad/s) at the first sample, of the smoothed record."""
    value, slope = first_of_spline(frequency * (time - time[0]), angle)
    return value, slope * frequency


def first_zero(model: Model) -> float | None:
    """Return first guess of the sensor's zero, as `fit_start` takes it: none for a body that is free to move.

    Nothing tells it from where such a body begins. A zero that is a term of the model is not fitted again.
    """
    known = any(not sensor.formula.names for sensor in model.sensors)
    return None if known or is_free_to_move(model.library, model.coefficients) else 0.0


# Newton steps from what a sensor shows at a start to the angle of the motion.
SENSOR_STEPS = 3


def true_start(model: Model, shown: float, rate: float) -> float:
    """Return the angle (rad) of a motion at its start where the sensor shows another one.

    Parameters
    ----------
    model : Model
        With its sensor terms.
    shown, rate : float, rad and rad/s
        What the sensor shows at the start, and the rate there.
    """
    if not model.sensors:
        return shown
    angle, v, elapsed = np.array([shown]), np.array([rate / model.reference_frequency]), np.zeros(1)
    for _ in range(SENSOR_STEPS):
        error, by_motion, _ = sensor_error(model, elapsed, angle, v, ())
        angle = angle - (angle + error - shown) / (1.0 + by_motion[:, 0])
    return float(angle[0])


def fit_start(
    model: Model,
    time: Array,
    angle: Array,
    start: tuple[float, float],
    *,
    offset: float | None = 0.0,
    sensitivity: Array | None = None,
    near: bool = False,
    most_steps: int = STEPS_A_PERIOD,
) -> FittedMotion:
    """Return the least squares of a record on the initial conditions of a model's motion.

    Parameters
    ----------
    model : Model
        The model.
    time : (sample,) array of float, s
        Times of the record.
    angle : (sample,) array of float, rad
        The record.
    start : (float, float), rad and rad/s
        First guess of angle and rate at the first sample.
    offset : float or None, rad
        First guess of the sensor's zero; None holds it at zero.
    sensitivity : (sample, 2) array of float, optional
        Sensitivity of a model nearby; by default its own.
    near : bool
        Whether the motion need only be near the record, not the best of all: the last step is then taken by
        its start alone.
    most_steps : int
        Of `trajectory`.

    Returns
    -------
    FittedMotion

    Raises
    ------
    SimulationError
        The model's motion cannot be computed.

    Notes
    -----
    Gauss-Newton with one set of sensitivities (a chord): the motion is nearly linear in its start.
    """
    amplitude = float(np.max(np.abs(angle))) * np.array([1.0, model.reference_frequency])
    # A rate in a power of two near w, in which it counts as an angle does, whatever the unit of time.
    units = np.array([1.0, np.exp2(np.round(np.log2(model.reference_frequency)))])
    begin, zero, longest = np.array(start, dtype=float), offset or 0.0, np.inf
    by = BY_START if sensitivity is None else ()
    # Derivatives of a motion along many narrow parts of a curve take many times as long as the motion itself.
    smooth = without_curves(model, float(np.ptp(angle))) if has_curves(model) else None
    accuracy = accuracy_of(model)
    rounds = NEARBY_ROUNDS if near else MAX_ROUNDS
    for done in range(rounds + 1):
        if by and smooth is not None:
            sensitivity = trajectory(smooth, time, *begin, by=by, most_steps=most_steps).derivatives["angle"]
            by = ()
        motion = trajectory(model, time, *begin, by=by, most_steps=most_steps, accuracy=accuracy)
        sensitivity = motion.derivatives.get("angle", sensitivity)
        if longest < SETTLED_START or done == rounds:
            break
        columns = sensitivity * units
        columns = columns if offset is None else np.column_stack([columns, np.ones(len(time))])
        # Three columns of many rows: their products tell a step as well, and ten times as fast.
        residual = angle - zero - motion.angle
        steps, *_ = np.linalg.lstsq(columns.T @ columns, columns.T @ residual, rcond=SINGULAR**2)
        steps[:2] *= units
        before, longest = longest, np.max(np.abs(steps[:2]) / amplitude)
        # A step as long as the swing itself is a phase slip, not a start.
        begin = begin + steps[:2] * min(1.0, 0.5 / max(longest, 1e-300))
        zero += float(steps[2]) if offset is not None else 0.0
        if near and longest < NEAR_START:
            break
        by = BY_START if longest > min(FAR_START, NOT_SHORTER * before) else ()
        if longest > NOT_SHORTER * before:
            smooth = None
    v = motion.rate / model.reference_frequency
    return FittedMotion(
        begin.item(0), begin.item(1), zero, motion.angle, v, motion.stop_time, motion.hidden, sensitivity
    )


def measured_motion(
    model: Model,
    run: xr.Dataset,
    start: tuple[float, float],
    *,
    fitted: slice | None = None,
) -> tuple[SimulatedMotion, Array]:
    """Fit the start of a motion, and the sensor's bias, to what was measured of a run.

    Parameters
    ----------
    model : Model
        With its inputs.
    run : Dataset
        See `measured_part`.
    start : (float, float), rad and rad/s
        First guess of angle and rate at the first sample.
    fitted : slice, optional
        Samples that the start is fitted to; all where left out.

    Returns
    -------
    motion : SimulatedMotion
    residual : (sample,) array of float
        Measured signal minus motion and bias, in the unit of the sensor.

    Raises
    ------
    SimulationError
        The motion cannot be computed.
    """
    (quantity, distance), time, values = measured_part(run)
    part = slice(None) if fitted is None else fitted
    # The bias of a body that may be anywhere, and moves at any speed, cannot be determined.
    biased = first_zero(model) is not None
    begin, last = np.array(start, dtype=float), np.inf
    scale = np.array([1.0, model.reference_frequency, model.reference_frequency])[: 2 + biased]
    for _ in range(MAX_ROUNDS):
        motion = trajectory(model, time, *begin, by=BY_START)
        columns = motion.shown_derivatives(quantity, distance)
        columns = np.column_stack([columns, np.ones(len(time))]) if biased else columns
        residual = values - motion.shown(quantity, distance)
        step, *_ = np.linalg.lstsq(columns[part] * scale, residual[part], rcond=SINGULAR)
        step = step * scale
        size = float(np.max(np.abs(columns[part] @ step))) / max(float(np.std(values)), 1e-300)
        if biased:
            residual = residual - step[2]
        if size < SETTLED_START or not size < NOT_SHORTER * last:
            break
        begin, last = begin + step[:2], size
    return motion, residual


# A start may be in a local minimum if its residual (RMS) is more than this part of the record's.
LOCAL_MINIMUM = 0.3
# Sizes of the swing and phases of a period at which others then begin; the nearest of them are fitted.
SWING_SIZES, START_PHASES, FITTED_STARTS = np.linspace(0.6, 1.3, 29), 16, 4


def fit_start_of_several(
    model: Model,
    time: Array,
    angle: Array,
    start: tuple[float, float],
    *,
    offset: float | None = 0.0,
) -> FittedMotion:
    """Return `fit_start` from further first guesses where the motion from the first one misses the record.

    Where the frequency of a model is a little off, its motion slips out of phase in a long record, and the
    sum of squares has a minimum for each slip. A better motion may begin at another phase, or with another
    amplitude, on which the frequency depends. A driven motion forgets its start, and is fitted once.

    Raises
    ------
    SimulationError
        The model's motion cannot be computed from the first start.
    """
    best = fit_start(model, time, angle, start, offset=offset)
    if model.inputs or not _missed(best, angle) > LOCAL_MINIMUM * float(np.std(angle)):
        return best
    step, lead = float(np.median(np.diff(time))), 2.0 * np.pi / model.reference_frequency
    longer = np.append(time, time[-1] + step * np.arange(1.0, 2.0 + lead / step))
    nearest: list[tuple[float, tuple[float, float]]] = []
    for size in SWING_SIZES:
        with suppress(SimulationError):
            motion = trajectory(model, longer, size * start[0], size * start[1])
            # The same motion later begins at another phase.
            for later in lead * np.arange(START_PHASES) / START_PHASES:
                x = np.interp(time + later, longer, motion.angle)
                begin = [float(np.interp(time[0] + later, longer, of)) for of in (motion.angle, motion.rate)]
                nearest.append((float(np.sum((angle - best.offset - x) ** 2)), (begin[0], begin[1])))
    for _, guess in sorted(nearest)[:FITTED_STARTS]:
        with suppress(SimulationError):
            tried = fit_start(model, time, angle, guess, offset=offset)
            best = min(best, tried, key=lambda motion: _missed(motion, angle))
    return best


def _missed(motion: FittedMotion, angle: Array) -> float:
    """Return the RMS of a record minus a motion; infinite where that is no number."""
    rms = float(np.sqrt(np.mean((angle - motion.offset - motion.x) ** 2)))
    return rms if np.isfinite(rms) else float("inf")
