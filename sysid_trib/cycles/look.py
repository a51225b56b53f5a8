"""What a record holds before any fit, and which forces its backbone points to."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np
import scipy
import xarray as xr
from scipy.ndimage import median_filter, uniform_filter1d
from scipy.optimize import lsq_linear, nnls
from scipy.special import ellipk

from sysid_trib.arrays import Array
from sysid_trib.cycles.backbone import backbone, half_width
from sysid_trib.cycles.signatures import averages
from sysid_trib.errors import DecayError
from sysid_trib.forces.force import Force
from sysid_trib.forces.library import load_library
from sysid_trib.records import equilibrium, half_periods, half_sines, modes, sensor, signal, smoothing
from sysid_trib.results.signal_scale import counts_angles
from sysid_trib.results.variables import Variables, group_names, variable

# By formula, as libraries may name them otherwise; in words.
FRICTION = {"sign(v)": "dry friction", "2*v": "viscous friction", "v*abs(v)": "drag"}
ELASTIC = {"x*abs(x)": "a stiffness that goes with the amplitude", "x**3": "a cubic stiffness"}


def pointed_to(
    curves: xr.Dataset, forces: Mapping[str, Force], *, angle: bool, scatter: Array | float = 0.0
) -> tuple[list[str], bool]:
    """The forces that a backbone points to, by their formulas, and whether it is that of a pendulum.

    Parameters
    ----------
    curves : Dataset
        Of `backbone`.
    forces : mapping of str to Force
        Those of `FRICTION` and `ELASTIC` by their formulas.
    angle : bool
        Whether the signal is an angle in rad: else nothing is a pendulum.
    scatter : (amplitude,) array of float, optional
        Of a single extremum, over the amplitude.

    Notes
    -----
    Of damping the fewest of dry friction, viscous friction and drag, none negative, that stay within the
    band; all that have a part in the best sum where none do. Of frequency nothing where a constant stays
    within the band; a pendulum where w0 pi/(2 K(sin(a/2))) does; else the fewest elastic forces.
    """
    a = curves.amplitude.values
    damping = {formula: -averages(forces[formula], a, {})[0] / a for formula in FRICTION}
    shifts = {formula: averages(forces[formula], a, {})[1] / a for formula in ELASTIC}
    frequency, half = curves.frequency.values, half_width(curves, "frequency")
    # Noise, or the line of another motion, moves the mean frequency of many periods, and that of their
    # decrements, by the square of its part of the amplitude: no average takes that away.
    part = np.square(scatter)
    half = half + part * frequency
    shift = np.abs(frequency - np.average(frequency, weights=half**-2.0))
    ratio = curves.damping_ratio.values
    # Decrements go with the square of the period: averages of first order leave that open.
    width = half_width(curves, "damping_ratio") + 2.0 * (shift / frequency + part) * np.abs(ratio)
    # A curve that is nowhere known better than so says nothing.
    known = np.min(width / np.abs(ratio)) < 0.5
    friction = _fewest(damping, ratio, width, []) if known else []
    constant = np.ones(len(a))
    if _fit([constant], frequency, half)[0] <= 1.0:
        return friction, False
    swing = np.pi / (2.0 * ellipk(np.sin(0.5 * np.minimum(a, 3.1)) ** 2))
    # Besides the band, of a shift of the frequency: what a pendulum's third harmonic and a string that gives
    # leave open.
    half = half + 0.1 * shift
    if angle and a[-1] < np.pi and _fit([swing], frequency, half)[0] <= 1.0:
        return friction, True
    return [*friction, *_fewest(shifts, frequency, half, [constant])], False


def _fewest(columns: Mapping[str, Array], curve: Array, half: Array, always: list[Array]) -> list[str]:
    """The fewest columns whose sum stays within the band; those of the best sum where none do."""
    for count in range(1, len(columns) + 1):
        deviations = {
            names: _fit([*(columns[name] for name in names), *always], curve, half, bool(always))[0]
            for names in combinations(columns, count)
        }
        best = min(deviations, key=deviations.__getitem__)
        if deviations[best] <= 1.0:
            return list(best)
    _, weights = _fit([*columns.values(), *always], curve, half, bool(always))
    return [name for name, weight in zip(columns, weights, strict=False) if weight]


def _fit(columns: list[Array], curve: Array, half: Array, free: bool = True) -> tuple[float, Array]:
    """Largest deviation of the best sum in half widths, and weights; none negative if they are not free."""
    table = np.column_stack(columns) / half[:, None]
    weights = lsq_linear(table, curve / half).x if free else nnls(table, curve / half)[0]
    return float(np.max(np.abs(table @ weights - curve / half))), weights


def _listed(words: list[str]) -> str:
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"


USUAL_LIBRARY, PENDULUM = "contact_forces", "pendulum"
# Points of a spectrum that are kept: it is drawn, not computed with.
SPECTRUM_POINTS = 2000
FEWEST_INSTANTS, FEWEST_FOR_DRIFT, DRIFT_ERRORS = 5, 12, 4.0


def look(records: list[xr.Dataset], decays: list[xr.Dataset]) -> xr.DataTree:
    """Facts of records and of the decays in them, without a fit.

    Parameters
    ----------
    records : list of Dataset
        As `read_records` returns them.
    decays : list of Dataset
        As `free_decays` returns them.

    Returns
    -------
    DataTree
        Groups `record` (`record_1`, ...) with `angle(time)`; `decay` (`decay_1`, ...) over `instant` with
        `amplitude`, `instant_time` and `frequency`, scalars `start`, `stop`, `period` (s), `periods`,
        `first_amplitude`, `last_amplitude`, `first_damping_ratio`, `last_damping_ratio`, `noise`,
        `drift` (of the middle; 0
        within its errors), `sensor_step` (of what was measured; nan if none), `samples_per_period`, and
        `spectrum(frequency_line)`. Units are those of the record. attrs `points_to_forces`,
        `points_to_system`, `points_to`: what the backbone points to, empty if nothing; `modes`, where several
        swing at once.

    Raises
    ------
    DecayError
        Fewer than three half periods.
    """
    of_sum = {record.attrs.get("record_checksum"): record for record in records}
    facts = [_facts(decay, of_sum.get(decay.attrs.get("record_checksum"), decay)) for decay in decays]
    groups = dict(zip(group_names("record", len(records)), records, strict=True))
    groups |= dict(zip(group_names("decay", len(decays)), facts, strict=True))
    return xr.DataTree.from_dict(groups)


def _facts(decay: xr.Dataset, record: xr.Dataset) -> xr.Dataset:
    curve = half_sines.envelope(decay)
    time, angle = decay.time.values, decay.angle.values
    unit = signal.unit_of_signal(decay)
    frequency = _median_frequency(curve)
    period = 2.0 * np.pi / frequency
    amplitude, instants = _without_drift(curve.amplitude.values), curve.instant_time.values
    # What was resampled or integrated since has lost its steps.
    measured = record[record.attrs.get("measured", "angle")].sel(time=slice(time[0], time[-1]))
    step_unit = str(measured.attrs.get("units", unit))
    first = _damping(instants, amplitude, frequency)
    last = -_damping(-instants[::-1], amplitude[::-1], frequency)
    step = sensor.sensor_step(measured.to_numpy())
    # Steps are noise: by chance the values that a filter repeats lie on a lattice as well. Many samples are
    # taken by a motion from one step to the next at most.
    largest = 30.0 * half_periods.noise_level(measured.time.values, measured.to_numpy())
    step, noise = step if step <= largest else float("nan"), smoothing.sensor_noise(decay)
    scalars: Variables = {
        "start": variable((), time[0], "first sample", "s"),
        "stop": variable((), time[-1], "last sample", "s"),
        "period": variable((), period, "period of the swing, median", "s"),
        "periods": variable((), (time[-1] - time[0]) / period, "periods", "1"),
        "first_amplitude": variable((), amplitude[0], "first amplitude", unit),
        "last_amplitude": variable((), amplitude[-1], "last amplitude", unit),
        "first_damping_ratio": variable((), first, "rate of decay over w at the start", "1"),
        "last_damping_ratio": variable((), last, "rate of decay over w at the end", "1"),
        "noise": variable((), noise, "standard deviation of the sensor's noise", unit),
        "drift": variable((), _drift(curve), "how far the middle of the swing moves", unit),
        "sensor_step": variable((), step, "step of the sensor", step_unit),
        "samples_per_period": variable((), period / float(np.median(np.diff(time))), "samples a period", "1"),
    }
    kept = curve[["instant_time", "frequency"]].assign(amplitude=curve.amplitude.copy(data=amplitude))
    facts = kept.assign({**scalars, **_spectrum(time, angle, unit)})
    several = modes.modes(measured.time.values, measured.to_numpy())
    said = modes.listed(several) if len(several) > 1 else ""
    return facts.assign_attrs({**decay.attrs, **pointers(decay), "modes": said})


def pointers(decay: xr.Dataset) -> dict[str, str]:
    """What the backbone of a record points to, empty if nothing.

    Parameters
    ----------
    decay : Dataset
        ``angle(time)``.

    Returns
    -------
    dict of str to str
        `points_to_forces`, their symbols; `points_to_system`; `points_to`, both in words.
    """
    library = load_library(USUAL_LIBRARY)
    roles = {formula: library.role(formula) for formula in (*FRICTION, *ELASTIC)}
    forces = {formula: force for formula, force in roles.items() if force is not None}
    try:
        curves, angle = backbone(decay), counts_angles(decay)
        formulas, pendulum = pointed_to(curves, forces, angle=angle, scatter=_scatter(decay, curves))
    except DecayError:
        formulas, pendulum = [], False
    friction, elastic = ([words[f] for f in formulas if f in words] for words in (FRICTION, ELASTIC))
    parts = [f"damping as of {_listed(friction)}"] if friction else []
    if pendulum:
        parts.append("amplitude and frequency as of a pendulum under gravity")
    elif elastic:
        parts.append(f"frequency as of {_listed(elastic)}")
    return {
        "points_to_forces": ",".join(forces[formula].symbol for formula in formulas),
        "points_to_system": PENDULUM if pendulum else "",
        "points_to": "; ".join(parts),
    }


# Extrema of which the median of the scatter is taken; of many, what each is off the mean of so many.
MEDIAN_OF, LOCAL, FEWEST_FOR_LOCAL = 9, 41, 400


def _scatter(decay: xr.Dataset, curves: xr.Dataset) -> Array:
    """Scatter of a single extremum over its size, at the amplitudes of a backbone."""
    measured = half_sines.envelope(decay)
    size = measured.extremum.values
    order = np.argsort(size)
    relative = measured.extremum_standard_error.values / size
    if size.size >= FEWEST_FOR_LOCAL:
        off = np.log(size) - uniform_filter1d(np.log(size), LOCAL)
        relative = np.maximum(relative, np.sqrt(uniform_filter1d(off**2, LOCAL)))
    relative = median_filter(relative[order], MEDIAN_OF)
    return np.asarray(np.interp(curves.amplitude.values, size[order], relative))


def _without_drift(amplitude: Array) -> Array:
    """Amplitudes as the mean over both sides: a middle that moves makes one side's larger, in turn."""
    if amplitude.size < FEWEST_INSTANTS:
        return amplitude
    inner = 0.25 * (amplitude[:-2] + 2.0 * amplitude[1:-1] + amplitude[2:])
    # The ends by the slope of their neighbours.
    first, last = 2.0 * inner[0] - inner[1], 2.0 * inner[-1] - inner[-2]
    return np.concatenate(([first], inner, [last if last > 0.0 else amplitude[-1]]))


