"""Several runs of one experiment: their decays, and what is each run's own in a result."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from sysid_trib.errors import UsageError

Decays: TypeAlias = xr.Dataset | Sequence[xr.Dataset]


def as_runs(decay: Decays) -> list[xr.Dataset]:
    """The runs as a list, also if there is one.

    Raises
    ------
    UsageError
        None is given, or one is no decay.
    """
    runs = [decay] if isinstance(decay, xr.Dataset) else list(decay)
    if not runs:
        raise UsageError("No run is given; give at least one decay.")
    for run in runs:
        if not isinstance(run, xr.Dataset) or "angle" not in run:
            raise UsageError(
                f"A decay is a Dataset with angle(time), not {type(run).__name__}: free_decay(record)."
            )
    return runs


def root_mean_square(values: ArrayLike) -> float:
    """RMS of numbers; of one it is that number itself."""
    each = np.asarray(values, dtype=float)
    return float(each[0]) if len(each) == 1 else float(np.sqrt(np.mean(each**2)))


def start_variables(
    starts: Sequence[tuple[float, float]], offsets: ArrayLike
) -> Mapping[str, tuple[ArrayLike, str, str]]:
    """Start and sensor's zero of each run, as `Estimate.extra` takes them."""
    angles, rates = zip(*starts, strict=True)
    return {
        "start_angle": (angles, "rad", "angle of the model at the first sample"),
        "start_rate": (rates, "rad/s", "rate of the model at the first sample"),
        "offset": (offsets, "rad", "zero of the sensor about the decay's equilibrium"),
    }


def run_noise(noises: Sequence[float]) -> Mapping[str, tuple[ArrayLike, str, str]]:
    """The noise of each run where there are several, as `Estimate.extra` takes it."""
    if len(noises) == 1:
        return {}
    return {"run_noise": (noises, "rad", "standard deviation of the noise of the run")}


def noise_of_run(result: xr.Dataset, run: int) -> float:
    """Noise of one run of an identification, rad."""
    return float(result.run_noise.values[run]) if "run_noise" in result else float(result.noise)


def one_or_all(runs: Sequence[xr.Dataset]) -> Decays:
    """The decay itself where there is but one."""
    return runs[0] if len(runs) == 1 else list(runs)


def group_names(name: str, count: int) -> list[str]:
    """Names of the runs' groups in a tree: `record`, or `record_1`, `record_2`, ... of several."""
    return [name] if count == 1 else [f"{name}_{at + 1}" for at in range(count)]


def record_groups(tree: xr.DataTree) -> list[str]:
    """Names of the records in a tree, in the order of the runs."""
    count = 0
    while f"record_{count + 1}" in tree.children:
        count += 1
    return group_names("record", max(1, count))
