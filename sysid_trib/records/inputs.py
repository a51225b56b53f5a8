"""Known inputs: measured with the motion, they drive it; polynomials from sample to sample."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline, PPoly, make_interp_spline

from sysid_trib.arrays import Array
from sysid_trib.errors import DecayError, UsageError
from sysid_trib.forces.force import Channel, ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.records import half_periods
from sysid_trib.records.roles import INPUT, input_label, input_names
from sysid_trib.records.signal import checked_signal, unit_of_signal

FORCING_CHANNEL = Channel(INPUT, 0, "acceleration")
# Suffix of the signal's unit in the unit of an input, by its kind.
PER_KIND = {"displacement": "", "rate": "/s", "acceleration": "/s^2"}
# Name of the library with the forces of inputs.
SHIPPED = "inputs"
# Degree of the spline. The error of `smooth` is below a hundredth for a signal with three samples a period.
BETWEEN_SAMPLES = {"linear": 1, "held": 0, "cubic": 3, "smooth": 7}


@dataclass(frozen=True, eq=False)
class KnownInput:
    """An input u(t) in its own unit.

    Parameters
    ----------
    elapsed : (sample,) array of float, s
        Time since the first sample of the record, increasing.
    values : (sample,) array of float
        Values at the samples; the last value continues beyond the record.
    between : str
        `linear`, `held` (such as the output of a converter), or a spline: `cubic`, or `smooth` (of degree 7,
        for a signal that was measured without aliasing).

    Raises
    ------
    UsageError
        A value is not finite, or `between` is another word.
    """

    elapsed: Array
    values: Array
    between: str = "smooth"

    def __post_init__(self) -> None:
        if not np.all(np.isfinite(self.values)):
            raise UsageError("A known input must be finite numbers; cut the record where it is not.")
        if (between := self.between) not in BETWEEN_SAMPLES:
            raise UsageError(f"Between samples an input is {', '.join(BETWEEN_SAMPLES)}, not '{between}'.")

    @cached_property
    def _polynomials(self) -> tuple[PPoly, ...]:
        """The input and its derivative by time, held before the first sample and from the last on."""
        degree = BETWEEN_SAMPLES[self.between]
        degree = degree if degree < len(self.elapsed) else 1
        spline = make_interp_spline(self.elapsed, self.values, degree)
        # Leave out the empty pieces between repeated knots at either end.
        knots = np.unique(spline.t)
        powers = PPoly.from_spline(spline).c[:, degree : -max(1, degree)]
        whole = np.pad(powers, ((0, 0), (1, 1)))
        whole[-1, [0, -1]] = self.values[[0, -1]]
        value = PPoly(whole, np.concatenate([[knots[0] - 1.0], knots, [knots[-1] + 1.0]]))
        return value, value.derivative()

    @property
    def bends(self) -> Array:
        """Times at which the polynomial changes, (knot,), s."""
        return np.asarray(self._polynomials[0].x[1:-1])

    def of(self, elapsed: ArrayLike, order: int = 0) -> Array:
        """Return input, or a time derivative, at times since the first sample; at a jump the mean of both."""
        polynomial = self._polynomials[order]
        degree = BETWEEN_SAMPLES[self.between]
        inside = np.clip(np.asarray(elapsed, dtype=float), polynomial.x[0], polynomial.x[-1])
        if degree > 1:
            # A derivative at the last sample is that before it, not that of the value held after it.
            inside = np.where(inside == self.elapsed[-1], np.nextafter(inside, -np.inf), inside)
        values = polynomial(inside)
        if degree <= order:
            values = 0.5 * (values + polynomial(np.nextafter(inside, -np.inf)))
        return np.asarray(values)

    def polynomials(self, knots: Array, frequency: float, order: int = 0) -> Array:
        """Return polynomials from each knot (tau = w t) on, by powers of tau since it, (knot, power)."""
        polynomial = self._polynomials[order]
        # Rounding must not assign a knot to the polynomial that ends there.
        here = knots / frequency * (1.0 + 8e-16)
        degrees = range(polynomial.c.shape[0])
        powers = [polynomial(here, degree) / math.factorial(degree) for degree in degrees]
        return np.stack(powers, axis=1) / frequency ** np.arange(len(powers))


def named_inputs(given: str | Sequence[str] | Mapping[str, str | int] | None) -> dict[str, str | int]:
    """Return input columns by their names in forces: a single one is `u`, several are `NAME=COLUMN`.

    Raises
    ------
    UsageError
        There are several columns without names.
    """
    if given is None or isinstance(given, Mapping):
        return dict(given or {})
    texts = [given] if isinstance(given, str) else list(given)
    pairs = [text.partition("=")[::2] if "=" in text else ("u", text) for text in texts]
    if len({name for name, _ in pairs}) < len(pairs):
        raise UsageError("Several inputs have each a name of its own: u=COLUMN,b=COLUMN.")
    return {name.strip(): column.strip() for name, column in pairs}


def values_of_inputs(
    inputs: Mapping[str, KnownInput], channels: Iterable[Channel], elapsed: ArrayLike, frequency: float
) -> dict[str, Array]:
    """Return the inputs `u` and `du` of formulas at times since the first sample; zero without an input.

    Parameters
    ----------
    inputs : mapping of str to KnownInput
    channels : iterable of Channel
        Inputs to return.
    elapsed : array of float, s
    frequency : float, rad/s
        Reference frequency.
    """
    nothing = np.zeros(np.shape(elapsed))
    return {
        c.name: inputs[c.input].of(elapsed, c.order) / frequency**c.power if c.input in inputs else nothing
        for c in channels
    }


def inputs_of(record: xr.Dataset) -> dict[str, KnownInput]:
    """Return inputs of a record by their names: `input(time)`, and variables with attrs["role"] = "input".

    Parameters
    ----------
    record : Dataset
        `angle(time)`, and inputs over `time` or over times of their own. Attributes of each: `units`,
        `between` (see `KnownInput`). `input(time)` is an acceleration in the signal's unit over s^2, which
        acts directly.

    Raises
    ------
    UsageError
        `input` states no unit, or another one: a torque or a voltage is not an acceleration.
    DecayError
        An input is not a finite number at each time, or does not cover the record.
    """
    return {name: _input(record, name) for name in input_names(record)}


def _input(record: xr.Dataset, name: str) -> KnownInput:
    given = record[name]
    unit = unit_of_signal(record)
    if given.dims == ("time",):
        checked_signal(record, name)
    units = given.attrs.get("units")
    if name == INPUT and units != f"{unit}/s^2":
        said = "says no unit" if units is None else f"is in {units}"
        raise UsageError(
            f"input(time) {said}; give the acceleration in {unit}/s^2, input.attrs['units'] = '{unit}/s^2'."
        )
    start = float(record.time.values[0])
    time = given[str(given.dims[0])].values.astype(float)
    # Rounding within which two clocks with large numbers show the same instant.
    rounding = 1e-3 * float(np.median(np.diff(record.time.values.astype(float))))
    if time[0] > start + rounding or time[-1] < float(record.time.values[-1]) - rounding:
        reach = f"{time[0]:g} to {time[-1]:g} s, the record from {start:g} to {record.time.values[-1]:g} s"
        raise DecayError(
            f"The input {input_label(record, name)} covers {reach}; cut the record (--window), or give all "
            "of the input."
        )
    values = given.values.astype(float)
    return KnownInput(time - start, values, str(given.attrs.get("between") or usual_between(values)))


# Most levels of a switched signal, such as a square wave; more are the steps of a converter.
MOST_LEVELS = 8


def usual_between(values: Array) -> str:
    """Return the usual interpolation of an input: smooth, or held if it moves in steps.

    A held input is constant between most samples, and its changes are jumps: larger than a step of the
    sensor, or between a few levels. A smooth signal with coarse steps, or a pulse, is smooth.
    """
    moves = np.diff(values)
    changes = np.flatnonzero(moves)
    if len(changes) == 1 and np.unique(values).size == 2:
        # A switch that is operated once.
        return "held"
    if len(changes) < 2 or 2 * len(changes) > len(moves):
        return "smooth"
    isolated = np.diff(changes, prepend=-2) > 1
    leaps = np.median(np.abs(moves[changes])) > 3.0 * half_periods.quantisation_step(values)
    levels = np.unique(values).size
    return "held" if np.mean(isolated) > 0.8 and (leaps or levels <= MOST_LEVELS) else "smooth"


def is_switch(values: Array) -> bool:
    """Return true if an input is held at one of two values."""
    return np.unique(values).size == 2 and usual_between(values) == "held"


def inputs_for(record: xr.Dataset, library: ForceLibrary) -> dict[str, KnownInput]:
    """Return the inputs of a record for the forces of a library.

    Raises
    ------
    UsageError
        A force contains an input that the record lacks, the record has an input that no force contains, or an
        input is not of the kind that the library states.
    DecayError
        As in `inputs_of`.
    """
    inputs = inputs_of(record)
    refuse_unused(inputs, library, {name: input_label(record, name) for name in inputs})
    for force in library:
        if missing := [name for name in force.inputs if name not in inputs]:
            wrong = f"Force '{force.symbol}' contains the input {missing[0]}, which this record lacks"
            raise UsageError(
                f"{wrong}; name its column (--input {missing[0]}=COLUMN; input= in Python), or leave the "
                "force out."
            )
    for channel in library.channels:
        units = record[channel.input].attrs.get("units")
        wanted = unit_of_signal(record) + PER_KIND.get(channel.kind, "")
        if channel.kind and units not in (None, wanted):
            label = input_label(record, channel.input)
            wrong = f"The input {label} is in {units}, and these forces take it as {channel.kind}"
            raise UsageError(f"{wrong} in {wanted}; convert it, or offer forces that take another quantity.")
    return inputs


def refuse_unused(
    inputs: Iterable[str], library: ForceLibrary, labels: Mapping[str, str] = MappingProxyType({})
) -> None:
    """Raise an error for an input that no force contains.

    `labels` : names of inputs as their user knows them.

    Raises
    ------
    UsageError
        The input would have no effect.
    """
    for name in inputs:
        if name != INPUT and name not in library.inputs:
            held = f"they contain {', '.join(library.inputs)}" if library.inputs else "they contain none"
            wrong = f"No force contains the input {labels.get(name, name)} ({held})"
            shipped = load_library(SHIPPED)
            taking = [force.symbol for force in shipped if force.inputs == (name,)]
            if taking:
                offer = f"offer one that does (--forces {','.join([taking[0], *library.symbols])})"
            else:
                known = ", ".join(shipped.inputs)
                offer = f"call it {known} (--input u=COLUMN), or offer a force of your own that contains it"
            raise UsageError(f"{wrong}; {offer}, or leave the input out.")


def refuse_inputs(record: xr.Dataset) -> None:
    """Raise an error if a function of free motions is called with a known input.

    Raises
    ------
    UsageError
        The record has an input that is not zero.
    """
    names = [name for name, given in inputs_of(record).items() if np.any(given.values)]
    if names:
        raise UsageError(
            f"This record has a known input ({', '.join(names)}), which only Direct, Trajectory, "
            "simulate, predict, innovations and prediction_bands accept; if it is zero, remove it: "
            f"drop_vars('{names[0]}')."
        )


# Relative variation below which an input is constant.
CONSTANT_WITHIN = 1e-12


def is_constant(values: Array) -> bool:
    """Return true if an input is constant up to rounding."""
    return bool(np.ptp(values) <= CONSTANT_WITHIN * np.max(np.abs(values), initial=0.0))


# If the mean of a rate is below this fraction of its standard deviation, it is a bias of the sensor.
BIAS_PART = 0.1


def integral_of_rate(time: Array, rate: Array) -> Array:
    """Return the plain integral of a measured rate about its mean, without a small bias of the sensor."""
    values = rate.astype(float)
    mean = float(np.mean(values))
    values = values - mean if abs(mean) <= BIAS_PART * float(np.std(values)) else values
    integral = CubicSpline(time, values).antiderivative()(time)
    return np.asarray(integral - np.mean(integral))
