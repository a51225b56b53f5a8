"""Errors of the model: two runs of a rig that lacks an effect, differences of coefficients over their errors.

python -m benchmarks.model_error [--rigs 200] [--seed 0]

Simulated rigs: lambda, zeta, delta, nu, epsilon drawn at random, and one effect that is not offered, of ten
kinds: the sensor's curve (odd, even), even forces, Stribeck friction, drag that grows with the angle, drift
of the frequency and of friction, coarse steps of the sensor. Two runs each, released at the amplitude and at
60 % of it. Where the errors are right the RMS of the differences over them is one.
"""

import argparse
import warnings
from contextlib import suppress

import numpy as np
import xarray as xr
from rich.console import Console
from rich.progress import track
from rich.table import Table

import sysid_trib as st
from sysid_trib.errors import SysidTribError

BASE = ("lambda", "zeta", "delta", "nu", "epsilon")
NOISE = 3e-4
# Extra forces by name: formula, and the range of their strength.
FORCES = {
    "even force": ("x**2", 0.01, 0.1),
    "even drag": ("abs(v)*v*v", 0.005, 0.03),
    "even damping": ("x*v", 0.01, 0.1),
    "stribeck": ("exp(-abs(v)/0.05)*sign(v)", 3e-4, 3e-3),
    "growing drag": ("x**2*v", 0.01, 0.1),
    "drift of the frequency": ("t*x/30", 3e-4, 3e-3),
    "drift of friction": ("t*sign(v)/30", 2e-4, 1e-3),
}
SENSORS = ("odd curve", "even curve", "steps")
KINDS = (*FORCES, *SENSORS)


def library(extra: str) -> st.forces.ForceLibrary:
    """The five forces and the one that is hidden."""
    from sysid_trib.forces.library import parse_library

    six = st.load_library().select(BASE)
    if not extra:
        return six
    from dataclasses import replace

    hidden = parse_library({"title": "hidden", "force": [{"symbol": "hidden", "formula": extra}]}, "hidden")
    return replace(six, forces=(*six.forces, *hidden.forces))


def rig(kind: str, random: np.random.Generator) -> list[xr.Dataset]:
    """Two runs of one rig."""
    formula, low, high = FORCES.get(kind, ("", 0.0, 0.0))
    scale = np.exp(random.uniform(np.log(1e-3), np.log(1e-2)))
    values = {
        "lambda": random.uniform(0.0, 5e-4),
        "zeta": random.uniform(1e-3, 1e-2),
        "delta": random.uniform(0.0, 0.04),
        "nu": random.uniform(-0.1, 0.1),
        "epsilon": random.uniform(-0.17, 0.1),
    }
    if formula:
        values["hidden"] = np.exp(random.uniform(np.log(low), np.log(high))) * random.choice([-1.0, 1.0])
    model = st.Model(library(formula), values, random.uniform(4.0, 12.0))
    amplitude, time = random.uniform(0.3, 0.8), np.arange(0.0, 30.0, 0.02)
    runs = []
    for part in (1.0, 0.6):
        x = st.simulate(model, time, angle=part * amplitude).angle.values
        if kind == "odd curve":
            x = x + 20 * scale * x**3
        if kind == "even curve":
            x = x + 5 * scale * x**2
        x = x + NOISE * random.standard_normal(len(time))
        if kind == "steps":
            x = np.round(x / scale) * scale
        runs.append(
            st.free_decay(
                xr.Dataset({"angle": ("time", x, {"units": "rad"})}, {"time": ("time", time, {"units": "s"})})
            )
        )
    return runs


def drawn(kind: str, random: np.random.Generator) -> list[xr.Dataset]:
    """Two runs of a rig of this kind whose motion decays."""
    while True:
        with suppress(SysidTribError):
            return rig(kind, random)


def ratios(runs: list[xr.Dataset], method) -> tuple[np.ndarray, np.ndarray]:
    """Differences over the stated total errors, and over those by the noise."""
    first, second = (st.identify(run, library(""), method) for run in runs)
    gap = st.validation.difference(first, second)
    total = gap.z.values
    noises = [np.asarray(r.get("error_of_noise", r.standard_error)) for r in (first, second)]
    return total, gap.difference.values / np.hypot(*noises)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--rigs", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    random = np.random.default_rng(options.seed)
    table = Table("method", "errors", *(f"{s}: RMS" for s in BASE), *(f"{s}: median" for s in BASE), "rigs")
    found: dict[str, list] = {"averaging": [], "direct": []}
    for at in track(range(options.rigs), console=Console(stderr=True), transient=True):
        runs = drawn(KINDS[at % len(KINDS)], random)
        for name, method in (("averaging", st.methods.Averaging()), ("direct", st.methods.Direct())):
            try:
                found[name].append(ratios(runs, method))
            except SysidTribError:
                continue
    for name, of_rigs in found.items():
        for kind, values in zip(("total", "by the noise"), np.array(of_rigs).swapaxes(0, 1), strict=True):
            rms, median = np.sqrt(np.mean(values**2, axis=0)), np.median(np.abs(values), axis=0)
            table.add_row(name, kind, *(f"{v:.2f}" for v in (*rms, *median)), str(len(of_rigs)))
    Console(width=170).print(table)


if __name__ == "__main__":
    main()
