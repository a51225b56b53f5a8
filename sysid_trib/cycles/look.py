"""Facts of a record without a fit, and the forces that its backbone indicates."""

from collections.abc import Sequence

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.cycles.pointing import ElasticModel, pointed_to
from sysid_trib.records import equilibrium, half_periods, half_sines, modes, sensor, signal, smoothing
from sysid_trib.records.free_decay import free_decays
from sysid_trib.records.in_memory import as_decays
from sysid_trib.records.runs import RecordsLike
from sysid_trib.results.variables import Variables, group_names, variable

PENDULUM = "pendulum"
# Largest number of points of a stored spectrum, which is only drawn.
SPECTRUM_POINTS = 2000
FEWEST_INSTANTS, FEWEST_FOR_DRIFT, DRIFT_ERRORS = 5, 12, 4.0


# If the amplitude falls by less than this factor, laws of damping are hardly distinguishable.
LEAST_FALL = 2.0
# Least power of the amplitude in the damping ratio that suggests a law: -1 for dry friction, 1 for quadratic
# drag.
CLEAR_POWER = 0.25


def look(records: RecordsLike, decays: Sequence[xr.Dataset] | None = None) -> xr.DataTree:
    """Return the facts of records and of the decays in them, without a fit.

    Parameters
    ----------
    records : record, or several of them
        As `read_record` returns them, or `(t, angle)`.
    decays : sequence of Dataset, optional
        The free decays in the records, by default as `free_decays` returns them.

    Returns
    -------
    DataTree
        Groups `record` (`record_1`, ...) with `angle(time)`; `decay` (`decay_1`, ...) over `instant` with
        `amplitude`, `instant_time` and `frequency`, and `spectrum(frequency_line)`. Scalars of a decay:
        `start`, `stop`, `period` (s), `periods`, `first_amplitude`, `last_amplitude`, `first_damping_ratio`,
        `last_damping_ratio`, `damping_power` (the power of the amplitude in the damping ratio; nan if the
        amplitude hardly falls), `falls_too_little`, `noise`, `drift` (of the middle of the swing; 0 within
        its errors), `sensor_step` (of the measured signal; nan if none), `samples_per_period`. Units are
        those of the record. Attributes: `points_to_forces`, `points_to_system` and `points_to`, which the
        backbone indicates, empty if nothing; `damping_law`, the formula of the friction that `damping_power`
        suggests, by default viscous; `modes`, if several modes swing at once.

    Raises
    ------
    DecayError
        The record has fewer than three half periods.

    Examples
    --------
    >>> import sysid_trib as st
    >>> facts = st.look(st.records.paper_twin())["decay"]
    >>> print(f"{facts.periods.item():.0f} periods of {facts.period.item():.2f} s")
    39 periods of 0.64 s
    >>> facts.attrs["points_to_forces"]
    'zeta,delta,nu,epsilon'
    """
    given = as_decays(records, "look")
    whole = [given] if isinstance(given, xr.Dataset) else given
    parts = [part for record in whole for part in free_decays(record)] if decays is None else decays
    of_sum = {record.attrs.get("record_checksum"): record for record in whole}
    facts = [_facts(decay, of_sum.get(decay.attrs.get("record_checksum"), decay)) for decay in parts]
    groups = dict(zip(group_names("record", len(whole)), whole, strict=True))
    groups |= dict(zip(group_names("decay", len(parts)), facts, strict=True))
    return xr.DataTree.from_dict(groups)


def _facts(decay: xr.Dataset, record: xr.Dataset) -> xr.Dataset:
    curve = half_sines.envelope(decay)
    time, angle = decay.time.values, decay.angle.values
    unit = signal.unit_of_signal(decay)
    frequency = _median_frequency(curve)
    period = 2.0 * np.pi / frequency
    amplitude, instants = _without_drift(curve.amplitude.values), curve.instant_time.values
    # Take the step from the measured signal: resampling or integration removes it.
    measured = record[record.attrs.get("measured", "angle")].sel(time=slice(time[0], time[-1]))
    step_unit = str(measured.attrs.get("units", unit))
    first = _damping(instants, amplitude, frequency)
    last = -_damping(-instants[::-1], amplitude[::-1], frequency)
    fall = amplitude[0] / amplitude[-1]
    power = _damping_power(first, last, fall)
    law = "sign(v)" if power < -CLEAR_POWER else "v*abs(v)" if power > CLEAR_POWER else "2*v"
    step = sensor.sensor_step(measured.to_numpy())
    # Larger steps are noise, because repeated values of a filter may lie on a lattice by chance. A motion
    # takes at most thirty samples from one step to the next.
    largest = 30.0 * half_periods.noise_level(measured.time.values, measured.to_numpy())
    step, noise = step if step <= largest else float("nan"), smoothing.sensor_noise(decay)
    scalars: Variables = {
        "start": variable((), time[0], "first sample", "s"),
        "stop": variable((), time[-1], "last sample", "s"),
        "period": variable((), period, "period of the swing, median", "s"),
        "periods": variable((), (time[-1] - time[0]) / period, "periods", "1"),
        "first_amplitude": variable((), amplitude[0], "first amplitude", unit),
        "last_amplitude": variable((), amplitude[-1], "last amplitude", unit),
        "first_damping_ratio": variable((), first, "damping ratio at the start", "1"),
        "last_damping_ratio": variable((), last, "damping ratio at the end", "1"),
        "damping_power": variable((), power, "power of the amplitude in the damping ratio", "1"),
        "falls_too_little": variable(
            (), 1.0 < fall < LEAST_FALL, "too little to separate laws of damping", ""
        ),
        "noise": variable((), noise, "standard deviation of the sensor's noise", unit),
        "drift": variable((), _drift(curve), "movement of the middle of the swing", unit),
        "sensor_step": variable((), step, "step of the sensor", step_unit),
        "samples_per_period": variable((), period / float(np.median(np.diff(time))), "samples a period", "1"),
    }
    kept = curve[["instant_time", "frequency"]].assign(amplitude=curve.amplitude.copy(data=amplitude))
    facts = kept.assign({**scalars, **_spectrum(time, angle, unit)})
    several = modes.modes(measured.time.values, measured.to_numpy())
    said = modes.listed(several) if len(several) > 1 else ""
    return facts.assign_attrs({**decay.attrs, **pointers(decay), "damping_law": law, "modes": said})


