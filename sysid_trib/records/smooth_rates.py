"""Fit of modes whose frequency and rate of decay are smooth curves, to all sensors at once.

The envelopes of `ringing` are flexible enough to contain part of a neighbouring mode near the ends of a
record. Here each mode has few parameters: a constant shape, and rates of phase and level that are splines
with a few intervals.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline

from sysid_trib.arrays import Array
from sysid_trib.records.ringing import (
    NORMAL_RIDGE,
    POINTS_A_KNOT,
    SAMPLES_AT_ONCE,
    Complex,
    Component,
    fit_envelopes,
    with_common_part,
)

# Splines of the rates of phase and level: least number of intervals, degree, and the fraction of the duration
# by which their knots are placed in time instead of in amplitude.
FEWEST_RATES, RATE_DEGREE, IN_TIME = 3, 3, 0.3
POLISHING_ROUNDS, LEAST_GAIN = 12, 1.0
# Range of the damping of Levenberg-Marquardt steps, relative to the diagonal of the normal equations.
LEAST_DAMPING, MOST_DAMPING, LARGEST_LEVEL = 1e-9, 1.0, 40.0


@dataclass(frozen=True)
class RateIntervals:
    """Number of intervals of the splines of a rate.

    Attributes
    ----------
    per_fall : float
        Intervals per fall of the amplitude by e.
    most : int
    """

    per_fall: float
    most: int


# Few intervals separate modes by their frequencies alone; many follow the law of a mode closely, which the
# sensors must then separate by its shape.
FEW_INTERVALS, MANY_INTERVALS = RateIntervals(2.0, 10), RateIntervals(4.0, 24)


def with_smooth_rates(
    signals: Array,
    components: Sequence[Component],
    interval: float,
    noise: Array,
    intervals: RateIntervals = FEW_INTERVALS,
) -> list[Component]:
    """Fit components whose frequency and rate of decay are smooth curves, and whose shapes are constant.

    Few parameters describe each oscillation, so neighbouring modes are separated at the ends of a record too
    (Gauss-Newton steps from the previous envelopes).

    Parameters
    ----------
    signals : (sensor, sample) array of float
    components : sequence of Component
        Components with their envelopes.
    interval : float, s
    noise : (sensor,) array of float
    intervals : RateIntervals, optional
    """
    common = [with_common_part(component, noise) for component in components]
    smoothed = [_smoothed(component, interval, intervals) for component in common]
    integrals = [_integrated_rates(component, interval, intervals) for component in smoothed]
    fitted = fit_envelopes(signals, smoothed)
    shapes = [_mean_shape(component) for component in fitted]
    damping, rounds = LEAST_DAMPING, 0
    rest, columns = _what_is_left(signals, fitted, shapes, integrals)
    squares = float(np.sum((rest / noise[:, None]) ** 2))
    gram, right = _products(columns, rest)
    while rounds < POLISHING_ROUNDS and damping < MOST_DAMPING:
        rounds += 1
        steps = _newton_step(gram, right, shapes, [len(integral) for integral in integrals], noise, damping)
        stepped = [
            _stepped(component, of_level @ integral, of_phase @ integral)
            for component, (_, of_level, of_phase), integral in zip(fitted, steps, integrals, strict=True)
        ]
        new_shapes = [shape + of_shape for shape, (of_shape, _, _) in zip(shapes, steps, strict=True)]
        rest, columns = _what_is_left(signals, stepped, new_shapes, integrals)
        now = float(np.sum((rest / noise[:, None]) ** 2))
        # Levenberg-Marquardt: a step without improvement is shortened.
        if not now < squares:
            damping *= 30.0
            continue
        fitted, shapes, gain, squares, damping = stepped, new_shapes, squares - now, now, damping / 10.0
        if gain < LEAST_GAIN:
            break
        gram, right = _products(columns, rest)
    return [
        replace(component, envelope=np.tile(shape, (component.splines, 1)), error=np.zeros(component.splines))
        for component, shape in zip(fitted, shapes, strict=True)
    ]


def _what_is_left(
    signals: Array, fitted: Sequence[Component], shapes: Sequence[Complex], integrals: Sequence[Array]
) -> tuple[Array, list[Complex]]:
    """Return the residual of signals, and the columns of the next step."""
    rest, columns = signals.copy(), []
    for component, shape, integral in zip(fitted, shapes, integrals, strict=True):
        level = np.minimum(component.level[: component.stop], LARGEST_LEVEL)
        wave = np.exp(level + 1j * component.phase[: component.stop])
        rest[:, : component.stop] -= (shape[:, None] * wave).real
        columns += [wave[None], wave * integral]
    return rest, columns


def _smoothed(component: Component, interval: float, intervals: RateIntervals) -> Component:
    """Replace phase and level of an oscillation by the nearest ones with smooth rates."""
    every = max(1, component.stop // 1000)
    for _ in range(2):
        integrals = _integrated_rates(component, interval, intervals)
        table = np.vstack([np.ones(component.stop), integrals])
        weight = np.exp(
            np.maximum(component.level[: component.stop] - component.level[: component.stop].max(), -6.0)
        )[::every]
        thin = (table[:, ::every] * weight).T
        made = []
        for part in (component.level, component.phase):
            values = part[: component.stop]
            fit = np.linalg.lstsq(thin, values[::every] * weight, rcond=1e-10)[0]
            made.append(fit @ table - values)
        component = _stepped(component, *made)
    return component


def _mean_shape(component: Component) -> Complex:
    """Return the constant shape that best fits the envelopes of all sensors."""
    points = np.linspace(0.0, component.stop - 1.0, POINTS_A_KNOT * component.splines)
    weight = np.exp(2.0 * np.interp(points, np.arange(component.level.size), component.level))
    return np.asarray(weight @ component.envelope_at(points) / weight.sum())


def _integrated_rates(component: Component, interval: float, intervals: RateIntervals) -> Array:
    """Return the integrals over time of the splines of the rates, (spline, sample)."""
    time = np.linspace(0.0, 1.0, component.stop)
    fall = np.maximum(-np.gradient(component.level[: component.stop]), 0.0)
    fallen = np.cumsum(fall)
    along = IN_TIME * time + (1.0 - IN_TIME) * fallen / fallen[-1] if fallen[-1] > 0.0 else time
    along = along / along[-1]
    count = int(np.clip(round(intervals.per_fall * fallen[-1]), FEWEST_RATES, intervals.most))
    knots = np.concatenate([np.zeros(RATE_DEGREE), np.linspace(0.0, 1.0, count + 1), np.ones(RATE_DEGREE)])
    splines = BSpline.design_matrix(np.clip(along, 0.0, 1.0), knots, RATE_DEGREE).toarray().T
    summed = np.cumsum(splines, axis=1)
    return (summed - 0.5 * (splines + splines[:, :1])) * interval


def _products(columns: Sequence[Complex], rest: Array) -> tuple[Array, Array]:
    """Return products of real and negative imaginary parts of waves, with each other and with signals."""
    sizes = [2 * len(part) for part in columns]
    size, stop = sum(sizes), max(part.shape[1] for part in columns)
    gram, right = np.zeros((size, size)), np.zeros((size, rest.shape[0]))
    for low in range(0, stop, 4 * SAMPLES_AT_ONCE):
        high = min(low + 4 * SAMPLES_AT_ONCE, stop)
        table = np.zeros((size, high - low))
        row = 0
        for part in columns:
            inside = part[:, low:high]
            table[row : row + len(part), : inside.shape[1]] = inside.real
            table[row + len(part) : row + 2 * len(part), : inside.shape[1]] = -inside.imag
            row += 2 * len(part)
        gram += table @ table.T
        right += table @ rest[:, low:high].T
    return gram, right


def _newton_step(
    gram: Array, right: Array, shapes: Sequence[Complex], counts: Sequence[int], noise: Array, damping: float
) -> list[tuple[Complex, Array, Array]]:
    """Return the steps of the shape and of the rates of level and phase, for each oscillation."""
    sensors, total = len(noise), 2 * sum(len(noise) + count for count in counts)
    normal, target = np.zeros((total, total)), np.zeros(total)
    for sensor in range(sensors):
        # Weights of the unknowns in the columns of this sensor.
        mapped = np.zeros((len(gram), total))
        row = place = 0
        for shape, count in zip(shapes, counts, strict=True):
            mapped[row, place + sensor] = mapped[row + 1, place + sensors + sensor] = 1.0
            rates, at = place + 2 * sensors, row + 2
            ones, value = np.arange(count), shape[sensor]
            mapped[at + ones, rates + ones] = value.real
            mapped[at + count + ones, rates + ones] = value.imag
            mapped[at + ones, rates + count + ones] = -value.imag
            mapped[at + count + ones, rates + count + ones] = value.real
            row += 2 + 2 * count
            place += 2 * (sensors + count)
        normal += mapped.T @ gram @ mapped / noise[sensor] ** 2
        target += mapped.T @ right[:, sensor] / noise[sensor] ** 2
    scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    scaled = scale[:, None] * normal * scale + (NORMAL_RIDGE + damping) * np.eye(total)
    solution = scale * np.linalg.solve(scaled, scale * target)
    steps: list[tuple[Complex, Array, Array]] = []
    place = 0
    for count in counts:
        own = solution[place : place + 2 * (sensors + count)]
        of_shape = own[:sensors] + 1j * own[sensors : 2 * sensors]
        steps.append((of_shape, own[2 * sensors : 2 * sensors + count], own[2 * sensors + count :]))
        place += 2 * (sensors + count)
    return steps


def _stepped(component: Component, level: Array, phase: Array) -> Component:
    """Change level and phase of an oscillation; after its stop by the change at the stop."""
    after = component.phase.size - component.stop
    level, phase = (np.concatenate([part, np.full(after, part[-1])]) for part in (level, phase))
    return replace(component, level=component.level + level, phase=component.phase + phase)
