"""Runs and samples held against each other: how often equal ones are said to differ, and unequal ones found.

agreement: pairs of runs of one motion that is pushed at random (20 periods from 0.3 and 0.25 rad, 60 samples
a period, sensor noise of 2e-4 rad, a wander of five noise levels); 0.3 to 3 % are to disagree at 1 %.
--unlike multiplies the density of the second run: what the test of the size of the random force then finds.
pairs: pairs of samples, equal and not, the model complete and not.
rigs: two runs, at an amplitude and at 60 % of it, of rigs with lambda, zeta, delta, nu, epsilon drawn at
random and one effect that is not offered: the sensor's curve (odd, even), even forces, Stribeck friction,
drag that grows with the angle, drift of the frequency and of friction, coarse steps of the sensor. Where the
total errors are right the RMS of the differences of the coefficients over them is one.
spread: round-robins of eight laboratories with three runs each. A coefficient has a spread between
laboratories and one between their runs, none to three stated errors in size; errors differ by a factor of e.
Of these the intervals of `between_runs` (spread, effect of the load, values of the runs) and of ISO 5725 are
counted.
"""

import warnings
from argparse import Namespace
from collections import Counter
from contextlib import suppress
from dataclasses import replace

import numpy as np
import xarray as xr
from helpers import library_of_formulas, measured, rms
from scipy.stats import binomtest, chi2, ncx2, t as student
from test_between_runs import runs_of

import sysid_trib as st
from benchmarks.study.common import METHODS, Pushed, over_seeds, shown, uniform
from sysid_trib.errors import SysidTribError
from sysid_trib.questions.difference import held_against
from sysid_trib.validation import run_agreement

LEVEL = 0.01
RUNS = (Pushed(5.0), Pushed(5.0, start=0.25))


def agreement(asked: Namespace) -> None:
    name = asked.method or "direct"
    method, library = METHODS[name], RUNS[0].model.library

    def pairs_of(seeds: list[int]):
        pairs = [
            run.records([2 * seed + at for seed in seeds], stream=(3,), times=asked.unlike if at else 1.0)
            for at, run in enumerate(RUNS)
        ]
        return map(list, zip(*pairs, strict=True))

    def one(decays: list[xr.Dataset]) -> dict:
        runs = run_agreement(decays, st.identify(decays, library, method))
        words = {"p_value": "total_p_value", "density_p_value": "density_p_value"}
        return {key: runs[word].item() for key, word in words.items() if word in runs}

    rows = over_seeds(asked, one, pairs_of, method=name, unlike=f"{asked.unlike:g}")
    print(f"{len(rows)} pairs, {sum('failed' in row for row in rows)} failed")
    for key, title in (("p_value", "forces"), ("density_p_value", "size of the random force")):
        values = np.array([row[key] for row in rows if key in row], dtype=float)
        known = values[np.isfinite(values)]
        if not len(known):
            continue
        rejected = int(np.sum(known < LEVEL))
        low, high = (100.0 * end for end in binomtest(rejected, len(known)).proportion_ci())
        print(
            f"{title}: {rejected} of {len(known)} disagree at 1 %: {100.0 * rejected / len(known):.2f} % "
            f"({low:.2f} to {high:.2f}); at 5 %: {100.0 * np.mean(known < 0.05):.1f} %; p-values uniform by "
            f"Kolmogorov and Smirnov: {uniform(known):.2g}"
        )


SAMPLE = {"lambda": 2e-4, "zeta": 0.0097, "delta": 0.037, "nu": -0.4, "epsilon": 0.3}
SAMPLE_TIME, SAMPLE_NOISE = np.arange(0.0, 25.0, 0.01), 2e-4
# By so many standard errors of the bound the second sample's zeta differs, all others being equal.
SHIFT = 4.0
# Forces that are fitted.
FITTED = {"model complete": (*SAMPLE,), "epsilon left out": ("lambda", "zeta", "delta", "nu")}


def pairs(asked: Namespace) -> None:
    library = st.load_library().select(list(SAMPLE))
    model = st.Model(library, SAMPLE, 9.91)
    bound = st.validation.cramer_rao_bound(model, SAMPLE_TIME, 0.26, 0.0, SAMPLE_NOISE, free=True)
    at, covariance = [*SAMPLE].index("zeta"), bound.covariance.sel(force=[*SAMPLE], other_force=[*SAMPLE])
    step = SHIFT * np.sqrt(2.0) * np.linalg.inv(covariance.values)[at, at] ** -0.5
    shifted = st.Model(library, SAMPLE | {"zeta": SAMPLE["zeta"] + step}, 9.91)
    power = ncx2.sf(chi2.isf(LEVEL, len(SAMPLE)), len(SAMPLE), SHIFT**2)
    print(f"unequal: zeta by {step:.2e}; found by the bound's chi-square with probability {power:.3f}")

    def decay_of(model: st.Model, seed: int) -> xr.Dataset:
        return st.free_decay(measured(model, SAMPLE_TIME, 0.26, noise=SAMPLE_NOISE, seed=seed))

    for fit, forces in FITTED.items():
        for kind, second in (("equal", model), ("unequal", shifted)):

            def one(seed: int, forces=forces, second=second) -> dict:
                samples = [decay_of(model, 2 * seed)], [decay_of(second, 2 * seed + 1)]
                difference = held_against(*samples, library.select(list(forces)), st.methods.Direct())
                return {"verdict": difference.attrs["verdict"]}

            if asked.only in (title := f"{kind}, {fit}"):
                said = Counter(row.get("verdict", "failed") for row in over_seeds(asked, one, case=title))
                counts = ", ".join(f"{name} {100.0 * n / asked.seeds:.1f} %" for name, n in said.items())
                print(f"{title:28} {counts}", flush=True)