def _drift(curve: xr.Dataset) -> float:
    """Movement of the middle along a line, from the first half period to the last; 0 within its errors."""
    signed, time = curve.sign.values * curve.extremum.values, curve.extremum_time.values
    if signed.size < FEWEST_FOR_DRIFT:
        return 0.0
    # The middle between extrema of both sides; decays of either sign cancel in it to third order.
    middle = np.convolve(signed, equilibrium.BINOMIAL, "valid")
    at = time[2:-2] - time[2:-2].mean()
    line, covariance = np.polyfit(at, middle, 1, cov=True)
    # Neighbouring middles share extrema.
    error = np.sqrt(covariance[0, 0] * equilibrium.BINOMIAL.size)
    return float(line[0] * (time[-1] - time[0])) if abs(line[0]) > DRIFT_ERRORS * error else 0.0


# Instants at an end of a decay that give its rate there, and the part of it by which it may be wrong.
INSTANTS, KNOWN_RATE = 8, 0.1
# Parts of a long decay in which its frequency is taken; periods one by one are too noisy.
FREQUENCY_PARTS = 100


def _median_frequency(curve: xr.Dataset) -> float:
    """Median of the frequency (rad/s) of some periods each."""
    time = curve.extremum_time.values
    halves = max(2, len(time) // FREQUENCY_PARTS)
    return float(np.median(halves * np.pi / (time[halves:] - time[:-halves])))


def _damping(time: Array, amplitude: Array, frequency: float) -> float:
    """Logarithmic rate of the amplitude at the first times, over w: by so many that it is known."""
    good = amplitude > 0.0
    time, level = time[good], np.log(amplitude[good])
    if time.size < 2:
        return float("nan")
    most = max(2, time.size // 2)
    count = min(INSTANTS, most)
    while True:
        at = time[:count] - time[:count].mean()
        squares = float(np.sum(at**2))
        slope = float(np.sum(at * level[:count])) / squares
        rest = level[:count] - level[:count].mean() - slope * at
        error = np.sqrt(float(np.sum(rest**2)) / max(count - 2, 1) / squares)
        if error <= KNOWN_RATE * abs(slope) or count == most:
            return -slope / frequency
        count = min(2 * count, most)


def _spectrum(time: Array, angle: Array, unit: str) -> Variables:
    """One-sided density, averaged to so many points on a logarithmic axis."""
    sampling_rate = 1.0 / float(np.mean(np.diff(time)))
    line, power = (values[1:] for values in scipy.signal.periodogram(angle, sampling_rate, "hann"))
    if line.size > SPECTRUM_POINTS:
        edges = np.unique(np.geomspace(1, line.size, SPECTRUM_POINTS).astype(int)) - 1
        counts = np.diff(np.append(edges, line.size))
        line, power = (np.add.reduceat(values, edges) / counts for values in (line, power))
    return {
        "frequency_line": variable("frequency_line", line, "frequency", "Hz"),
        "spectrum": variable("frequency_line", power, "spectral density", f"{unit}^2/Hz"),
    }
