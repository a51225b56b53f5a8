"""Errors of the model: two runs of a rig that lacks an effect, differences of coefficients over their errors.

Simulated rigs: lambda, zeta, delta, nu, epsilon drawn at random, and one effect that is not offered, of ten
kinds: the sensor's curve (odd, even), even forces, Stribeck friction, drag that grows with the angle, drift
of the frequency and of friction, coarse steps of the sensor. Two runs each, released at the amplitude and at
60 % of it. Where the errors are right the RMS of the differences over them is one.
"""

import warnings
from argparse import Namespace
from contextlib import suppress
from dataclasses import replace

import numpy as np
import xarray as xr
from helpers import library_of_formulas, rms

import sysid_trib as st
from benchmarks.study.common import shown
from sysid_trib.errors import SysidTribError

BASE = ("lambda", "zeta", "delta", "nu", "epsilon")
FIVE = st.load_library().select(BASE)
NOISE, TIME = 3e-4, np.arange(0.0, 30.0, 0.02)
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
KINDS = (*FORCES, "odd curve", "even curve", "steps")


def logarithmic(random: np.random.Generator, low: float, high: float) -> float:
    """A number between two, each size as likely as the others."""
    return float(np.exp(random.uniform(np.log(low), np.log(high))))


def rig(kind: str, random: np.random.Generator) -> list[xr.Dataset]:
    """Two runs of one rig."""
    scale = logarithmic(random, 1e-3, 1e-2)
    ranges = ((0.0, 5e-4), (1e-3, 1e-2), (0.0, 0.04), (-0.1, 0.1), (-0.17, 0.1))
    values, library = {name: random.uniform(*of) for name, of in zip(BASE, ranges, strict=True)}, FIVE
    if kind in FORCES:
        formula, low, high = FORCES[kind]
        values["hidden"] = logarithmic(random, low, high) * random.choice([-1.0, 1.0])
        library = replace(FIVE, forces=(*FIVE, *library_of_formulas(hidden=formula)))
    model = st.Model(library, values, random.uniform(4.0, 12.0))
    amplitude, runs = random.uniform(0.3, 0.8), []
    for part in (1.0, 0.6):
        x = st.simulate(model, TIME, angle=part * amplitude).angle.values
        x = x + {"odd curve": 20 * scale * x**3, "even curve": 5 * scale * x**2}.get(kind, 0.0)
        x = x + NOISE * random.standard_normal(len(TIME))
        x = np.round(x / scale) * scale if kind == "steps" else x
        runs.append(st.free_decay(xr.Dataset({"angle": ("time", x, {"units": "rad"})}, {"time": TIME})))
    return runs


def drawn(kind: str, random: np.random.Generator) -> list[xr.Dataset]:
    """Two runs of a rig of this kind whose motion decays."""
    while True:
        with suppress(SysidTribError):
            return rig(kind, random)


def ratios(runs: list[xr.Dataset], method) -> tuple[np.ndarray, np.ndarray]:
    """Differences over the stated total errors, and over those by the noise."""
    pair = [st.identify(run, FIVE, method) for run in runs]
    apart = st.validation.difference(*pair)
    noises = [np.asarray(result.get("error_of_noise", result.standard_error)) for result in pair]
    return apart.z.values, apart.difference.values / np.hypot(*noises)


def main(asked: Namespace) -> None:
    warnings.simplefilter("ignore")
    random = np.random.default_rng(asked.first)
    found: dict[str, list] = {"averaging": [], "direct": []}
    for at in range(asked.seeds):
        runs = drawn(KINDS[at % len(KINDS)], random)
        for name, method in (("averaging", st.methods.Averaging()), ("direct", st.methods.Direct())):
            with suppress(SysidTribError):
                found[name].append(ratios(runs, method))
    rows = []
    for name, of_rigs in found.items():
        for kind, values in zip(("total", "by the noise"), np.array(of_rigs).swapaxes(0, 1), strict=True):
            figures = (*rms(values), *np.median(np.abs(values), axis=0))
            rows.append([name, kind, *(f"{figure:.2f}" for figure in figures), str(len(of_rigs))])
    heads = (*(f"{s}: RMS" for s in BASE), *(f"{s}: median" for s in BASE))
    shown("", ("method", "errors", *heads, "rigs"), rows, 170)
