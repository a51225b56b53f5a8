"""Forced response of an identified model, with bands, checked by simulations."""

from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.arrays import Array, Index, Mask
from sysid_trib.cycles.smooth_curve import simultaneous_factor
from sysid_trib.errors import SimulationError, UsageError
from sysid_trib.forces.force import Channel, Force, ForceLibrary
from sysid_trib.forces.selection import is_free_to_move
from sysid_trib.motion_fit.bands import parameters_of
from sysid_trib.questions import averaged_motion as steady
from sysid_trib.records.inputs import PER_KIND, KnownInput
from sysid_trib.records.roles import INPUT
from sysid_trib.results import models, schema, signal_scale, variables
from sysid_trib.results.judged import best
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.trajectory import trajectory

SWEEPS = ("up", "down", "unstable")
# Number of parameter draws for a 95 % band, and its quantiles.
PARAMETER_DRAWS, BAND_QUANTILES = 200, (0.025, 0.975)
# Number of simulated motions per sweep, and of samples per period. A simulation lasts until the transient has
# decayed to this fraction; the amplitude is that of the last periods.
CHECKED, SAMPLES_A_PERIOD, TRANSIENT_PART, LAST_PERIODS = 4, 40, 1e-3, 20
SHORTEST_PERIODS, LONGEST_PERIODS = 60, 1500
# Variables at each frequency, and of each simulation.
RESPONSE_CURVES = ("amplitude", "amplitude_low", "amplitude_high", "whole_low", "whole_high", "phase")
SIMULATED_CHECKS = ("check_frequency", "check_amplitude", "simulated_amplitude")


def forced_response(
    result: xr.Dataset | xr.DataTree,
    drive: ArrayLike,
    frequencies: ArrayLike,
    *,
    driven_by: str = "",
    base: bool = False,
    seed: int = 0,
) -> xr.Dataset:
    """Return the steady response of an identified model to a harmonic drive, in sweeps of its frequency.

    Parameters
    ----------
    result : Dataset or DataTree
        An identification of a decay or of a driven record; for a whole result, its preferred one.
    drive : float or (frequency,) array of float
        Amplitude of the input, in its unit. For a model without inputs, the static deflection, in the unit of
        the signal.
    frequencies : (frequency,) array of float, rad/s
        Increasing frequencies.
    driven_by : str
        Name of the driving input, if the model has several.
    base : bool
        For a model without inputs: whether `drive` is the displacement of a base, relative to which the
        signal is measured.
    seed : int
        Seed of the draws for the bands.

    Returns
    -------
    Dataset
        Over `sweep` (`up`, `down`, `unstable`) and `frequency` (rad/s): `amplitude` in the unit of the
        signal, nan if there is no such motion (or dry friction holds the body), with `amplitude_low` and
        `amplitude_high`, the ends of 95 % bands, and `whole_low` and `whole_high`, those of bands for a whole
        sweep; `phase` (rad), the phase lead over the drive. `frequency_ratio(frequency)`, relative to the
        frequency at small amplitudes. Over `check`, simulated motions: `check_frequency`, `check_amplitude`,
        `simulated_amplitude`. `left_open`: the largest relative difference of these amplitudes, which the
        bands include.

    Raises
    ------
    UsageError
        The drive or the frequencies are invalid, the model does not have the input, or the input is not an
        added term of a force.
    DecayError
        No damping limits the response.

    Notes
    -----
    The response is computed with describing functions (`averaged_motion`), so with the first harmonic
    only. Bands are from parameters drawn with their covariance, which includes the model errors stated in the
    result. Beyond the amplitudes of the record they are valid if the forces have the same form there.

    Examples
    --------
    A softening spring: the resonance is below the frequency at small amplitudes.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> result = st.identify(st.records.paper_twin(), method="direct")
    >>> response = st.forced_response(result, drive=0.003, frequencies=np.linspace(9.0, 10.5, 61))
    >>> up = response.amplitude.sel(sweep="up")
    >>> up.max().round(2).item(), up.idxmax("frequency").item()
    (0.13, 9.7)
    """
    w = np.asarray(frequencies, dtype=float)
    if w.ndim != 1 or not len(w) or not np.all(np.isfinite(w)) or w[0] <= 0.0 or np.any(np.diff(w) <= 0.0):
        raise UsageError("Frequencies must be a row of positive numbers that increase, in rad/s.")
    size = np.broadcast_to(np.asarray(drive, dtype=float), w.shape)
    if not np.all(np.isfinite(size) & (size > 0.0)):
        raise UsageError("A drive must be a positive amplitude: a number, or one for each frequency.")
    result = best(result)
    forces = models.library_of(result)
    if is_free_to_move(forces, dict(zip(forces.symbols, result.coefficient.values.tolist(), strict=True))):
        raise UsageError("A body without a restoring force has no resonance; its response is that of a mass.")
    name = _input_of(forces, driven_by, base)
    kind = {channel.input: channel.kind for channel in forces.channels}.get(name, "displacement")
    units = {"units": variables.signal_units(result) + PER_KIND[kind]} if kind else {}
    given = xr.Dataset({"drive": ("frequency", size, units)}, {"frequency": w})
    return _response(result, given, name, base, seed)


