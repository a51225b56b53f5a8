"""Is "explained with a random force" said where it is true, and not where a force was left out?

First motions with nothing beside the sensor's noise: they are explained. Then motions that are pushed by a
white force alone: p-values of `random_force_dependence` are uniform. Then motions without a random force in
which one effect of the library acts that the model has not: its coefficient is 60 to 200 standard errors of a
fit that offers it (Cramér-Rao bound in white noise as strong as that of the sensor at the frequency of the
swing).
"""

import time as clock
from argparse import Namespace
from collections import Counter

import numpy as np
import xarray as xr
from helpers import correlated_noise

import sysid_trib as st
from benchmarks.study.common import METHODS, NOISE, W, density_of, time_of
from sysid_trib.errors import SysidTribError
from sysid_trib.likelihood.random_force import random_force_of

PER_PERIOD, ANGLE = 60, 0.3
TRUTH = {"zeta": 5e-3, "delta": 2e-3, "epsilon": -0.1}
OFFERED = st.load_library("contact_forces").select(TRUTH)
EFFECTS = st.load_library("candidate_effects")
TIME = time_of(20, PER_PERIOD)
# Autocorrelation of the sensor's noise from sample to sample.
NOISES = {"white": 0.0, "AR(0.8)": 0.8}


def decay_of(model: st.Model, noise: str, seed: int, wander: float = 0.0) -> xr.Dataset:
    """A simulated record with the sensor's noise."""
    angle = st.simulate(model, TIME, ANGLE, random_force=density_of(wander, TIME), seed=seed).angle
    return xr.Dataset({"angle": angle + correlated_noise(len(TIME), seed, NOISES[noise], NOISE)})


def noise_at_swing(noise: str) -> float:
    """Standard deviation of white noise that is as strong as the sensor's at the swing's frequency, rad."""
    correlation, turn = NOISES[noise], np.exp(-2j * np.pi / PER_PERIOD)
    return float(NOISE * np.sqrt(1.0 - correlation**2) / np.abs(1.0 - correlation * turn))


def verdict_of(decay: xr.Dataset, method) -> tuple[str, float]:
    """What is said of a record, and the p-value of a random force that depends on nothing (nan: none)."""
    result = st.identify(decay, OFFERED, method)
    tree = st.cross_check(decay, result, result, draws=1)
    p = tree["random_force"].p_value.item() if "random_force" in tree.children else np.nan
    return tree["comparison"].attrs["verdict_on_record"], p


def p_value(decay: xr.Dataset, method) -> float:
    """Of a random force that depends on nothing; nan where no random force was found."""
    result = st.identify(decay, OFFERED, method)
    if not random_force_of(result):
        return float("nan")
    return st.validation.random_force_dependence(decay, result).p_value.item()


def tried(call, *given):
    """What a call gives, None where it is refused."""
    try:
        return call(*given)
    except SysidTribError:
        return None


def counted(verdicts) -> str:
    return ", ".join(f"{name} {count}" for name, count in Counter(verdicts).items())


def pushed(method, noise: str, wander: float, seeds: range) -> str:
    """One line: how often a random force is called dependent."""
    model = st.Model(OFFERED, TRUTH, W)
    values = [tried(p_value, decay_of(model, noise, seed, wander), method) for seed in seeds]
    given = np.array([value for value in values if value is not None])
    known = given[np.isfinite(given)]
    rates = ", ".join(f"{100.0 * np.mean(known < level):.1f} %" for level in (0.01, 0.1, 0.5))
    return (
        f"pushed, wander {wander:2}: p below 1, 10, 50 %: {rates} of {len(known)} records; "
        f"no random force found {len(given) - len(known)}, failed {len(values) - len(given)}"
    )


def left_out(method, noise: str, seeds: range) -> str:
    """One line: the verdicts where a force is left out, and where they are wrong."""
    effects = [force for force in EFFECTS if force.kind == "force"]
    missed, verdicts, failed = [], [], []
    for seed in seeds:
        force = effects[seed % len(effects)]
        model = tried(with_effect, force, np.random.default_rng(seed), noise_at_swing(noise))
        if model is None:
            continue
        said = tried(verdict_of, decay_of(model, noise, seed), method)
        if said is None:
            failed.append(force.symbol)
            continue
        verdicts.append(said[0])
        if said[0] != "not explained":
            missed.append(f"{force.symbol} ({said[0]}, p {said[1]:.2g})")
    wrong, without = (", ".join(symbols) or "none" for symbols in (missed, failed))
    return f"left out: {counted(verdicts)}; wrong: {wrong}; no identification: {without}"


def with_effect(force: st.forces.Force, random: np.random.Generator, noise: float) -> st.Model | None:
    """The model with an effect of 60 to 200 standard errors; None where no such motion exists."""
    zero, coefficient = EFFECTS["bias"], 1e-4
    if force.symbol == zero.symbol:
        return None
    library = st.forces.ForceLibrary("with one that is left out", (*OFFERED, force))
    # The bound takes the sensor's zero as known; a constant force is the same as one that is fitted.
    whole, shapes = st.forces.ForceLibrary("with a free zero", (*library, zero)), library.shape_values()
    # The error hardly depends on the coefficient, but where the force makes switchings.
    for _ in range(3):
        model = st.Model(whole, TRUTH | {force.symbol: coefficient, zero.symbol: 0.0}, W, shapes)
        bound = st.validation.cramer_rao_bound(model, TIME, ANGLE, 0.0, noise, free=True)
        coefficient = 60.0 * bound.standard_error.sel(force=force.symbol).item()
    if not np.isfinite(coefficient) or coefficient > 1.0:
        return None
    factor = float(np.exp(random.uniform(0.0, np.log(200.0 / 60.0))))
    return st.Model(library, TRUTH | {force.symbol: factor * coefficient}, W, shapes)


def main(asked: Namespace) -> None:
    seeds, start = range(asked.first, asked.first + asked.seeds), clock.process_time()
    for name in [asked.method] if asked.method else ("trajectory", "direct"):
        method = METHODS[name]
        print(f"{name}, {asked.noise} noise")
        if not asked.left_out:
            model = st.Model(OFFERED, TRUTH, W)
            said = (verdict_of(decay_of(model, asked.noise, seed), method)[0] for seed in seeds)
            print(f"noise alone: {counted(said)}", flush=True)
            for wander in (1, 5, 20):
                print(pushed(method, asked.noise, wander, seeds), flush=True)
        print(left_out(method, asked.noise, seeds), flush=True)
    print(f"{clock.process_time() - start:.0f} s")
