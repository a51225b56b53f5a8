"""Phase and amplitude of a mode along its decay, and whether the amplitude rises again."""

from dataclasses import dataclass

import numpy as np

from sysid_trib.arrays import Array
from sysid_trib.records.mode_search import Ringing
from sysid_trib.records.ringing import Component, common_shape

# Number of points of a history per spline of its envelope, and the least number of splines.
POINTS_A_SPLINE, FEWEST_POINTS = 8, 8
# An amplitude rises again if the rise exceeds this fraction and this number of standard errors.
RISE, RISE_ERRORS = 0.05, 8.0
RISE_MEANS = "modes exchange energy, or another mode is too near to be separated"


@dataclass(frozen=True)
class History:
    """History of a mode along its decay.

    Attributes
    ----------
    time, phase, amplitude : (point,) array of float
        In s, rad, and in the unit of the sensor at which the mode is largest.
    error : (point,) array of float
        Standard error of the phase, and relative error of the amplitude, as if points were independent.
    """

    time: Array
    phase: Array
    amplitude: Array
    error: Array


@dataclass(frozen=True)
class Rise:
    """Rise of an amplitude after a fall.

    Attributes
    ----------
    low, high : float
        Amplitudes at the begin and the end of the rise.
    time : float, s
        Time of the larger amplitude after the blow.
    """

    low: float
    high: float
    time: float

    def said(self, units: str) -> str:
        """Describe the rise."""
        rise = f"from {self.low:.3g} to {self.high:.3g} {units}"
        return f"rises again {rise} until {self.time:.3g} s after the blow"


def history_of(component: Component, ringing: Ringing) -> History:
    """Return the history of a mode, from all sensors together."""
    count = POINTS_A_SPLINE * max(FEWEST_POINTS, component.splines)
    points = np.linspace(0.0, component.stop - 1.0, count)
    envelope = component.envelope_at(points)
    shape = common_shape(envelope / ringing.noise)
    common = envelope / ringing.noise @ shape.conj()
    level, phase = (
        np.interp(points, np.arange(component.phase.size), part)
        for part in (component.level, component.phase)
    )
    size = np.abs(common) * np.exp(level)
    largest = float(np.max(np.abs(shape) * ringing.noise))
    return History(
        time=points * ringing.interval,
        phase=phase + np.unwrap(np.angle(common)),
        amplitude=size * largest,
        # Points within one spline are not independent.
        error=np.sqrt(POINTS_A_SPLINE) * component.error_at(points) / np.abs(common),
    )


def rise_of(history: History) -> Rise | None:
    """Return the rise of the amplitude of a mode after a fall; None if it only falls."""
    level = np.log(history.amplitude)
    lowest = np.minimum.accumulate(level)
    rise = level - lowest
    error = np.hypot(
        history.error, history.error[[int(np.argmin(level[: at + 1])) for at in range(level.size)]]
    )
    # The ends of splines are uncertain.
    rise[: 2 * POINTS_A_SPLINE] = rise[-2 * POINTS_A_SPLINE :] = 0.0
    top = int(np.argmax(rise / (RISE + RISE_ERRORS * error)))
    if not rise[top] > RISE + RISE_ERRORS * error[top]:
        return None
    return Rise(
        low=float(np.exp(lowest[top])), high=float(history.amplitude[top]), time=float(history.time[top])
    )