def pointers(decay: xr.Dataset) -> dict[str, str]:
    """Return the forces and the system that the backbone of a record indicates; empty if none.

    Parameters
    ----------
    decay : Dataset
        ``angle(time)``.

    Returns
    -------
    dict of str to str
        `points_to_forces`, their symbols; `points_to_system`; `points_to`, both in words; `predicted_by`, the
        part of the frequency change with amplitude that each model does not explain;
        `columns_point_to_system`, the columns that name the system; `points_to_scale`, the factor on the
        signal with which the system fits, and its error.
    """
    pointed = pointed_to(decay)
    scale = pointed.scale
    return {
        "points_to_forces": ",".join(pointed.forces),
        "points_to_system": pointed.system,
        "points_to": pointed.words,
        "predicted_by": _ranked(pointed.ranking),
        "columns_point_to_system": pointed.columns,
        "points_to_scale": f"{scale.factor:.3g}" if scale else "",
        "points_to_scale_error": f"{scale.error:.1g}" if scale else "",
    }


def _ranked(ranking: tuple[ElasticModel, ...]) -> str:
    """Describe how much of the frequency change the models do not explain; empty if none predicts it."""
    parts = list[str]()
    for at, model in enumerate(ranking):
        # The first model is the chosen one. A subset of the forces of a system is not an alternative.
        if model.remains < 1.0 and (at == 0 or model.systems):
            systems = f" ({', '.join(model.systems)})" if model.systems else ""
            parts.append(f"{model.words} {100.0 * model.remains:.2g} %{systems}")
    return ", ".join(parts)


def _without_drift(amplitude: Array) -> Array:
    """Return amplitudes as the mean over both sides, which removes a moving middle."""
    if amplitude.size < FEWEST_INSTANTS:
        return amplitude
    inner = 0.25 * (amplitude[:-2] + 2.0 * amplitude[1:-1] + amplitude[2:])
    # Extrapolate the ends from their neighbours.
    first, last = 2.0 * inner[0] - inner[1], 2.0 * inner[-1] - inner[-2]
    return np.concatenate(([first], inner, [last if last > 0.0 else amplitude[-1]]))


def _drift(curve: xr.Dataset) -> float:
    """Return the drift of the middle by a linear fit, first to last half period; 0 within its errors."""
    signed, time = curve.sign.values * curve.extremum.values, curve.extremum_time.values
    if signed.size < FEWEST_FOR_DRIFT:
        return 0.0
    # The middle between extrema of both sides; the decay of the amplitude cancels in it to third order.
    middle = np.convolve(signed, equilibrium.BINOMIAL, "valid")
    at = time[2:-2] - time[2:-2].mean()
    line, covariance = np.polyfit(at, middle, 1, cov=True)
    # Neighbouring values of the middle share extrema.
    error = np.sqrt(covariance[0, 0] * equilibrium.BINOMIAL.size)
    return float(line[0] * (time[-1] - time[0])) if abs(line[0]) > DRIFT_ERRORS * error else 0.0


# Number of instants at an end of a decay that give its rate there, and the relative error allowed for this
# rate.
INSTANTS, KNOWN_RATE = 8, 0.1
# Number of parts of a long decay in which the frequency is determined; single periods are too noisy.
FREQUENCY_PARTS = 100


def _median_frequency(curve: xr.Dataset) -> float:
    """Return the median of the frequency (rad/s) over parts of a few periods each."""
    time = curve.extremum_time.values
    halves = max(2, len(time) // FREQUENCY_PARTS)
    return float(np.median(halves * np.pi / (time[halves:] - time[:-halves])))


def _damping(time: Array, amplitude: Array, frequency: float) -> float:
    """Return the logarithmic decay rate over w at the first times, from enough periods for its accuracy."""
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


def _damping_power(first: float, last: float, fall: float) -> float:
    """Return the power of the amplitude with which the damping ratio changes; nan if it hardly falls.

    `first`, `last` : damping ratios at both ends; `fall` : the first amplitude over the last.
    """
    if not (fall >= LEAST_FALL and first > 0.0 and last > 0.0):
        return float("nan")
    return float(np.log(first / last) / np.log(fall))


def _spectrum(time: Array, angle: Array, unit: str) -> Variables:
    """Return the one-sided density, averaged to few points on a logarithmic axis."""
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
