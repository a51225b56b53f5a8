"""What `sysid-trib simulate` does: the motion of a model, as a record."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import xarray as xr

from sysid_trib.commands.checks import assigned
from sysid_trib.commands.options import DEFAULT_LIBRARY, MOST
from sysid_trib.commands.own_options import SimulationOptions
from sysid_trib.errors import Tell, UsageError
from sysid_trib.forces.force import ForceLibrary
from sysid_trib.forces.library import load_library
from sysid_trib.forces.selection import with_shipped
from sysid_trib.likelihood.random_force import DENSITY_UNITS
from sysid_trib.results.files import save, write_file
from sysid_trib.simulation.model import Model, check_shapes
from sysid_trib.simulation.simulate import PAPER_COEFFICIENTS, simulate as motion_of

MAX_SAMPLES, MAX_PERIODS = 20_000_000, 1_000_000


def simulate(tell: Tell, asked: SimulationOptions) -> Callable[[], None]:
    """Simulate a record and write it."""
    named = [text.partition("=")[0].partition(".")[0].strip() for text in asked.set_]
    offered = with_shipped(load_library(asked.library), named)
    coefficients, shapes = _settings(asked.set_, offered, papers=asked.library == DEFAULT_LIBRARY)
    tell("simulation")
    record = _simulated(Model(offered, coefficients, asked.reference_frequency, shapes), asked)
    write_record(record, asked.output)
    stop = record.stop_time.item()
    ending = f"; it stops at {stop:.4g} s" if stop == stop else ""
    return partial(print, f"{asked.output}: {record.sizes['time']} simulated samples{ending}.")


def _settings(
    texts: list[str], library: ForceLibrary, *, papers: bool
) -> tuple[dict[str, float], dict[str, float]]:
    """Coefficients and shape parameters from `lambda=1e-3`, `dahl.s=0.02`; the paper's if none is set."""
    values = assigned(texts, "--set '{}' must be SYMBOL=VALUE, such as lambda=1e-3.")
    for name, value in values.items():
        if abs(value) > MOST:
            raise UsageError(f"--set {name}: {value:g} is larger than {MOST:g}.")
    shapes = {name: value for name, value in values.items() if "." in name}
    coefficients = {name: value for name, value in values.items() if "." not in name}
    check_shapes(shapes, library)
    if not coefficients and (texts or not papers):
        raise UsageError("No force is given a coefficient: add one, such as --set zeta=0.01.")
    return coefficients or PAPER_COEFFICIENTS, shapes


def _simulated(model: Model, motion: SimulationOptions) -> xr.Dataset:
    """What `simulate` returns, with the noise in `angle`; numbers from which no record comes are refused."""
    duration, sampling_rate, noise = motion.duration, motion.sampling_rate, motion.noise
    samples = round(duration * sampling_rate)
    if not 2 <= samples <= MAX_SAMPLES:
        raise UsageError(
            f"{duration:g} s at {sampling_rate:g} Hz must be 2 to {MAX_SAMPLES:,} samples; "
            "change --duration or --sampling-rate."
        )
    if duration * model.reference_frequency > 2.0 * np.pi * MAX_PERIODS:
        raise UsageError(
            f"{duration:g} s at {model.reference_frequency:g} rad/s are more than {MAX_PERIODS:,} periods; "
            "shorten --duration, or lower --reference-frequency."
        )
    if motion.seed < 0:
        raise UsageError(f"--seed '{motion.seed}' must be a whole number, 0 or more.")
    time = np.arange(samples) / sampling_rate
    density, seed = motion.random_force, motion.seed
    record = motion_of(model, time, motion.angle0, motion.rate0, random_force=density, seed=seed)
    record["angle"] = record.angle + noise * np.random.default_rng(seed).standard_normal(samples)
    record.angle.attrs = {"units": "rad", "long_name": "angle"}
    disturbed = f", random force {density:g} {DENSITY_UNITS}" if density else ""
    source = f"simulated by sysid_trib, noise {noise:g} rad{disturbed}, seed {seed}"
    return record.assign_attrs(source=source, synthetic="yes")


def write_record(record: xr.Dataset, target: Path) -> None:
    """Write a record as CSV (`time (s)`, `angle (rad)`) or netCDF, by the file's ending."""
    if target.suffix.lower() == ".csv":
        table = record.angle.to_dataframe()[["angle"]].rename(columns={"angle": "angle (rad)"})
        write_file(target, table.to_csv(index_label="time (s)").encode())
    else:
        save(record, target)
