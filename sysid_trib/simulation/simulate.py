"""Exact motion of a model, with exact times of switching, sticking and reversals; the synthetic example."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.errors import UsageError
from sysid_trib.forces.library import load_library
from sysid_trib.records.inputs import PER_KIND, KnownInput, refuse_unused, usual_between
from sysid_trib.records.roles import INPUT, ROLE
from sysid_trib.simulation.model import Model, Vector
from sysid_trib.simulation.motions import integrate
from sysid_trib.simulation.trajectory import checked_start, forcing_of, trajectory


def simulate(
    model: Model,
    time: ArrayLike,
    angle: float = 0.3,
    rate: float = 0.0,
    *,
    random_force: float = 0.0,
    seed: int = 0,
    known_input: ArrayLike | KnownInput | None = None,
    inputs: Mapping[str, ArrayLike | KnownInput] | None = None,
) -> xr.Dataset:
    """Simulate the motion of a model: free, driven by known inputs, with a random force, or both.

    Parameters
    ----------
    model : Model
        Forces, coefficients and reference frequency.
    time : (time,) array of float, s
        Increasing times, not necessarily equidistant; `t` in a formula counts from the first.
    angle, rate : float, rad and rad/s
        Angle and its derivative at time[0].
    random_force : float, (rad/s^2)^2/Hz
        One-sided density of a white acceleration in the motion.
    seed : int
        Seed of the random force.
    known_input : (time,) array of float, rad/s^2, or KnownInput, optional
        An acceleration a(t) in theta'' + w^2 (theta + f) = a. An array is interpolated smoothly, or held
        between the times if it moves in steps (`usual_between`); a `KnownInput` states its interpolation.
    inputs : mapping of str to (time,) array of float or KnownInput, optional
        Inputs by their names in formulas, `{"u": ...}`, each in its own unit.

    Returns
    -------
    Dataset
        `angle(time)` in rad as measured (with the sensor terms of the model), the true `rate(time)` in rad/s,
        `stop_time` in s (NaN if the motion does not stop, or has a random force), states and memory of forces
        (`dahl.z(time)`), and the inputs: `input(time)` in rad/s^2, and those of forces by their names.
        `methods.Direct` and `methods.Trajectory` identify the model from this record.

    Raises
    ------
    SimulationError
        The motion diverges or switches without end, or the times do not increase.
    UsageError
        The argument is not a model; a density is negative or infinite; an input does not have one finite
        number for each time, or no force contains it.

    Examples
    --------
    Free motion: each swing is smaller than the one before. Then the same model driven at its own frequency.

    >>> import numpy as np
    >>> import sysid_trib as st
    >>> model = st.Model("contact_forces", {"zeta": 0.05}, reference_frequency=10.0)
    >>> time = np.arange(0.0, 10.0, 0.01)
    >>> free = st.simulate(model, time, angle=0.3)
    >>> driven = st.simulate(model, time, angle=0.0, known_input=np.cos(10.0 * time))
    >>> [round(abs(run.angle.sel(time=slice(9.0, None))).max().item(), 4) for run in (free, driven)]
    [0.0031, 0.0992]
    """
    if not isinstance(model, Model):
        raise UsageError(
            "simulate takes a Model: that of a result is st.physics.model_of(st.best(result)), and "
            "st.predict(result, record) is its motion from the start of a record."
        )
    time = np.asarray(time, dtype=float)
    if not (np.isfinite(random_force) and random_force >= 0.0):
        raise UsageError(f"random_force={random_force} is not a density; give (rad/s^2)^2/Hz, zero or more.")
    if not all(model.coefficients.values()):
        model = model.with_coefficients({k: c for k, c in model.coefficients.items() if c != 0.0})
    given = dict(inputs or {}) | ({} if known_input is None else {INPUT: known_input})
    known = {name: _known(values, time) for name, values in given.items()}
    if known:
        model = replace(model, inputs=known)
        refuse_unused(known, model.library)
    tau, w = checked_start(model, time, angle, rate), model.reference_frequency
    forcing = forcing_of(model, tau, random_force, seed)
    motion = replace(integrate(model, tau, (angle, rate / w), forcing=forcing), start=float(time[0]))
    data: dict[str, Any] = {
        "angle": ("time", motion.angle, {"units": "rad", "long_name": "angle"}),
        "rate": ("time", motion.rate, {"units": "rad/s", "long_name": "angular rate"}),
        "stop_time": ((), motion.stop_time, {"units": "s", "long_name": "time at which the motion stops"}),
    }
    for name, values in motion.hidden.items():
        data[name] = ("time", values, {"units": "1", "long_name": f"{name}, state or memory of a force"})
    kinds = {channel.input: channel.kind for channel in (*model.library.channels, *model.driven)}
    for name, drive in known.items():
        units = {"units": f"rad{PER_KIND[kinds[name]]}"} if kinds[name] else {}
        attrs = {**units, "long_name": f"input {name}", "between": drive.between, "role": ROLE}
        data[name] = ("time", drive.values, attrs)
    data["time"] = ("time", time, {"units": "s", "long_name": "time"})
    return xr.Dataset(data)


def _known(values: ArrayLike | KnownInput, time: Vector) -> KnownInput:
    if not isinstance(values, KnownInput):
        values = np.asarray(values, dtype=float)
        values = KnownInput(time - time[0], values, usual_between(values))
    if not np.array_equal(values.elapsed, time - time[0]):
        raise UsageError("A known input must be sampled at the times of the simulation, from zero on.")
    return values


# Le Bot et al. 2019, Sec. 3: PDMS sphere on glass, alpha accounted for in w_inf.
PAPER_COEFFICIENTS = {"lambda": -0.000023, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
PAPER_FREQUENCY = 9.91
START_ANGLE = 0.3
PAPER_DURATION = 25.0
PAPER_SAMPLING_RATE = 100.0
# The paper gives neither. With this step the signal is coarse at 0.02 rad, where the authors stopped.
SENSOR_NOISE = 5e-4
SENSOR_STEP = 1e-3


def paper_twin(*, seed: int = 2019) -> xr.Dataset:
    """Simulate the paper's run: 25 s at 100 Hz from 0.3 rad, noise 5e-4 rad, angle steps of 1e-3 rad.

    Parameters
    ----------
    seed : int
        Seed of the noise.

    Returns
    -------
    Dataset
        Record with `angle(time)` in rad. Its attributes state that it is synthetic.

    Examples
    --------
    >>> import sysid_trib as st
    >>> record = st.records.paper_twin()
    >>> record.sizes["time"], record.angle[0].item()
    (2500, 0.3)
    >>> found = st.identify(record, method="direct").coefficient.round(3)
    >>> found.sel(force=["zeta", "delta", "nu"]).values.tolist()
    [0.01, 0.037, -0.4]
    """
    time = np.arange(round(PAPER_DURATION * PAPER_SAMPLING_RATE)) / PAPER_SAMPLING_RATE
    model = Model(load_library(), PAPER_COEFFICIENTS, PAPER_FREQUENCY)
    angle = trajectory(model, time, START_ANGLE, 0.0).angle
    angle = angle + SENSOR_NOISE * np.random.default_rng(seed).standard_normal(len(time))
    angle = SENSOR_STEP * np.round(angle / SENSOR_STEP)
    return xr.Dataset(
        {"angle": ("time", angle, {"units": "rad", "long_name": "angle"})},
        {"time": ("time", time, {"units": "s", "long_name": "time"})},
        {
            "source": "simulation of the PDMS/glass run of Le Bot et al. 2019 (not the measurement)",
            "record_checksum": "",
            "synthetic": f"noise {SENSOR_NOISE:g} rad, angle step {SENSOR_STEP:g} rad, seed {seed}",
        },
    )
