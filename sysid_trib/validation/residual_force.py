"""The force that a model lacks, over angle and rate: the restoring-force surface of the residual."""

import numpy as np
import xarray as xr
from scipy.stats import binned_statistic, binned_statistic_2d

from sysid_trib.arrays import Array
from sysid_trib.averaging.internal_states import states_along
from sysid_trib.decays.equilibrium import with_half_periods
from sysid_trib.decays.signal import unit_of_signal
from sysid_trib.noise.level import sensor_noise
from sysid_trib.noise.smoothing import knot_intervals, smooth
from sysid_trib.results.schema import model_of
from sysid_trib.results.variables import variable, with_error
from sysid_trib.simulation.model import Model

# Cells each way, drawings of noise for the errors, and a seed for them.
SURFACE_CELLS, SURFACE_DRAWS, DRAWS_SEED = 13, 24, 0
# Longer records are drawn by every second sample (third, ...), which keeps so many between knots.
MOST_DRAWN, DRAWN_PER_KNOT = 20_000, 4


def residual_force(decay: xr.Dataset, result: xr.Dataset, run: int = 0) -> xr.Dataset:
    """Mean force that a model lacks in cells of angle and rate, by the record's own motion.

    Parameters
    ----------
    decay : Dataset
        `angle(time)` of a run.
    result : Dataset
        An identification of it.
    run : int
        Which of the result's runs it is.

    Returns
    -------
    Dataset
        Over `x` and `v` (rate over w): `force` over I w^2 with its `force_standard_error` by the sensor's
        noise, nan in cells without samples; over each alone, the mean over the other, `force_of_x` and
        `force_of_v` with their errors. All in the unit of the record.

    Raises
    ------
    DecayError
        The samples do not determine the motion.

    Notes
    -----
    -(x'' + x) - f(x, x') with derivatives by tau = w t (Masri and Caughey 1979), x by the least-squares
    spline; f goes through the same spline, so that what smoothing takes from a jump of friction it takes from
    both. Errors are those of drawings of white noise of the sensor's level through the same steps. No motion
    is simulated: a model that slips in phase has its surface too.
    """
    time, angle, _ = with_half_periods(decay)
    model = model_of(result)
    tau = model.reference_frequency * (time - time[0])
    every = max(1, min(-(-len(time) // MOST_DRAWN), len(time) // (DRAWN_PER_KNOT * knot_intervals(tau))))
    zero = float(np.ravel(result.offset)[run]) if "offset" in result else 0.0
    motion = smooth(tau, angle)
    x, v = motion.x - zero, motion.v
    asked = -(motion.acceleration + x) - smooth(tau, model_force(model, tau, x, v, time - time[0])).x
    tau, x, v, asked = tau[::every], x[::every], v[::every], asked[::every]
    white = np.random.default_rng(DRAWS_SEED).standard_normal((len(tau), SURFACE_DRAWS))
    # Fewer samples of less noise: a spline averages both to the same.
    drawn = smooth(tau, sensor_noise(decay) / np.sqrt(every) * white)
    # A spline bends freely in the quarter period before its ends.
    inside = np.minimum(tau, tau[-1] - tau) > 0.5 * np.pi
    values = np.vstack([asked, -(drawn.acceleration + drawn.x).T])[:, inside]
    return _in_cells(x[inside], v[inside], values, unit_of_signal(decay))


def model_force(model: Model, tau: Array, x: Array, v: Array, time: Array) -> Array:
    """Sum of coefficient times force along a motion, (sample,); terms of the sensor are no forces."""
    total = np.zeros_like(x)
    for force in model.library:
        if force.kind == "force" and (coefficient := model.coefficients.get(force.symbol, 0.0)):
            hidden = states_along(force, tau, x, v, model.shapes, time=time)
            h = force.value(x, v, time, shapes=model.shapes, hidden=hidden or None)
            total = total + coefficient * h
    return total


def _in_cells(x: Array, v: Array, values: Array, units: str) -> xr.Dataset:
    """Means over cells of the force (the first row) and their scatter over drawings (the others)."""
    size = 1.001 * float(np.max(np.hypot(x, v)))
    edges = np.linspace(-size, size, SURFACE_CELLS + 1)
    surface = binned_statistic_2d(x, v, values, "mean", bins=[edges, edges]).statistic
    along = {
        name: binned_statistic(on, values, "mean", bins=edges).statistic for name, on in (("x", x), ("v", v))
    }
    data = with_error("force", ("x", "v"), _mean_and_error(surface), "mean residual force over I w^2", units)
    for name, means in along.items():
        text = f"mean residual force over {'angle' if name == 'x' else 'rate over w'}"
        data |= with_error(f"force_of_{name}", (name,), _mean_and_error(means), text, units)
    middle = 0.5 * (edges[1:] + edges[:-1])
    coords = {"x": variable("x", middle, "angle", units), "v": variable("v", middle, "rate over w", units)}
    return xr.Dataset(data, coords)


def _mean_and_error(means: Array) -> tuple[Array, Array]:
    return means[0], np.sqrt(np.mean(means[1:] ** 2, axis=0))