@signal_scale.in_units_of_the_motion
def _response(result: xr.Dataset, given: xr.Dataset, name: str, base: bool, seed: int) -> xr.Dataset:
    model, w, size = schema.model_of(result).bound, given.frequency.values, given.drive.values
    model = replace(model, library=model.library.select(force.symbol for force in model.forces))
    c = np.array([model.coefficients[force.symbol] for force in model.forces])
    ratio = w / model.reference_frequency
    by_force = _forcings(model, name, ratio) if name else np.zeros((len(c), len(w)), complex)
    at_rest = np.zeros(len(w)) if name else ratio**2 if base else np.ones(len(w))
    described_at = steady.describing_functions(model.forces, model.shapes, ratio)
    drive = size * (c @ by_force + at_rest)
    amplitudes = steady.balance_grid(described_at, c, ratio, np.abs(drive))
    at_frequency, *motions, stable, by_lines = steady.balances(described_at, c, ratio, drive, amplitudes)
    chosen = sweeps(len(w), at_frequency, motions[0], stable)
    amplitude, phase, by_lines = (_picked(values, chosen) for values in (*motions, by_lines))
    drawn = _drawn(result, model, seed)
    sums, curves = described_at(amplitudes), np.full((len(drawn), *amplitude.shape), np.nan)
    for at, (reference, coefficients) in enumerate(drawn):
        other = w / reference
        forcing = size * (coefficients @ by_force + (at_rest if not base or name else other**2))
        surplus = steady.excess(sums, coefficients, other, forcing, amplitudes)
        row, there = steady.crossings(surplus, amplitudes)
        rises = surplus[row, np.searchsorted(amplitudes, there) - 1] < 0.0
        curves[at] = _picked(there, sweeps(len(w), row, there, rises))
    checks = _checks(model, w, drive, amplitude, phase)
    there = np.abs(checks[2] / checks[1] - 1.0)
    # A simulated motion with a larger relative difference has left its branch.
    left_open = float(np.max(there[there < 0.2], initial=0.0))
    # If no draw has a motion, there is no motion and no band.
    curves[:, np.isnan(curves).all(axis=0)] = 0.0
    low, high = np.nanquantile(curves, BAND_QUANTILES, axis=0)
    # The interpolation error is the same in each draw; all include the difference from the simulations.
    exact, wider = amplitude / by_lines, (1.0 - left_open, 1.0 + left_open)
    ends = zip((low, high, *_as_a_whole(curves, low, high)), 2 * wider, strict=True)
    bands = [exact * end * part for end, part in ends]
    data = dict(zip(RESPONSE_CURVES, (amplitude, *bands, phase), strict=True))
    data |= dict(zip(SIMULATED_CHECKS, checks, strict=True))
    data |= {"frequency_ratio": w / result.asymptotic_frequency.item(), "left_open": left_open}
    coords = {"sweep": list(SWEEPS), **variables.described("response", {"frequency": w})}
    kept = ("library", "library_source", "record_source", signal_scale.UNIT_ATTR, signal_scale.SIZE_ATTR)
    attrs = {key: result.attrs[key] for key in kept if key in result.attrs}
    return xr.Dataset({"drive": given.drive, **variables.described("response", data)}, coords, attrs)


def sweeps(count: int, frequency: Index, amplitude: Array, stable: Mask) -> Index:
    """Return the motions of a sweep up, of one down, and an unstable one, (3, frequency); -1 if none.

    A sweep starts with the smallest stable motion, and continues with the nearest one.
    """
    of_each = np.split(np.arange(len(frequency)), np.searchsorted(frequency, np.arange(1, count)))
    chosen = np.full((3, count), -1)
    for row, order in enumerate((range(count), range(count - 1, -1, -1))):
        before = 0.0
        for at in order:
            there = of_each[at][stable[of_each[at]]]
            if len(there):
                chosen[row, at] = there[np.argmin(np.abs(amplitude[there] - before))]
                before = amplitude[chosen[row, at]]
    for at, every in enumerate(of_each):
        if len(unstable := every[~stable[every]]):
            chosen[2, at] = unstable[-1]
    return chosen


def _picked(values: Array, numbers: Index) -> Array:
    """Return values (motion,) by their indices, nan for index -1."""
    return np.asarray(np.append(values, np.nan)[numbers])


def _as_a_whole(curves: Array, low: Array, high: Array) -> tuple[Array, Array]:
    """Widen pointwise bands, (sweep, frequency), until they contain whole drawn sweeps."""
    middle = np.nanmedian(curves, axis=0)
    width = np.where(curves > middle, high - middle, middle - low)
    apart = (curves - middle) / np.where(width > 0.0, width, np.inf)
    # The quantile of few draws may be slightly below the pointwise one.
    factor = np.array([max(1.0, simultaneous_factor(of_sweep)) for of_sweep in apart.swapaxes(0, 1)])[:, None]
    return middle + factor * (low - middle), middle + factor * (high - middle)


