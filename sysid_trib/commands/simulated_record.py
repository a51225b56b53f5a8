"""A simulated record as a file."""

import os
from pathlib import Path

import numpy as np
import xarray as xr

from sysid_trib.commands.checks import MOST, check_between
from sysid_trib.commands.simulate import MotionOptions
from sysid_trib.errors import UsageError
from sysid_trib.likelihood.random_force import DENSITY_UNITS
from sysid_trib.results.files import save, write_file
from sysid_trib.simulation.integrate import DIVERGED
from sysid_trib.simulation.model import Model
from sysid_trib.simulation.simulate import simulate

MAX_SAMPLES = 20_000_000
MAX_PERIODS = 1_000_000
MAX_NOISE = 1e3


def simulated_record(model: Model, motion: MotionOptions) -> xr.Dataset:
    """Simulate a record.

    Parameters
    ----------
    model : Model
        The model.
    motion : MotionOptions
        Options: how it starts, how long it is recorded, and what disturbs it.

    Returns
    -------
    xr.Dataset
        What `simulate` returns, with the noise in `angle`.

    Raises
    ------
    UsageError
        Numbers from which no record can be made.
    """
    duration, sampling_rate, noise = motion.duration, motion.sampling_rate, motion.noise
    samples = round(duration * sampling_rate) if np.isfinite(duration * sampling_rate) else 0
    if not 2 <= samples <= MAX_SAMPLES or duration <= 0:
        raise UsageError(
            f"{duration:g} s at {sampling_rate:g} Hz must be 2 to {MAX_SAMPLES:,} samples; "
            "change --duration or --sampling-rate."
        )
    if duration * model.reference_frequency > 2.0 * np.pi * MAX_PERIODS:
        raise UsageError(
            f"{duration:g} s at {model.reference_frequency:g} rad/s are more than {MAX_PERIODS:,} periods; "
            "shorten --duration, or lower --reference-frequency."
        )
    check_between(motion.angle0, "--angle0", -DIVERGED, DIVERGED, " rad")
    check_between(motion.rate0, "--rate0", -MOST, MOST, " rad/s")
    check_between(noise, "--noise", 0.0, MAX_NOISE, " rad")
    check_between(motion.random_force, "--random-force", 0.0, MOST, f" {DENSITY_UNITS}")
    if motion.seed < 0:
        raise UsageError(f"--seed '{motion.seed}' must be a whole number, 0 or more.")
    time = np.arange(samples) / sampling_rate
    density, seed = motion.random_force, motion.seed
    record = simulate(model, time, motion.angle0, motion.rate0, random_force=density, seed=seed)
    record["angle"] = record.angle + noise * np.random.default_rng(seed).standard_normal(samples)
    record.angle.attrs = {"units": "rad", "long_name": "angle"}
    pushed = f", random force {density:g} (rad/s^2)^2/Hz" if density else ""
    source = f"simulated by sysid_trib, noise {noise:g} rad{pushed}, seed {seed}"
    return record.assign_attrs(source=source, synthetic="yes")


def write_record(record: xr.Dataset, path: str | os.PathLike[str]) -> None:
    """Write a record as CSV (`time (s)`, `angle (rad)`) or netCDF, by the file's ending."""
    target = Path(path)
    if target.suffix.lower() == ".csv":
        table = record.angle.to_dataframe()[["angle"]].rename(columns={"angle": "angle (rad)"})
        write_file(target, table.to_csv(index_label="time (s)").encode())
    elif target.suffix.lower() == ".nc":
        save(record, target)
    else:
        raise UsageError(f"{target}: the ending must be .csv or .nc.")
