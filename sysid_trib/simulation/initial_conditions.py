"""The start of a motion fitted to a record."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.forces.selection import is_free_to_move
from sysid_trib.records.smoothing import first_of_spline
from sysid_trib.simulation.model import BY_ANGLE, BY_RATE, Model, sensor_error
from sysid_trib.simulation.motions import STEPS_A_PERIOD
from sysid_trib.simulation.stand_in import accuracy_of, has_curves, most_steps_of, without_curves
from sysid_trib.simulation.trajectory import trajectory

MAX_ROUNDS = 8
# Last step of the start, as a fraction of the swing; the second for a motion that need only be near the
# record.
SETTLED_START, NEAR_START = 1e-5, 3e-5
# After a step longer than this fraction of the swing, compute the derivatives again.
FAR_START = 1e-2
# Compute them again too after a step that is longer than this fraction of the last step: if both sides of a
# rest with friction have the same slope, the start alternates between them.
NOT_SHORTER = 0.5
BY_START = (BY_ANGLE, BY_RATE)
# rad; smaller than any motion, for a record that is zero throughout.
LEAST_SWING = 1e-30
# A direction is lost in rounding if it moves the motion by less than this fraction of the largest.
SINGULAR = 1e-7
# If a motion does not come near the record in this number of rounds, it has lost the phase.
NEARBY_ROUNDS = 4
# The same for motions along curves, if after this number of rounds they are farther from the record than rest
# is.
ROUNDS_OF_CURVES = 2


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
        Time at which the motion stops; nan if it does not stop within the record.
    hidden : mapping of str to (sample,) array of float
        States and memory of forces by their names, such as `dahl.z`.
    sensitivity : (sample, 2) array of float, or None
        Derivatives of the angle by the angle (1) and the rate (s) at the first sample, for a nearby motion;
        None if not computed.
    settled : bool
        True if the fit has converged: the last step of the start was short.
    """

    angle: float
    rate: float
    offset: float
    x: Array
    v: Array
    stop_time: float
    hidden: Mapping[str, Array]
    sensitivity: Array | None
    settled: bool = True


def first_guess(time: Array, angle: Array, frequency: float) -> tuple[float, float]:
    """Return the angle (rad) and rate (rad/s) of the smoothed record at its first sample."""
    value, slope = first_of_spline(frequency * (time - time[0]), angle)
    return value, slope * frequency


def first_zero(model: Model) -> float | None:
    """Return the first estimate of the sensor's zero for `fit_start`; None for a body that is free to move.

    The zero of such a body cannot be separated from its position. A zero that is a sensor term of the model
    is not fitted again.
    """
    known = any(not sensor.formula.names for sensor in model.sensors)
    return None if known or is_free_to_move(model.library, model.coefficients) else 0.0


# Number of Newton steps from the sensor's reading at the start to the angle of the motion.
SENSOR_STEPS = 3


def true_start(model: Model, shown: float, rate: float) -> float:
    """Return the angle (rad) of a motion at its start for a given reading of the sensor.

    Parameters
    ----------
    model : Model
        Model with its sensor terms.
    shown, rate : float, rad and rad/s
        Sensor's reading at the start, and the rate there.
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
        First estimate of angle and rate at the first sample.
    offset : float or None, rad
        First estimate of the sensor's zero; None holds it at zero.
    sensitivity : (sample, 2) array of float, optional
        Sensitivity of a nearby model; by default that of the model itself.
    near : bool
        Whether the motion need only be near the record and not the best one: the last step of the start is
        then applied without a new motion.
    most_steps : int
        Largest number of steps, see `trajectory`.

    Returns
    -------
    FittedMotion

    Raises
    ------
    SimulationError
        The model's motion cannot be computed.

    Notes
    -----
    This is Gauss-Newton with constant sensitivities (chord method): the motion is nearly linear in its start.
    """
    # A short record near the middle of the swing shows its size by the rate.
    swing = max(float(np.max(np.abs(angle))), abs(start[1]) / model.reference_frequency, LEAST_SWING)
    amplitude = swing * np.array([1.0, model.reference_frequency])
    # Scale the rate by a power of two near w, so that it is comparable to an angle in any unit of time.
    units = np.array([1.0, np.exp2(np.round(np.log2(model.reference_frequency)))])
    begin, zero, longest = np.array(start, dtype=float), offset or 0.0, np.inf
    by = BY_START if sensitivity is None else ()
    # Derivatives along the many narrow basis functions of a curve take many times as long as the motion
    # itself.
    of_curves = has_curves(model)
    smooth = without_curves(model, float(np.ptp(angle))) if of_curves else None
    accuracy, most_steps = accuracy_of(model), most_steps_of(model, most_steps)
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
        # With three columns and many rows, the normal equations give the step as well, and ten times as fast.
        residual = angle - zero - motion.angle
        if of_curves and done >= ROUNDS_OF_CURVES and np.std(residual) > np.std(angle):
            break
        steps, *_ = np.linalg.lstsq(columns.T @ columns, columns.T @ residual, rcond=SINGULAR**2)
        steps[:2] *= units
        before, longest = longest, np.max(np.abs(steps[:2]) / amplitude)
        # A step as long as the swing itself would be a phase slip: limit it.
        begin = begin + steps[:2] * min(1.0, 0.5 / max(longest, 1e-300))
        zero += float(steps[2]) if offset is not None else 0.0
        if near and longest < NEAR_START:
            break
        by = BY_START if longest > min(FAR_START, NOT_SHORTER * before) else ()
        if longest > NOT_SHORTER * before:
            smooth = None
    v = motion.rate / model.reference_frequency
    return FittedMotion(
        angle=begin.item(0),
        rate=begin.item(1),
        offset=zero,
        x=motion.angle,
        v=v,
        stop_time=motion.stop_time,
        hidden=motion.hidden,
        sensitivity=sensitivity,
        settled=bool(longest < SETTLED_START),
    )