BASE = {"lambda": (0.0, 5e-4), "zeta": (1e-3, 1e-2), "delta": (0.0, 0.04), "nu": (-0.1, 0.1)}
BASE |= {"epsilon": (-0.17, 0.1)}
FIVE = st.load_library().select(BASE)
RIG_NOISE, RIG_TIME = 3e-4, np.arange(0.0, 30.0, 0.02)
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


def rig(kind: str, random: np.random.Generator) -> list[xr.Dataset]:
    """Two runs of one rig."""
    scale = np.exp(random.uniform(*np.log([1e-3, 1e-2])))
    values, library = {name: random.uniform(*of) for name, of in BASE.items()}, FIVE
    if kind in FORCES:
        formula, *ends = FORCES[kind]
        values["hidden"] = np.exp(random.uniform(*np.log(ends))) * random.choice([-1.0, 1.0])
        library = replace(FIVE, forces=(*FIVE, *library_of_formulas(hidden=formula)))
    model = st.Model(library, values, random.uniform(4.0, 12.0))
    amplitude, runs = random.uniform(0.3, 0.8), []
    for part in (1.0, 0.6):
        x = st.simulate(model, RIG_TIME, angle=part * amplitude).angle.values
        x = x + {"odd curve": 20 * scale * x**3, "even curve": 5 * scale * x**2}.get(kind, 0.0)
        x = x + RIG_NOISE * random.standard_normal(len(RIG_TIME))
        x = np.round(x / scale) * scale if kind == "steps" else x
        runs.append(st.free_decay(xr.Dataset({"angle": ("time", x, {"units": "rad"})}, {"time": RIG_TIME})))
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


def rigs(asked: Namespace) -> None:
    warnings.simplefilter("ignore")
    random, found = np.random.default_rng(asked.first), {"averaging": [], "direct": []}
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


PLACES = np.repeat(np.arange(8), 3)
SLOPE, SPREADS = 0.5, (0.0, 0.5, 1.0, 3.0)
ISO = ("repeatability", "between_laboratory", "reproducibility")


def holds(fit: xr.Dataset, name: str, truth: float) -> bool:
    """Return whether an interval contains the truth."""
    return bool(fit[f"{name}_lower"] <= truth <= fit[f"{name}_upper"])


def of_spread(spread: float, count: int) -> list[str]:
    """Round-robins of numbers, by the spread between runs of one laboratory in stated errors."""
    random, runs, hold = np.random.default_rng([8, int(10 * spread)]), len(PLACES), []
    for _ in range(count):
        errors, load = np.exp(random.uniform(-0.5, 0.5, runs)), random.uniform(0.0, 4.0, runs)
        true = 3.0 + SLOPE * load + spread * random.standard_normal(runs)
        values = runs_of(true + errors * random.standard_normal(runs), errors)
        fit = st.campaigns.between_runs(values, {"load": load}).squeeze()
        inside, of_load = (
            np.abs(fit.shrunken - true) <= 1.96 * fit.shrunken_standard_error,
            fit.sel(term="load"),
        )
        wide = student.ppf(0.975, runs - 2) * of_load.effect_standard_error
        between = np.hypot(0.5, spread)
        each = between * random.standard_normal(8)[PLACES] + random.standard_normal(runs)
        measured_values = runs_of(each, np.full(runs, 0.1))
        iso = st.campaigns.between_runs(measured_values, {"place": PLACES}, laboratories="place").squeeze()
        truths = zip(ISO, (1.0, between, np.hypot(1.0, between)), strict=True)
        near = bool(abs(of_load.effect - SLOPE) <= wide)
        of_iso = [holds(iso, name, truth) for name, truth in truths]
        hold.append([holds(fit, "between_run", spread), near, float(inside.mean()), *of_iso])
    return [f"{spread:g}", *(f"{100.0 * share:.1f}" for share in np.mean(hold, axis=0))]


def spread(asked: Namespace) -> None:
    title = f"{asked.seeds} round-robins each: intervals of 95 % that hold (%)"
    heads = ("spread / stated error", "between runs", "load", "runs, shrunken", *ISO)
    shown(title, heads, (of_spread(each, asked.seeds) for each in SPREADS))
