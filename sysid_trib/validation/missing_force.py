"""Force that a model lacks: its mean over angle and rate, by the motion of the record."""

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

# Cells each way, and draws of noise for the errors.
CELLS, DRAWS_OF_NOISE = 13, 24
# Longer records with white noise are decimated, but so many samples between knots are kept.
MOST_DRAWN, DRAWN_PER_KNOT = 20_000, 4


class RunWithMotion(NamedTuple):
    """A run and the free motion of a model in it.

    Attributes
    ----------
    time : (sample,) array of float, s
    angle : (sample,) array of float, rad
        The record without the sensor's zero and its other terms.
    simulated : (sample,) array of float, rad
        The motion of the model; zero where it has none.
    noise : NoiseModel
        Of the sensor.
    inputs : mapping of str to KnownInput
        Those of the run by name.
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
        `x` and `v` (rate over w, rad), the middles of the cells; over both `force` over I w^2 (rad) with its
        standard error by the noise, nan without samples, and the number of `samples`; over each alone
        `force_of_x` and `force_of_v` with their standard errors.

    Raises
    ------
    DecayError
        The samples do not determine the motion.

    Notes
    -----
    -(x'' + x) - f(x, x') with derivatives by tau = w t (Masri and Caughey 1979), where x is the least-squares
    spline of the record. f goes through the same spline, so that smoothing changes a jump of friction alike
    in both. The same expression for the motion of the model is subtracted: it is the error of the smoothing.
    The standard errors are those of draws of the sensor's noise that go through the same steps.
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
        Which of the result's runs it is.

    Returns
    -------
    Dataset
        See `missing_force`, in the unit of the record.

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

    Near the ends of a record, where a spline bends freely, the force is nan: within a quarter period.
    """
    tau = model.reference_frequency * (run.time - run.time[0])
    x, v, lacking = _lacking(model, tau, run.angle, run.inputs)
    if np.any(run.simulated):
        lacking = lacking - _lacking(model, tau, run.simulated, run.inputs)[2]
    every = 1
    if len(run.noise.filter_) == 1:
        # Fewer samples of less white noise: a spline averages both to the same.
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
    """Return angle and rate of a motion, smoothed, and the force that it has beyond the model."""
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
        # A force whose states cannot be followed along a given motion is left out.
        with suppress(LibraryError):
            hidden |= states_along(force, tau, x, v, model.shapes, time=time)
            h = force.value(x, v, time, shapes=model.shapes, hidden=hidden)
            total = total + model.coefficients[force.symbol] * h
    return total


def cell_middles(edges: Array) -> Array:
    """Return the middles of cells that lie evenly about zero, (cell,), with an exact zero."""
    middle = 0.5 * (edges[1:] + edges[:-1])
    return 0.5 * (middle - middle[::-1])
