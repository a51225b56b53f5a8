"""The embedded example: a simulation of the paper's PDMS/glass run, which was never published."""

import numpy as np
import xarray as xr

from sysid_trib.forces.library import load_library
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import trajectory

# Le Bot et al. 2019, Sec. 3: PDMS sphere on glass, alpha accounted for in w_inf.
PAPER_COEFFICIENTS = {"lambda": -0.000023, "zeta": 0.0097, "delta": 0.037, "nu": -0.40, "epsilon": 0.30}
PAPER_FREQUENCY = 9.91
START_ANGLE = 0.3
PAPER_DURATION = 25.0
PAPER_SAMPLING_RATE = 100.0
# The paper gives neither; with this step the signal is coarse at 0.02 rad, where the authors stopped.
SENSOR_NOISE = 5e-4
SENSOR_STEP = 1e-3


def paper_model() -> Model:
    """The paper's five-force model of its PDMS/glass run."""
    return Model(load_library(), PAPER_COEFFICIENTS, PAPER_FREQUENCY)


def paper_twin(*, seed: int = 2019) -> xr.Dataset:
    """Simulate the paper's run: 25 s at 100 Hz from 0.3 rad, noise 5e-4 rad, angle steps of 1e-3 rad.

    Parameters
    ----------
    seed : int
        Seed of the noise.

    Returns
    -------
    Dataset
        Record with `angle(time)` in rad. It is synthetic, and its attrs say so.
    """
    time = np.arange(round(PAPER_DURATION * PAPER_SAMPLING_RATE)) / PAPER_SAMPLING_RATE
    angle = trajectory(paper_model(), time, START_ANGLE, 0.0).angle
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
