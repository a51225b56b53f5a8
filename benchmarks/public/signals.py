"""Signals of a benchmark, and its split into a training part and tests."""

from dataclasses import dataclass, replace

import numpy as np
import xarray as xr
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Signals:
    """Input and output of one experiment.

    Parameters
    ----------
    u, y : (sample,) array of float
        Input and output, in the units of the benchmark.
    sampling_time : float, s
    """

    u: Array
    y: Array
    sampling_time: float

    def __len__(self) -> int:
        return len(self.y)

    def part(self, first: int, end: int | None = None) -> "Signals":
        """Return the samples from `first` up to `end`."""
        return replace(self, u=self.u[first:end], y=self.y[first:end])

    def record(self, units: "Units") -> xr.Dataset:
        """Return the record that `sysid_trib` identifies."""
        time = self.sampling_time * np.arange(len(self))
        driving = {"units": units.input, "role": "input", "between": units.between}
        data = {"angle": ("time", self.y, {"units": units.output}), "u": ("time", self.u, driving)}
        return xr.Dataset(data, {"time": ("time", time, {"units": "s"})})


@dataclass(frozen=True)
class Units:
    """Units of a benchmark, and how its input goes on between two samples (`linear`, `held`, `smooth`)."""

    input: str
    output: str
    between: str


@dataclass(frozen=True, eq=False)
class Test:
    """A test.

    Parameters
    ----------
    name : str
    signals : Signals
    start_samples : int
        Samples at its beginning whose output may be used, and which do not count.
    periodic : bool
        Whether its input is one period of a periodic one, and its output the steady response.
    submitted : bool
        Whether its RMSE is one of those to submit.
    """

    name: str
    signals: Signals
    start_samples: int
    periodic: bool = False
    submitted: bool = True

    @property
    def counted(self) -> Array:
        """Output of the samples that count."""
        return self.signals.y[self.start_samples :]


@dataclass(frozen=True, eq=False)
class Split:
    """A benchmark's training part and tests.

    Parameters
    ----------
    training : Signals
    tests : tuple of Test
    said : str
        A sentence that states what was used for training and for the tests.
    official : bool
        Whether the tests are the official ones, and their files were checked.
    """

    training: Signals
    tests: tuple[Test, ...]
    said: str
    official: bool