def _input_of(forces: ForceLibrary, driven_by: str, base: bool) -> str:
    """Return the driving input; empty if the model has none."""
    if not forces.inputs and not driven_by:
        return ""
    if base:
        raise UsageError("base= is for a model without inputs; the forces of this one define its drive.")
    if driven_by not in ("", *forces.inputs) or (not driven_by and len(forces.inputs) > 1):
        held = f"has the inputs {', '.join(forces.inputs)}" if forces.inputs else "has no input"
        raise UsageError(f"This model {held}; say which of them drives (driven_by=, --driven-by), or none.")
    return driven_by or forces.inputs[0]


def _forcings(model: Model, name: str, ratio: Array) -> Array:
    """Return the forcing by an input of amplitude 1 in each force, (force, frequency), complex."""
    forcing = np.zeros((len(model.forces), len(ratio)), complex)
    for at, force in enumerate(model.forces):
        for channel in (channel for channel in force.channels if channel.input == name):
            rise = force.value(0.0, 0.0, shapes=model.shapes, hidden={channel.name: 1.0})
            rise = rise - force.value(0.0, 0.0, shapes=model.shapes)
            _refuse_mixed(force, channel, float(rise))
            w_power = model.reference_frequency ** (channel.order - channel.power)
            forcing[at] -= float(rise) * (1j * ratio) ** channel.order * w_power
    return forcing


def _refuse_mixed(force: Force, channel: Channel, rise: float) -> None:
    """Raise an error for a force to which an input is not a proportional, added term."""
    points = {k: force.test_points[k] for k in "xv"}
    for factor in (1.0, 2.0):
        there, here = (force.value(**points, hidden={channel.name: factor * given}) for given in (1.0, 0.0))
        if force.state or not np.allclose(there - here, factor * rise, rtol=1e-9, atol=1e-12):
            raise UsageError(
                f"Force '{force.symbol}' does not contain the input {channel.input} as a proportional, added "
                "term: its drive has no describing function; simulate it (st.simulate)."
            )


def _drawn(result: xr.Dataset, model: Model, seed: int) -> list[tuple[float, Array]]:
    """Draw frequencies and coefficients with the errors of the result."""
    names, covariance = parameters_of(result)
    kept = [*(names.index(force.symbol) for force in model.forces), -1]
    values, vectors = np.linalg.eigh(covariance[np.ix_(kept, kept)])
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    mean = np.array([*(model.coefficients[f.symbol] for f in model.forces), model.reference_frequency])
    draws = mean + np.random.default_rng(seed).standard_normal((PARAMETER_DRAWS, len(mean))) @ factor.T
    return [(float(draw[-1]), draw[:-1]) for draw in draws if draw[-1] > 0.0]


def _checks(model: Model, w: Array, drive: Array, amplitude: Array, phase: Array) -> Array:
    """Return frequency, predicted and simulated amplitude, (3, check), of motions of both sweeps."""
    rows = []
    for sweep in (0, 1):
        there = np.flatnonzero(np.isfinite(amplitude[sweep]))
        if not len(there):
            continue
        # Check the largest motion, except at the very end of its branch, and others that are evenly spaced.
        apart = there[np.linspace(0, len(there) - 1, CHECKED + 1).round().astype(int)[1:-1]]
        largest = there[np.argmax(amplitude[sweep, there])]
        for at in {*apart.tolist(), int(np.clip(largest - 3 * (1 - 2 * sweep), there[0], there[-1]))}:
            motion = float(amplitude[sweep, at]), float(phase[sweep, at])
            rows.append((w[at], motion[0], _simulated(model, float(w[at]), complex(drive[at]), motion)))
    return np.array(rows).T if rows else np.zeros((3, 0))


def _simulated(model: Model, w: float, drive: complex, motion: tuple[float, float]) -> float:
    """Return the amplitude of the first harmonic after a start on a steady motion has settled; else nan."""
    amplitude, phase = motion
    ratio = np.array([w / model.reference_frequency])
    described_at = steady.describing_functions(model.forces, model.shapes, ratio)
    c = np.array([model.coefficients[force.symbol] for force in model.forces])
    sine = c @ described_at(np.array([amplitude]), np.zeros(1, int))[:, 0, 0]
    forgets = max(-float(sine) / amplitude, 1e-9)
    periods = int(np.clip(-np.log(TRANSIENT_PART) / (np.pi * forgets), SHORTEST_PERIODS, LONGEST_PERIODS))
    step = 2.0 * np.pi / w / SAMPLES_A_PERIOD
    time: Array = step * np.arange(periods * SAMPLES_A_PERIOD, dtype=float)
    turning = np.exp(1j * w * time)
    forcing = model.reference_frequency**2 * np.real(drive * turning)
    driven = replace(model, inputs={INPUT: KnownInput(time, forcing, "smooth")})
    start = amplitude * np.cos(phase), -amplitude * w * np.sin(phase)
    try:
        angle = trajectory(driven, time, *start).angle[-LAST_PERIODS * SAMPLES_A_PERIOD :]
    except SimulationError:
        return float("nan")
    return 2.0 * abs(float(np.abs(np.mean(angle * turning[-len(angle) :].conj()))))
