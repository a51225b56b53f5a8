"""What a record holds: its decays with their periods, amplitudes, decay rates, noise and spectrum."""

import numpy as np
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.averaging.backbone import backbone_curves
from sysid_trib.decays.half_periods import noise_level
from sysid_trib.decays.half_sines import envelope
from sysid_trib.decays.signal import unit_of_signal
from sysid_trib.errors import DecayError
from sysid_trib.forces.library import load_library
from sysid_trib.looking.pointers import Pointed, pointed_to
from sysid_trib.noise.level import sensor_noise
from sysid_trib.noise.sensor_step import sensor_step
from sysid_trib.results.per_run import group_names
from sysid_trib.results.signal_scale import counts_angles
from sysid_trib.results.variables import Variables, variable

USUAL_LIBRARY, PENDULUM = "contact_forces", "pendulum"
# Points of a spectrum that are kept: it is drawn, not computed with.
SPECTRUM_POINTS = 2000
# Instants at either end from which the rate of decay there is taken.
END_INSTANTS = 8
# A step beside the noise of sixth differences, of a motion that takes many samples to the next step at most.
MOST_STEP = 30.0
# The middle between extrema of both sides; decays of either sign cancel in it to third order.
MIDDLE = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0
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
        `points_to_system`, `points_to`: what the backbone points to, empty if nothing.

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
    curve = envelope(decay)
    time, angle = decay.time.values, decay.angle.values
    unit = unit_of_signal(decay)
    frequency = float(np.median(curve.frequency))
    period = 2.0 * np.pi / frequency
    amplitude, instants = _beside_a_drift(curve.amplitude.values), curve.instant_time.values
    # What was resampled or integrated since has lost its steps.
    measured = record[record.attrs.get("measured", "angle")].sel(time=slice(time[0], time[-1]))
    step_unit = str(measured.attrs.get("units", unit))
    first, last = (_damping(instants[part], amplitude[part], frequency) for part in _ends(len(instants)))
    step = sensor_step(measured.to_numpy())
    # Steps are noise: by chance the values that a filter repeats lie on a lattice as well.
    step = (
        step if step <= MOST_STEP * noise_level(measured.time.values, measured.to_numpy()) else float("nan")
    )
    scalars: Variables = {
        "start": variable((), time[0], "first sample", "s"),
        "stop": variable((), time[-1], "last sample", "s"),
        "period": variable((), period, "period of the swing, median", "s"),
        "periods": variable((), (time[-1] - time[0]) / period, "periods", "1"),
        "first_amplitude": variable((), amplitude[0], "first amplitude", unit),
        "last_amplitude": variable((), amplitude[-1], "last amplitude", unit),
        "first_damping_ratio": variable((), first, "rate of decay over w at the start", "1"),
        "last_damping_ratio": variable((), last, "rate of decay over w at the end", "1"),
        "noise": variable((), sensor_noise(decay), "standard deviation of the sensor's noise", unit),
        "drift": variable((), _drift(curve), "how far the middle of the swing moves", unit),
        "sensor_step": variable((), step, "step of the sensor", step_unit),
        "samples_per_period": variable((), period / float(np.median(np.diff(time))), "samples a period", "1"),
    }
    kept = curve[["amplitude", "instant_time", "frequency"]].assign(
        amplitude=("instant", amplitude, curve.amplitude.attrs | {"units": unit})
    )
    return kept.assign({**scalars, **_spectrum(time, angle, unit)}).assign_attrs(
        {**decay.attrs, **_pointers(decay)}
    )


def _pointers(decay: xr.Dataset) -> dict[str, str]:
    """What the backbone points to: forces by their symbols, the system, both in words; empty if nothing."""
    library = load_library(USUAL_LIBRARY)
    try:
        pointed = pointed_to(backbone_curves(decay), library, angle=counts_angles(decay))
    except DecayError:
        pointed = Pointed()
    forces = [force.symbol for formula in pointed.formulas if (force := library.role(formula)) is not None]
    return {
        "points_to_forces": ",".join(forces),
        "points_to_system": PENDULUM if pointed.pendulum else "",
        "points_to": pointed.sentence,
    }


def _beside_a_drift(amplitude: Array) -> Array:
    """Amplitudes as the mean over both sides: a middle that moves makes one side's larger, in turn."""
    if amplitude.size < FEWEST_INSTANTS:
        return amplitude
    inner = 0.25 * (amplitude[:-2] + 2.0 * amplitude[1:-1] + amplitude[2:])
    # The ends by the slope of their neighbours.
    first, last = 2.0 * inner[0] - inner[1], 2.0 * inner[-1] - inner[-2]
    return np.concatenate(([first], inner, [last if last > 0.0 else amplitude[-1]]))


def _drift(curve: xr.Dataset) -> float:
    """How far the middle moves along a line, from the first half period to the last; 0 within its errors."""
    signed, time = curve.sign.values * curve.extremum.values, curve.extremum_time.values
    if signed.size < FEWEST_FOR_DRIFT:
        return 0.0
    middle = np.convolve(signed, MIDDLE, "valid")
    at = time[2:-2] - time[2:-2].mean()
    line, covariance = np.polyfit(at, middle, 1, cov=True)
    # Neighbouring middles share extrema.
    error = np.sqrt(covariance[0, 0] * MIDDLE.size)
    return float(line[0] * (time[-1] - time[0])) if abs(line[0]) > DRIFT_ERRORS * error else 0.0


def _ends(count: int) -> tuple[slice, slice]:
    part = min(END_INSTANTS, max(2, count // 2))
    return slice(0, part), slice(count - part, count)


def _damping(time: Array, amplitude: Array, frequency: float) -> float:
    """Logarithmic rate of the amplitude over w."""
    good = amplitude > 0.0
    if np.count_nonzero(good) < 2:
        return float("nan")
    return -float(np.polyfit(time[good], np.log(amplitude[good]), 1)[0]) / frequency


def _spectrum(time: Array, angle: Array, unit: str) -> Variables:
    """One-sided density, averaged to so many points on a logarithmic axis."""
    step = float(np.mean(np.diff(time)))
    window = np.sin(np.pi * np.arange(angle.size) / angle.size) ** 2
    line = np.fft.rfftfreq(angle.size, step)[1:]
    power = 2.0 * step * np.abs(np.fft.rfft(window * (angle - angle.mean()))[1:]) ** 2 / np.sum(window**2)
    # The line of the highest frequency has no mirror image.
    power[-1] *= 0.5 if angle.size % 2 == 0 else 1.0
    if line.size > SPECTRUM_POINTS:
        edges = np.unique(np.geomspace(1, line.size, SPECTRUM_POINTS).astype(int)) - 1
        counts = np.diff(np.append(edges, line.size))
        line, power = (np.add.reduceat(values, edges) / counts for values in (line, power))
    return {
        "frequency_line": variable("frequency_line", line, "frequency", "Hz"),
        "spectrum": variable("frequency_line", power, "spectral density", f"{unit}^2/Hz"),
    }
