"""What is each run's own in a result: its start, its noise, its group in a tree."""

from collections.abc import Mapping, Sequence

import xarray as xr
from numpy.typing import ArrayLike


def start_variables(
    starts: Sequence[tuple[float, float]], offsets: ArrayLike
) -> Mapping[str, tuple[ArrayLike, str, str]]:
    """Start and sensor's zero of each run, as `Estimate.extra` takes them.

    Parameters
    ----------
    starts : sequence of (float, float)
        Angle (rad) and rate (rad/s) at the first sample of each run.
    offsets : (run,) array_like of float, rad
        Zero of the sensor in each run.
    """
    angles, rates = zip(*starts, strict=True)
    return {
        "start_angle": (angles, "rad", "angle of the model at the first sample"),
        "start_rate": (rates, "rad/s", "rate of the model at the first sample"),
        "offset": (offsets, "rad", "zero of the sensor about the decay's equilibrium"),
    }


def run_noise(noises: Sequence[float]) -> Mapping[str, tuple[ArrayLike, str, str]]:
    """The sensor's noise (rad) of each run where there are several, as `Estimate.extra` takes it."""
    if len(noises) == 1:
        return {}
    return {"run_noise": (noises, "rad", "standard deviation of the sensor's noise in the run")}


def noise_of_run(result: xr.Dataset, run: int) -> float:
    """The sensor's noise in one run of an identification, rad."""
    return float(result.run_noise.values[run]) if "run_noise" in result else float(result.noise)


def group_names(name: str, count: int) -> list[str]:
    """Names of the runs' groups in a tree: `record`, or `record_1`, `record_2`, ... of several."""
    return [name] if count == 1 else [f"{name}_{at + 1}" for at in range(count)]


def record_groups(tree: xr.DataTree) -> list[str]:
    """Names of the records in a tree, in the order of the runs."""
    count = 0
    while f"record_{count + 1}" in tree.children:
        count += 1
    return group_names("record", max(1, count))
