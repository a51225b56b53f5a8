"""Force that a model lacks: its mean over angle and rate, along the motion of the record."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import scipy
import xarray as xr

from sysid_trib.arrays import Array
from sysid_trib.errors import LibraryError
from sysid_trib.likelihood.sensor_noise import NoiseModel
from sysid_trib.records import inputs, signal
from sysid_trib.records.smoothing import knot_intervals, sensor_noise, smooth
from sysid_trib.results import schema
from sysid_trib.results.variables import described
from sysid_trib.simulation.internal_states import states_along
from sysid_trib.simulation.model import Model

# Number of cells in each direction, and of noise draws for the errors.
CELLS, DRAWS_OF_NOISE = 13, 24
# Longer records with white noise are decimated, with at least this number of samples kept between knots.
MOST_DRAWN, DRAWN_PER_KNOT = 20_000, 4


class RunWithMotion(NamedTuple):
    """A run and the free motion of a model in it.

    Attributes
    ----------
    time : (sample,) array of float, s
    angle : (sample,) array of float, rad
        The record without the sensor's zero and its other terms.
    simulated : (sample,) array of float, rad
        The motion of the model; zero if it has none.
    noise : NoiseModel
        Noise of the sensor.
    inputs : mapping of str to KnownInput
        Inputs of the run by name.
    """

    time: Array
    angle: Array
    simulated: Array
    noise: NoiseModel
    inputs: Mapping[str, inputs.KnownInput]


def missing_force(model: Model, runs: Sequence[RunWithMotion]) -> dict[str, Array | tuple[Array, Array]]:
    """Return the mean force that a model lacks, in cells of angle and rate over all runs.

    Parameters
    ----------
    model : Model
    runs : sequence of RunWithMotion

    Returns
    -------
    dict
        `x` and `v` (rate over w, rad), the centres of the cells; over both `force` over I w^2 (rad) with its
        standard error due to the noise, nan without samples, and the number of `samples`; `force_of_x` and
        `force_of_v`, each with its standard error.

    Raises
    ------
    DecayError
        The samples do not determine the motion.

    Notes
    -----
    The force is -(x'' + x) - f(x, x') with derivatives by tau = w t (Masri and Caughey 1979), where x is the
    least-squares spline of the record. f is smoothed by the same spline, so that smoothing has the same
    effect on a jump of friction in both. The same expression for the motion of the model is subtracted,
    because it is the error of smoothing. The standard errors are from draws of the sensor's noise, evaluated
    in the same way.
    """
    parts = [_forces_of_run(model, run) for run in runs]
    x, v, values = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
    size = 1.001 * float(np.max(np.hypot(x, v)))
    edges = np.linspace(-size, size, CELLS + 1)
    known = np.isfinite(values[0])
    if known.any():
        x, v, values = x[known], v[known], values[:, known]
    means = {"force": scipy.stats.binned_statistic_2d(x, v, values, "mean", bins=[edges, edges]).statistic}
    for name, on in (("x", x), ("v", v)):
        means[f"force_of_{name}"] = scipy.stats.binned_statistic(on, values, bins=edges).statistic
    cells = {name: (of[0], np.sqrt(np.mean(of[1:] ** 2, axis=0))) for name, of in means.items()}
    samples, *_ = np.histogram2d(x, v, [edges, edges])
    return {"x": cell_middles(edges), "v": cell_middles(edges), "samples": samples, **cells}


def residual_force(decay: xr.Dataset, result: xr.Dataset, run: int = 0) -> xr.Dataset:
    """Return the force that an identification lacks in one of its runs.

    Parameters
    ----------
    decay, result : Dataset
        `angle(time)` of a run, with `simulated_angle(time)` if the model has a motion; and an identification
        of it.
    run : int
        Index of the run of the result.

    Returns
    -------
    Dataset
        Result of `missing_force`, in the unit of the record.

    Raises
    ------
    DecayError
        The samples do not determine the motion.
    """
    signal.checked_signal(decay)
    known = inputs.inputs_of(decay)
    zero = float(np.ravel(result.offset)[run]) if "offset" in result else 0.0
    time, angle = decay.time.values.astype(float), decay.angle.values - zero
    simulated = np.zeros(len(time))
    if "simulated_angle" in decay and np.all(np.isfinite(decay.simulated_angle)):
        simulated = decay.simulated_angle.values - zero
    noise = NoiseModel(sensor_noise(decay), np.ones(1))
    cells = missing_force(schema.model_of(result), [RunWithMotion(time, angle, simulated, noise, known)])
    cells.pop("samples")
    missing = xr.Dataset(described("residual_force", cells))
    for in_unit in missing.variables.values():
        in_unit.attrs["units"] = signal.unit_of_signal(decay)
    return missing


def _forces_of_run(model: Model, run: RunWithMotion) -> tuple[Array, Array, Array]:
    """Return angles and rates of a run, (sample,), its missing force and draws of it: (1 + draw, sample).

    Within a quarter period of the ends of a record, where a spline bends freely, the force is nan.
    """
    tau = model.reference_frequency * (run.time - run.time[0])
    x, v, lacking = _lacking(model, tau, run.angle, run.inputs)
    if np.any(run.simulated):
        lacking = lacking - _lacking(model, tau, run.simulated, run.inputs)[2]
    every = 1
    if len(run.noise.filter_) == 1:
        # Use fewer samples with less white noise: the spline averages both to the same result.
        count = len(tau)
        every = max(1, min(-(-count // MOST_DRAWN), count // (DRAWN_PER_KNOT * knot_intervals(tau))))
    tau, x, v, lacking = (values[::every] for values in (tau, x, v, lacking))
    noise = run.noise.draws(len(tau), DRAWS_OF_NOISE).T / np.sqrt(every)
    drawn, _, bends, _ = smooth(tau, noise)
    values = np.vstack([lacking, -(bends + drawn).T])
    return x, v, np.where(np.minimum(tau, tau[-1] - tau) > 0.5 * np.pi, values, np.nan)


def _lacking(
    model: Model, tau: Array, angle: Array, known: Mapping[str, inputs.KnownInput]
) -> tuple[Array, Array, Array]:
    """Return smoothed angle and rate of a motion, and its force minus that of the model."""
    x, v, acceleration, _ = smooth(tau, angle)
    forces = smooth(tau, _force_of_model(model, tau, x, v, known))[0]
    return x, v, -(acceleration + x) - forces


def _force_of_model(
    model: Model, tau: Array, x: Array, v: Array, known: Mapping[str, inputs.KnownInput]
) -> Array:
    """Return the sum of coefficient times force along a motion, (sample,), without terms of the sensor."""
    total, frequency = np.zeros_like(x), model.reference_frequency
    time = tau / frequency
    for force in model.bound.forces:
        hidden = inputs.values_of_inputs(known, force.channels, time, frequency)
        # Leave out a force whose states cannot be computed along a given motion.
        with suppress(LibraryError):
            hidden |= states_along(force, tau, x, v, model.shapes, time=time)
            h = force.value(x, v, time, shapes=model.shapes, hidden=hidden)
            total = total + model.coefficients[force.symbol] * h
    return total


def cell_middles(edges: Array) -> Array:
    """Return the middles of cells that lie evenly about zero, (cell,), with an exact zero."""
    middle = 0.5 * (edges[1:] + edges[:-1])
    return 0.5 * (middle - middle[::-1])
