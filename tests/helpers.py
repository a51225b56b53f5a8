"""Simulated decays with a known truth, and the limits within which statistics of many of them must lie."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.stats import binom, chi2

import sysid_trib as st
from sysid_trib import Model, load_library, methods
from sysid_trib.forces import ForceLibrary
from sysid_trib.forces.library import parse_library
from sysid_trib.printing import Layer
from sysid_trib.results.random_force import RandomForce
from sysid_trib.simulation.simulate import simulate
from sysid_trib.simulation.trajectory import trajectory

Array = NDArray[np.float64]

# Le Bot et al. 2019, Sec. 3: PDMS sphere on glass.
W = 9.91
SIX: dict[str, float] = {
    "lambda": -2.3e-5,
    "zeta": 0.0097,
    "delta": 0.037,
    "alpha": 0.0,
    "nu": -0.40,
    "epsilon": 0.30,
}
FIVE = {symbol: value for symbol, value in SIX.items() if symbol != "alpha"}
# Forces of a decay that a classical method describes, with nothing neglected.
OWN_MODELS = {
    kind: {load_library().role(formula).symbol: value for formula, value in kind.scope.example.items()}
    for kind in methods.METHODS
    if getattr(kind.scope, "example", {})
}
NOISE = 1e-4
# Odd forces that are not there.
EIGHT_MORE = {
    "cubic_damping": "v**3",
    "van_der_pol": "x**2*v",
    "positional_damping": "abs(x)*v",
    "structural_damping": "abs(x)*sign(v)",
    "quadratic_structural": "x**2*sign(v)",
    "quintic": "x**5",
    "inertial": "x*v**2",
    "mixed": "abs(v)*x",
}


@dataclass(frozen=True)
class Run:
    """A decay from rest, simulated from its model."""

    model: Model
    time: Array
    start: float = 0.3

    @property
    def angle(self) -> Array:
        """The motion without noise, rad."""
        return trajectory(self.model, self.time, self.start, 0.0).angle

    def decay(self, seed: int | None = None, noise: float = NOISE) -> xr.Dataset:
        """The decay with white noise."""
        return decay(self.time, self.angle, seed, noise)


def paper_run(
    coefficients: Mapping[str, float] = SIX, *, duration: float = 25.0, sampling_rate: float = 100.0
) -> Run:
    """The paper's run."""
    time = np.arange(round(duration * sampling_rate)) / sampling_rate
    return Run(Model(load_library(), coefficients, W), time)


def decay(
    time: Array, angle: Array, seed: int | None = None, noise: float = NOISE, units: str | None = None
) -> xr.Dataset:
    """Dataset with `angle(time)`, with white noise if there is a seed."""
    if seed is not None:
        angle = angle + noise * np.random.default_rng(seed).standard_normal(len(angle))
    return xr.Dataset({"angle": ("time", angle, {"units": units} if units else {})}, {"time": time})


def measured(
    model: Model, time: Array, start: float = 0.3, *, noise: float = NOISE, seed: int = 0, **simulated: object
) -> xr.Dataset:
    """A simulated record, the angle alone, in white noise."""
    angle = simulate(model, time, start, seed=seed, **simulated).angle.values
    return decay(time, angle, seed, noise)


def emps_record(folder: Path, input: str) -> xr.Dataset:
    """Read the motor axis EMPS among the measured records; `input` : a formula of its voltage `vir`."""
    path = folder / "emps" / "DATA_EMPS.mat"
    return st.read_record(path, angle="qm", time="t", units="m", input=input, between="linear")


def density_that_wanders(levels: float, noise: float, time: Array, w: float) -> float:
    """Density of a random force that lets an angle drift by this number of noise levels until the end."""
    return RandomForce.density_of(2.0 * (levels * noise) ** 2 / (w * time[-1]), w)


def scores(result: xr.Dataset, truth: Mapping[str, float]) -> Array:
    """Errors of coefficients over those that are stated."""
    result = result.sel(force=list(truth))
    return (result.coefficient.values - list(truth.values())) / result.standard_error.values


def library_of_formulas(**formulas: str) -> ForceLibrary:
    """Forces from `symbol=formula`."""
    entries = [{"symbol": symbol, "formula": formula} for symbol, formula in formulas.items()]
    return parse_library({"force": entries}, "test")


def values(result: xr.Dataset, truth: Mapping[str, float]) -> Array:
    """Coefficients in the truth's order."""
    return result.coefficient.sel(force=list(truth)).values


def over_seeds(run: Run, identify: Callable[[xr.Dataset], xr.Dataset], seeds: int) -> tuple[Array, Array]:
    """Errors of the coefficients and their standard errors, (seed, force)."""
    truth, exact, found = run.model.coefficients, run.angle, []
    for seed in range(seeds):
        result = identify(decay(run.time, exact, seed)).sel(force=list(truth))
        found.append((result.coefficient.values - list(truth.values()), result.standard_error.values))
    errors, reported = np.array(found).swapaxes(0, 1)
    return errors, reported


def rms(values: Array, axis: int = 0) -> Array:
    return np.sqrt(np.mean(np.asarray(values) ** 2, axis=axis))


def rms_range(count: int, chance: float = 1e-4) -> tuple[float, float]:
    """Return the range of the RMS of `count` standard normal numbers, with this chance on either side."""
    low, high = chi2.ppf([chance, 1.0 - chance], count)
    return float(np.sqrt(low / count)), float(np.sqrt(high / count))


def share_range(count: int, probability: float, chance: float = 1e-4) -> tuple[float, float]:
    """Return the range of the fraction of hits of this probability in `count` trials."""
    low, high = binom.ppf([chance, 1.0 - chance], count, probability)
    return float(low / count), float(high / count)


def correlated_noise(size: int, seed: int, correlation: float, noise: float = NOISE) -> Array:
    """First-order autoregressive noise."""
    white = np.random.default_rng(seed).standard_normal(size) * noise * np.sqrt(1.0 - correlation**2)
    found = np.empty(size)
    found[0] = white[0] / np.sqrt(1.0 - correlation**2)
    for i in range(1, size):
        found[i] = correlation * found[i - 1] + white[i]
    return found


def names(forces: Sequence[str], kept: Array) -> set[str]:
    return {symbol for symbol, yes in zip(forces, kept, strict=True) if yes}


def lengthened(tree: xr.DataTree, samples: int) -> xr.DataTree:
    """A cross-check with its record and motions at more instants, as a faster sampling would give them."""
    time = np.linspace(0.0, float(tree["record"].time[-1]), samples)
    longer = tree["record"].to_dataset().interp(time=time)
    return xr.DataTree.from_dict({k: v.to_dataset() for k, v in tree.children.items()} | {"record": longer})


def sentences_of(blocks, layer=Layer.EXPLAIN):
    """Sentences that a layer of a result shows."""
    return [sentence for block in blocks if layer in block.layers for sentence in block.sentences]
